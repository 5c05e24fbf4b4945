"""Periods of clear, variable and overcast sky, told by the diffuse fraction of the irradiance.

Andriamahefa et al. (2023), section 4, tell them by eye from DHI/GHI: it "remains always less than 0.5" in the clear
period, is 1 in the overcast one, and varies strongly in the variable one.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array

Kind = Literal["clear", "overcast", "variable"]
CLEAR_BELOW = 0.5
OVERCAST_ABOVE = 0.9
SHORTEST_S = 3600.0
LOWEST_SUN_DEG = 7.0
"""Under a lower sun the light of a clear sky is mostly diffuse, and the diffuse fraction tells nothing."""

_MINUTE_S = 60.0
_LONGEST_GAP_S = 900.0


@dataclass(frozen=True, slots=True)
class Period:
    """A stretch of time under one kind of sky, `end_utc_s` not included."""

    kind: Kind
    start_utc_s: float
    end_utc_s: float


def sky_periods(utc_s: ArrayLike, diffuse_fraction: ArrayLike, shortest_s: float = SHORTEST_S) -> list[Period]:
    """Divide the time of the readings into periods.

    A stretch of at least `shortest_s` in which the mean of every minute is below 0.5 is clear, one in which it is above
    0.9 is overcast, and all the rest is variable. A gap of more than a quarter of an hour ends a period.

    Parameters
    ----------
    utc_s, diffuse_fraction
        Rising instants [s] and DHI/GHI then, shape (n,); NaN is no reading.
    shortest_s
        Shortest clear or overcast period [s].
    """
    time = np.asarray(utc_s, dtype=np.float64)
    fraction = np.asarray(diffuse_fraction, dtype=np.float64)
    known = np.isfinite(fraction)
    if not known.any():
        return []
    minutes, which = np.unique(np.floor(time[known] / _MINUTE_S), return_inverse=True)
    mean = np.bincount(which, fraction[known]) / np.bincount(which)
    kinds = np.where(mean < CLEAR_BELOW, 0, np.where(mean > OVERCAST_ABOVE, 1, 2))
    names: tuple[Kind, ...] = ("clear", "overcast", "variable")
    starts = minutes * _MINUTE_S
    periods: list[Period] = []
    for first, last in _stretches(starts, np.ones_like(kinds)):
        part = slice(first, last + 1)
        inside = kinds[part].copy()
        for begin, end in _stretches(starts[part], inside):
            if starts[part][end] + _MINUTE_S - starts[part][begin] < shortest_s:
                inside[begin : end + 1] = 2
        for begin, end in _stretches(starts[part], inside):
            periods.append(Period(names[inside[begin]], starts[part][begin], starts[part][end] + _MINUTE_S))
    return [Period(each.kind, float(each.start_utc_s), float(each.end_utc_s)) for each in periods]


def diffuse_fraction_of_faces(faces: ArrayLike, albedo: float = 0.2) -> Array:
    """Return DHI/GHI as the cube sees it, (2 I_min - albedo I_Z) / I_Z within 0..1; NaN without light.

    The better approximation of the diffuse light that Andriamahefa et al. (2023) offer. `faces` are irradiances [W/m2]
    of shape (..., 4) in the order east, south, west, zenith.
    """
    readings = np.asarray(faces, dtype=np.float64)
    east, west, zenith = readings[..., 0], readings[..., 2], readings[..., 3]
    lit = zenith > 0.0
    diffuse = 2.0 * np.minimum(east, west) - albedo * zenith
    fraction = np.divide(diffuse, zenith, out=np.full(zenith.shape, np.nan), where=lit)
    clipped: Array = np.clip(fraction, 0.0, 1.0)
    return clipped


def _stretches(starts_s: Array, kinds: NDArray[np.int_]) -> list[tuple[int, int]]:
    """First and last place of each run of one kind without a long gap."""
    breaks = (np.diff(kinds) != 0) | (np.diff(starts_s) > _LONGEST_GAP_S)
    edges = np.flatnonzero(breaks)
    firsts, lasts = np.concatenate([[0], edges + 1]), np.concatenate([edges, [len(starts_s) - 1]])
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))
