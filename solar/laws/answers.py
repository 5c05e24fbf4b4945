"""A law's answer, checked and in Python's own numbers: anybody may have written the law, and with numpy."""

import math

from solar.ephemeris import SunPosition
from solar.frames import Angles, Limits
from solar.laws.law import Aim


def checked_aim(found: object, limits: Limits) -> Aim:
    """Return what a law says, its target inside the limits; `TypeError` or `ValueError` for an invalid answer."""
    if not isinstance(found, Aim):
        raise TypeError(f"{type(found).__name__} is not an Aim")
    if not isinstance(found.sun, SunPosition):
        raise TypeError(f"the sun of its Aim is {found.sun!r}, not a SunPosition")
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
        raise TypeError(f"its target is {target!r}, not Angles")
    a_deg, b_deg = map(float, target)
    if not (math.isfinite(a_deg) and math.isfinite(b_deg)):
        raise ValueError(f"its target is A {a_deg:g}, B {b_deg:g} deg: a law without a target answers None")
    return limits.clip(a_deg, b_deg)
