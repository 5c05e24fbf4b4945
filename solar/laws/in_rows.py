"""Where the expected light is collected best among neighbours that shade each other (:mod:`solar.rows.group`).

What a pose collects is what :func:`solar.laws.light.aim_vector` says, less what the neighbours take of the beam when
they stand in the same pose. That has no closed form, so the best pose is searched for, but only where the best pose of
a tracker alone would have shade. Shade never adds light, so elsewhere that pose stays the best.
"""

from collections.abc import Sequence

import numpy as np

from solar.frames import Array, Limits, normal_from_angles
from solar.laws.light import dot_with_normal
from solar.rows.backtrack import out_of_shade, pose_grid, poses_around
from solar.rows.group import TrackerGroup

_COARSE_DEG = 10.0
_REFINING_FACTOR = 3
_REFINEMENTS = 4
_ROWS_AT_ONCE = 8


def taken_by_neighbours(group: TrackerGroup, beam: Array, suns: Sequence[Array], a_deg: Array, b_deg: Array) -> Array:
    """Return what shade takes [W/m2] of a beam, shape (...), in poses (...): mean of the group and of suns (..., 3)."""
    normals = normal_from_angles(a_deg, b_deg)
    lost = [np.maximum(np.sum(sun * normals, axis=-1), 0.0) * group.shade(sun, a_deg, b_deg).lost for sun in suns]
    taken: Array = beam * np.mean(lost, axis=0)
    return taken


def best_poses_of_group(
    group: TrackerGroup,
    vector: Array,
    beam: Array,
    suns: Sequence[Array],
    alone: tuple[Array, Array],
    limits: Limits,
) -> tuple[Array, Array]:
    """Return the poses [deg] that collect most, all of the group in the same one.

    They collect no less than the best poses of a tracker alone, or than those turned back out of all shade.

    Parameters
    ----------
    vector, beam
        The expected light: :func:`solar.laws.light.aim_vector`'s, shape (..., 3), and its beam [W/m2], shape (...).
    suns
        Each of shape (..., 3), of the instants that the pose is to last for.
    alone
        The best poses [deg] of a tracker without neighbours, shape (...).
    """
    shape = np.shape(beam)
    rows_beam = np.ravel(np.asarray(beam, dtype=np.float64))
    rows_vector = vector.reshape(rows_beam.size, 3)
    rows_suns = [np.broadcast_to(sun, vector.shape).reshape(rows_beam.size, 3) for sun in suns]
    best_a, best_b = (np.array(np.broadcast_to(angle, shape), dtype=np.float64).ravel() for angle in alone)
    shaded = np.flatnonzero(taken_by_neighbours(group, rows_beam, rows_suns, best_a, best_b) > 0.0)
    for first in range(0, shaded.size, _ROWS_AT_ONCE):
        some = shaded[first : first + _ROWS_AT_ONCE]
        light = (rows_vector[some, None], rows_beam[some, None], [sun[some, None] for sun in rows_suns])
        turned_back = out_of_shade(group, [sun[some] for sun in rows_suns], best_a[some], best_b[some], limits)
        starts = [np.stack(pair, axis=-1) for pair in zip((best_a[some], best_b[some]), turned_back, strict=True)]
        best_a[some], best_b[some] = _search_best(group, light, starts, limits)
    return best_a.reshape(shape), best_b.reshape(shape)


def _search_best(
    group: TrackerGroup, light: tuple[Array, Array, Sequence[Array]], starts: Sequence[Array], limits: Limits
) -> tuple[Array, Array]:
    vector, beam, suns = light
    everywhere = [np.broadcast_to(angles, (len(beam), angles.size)) for angles in pose_grid(limits, _COARSE_DEG)]
    tries = [np.concatenate(parts, axis=-1) for parts in zip(starts, everywhere, strict=True)]
    reach = _COARSE_DEG
    for _ in range(_REFINEMENTS):
        collected = dot_with_normal(vector, *tries) - taken_by_neighbours(group, beam, suns, *tries)
        best = np.argmax(collected, axis=-1)[:, None]
        a, b = (np.take_along_axis(angles, best, axis=-1)[:, 0] for angles in tries)
        tries = list(poses_around(a, b, reach, limits))
        reach /= _REFINING_FACTOR
    return a, b
