"""The tracker's frame and its two angles.

Axes, right-handed in the northern hemisphere: i South, j East, k Up. In the southern hemisphere the equator-facing
direction is North; the frame is mirrored here, once, so that i always points to the equator's side and every formula
of the paper holds as printed. A is the rotation about the secondary axis (negative East, positive West), B the
elevation of the secondary axis' normal (90 deg: secondary axis horizontal).
"""

from dataclasses import dataclass
from numbers import Real
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

FACE_NORMALS = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
"""Unit normals of an upright cube's faces east, south, west and zenith, shape (4, 3)."""


class Angles(NamedTuple):
    """A pair of tracker angles [deg]."""

    a_deg: float
    b_deg: float


@dataclass(frozen=True, slots=True)
class Limits:
    """The permitted range of each angle [deg], ends included; `ValueError` for ends exchanged or no numbers."""

    a_min_deg: float = -50.0
    a_max_deg: float = 50.0
    b_min_deg: float = 15.0
    b_max_deg: float = 90.0

    def __post_init__(self) -> None:
        """Refuse a range whose ends are exchanged, and ends that are no numbers."""
        ends = (self.a_min_deg, self.a_max_deg, self.b_min_deg, self.b_max_deg)
        if not all(isinstance(end, Real) for end in ends):
            raise ValueError(f"limits are four numbers, a_min_deg, a_max_deg, b_min_deg and b_max_deg, and not {ends}")
        # Written so that NaN fails.
        if not (self.a_min_deg <= self.a_max_deg and self.b_min_deg <= self.b_max_deg):
            raise ValueError(f"the lowest angle must not be above the highest, as in {self}")

    def contain(self, a_deg: float, b_deg: float) -> bool:
        """Tell whether both angles are inside; NaN is outside."""
        return self.a_min_deg <= a_deg <= self.a_max_deg and self.b_min_deg <= b_deg <= self.b_max_deg

    def clip(self, a_deg: float, b_deg: float) -> Angles:
        """Bring each angle to the nearest permitted value; raises `ValueError` for NaN or infinity."""
        if not (np.isfinite(a_deg) and np.isfinite(b_deg)):
            raise ValueError(f"angles must be finite numbers, not A={a_deg}, B={b_deg}")
        return Angles(min(max(a_deg, self.a_min_deg), self.a_max_deg), min(max(b_deg, self.b_min_deg), self.b_max_deg))

    def __str__(self) -> str:
        return f"A {self.a_min_deg:g}..{self.a_max_deg:g} deg, B {self.b_min_deg:g}..{self.b_max_deg:g} deg"


def normal_from_angles(a_deg: ArrayLike, b_deg: ArrayLike) -> Array:
    """Return the module's unit normal(s), shape (..., 3), for tracker angles [deg] that broadcast together.

    Andriamahefa et al. (2023), equation (13). Raises `ValueError` for what is no number.
    """
    a, b = np.radians(_numbers(a_deg)), np.radians(_numbers(b_deg))
    return stack_components(np.cos(a) * np.cos(b), -np.sin(a), np.cos(a) * np.sin(b))


def angles_from_direction(direction: ArrayLike) -> tuple[Array, Array]:
    """Return (a_deg, b_deg) that point the normal along `direction`, shape (..., 3), of any positive length.

    Andriamahefa et al. (2023), equation (14), with the sign of A that follows from (13) (the printed (15) lost it).
    B runs from 0 to 180 deg here; limits are not applied. A direction that is zero, NaN or infinite gives NaN, and
    another shape `ValueError`, here and below.
    """
    vector = as_vectors(direction)
    length, b_deg = _length_and_b(vector)
    return np.degrees(np.arcsin(bounded(-vector[..., 1] / length, -1.0, 1.0))), b_deg


def _length_and_b(vector: Array) -> tuple[Array, Array]:
    """Return a direction's length, and B [deg] of equation (14) without limits; both NaN where it is no direction."""
    south, east, up = vector[..., 0], vector[..., 1], vector[..., 2]
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.sqrt(south * south + east * east + up * up)
    valid = (length > 0.0) & (length < np.inf)
    return np.where(valid, length, np.nan), np.where(valid, np.degrees(np.arctan2(up, south)), np.nan)


def angles_within(direction: ArrayLike, limits: Limits) -> tuple[Array, Array]:
    """Return the (a_deg, b_deg) inside `limits` that bring the normal nearest to `direction`, shape (..., 3).

    B is that of equation (14), clipped; A is then the best for that B, atan2(-j, i cos B + k sin B), which is (14)
    itself wherever B was inside. A direction that is zero, NaN or infinite gives NaN.
    Raises `ValueError` for limits that are no `Limits`.
    """
    given: object = limits
    if not isinstance(given, Limits):
        wanted = "Limits(a_min_deg, a_max_deg, b_min_deg, b_max_deg)"
        raise ValueError(f"the limits must be {wanted}, and not {given!r}")  # noqa: TRY004 - as for all bad numbers
    vector = as_vectors(direction)
    _, free_b_deg = _length_and_b(vector)
    b_deg = bounded(free_b_deg, limits.b_min_deg, limits.b_max_deg)
    b = np.radians(b_deg)
    towards = vector[..., 0] * np.cos(b) + vector[..., 2] * np.sin(b)
    a_deg = np.degrees(np.arctan2(-vector[..., 1], towards))
    return bounded(a_deg, limits.a_min_deg, limits.a_max_deg), b_deg


def direction_from_azimuth(azimuth_deg: ArrayLike, elevation_deg: ArrayLike, latitude_deg: float) -> Array:
    """Return unit vector(s), shape (..., 3), of an azimuth (from North, clockwise) and an elevation [deg]."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    equatorward = -_hemisphere(latitude_deg) * np.cos(azimuth) * np.cos(elevation)
    return stack_components(equatorward, np.sin(azimuth) * np.cos(elevation), np.sin(elevation))


def azimuth_from_direction(direction: ArrayLike, latitude_deg: float) -> tuple[Array, Array]:
    """Return (azimuth_deg from North clockwise, elevation_deg) of vector(s) of shape (..., 3)."""
    vector = as_vectors(direction)
    north = -_hemisphere(latitude_deg) * vector[..., 0]
    azimuth = np.degrees(np.arctan2(vector[..., 1], north)) % 360.0
    elevation = np.degrees(np.arctan2(vector[..., 2], np.hypot(vector[..., 0], vector[..., 1])))
    return azimuth, elevation


def equator_azimuth_deg(latitude_deg: float) -> float:
    """Return the azimuth that the frame's first axis points to: 180 deg, or 0 in the southern hemisphere."""
    return 180.0 if _hemisphere(latitude_deg) > 0 else 0.0


def separation_deg(first: ArrayLike, second: ArrayLike) -> Array:
    """Return the angle(s) [deg] between vectors of shape (..., 3); exact for small angles too.

    NaN where either direction is zero, NaN or infinite.
    """
    u, v = as_vectors(first), as_vectors(second)
    with np.errstate(invalid="ignore", over="ignore"):
        across: Array = np.linalg.norm(np.cross(u, v), axis=-1)
        along: Array = np.sum(u * v, axis=-1)
        apart: Array = np.where(u.any(axis=-1) & v.any(axis=-1), np.degrees(np.arctan2(across, along)), np.nan)
    return apart[()]


def bounded(values: ArrayLike, low: ArrayLike, high: ArrayLike) -> Array:
    """Return the values, clipped to their bounds; `np.clip` takes several times as long where they are few."""
    result: Array = np.minimum(np.maximum(values, low), high)
    return result


def stack_components(*components: ArrayLike) -> Array:
    """Return components, of shapes that broadcast together, along a new last axis."""
    made = np.empty((*np.broadcast(*components).shape, len(components)))
    for place, component in enumerate(components):
        made[..., place] = component
    return made


def as_vectors(given: ArrayLike) -> Array:
    """Return directions as an array of shape (..., 3); `ValueError` for another shape and for what is no number."""
    if hasattr(given, "azimuth_deg"):
        raise ValueError("directions are south, east, up, and not a SunPosition: take them from sun_direction")
    components = _numbers(given)
    if components.shape[-1:] != (3,):
        raise ValueError(f"directions are south, east, up along the last axis, not an array of {components.shape}")
    return components


def _numbers(given: ArrayLike) -> Array:
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"angles and directions must be numbers, NaN where one is missing ({error})") from None


def _hemisphere(latitude_deg: float) -> float:
    return 1.0 if latitude_deg >= 0 else -1.0
