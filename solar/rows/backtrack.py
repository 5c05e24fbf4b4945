"""Backtracking with two axes: the pose nearest to the wanted one in which no tracker of a group shades another.

A row of one axis turns back to the angle at which its shadow ends at the next row's edge (Lorenzo et al. (2011),
Progress in Photovoltaics 19, pvlib's :func:`pvlib.tracking.singleaxis`). With two axes many poses have no shade. The
one taken has the normal that is nearest to the wanted one and no steeper: turning beyond the sun ends the shade as well
as turning back does, but sees less of the sky. It is found by search, over the limits' whole range and then ever closer
around the best: to a few hundredths of a degree across the edge of the shade, and to some tenths along it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array, Limits, normal_from_angles
from solar.rows.group import TrackerGroup

_COARSE_DEG = 5.0
_FINE = np.linspace(-1.0, 1.0, 7)
_REFINING_FACTOR = 3
_REFINEMENTS = 5
# Instants that are searched side by side: more need more memory, and are slower.
_ROWS_AT_ONCE = 8
# Added to the squared distance from the wanted pose, which is 4 at most: any steeper pose costs more than every pose
# that is not, and any pose with shade more than every pose without.
_STEEPER_COST = 5.0
_SHADED_COST = 10.0
_STEEPNESS_TOLERANCE = 1e-9
_FREE_SHARE = 1e-6
_LOWEST_SUN = 1e-3


def out_of_shade(
    group: TrackerGroup, suns: Sequence[ArrayLike], a_deg: ArrayLike, b_deg: ArrayLike, limits: Limits
) -> tuple[Array, Array]:
    """Return the poses (a_deg, b_deg) inside `limits`, nearest to the given ones, that have no shade.

    Where every pose has shade, the one with the least is returned. Poses without shade, and NaN, are returned as they
    are.

    Parameters
    ----------
    group
        The trackers; all of them are taken to stand in the pose that is returned.
    suns
        Unit vectors to the sun, each of shape (..., 3), at the instants that the pose is for: the beginning and the end
        of a rest, for a pose at the very edge of the shade may be in it some minutes later. A sun below the horizon is
        taken to be on it, so that the evening's last pose lasts.
    a_deg, b_deg
        The wanted poses [deg], shape (...).
    """
    a, b = (np.array(angle, dtype=np.float64) for angle in np.broadcast_arrays(a_deg, b_deg))
    instants = _instants(suns, a.shape)
    shares = [group.worst_shaded_share(sun, a, b) for sun in instants]
    known = np.isfinite(a) & np.isfinite(b) & np.isfinite(instants).all(axis=(0, -1))
    shaded = np.flatnonzero((np.max(shares, axis=0) > _FREE_SHARE) & known)
    rows = instants.reshape(len(instants), -1, 3)
    found_a, found_b = a.reshape(-1), b.reshape(-1)
    for first in range(0, shaded.size, _ROWS_AT_ONCE):
        some = shaded[first : first + _ROWS_AT_ONCE]
        found_a[some], found_b[some] = _nearest(group, rows[:, some], found_a[some], found_b[some], limits)
    return found_a.reshape(a.shape), found_b.reshape(b.shape)


def backtracked_poses(
    group: TrackerGroup, suns: Sequence[ArrayLike], a_deg: ArrayLike, b_deg: ArrayLike, limits: Limits
) -> tuple[Array, Array]:
    """Return the poses of `out_of_shade`; a group with `only_if_it_pays` turns only where it gets more beam by that."""
    turned = out_of_shade(group, suns, a_deg, b_deg, limits)
    if not group.only_if_it_pays:
        return turned
    wanted = np.broadcast_arrays(*(np.asarray(angle, dtype=np.float64) for angle in (a_deg, b_deg)))
    differ = (turned[0] != wanted[0]) | (turned[1] != wanted[1])
    instants = _instants(suns, differ.shape)[:, differ]
    there, here = (
        sum(group.beam_share(sun, a[differ], b[differ]) for sun in instants) for a, b in (turned, tuple(wanted))
    )
    pays = np.zeros(differ.shape, dtype=np.bool_)
    pays[differ] = there > here
    return np.where(pays, turned[0], wanted[0]), np.where(pays, turned[1], wanted[1])


def _instants(suns: Sequence[ArrayLike], shape: tuple[int, ...]) -> Array:
    """Return directions of shape (instants, *shape, 3), with those from below the horizon brought up to it."""
    instants = np.stack([np.broadcast_to(np.asarray(sun, dtype=np.float64), (*shape, 3)) for sun in suns])
    instants[..., 2] = np.maximum(instants[..., 2], _LOWEST_SUN)
    return instants


def _nearest(group: TrackerGroup, suns: Array, a: Array, b: Array, limits: Limits) -> tuple[Array, Array]:
    wanted = normal_from_angles(a, b)
    tries_a, tries_b = (angles[None, :] for angles in pose_grid(limits, _COARSE_DEG))
    reach = _COARSE_DEG
    for _ in range(_REFINEMENTS):
        best_a, best_b = _best(group, suns, wanted, tries_a, tries_b)
        tries_a, tries_b = poses_around(best_a, best_b, reach, limits)
        reach /= _REFINING_FACTOR
    return _best(group, suns, wanted, tries_a, tries_b)


def _best(group: TrackerGroup, suns: Array, wanted: Array, tries_a: Array, tries_b: Array) -> tuple[Array, Array]:
    """Return the best try of each row: the nearest without shade and no steeper than wanted, if there is one."""
    share = np.max([group.worst_shaded_share(sun[:, None, :], tries_a, tries_b) for sun in suns], axis=0)
    tries = normal_from_angles(tries_a, tries_b)
    cost = np.sum((tries - wanted[:, None, :]) ** 2, axis=-1)
    cost += np.where(tries[..., 2] < wanted[:, None, 2] - _STEEPNESS_TOLERANCE, _STEEPER_COST, 0.0)
    cost += np.where(share > _FREE_SHARE, _SHADED_COST * (1.0 + 1e3 * share), 0.0)
    best = np.argmin(cost, axis=-1)[:, None]
    chosen = [np.take_along_axis(np.broadcast_to(tries, cost.shape), best, axis=-1) for tries in (tries_a, tries_b)]
    return chosen[0][:, 0], chosen[1][:, 0]


def pose_grid(limits: Limits, step_deg: float) -> tuple[Array, Array]:
    """Return poses all over the limits, ends included, no further apart than a step [deg]: two arrays, shape (n,)."""
    axes = [
        np.linspace(low, high, int(np.ceil((high - low) / step_deg)) + 1)
        for low, high in ((limits.a_min_deg, limits.a_max_deg), (limits.b_min_deg, limits.b_max_deg))
    ]
    a_deg, b_deg = np.meshgrid(*axes, indexing="ij")
    return a_deg.ravel(), b_deg.ravel()


def poses_around(a_deg: Array, b_deg: Array, reach_deg: float, limits: Limits) -> tuple[Array, Array]:
    """Return 49 poses [deg] around each of (n,), inside the limits, shape (n, 49); the middle one is the pose."""
    by_a, by_b = (reach_deg * steps.ravel() for steps in np.meshgrid(_FINE, _FINE, indexing="ij"))
    return (
        np.clip(a_deg[:, None] + by_a, limits.a_min_deg, limits.a_max_deg),
        np.clip(b_deg[:, None] + by_b, limits.b_min_deg, limits.b_max_deg),
    )
