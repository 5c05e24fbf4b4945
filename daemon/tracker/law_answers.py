"""What a law answers, checked and in numbers of Python: anybody may have written it, and with numpy."""

import json
import math
from collections.abc import Mapping
from typing import Any

from solar.ephemeris import SunPosition
from solar.frames import Angles, Limits
from solar.laws.law import Aim


def checked_aim(found: object, limits: Limits) -> Aim:
    """Return what a law says, its target inside the limits; `TypeError` or `ValueError` for what is no answer."""
    if not isinstance(found, Aim):
        raise TypeError(f"{type(found).__name__} is no Aim")
    if not isinstance(found.sun, SunPosition):
        raise TypeError(f"the sun of its Aim is {found.sun!r}, no SunPosition")
    return Aim(
        azimuth_deg=float(found.azimuth_deg),
        elevation_deg=float(found.elevation_deg),
        sun=SunPosition(*map(float, found.sun)),
        target=None if found.target is None else _checked_target(found.target, limits),
        why=str(found.why or ""),
        beam_w_m2=float(found.beam_w_m2),
        diffuse_w_m2=float(found.diffuse_w_m2),
        albedo=float(found.albedo),
    )


def _checked_target(target: Angles, limits: Limits) -> Angles:
    if not isinstance(target, tuple) or len(target) != len(Angles._fields):
        raise TypeError(f"its target is {target!r}, no Angles")
    a_deg, b_deg = map(float, target)
    if not (math.isfinite(a_deg) and math.isfinite(b_deg)):
        raise ValueError(f"its target is A {a_deg:g}, B {b_deg:g} deg: a law that has none says None")
    return limits.clip(a_deg, b_deg)


def checked_kept(found: object) -> dict[str, Any] | None:
    """Return what a law wants kept as it will be read again; `TypeError` for what no file of kept state holds."""
    if found is None:
        return None
    if not isinstance(found, Mapping):
        raise TypeError(f"what it wants kept is {found!r}, no mapping")
    kept: dict[str, Any] = json.loads(json.dumps(dict(found), default=float))
    return kept


def checked_shown(found: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return what a law shows of itself; an error of Python's for what is no mapping of mappings of numbers."""
    return {str(part): {str(name): float(value) for name, value in of.items()} for part, of in found.items()}
