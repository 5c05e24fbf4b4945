"""The shade that the trackers of a group cast on each other.

All trackers of a group are taken to stand in one pose. Their modules are then parallel, and the shadow that a
neighbour casts on a module's plane is the neighbour's rectangle, shifted. With d the vector from the module's middle to
the neighbour's, s the direction to the sun, n the normal and u the direction of one edge, the shift along that edge is

    (d - t s).u,    t = d.n / s.n

and there is shade where t is positive (the neighbour stands before the module) and both shifts are shorter than their
edges. This is exact, and needs no search. The sun is a point here. Diffuse light is left as it is: what rows hide of
each other's sky and ground is not counted.

A shaded area takes more than its share from the electrical power. With groups of cells behind bypass diodes,
side by side across the width, the beam's part that is lost is

    1 - (1 - f) (1 - m/(N + 1))

with f the shaded share, and m of the N groups touched: Martinez-Moreno et al. (2010), Progress in Photovoltaics 18,
the empirical form, which pvlib has as :func:`pvlib.shading.direct_martinez`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array, direction_from_azimuth

# Farther neighbours stand behind these, except under a sun only a few degrees high.
_MOST_NEIGHBOURS = 24
_SAME_M = 1e-3
# Share of an edge: a smaller overlap is rounding, where two edges touch.
_TOUCH = 1e-9
_GRAZING = 1e-9


class Shade(NamedTuple):
    """What neighbours take of one module's beam, arrays of one shape.

    Attributes
    ----------
    share
        Share of the area that is shaded, 0..1.
    lost
        Share of the beam's part of the power that is lost, 0..1.
    """

    share: Array
    lost: Array


class TrackerGroup:
    """Trackers that may shade each other: where their modules' middles are, and how large the modules.

    Parameters
    ----------
    positions_m
        Of the middles, shape (n, 3), in the frame of :mod:`solar.frames`.
    width_m, height_m
        Edge across the secondary axis (east to west when flat), and edge along it.
    bypass_groups
        Groups of cells with a bypass diode each, side by side across the width; 0 to lose the shaded share alone.
    only_if_it_pays
        Whether laws that do not weigh the light turn out of the shade only where the group gets more beam by that.

    Raises
    ------
    ValueError
        Fewer than two trackers, a size that is not positive, or a number that is not finite.
    """

    def __init__(
        self,
        positions_m: ArrayLike,
        width_m: float,
        height_m: float,
        bypass_groups: int = 3,
        *,
        only_if_it_pays: bool = True,
    ) -> None:
        positions = np.asarray(positions_m, dtype=np.float64)
        if positions.ndim != 2 or positions.shape[1] != 3 or len(positions) < 2 or not np.isfinite(positions).all():
            raise ValueError("a group is the finite positions of two or more trackers")
        if not (0.0 < width_m < np.inf and 0.0 < height_m < np.inf and bypass_groups >= 0):
            raise ValueError(f"a module of {width_m:g} by {height_m:g} m with {bypass_groups} groups is not possible")
        self.count = len(positions)
        self.size_m = (float(width_m), float(height_m))
        self.bypass_groups = int(bypass_groups)
        self.only_if_it_pays = only_if_it_pays
        self.offsets_m, self.weights = _neighbour_vectors(positions)
        self._distinct_m = np.unique(self.offsets_m.reshape(-1, 3), axis=0)

    @classmethod
    def from_map(
        cls,
        east_m: Sequence[float],
        north_m: Sequence[float],
        up_m: Sequence[float],
        size_m: tuple[float, float],
        latitude_deg: float,
        bypass_groups: int = 3,
        *,
        only_if_it_pays: bool = True,
    ) -> "TrackerGroup":
        """Return the group of trackers that stand so far east, north and up [m] of one point; empty `up_m`: level."""
        to_east, to_north = direction_from_azimuth([90.0, 0.0], 0.0, latitude_deg)
        level = np.outer(east_m, to_east) + np.outer(north_m, to_north)
        above = np.outer(up_m or np.zeros(len(east_m)), [0.0, 0.0, 1.0])
        return cls(level + above, *size_m, bypass_groups, only_if_it_pays=only_if_it_pays)

    def __deepcopy__(self, _memo: object) -> "TrackerGroup":
        """Return the group itself: nothing changes it, so the copy of a law can share it."""
        return self

    def worst_shaded_share(self, sun: ArrayLike, a_deg: ArrayLike, b_deg: ArrayLike) -> Array:
        """Return the largest share [0..1] that one module shades of another, with all in this pose.

        `sun`, shape (..., 3), and the angles [deg] broadcast together. 1 where the modules turn their backs to the
        sun; 0 says that no module of the group has shade.
        """
        sun, across, along, normal = _frame(sun, a_deg, b_deg)
        shifts = self._shifts(self._distinct_m, sun, across, along, normal)
        covered = _covered_share(*shifts).max(axis=-1)
        result: Array = np.where(np.sum(sun * normal, axis=-1) > _GRAZING, covered, 1.0)
        return result

    def shade(self, sun: ArrayLike, a_deg: ArrayLike, b_deg: ArrayLike) -> Shade:
        """Return the mean over all modules of the group, with all in this pose; parameters as for `worst_shaded_share`.

        A module that turns its back to the sun has no beam, and nothing is taken from it.
        """
        each = self.shade_of_each(sun, a_deg, b_deg)
        return Shade(each.share @ self.weights, each.lost @ self.weights)

    def beam_share(self, sun: ArrayLike, a_deg: ArrayLike, b_deg: ArrayLike) -> Array:
        """Return the mean share of the beam that modules get, 1 if all face the sun unshaded; parameters as before."""
        sun, _, _, normal = _frame(sun, a_deg, b_deg)
        towards = np.maximum(np.sum(sun * normal, axis=-1), 0.0)
        result: Array = towards * (1.0 - self.shade(sun, a_deg, b_deg).lost)
        return result

    def shade_of_each(self, sun: ArrayLike, a_deg: ArrayLike, b_deg: ArrayLike) -> Shade:
        """Return the shade at every distinct place in the group, shape (..., places); `weights` are their shares."""
        sun, across, along, normal = _frame(sun, a_deg, b_deg)
        by_width, by_height = self._shifts(self.offsets_m, sun, across, along, normal)
        share = _covered_share(by_width, by_height)
        lit = (np.sum(sun * normal, axis=-1) > _GRAZING)[..., None]
        covered = np.where(lit, _covered_together(by_width, by_height, share), 0.0)
        touched = np.where(lit, _touched(by_width, share > 0.0, self.bypass_groups), 0.0)
        return Shade(covered, 1.0 - (1.0 - covered) * (1.0 - touched / (self.bypass_groups + 1.0)))

    def _shifts(self, offsets: Array, sun: Array, across: Array, along: Array, normal: Array) -> tuple[Array, Array]:
        """Return the shifts of neighbours' shadows, in edge lengths: from 1 on they miss the module; NaN: no shadow."""
        places = (1,) * (offsets.ndim - 1)

        def on(way: Array) -> Array:
            return (way @ offsets.reshape(-1, 3).T).reshape(*way.shape[:-1], *offsets.shape[:-1])

        def of_sun(way: Array) -> Array:
            share: Array = np.sum(sun * way, axis=-1)
            return share.reshape(*share.shape, *places)

        reach = on(normal) / np.maximum(of_sun(normal), _GRAZING)
        # A neighbour that stands beside or behind the module casts no shadow on it.
        reach = np.where(reach > _TOUCH, reach, np.nan)
        across_m, along_m = (on(edge) - reach * of_sun(edge) for edge in (across, along))
        return across_m / self.size_m[0], along_m / self.size_m[1]


def _neighbour_vectors(positions: Array) -> tuple[Array, Array]:
    """Return the vectors to the neighbours from each distinct place, (places, neighbours, 3), and the places' shares.

    A tracker with fewer neighbours than another has itself for the rest: a vector of no length casts no shade.
    """
    seen = positions[None, :, :] - positions[:, None, :]
    near = np.argsort(np.linalg.norm(seen, axis=-1), kind="stable")[:, : _MOST_NEIGHBOURS + 1]
    views = np.round(np.take_along_axis(seen, near[..., None], axis=1) / _SAME_M) * _SAME_M + 0.0
    order = np.lexsort(views.transpose(2, 0, 1)[::-1])
    views = np.take_along_axis(views, order[..., None], axis=1)
    distinct, counts = np.unique(views.reshape(len(positions), -1), axis=0, return_counts=True)
    return distinct.reshape(len(distinct), -1, 3), counts / len(positions)


def _frame(sun: ArrayLike, a_deg: ArrayLike, b_deg: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Return sun, the module's two edges (across to the east, along upwards) and its normal."""
    a, b = np.broadcast_arrays(np.radians(a_deg), np.radians(b_deg))
    sine_a, cosine_a, sine_b, cosine_b = np.sin(a), np.cos(a), np.sin(b), np.cos(b)
    across = np.stack([sine_a * cosine_b, cosine_a, sine_a * sine_b], axis=-1)
    along = np.stack([-sine_b, np.zeros(a.shape), cosine_b], axis=-1)
    normal = np.stack([cosine_a * cosine_b, -sine_a, cosine_a * sine_b], axis=-1)
    return np.asarray(sun, dtype=np.float64), across, along, normal


def _covered_share(by_width: Array, by_height: Array) -> Array:
    """Return the share of the module that each shadow covers, from shifts in edge lengths."""
    across, along = (1.0 - np.abs(shift) for shift in (by_width, by_height))
    # Written so that NaN, which casts nothing, fails.
    result: Array = np.where((across > _TOUCH) & (along > _TOUCH), across * along, 0.0)
    return result


def _covered_together(by_width: Array, by_height: Array, share: Array) -> Array:
    """Return the share that shadows cover together, over the last axis.

    Each shadow is as large as the module, so it covers one of the module's corners. In a strip between two vertical
    edges of shadows, the covered part is one piece from below and one from above.
    """
    total: Array = share.max(axis=-1)
    several = np.count_nonzero(share, axis=-1) > 1
    if not several.any():
        return total
    most = int(np.count_nonzero(share[several], axis=-1).max())
    chosen = np.argsort(-share[several])[:, :most]
    counts, x, y = (np.take_along_axis(value[several], chosen, axis=-1) for value in (share > 0.0, by_width, by_height))
    left, right = (np.where(counts, np.clip(edge, 0.0, 1.0), 0.0) for edge in (x, 1.0 + x))
    tall = np.where(counts, 1.0 - np.abs(y), 0.0)
    edges = np.sort(np.concatenate([left, right], axis=-1))
    middle = 0.5 * (edges[:, 1:] + edges[:, :-1])[..., None]
    inside = (left[:, None, :] < middle) & (middle < right[:, None, :])
    below, above = (
        np.where(inside & side[:, None, :], tall[:, None, :], 0.0).max(axis=-1) for side in (y <= 0.0, y > 0.0)
    )
    total[several] = np.sum(np.diff(edges) * np.minimum(below + above, 1.0), axis=-1)
    return total


def _touched(by_width: Array, casts: NDArray[np.bool_], groups: int) -> Array:
    """Return how many of the groups side by side across the width have shade, over the last axis."""
    reach = np.where(casts, 1.0 - np.abs(by_width), 0.0)
    sides = (np.where(side, reach, 0.0).max(axis=-1) for side in (by_width <= 0.0, by_width > 0.0))
    result: Array = np.minimum(sum(np.ceil(groups * side - _TOUCH) for side in sides), float(groups))
    return np.maximum(result, 0.0)
