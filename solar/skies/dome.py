"""A sky of any radiance over the dome, integrated over planes.

The dome is summed over patches of 7.5 deg; what planes up to 90 deg of tilt receive is kept as a polynomial of degree 4
in the normal, because an irradiance is the radiance seen through a cosine, which passes next to nothing of higher
degree.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array

_PATCH_DEG = 7.5
_CHUNK = 4096
_POWERS = [(i, j, k) for n in range(5) for k in range(2) for i in range(n - k + 1) for j in [n - k - i]]


class Dome(NamedTuple):
    """The p patches of the dome, equal steps in elevation.

    Attributes
    ----------
    directions
        Unit vectors, shape (p, 3).
    ring
        Ring of each patch, counted from the horizon up, shape (p,).
    ring_slant
        1/cos(zenith angle) of each ring.
    weight
        What a patch's radiance gives on a horizontal plane, shape (p,).
    to_polynomial
        What it gives in each coefficient of the polynomial in the normal, shape (p, 25).
    """

    directions: NDArray[np.float32]
    ring: NDArray[np.intp]
    ring_slant: NDArray[np.float32]
    weight: NDArray[np.float32]
    to_polynomial: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class DomeSky:
    """The sky at n instants, ready to shine on planes, as :class:`solar.skies.sky.Sky` is.

    Attributes
    ----------
    sun
        Unit vectors to the apparent sun, shape (n, 3).
    ghi_w_m2, dni_w_m2, dhi_w_m2
        Closed as in :class:`solar.skies.sky.Sky`, shape (n,).
    coefficients
        Of the polynomial in the normal that gives the sky's diffuse irradiance, shape (25, n).
    """

    sun: Array
    ghi_w_m2: Array
    dni_w_m2: Array
    dhi_w_m2: Array
    coefficients: Array

    def irradiance_on(self, normals: ArrayLike, albedo: float = 0.2) -> Array:
        """Return the plane-of-array irradiance [W/m2]; shapes as in :meth:`solar.skies.sky.Sky.irradiance_on`.

        For normals of fixed planes give the leading shape (..., 1).
        """
        planes = np.asarray(normals, dtype=np.float64)
        up = np.clip(planes[..., 2], -1.0, 1.0)
        sun = self.sun
        towards_sun = planes[..., 0] * sun[:, 0] + planes[..., 1] * sun[:, 1] + planes[..., 2] * sun[:, 2]
        towards_sun = np.maximum(towards_sun, 0.0)
        diffuse = _polynomial(self.coefficients, planes)
        ground = albedo * self.ghi_w_m2 * (1.0 - up) / 2.0
        total: Array = self.dni_w_m2 * towards_sun + np.maximum(diffuse, 0.0) + ground
        return total


def dome_sky(
    sun: ArrayLike, dni_w_m2: ArrayLike, dhi_w_m2: ArrayLike, radiance: Callable[[Dome, slice], NDArray[np.float32]]
) -> DomeSky:
    """Return the sky of n instants from its relative radiance, scaled so that a horizontal plane receives DHI.

    Parameters
    ----------
    sun
        Unit vectors to the apparent sun, shape (n, 3). There is no beam from below the horizon.
    dni_w_m2, dhi_w_m2
        Direct normal and diffuse horizontal irradiance [W/m2], shape (n,). Negative values count as zero.
    radiance
        Returns the relative radiance of every patch of the dome, shape (m, p) and never negative, for the m instants of
        a slice.
    """
    sun = np.asarray(sun, dtype=np.float64)
    sine = np.clip(sun[:, 2], 0.0, 1.0)
    dni = np.where(sine > 0.0, np.maximum(dni_w_m2, 0.0), 0.0)
    dhi = np.maximum(np.asarray(dhi_w_m2, dtype=np.float64), 0.0)
    patches = dome()
    coefficients = np.empty((len(_POWERS), len(sun)))
    for begin in range(0, len(sun), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        relative = radiance(patches, part)
        horizontal = relative @ patches.weight
        scale = np.divide(dhi[part], horizontal, out=np.zeros(len(horizontal)), where=horizontal > 0.0)
        coefficients[:, part] = (relative @ patches.to_polynomial).T * scale
    return DomeSky(sun=sun, ghi_w_m2=dni * sine + dhi, dni_w_m2=dni, dhi_w_m2=dhi, coefficients=coefficients)


@lru_cache(maxsize=1)
def dome() -> Dome:
    """Return the patches."""
    rings = int(90.0 / _PATCH_DEG)
    edges = np.radians(np.linspace(0.0, 90.0, rings + 1))
    sines, rows, solid = [], [], []
    for index in range(rings):
        low, high = np.sin(edges[index]), np.sin(edges[index + 1])
        count = max(round(360.0 / _PATCH_DEG * np.cos((edges[index] + edges[index + 1]) / 2)), 4)
        azimuth = (np.arange(count) + 0.5) * 2 * np.pi / count
        up = (low + high) / 2
        side = np.sqrt(1 - up * up)
        sines.append(np.stack([side * np.cos(azimuth), side * np.sin(azimuth), np.full(count, up)], axis=-1))
        rows.append(np.full(count, index))
        solid.append(np.full(count, (high - low) * 2 * np.pi / count))
    directions, ring, area = np.concatenate(sines), np.concatenate(rows), np.concatenate(solid)
    planes = _planes()
    kernel = np.maximum(directions @ planes.T, 0.0) * area[:, None]
    fit = np.linalg.pinv(_monomials(planes))
    slant = 1.0 / np.array([directions[ring == index][0, 2] for index in range(rings)])
    return Dome(
        directions=directions.astype(np.float32),
        ring=ring,
        ring_slant=slant.astype(np.float32),
        weight=(directions[:, 2] * area).astype(np.float32),
        to_polynomial=(kernel @ fit.T).astype(np.float32),
    )


def _planes() -> Array:
    """Return normals that the polynomial is fitted on: every azimuth, tilts from 0 to 90 deg."""
    tilt, azimuth = np.meshgrid(np.radians(np.arange(0.0, 91.0, 6.0)), np.radians(np.arange(0.0, 360.0, 10.0)))
    normals = [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)]
    return np.stack(normals, axis=-1).reshape(-1, 3)


def _monomials(normals: Array) -> Array:
    """Return the 25 independent monomials up to degree 4 on the sphere; those with z^2 follow from them."""
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    xs, ys = [np.ones_like(x)], [np.ones_like(y)]
    for _ in range(4):
        xs.append(xs[-1] * x)
        ys.append(ys[-1] * y)
    zs = (xs[0], z)
    return np.stack([xs[i] * ys[j] * zs[k] for i, j, k in _POWERS], axis=-1)


def _polynomial(coefficients: Array, normals: Array) -> Array:
    """Return the polynomial at normals (..., 3), by Horner's rule in x within the powers of y and z."""
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    row = {power: index for index, power in enumerate(_POWERS)}
    halves = []
    for k, degree in ((0, 4), (1, 3)):
        in_y = np.zeros(())
        for j in range(degree, -1, -1):
            in_x = coefficients[row[degree - j, j, k]] + 0.0 * x
            for i in range(degree - j - 1, -1, -1):
                in_x = in_x * x + coefficients[row[i, j, k]]
            in_y = in_y * y + in_x
        halves.append(in_y)
    result: Array = halves[0] + z * halves[1]
    return result
