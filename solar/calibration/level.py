"""The level of the gains where something other than the clear-sky model tells it: a referenced face, or a GHI nearby.

A face with a calibration of its own has a known response. A pyranometer nearby reads the G of the same clear sky; e_z
is the zenith face's reading, turned to the horizontal, over that. Either is one more measurement beside those of
:mod:`.anchor`, with the weight that its uncertainty gives it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solar.calibration.shape import RelativeCalibration
from solar.frames import FACE_NORMALS, Array

_ZENITH = len(FACE_NORMALS) - 1
_LEAST_COMMON = 8
# Beyond these the other instrument sees another sky, or its clock, place or unit is wrong.
_LARGEST_SPREAD, _LARGEST_RATIO = 0.02, 1.3
# From this step on it matters to which instant of its span a mean belongs.
_LONG_STEP_S = 150.0


class KnownResponse(NamedTuple):
    """A response (reading over truth) known from elsewhere, and its relative standard error (one sigma)."""

    response: float
    error: float


@dataclass(frozen=True, slots=True)
class LevelReference:
    """What is known from elsewhere of how much the faces respond.

    Attributes
    ----------
    faces
        Ties of east, south, west and zenith; None for a face that has none.
    ghi_w_m2
        Global horizontal irradiance by a pyranometer nearby at the instants of the readings, shape (n,), NaN where it
        has none; None without such an instrument.
    ghi_error
        Relative standard error of that instrument's own calibration (one sigma).
    ghi_step_s
        How far apart its values are.
    """

    faces: tuple[KnownResponse | None, KnownResponse | None, KnownResponse | None, KnownResponse | None] = (
        None,
        None,
        None,
        None,
    )
    ghi_w_m2: Array | None = None
    ghi_error: float = 0.0075
    ghi_step_s: float = 60.0


def known_responses(
    level: LevelReference, shape: RelativeCalibration, vertical: float, zenith_over_ghi: Array
) -> tuple[KnownResponse | None, KnownResponse | None]:
    """Return what is known of the responses e_z of the zenith face and e_v of the vertical faces' geometric mean.

    Parameters
    ----------
    shape, vertical
        The fit, and the ratio v that it was made with; its responses are relative to the zenith face's.
    zenith_over_ghi
        Z / G at the instants of the fit, shape (m,), by the pyranometer nearby; NaN where it has no reading.

    Raises
    ------
    ValueError
        The pyranometer and the zenith face do not agree; the text says how.
    """
    of_zenith = [level.faces[_ZENITH]]
    if level.ghi_w_m2 is not None:
        of_zenith.append(KnownResponse(_ratio(zenith_over_ghi, level.ghi_step_s), level.ghi_error))
    of_vertical = [
        None if tie is None else KnownResponse(tie.response * vertical / float(shape.response[face]), tie.error)
        for face, tie in enumerate(level.faces[:_ZENITH])
    ]
    return _combined_tie(of_zenith), _combined_tie(of_vertical)


def _ratio(zenith_over_ghi: Array, step_s: float) -> float:
    logs = np.log(zenith_over_ghi[np.isfinite(zenith_over_ghi) & (zenith_over_ghi > 0.0)])
    if logs.size < _LEAST_COMMON:
        raise ValueError(
            f"clear sky that the GHI nearby has as well: {logs.size} quarters of an hour, where {_LEAST_COMMON} are "
            "needed (are its times in UTC?)"
        )
    middle = float(np.median(logs))
    spread = 1.4826 * float(np.median(np.abs(logs - middle)))
    if not spread <= _LARGEST_SPREAD:
        apart = f"its values are {step_s / 60:g} min apart: is each mean's time the middle of its span? "
        means = apart if step_s > _LONG_STEP_S else ""
        raise ValueError(
            f"a GHI nearby that agrees with the zenith face: their ratio varies by {spread:.1%} from one quarter of an "
            f"hour to the next, where {_LARGEST_SPREAD:.0%} is allowed ({means}are its times in UTC? is a clock "
            "minutes off? does it see another sky?)"
        )
    if not abs(middle) <= np.log(_LARGEST_RATIO):
        raise ValueError(
            f"a GHI nearby that agrees with the zenith face: the face reads {np.exp(middle):.2f} times as much (is the "
            "GHI in W/m2? are the gains right?)"
        )
    return float(np.exp(middle))


def _combined_tie(known: Sequence[KnownResponse | None]) -> KnownResponse | None:
    """Return the mean of logarithms, each weighted by 1 / error^2."""
    there = [tie for tie in known if tie is not None]
    if not there:
        return None
    weights = np.array([tie.error**-2.0 for tie in there])
    logs = np.log([tie.response for tie in there])
    return KnownResponse(float(np.exp(weights @ logs / weights.sum())), float(weights.sum() ** -0.5))
