"""A sky that shares nothing with the laws: CIE general skies, blended by clearness, with clouds that drift over them.

Relative radiance of a point at zenith angle zeta and at the angle gamma from the sun, by one of the 15 types of
CIE S 011/E:2003 (ISO 15469:2004), "Spatial distribution of daylight - CIE standard general sky":

    (1 + a exp(b / cos zeta)) (1 + c (exp(d gamma) - exp(d pi/2)) + e cos^2 gamma)

Four types are blended by the sky's clearness, 1 + (DNI/DHI)/(1 + 1.041 z^3) of Perez et al. (1990) with the sun's
zenith angle z [rad]: the overcast sky (1), partly cloudy ones (6 and 8), and the clear sky (12). They are overlaid with
structure that no standard sky has: the radiance is multiplied by exp(s g), where g is a sum of plane waves of unit
variance on the clouds' plane that drift with the wind and change as they go, and s is greatest under broken clouds.
Both s and the waves are chosen, not measured. The whole is scaled so that a horizontal plane receives DHI; the beam is
as it was measured, without the structure.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array
from solar.skies.dome import Dome, DomeSky, dome_sky

_TYPES = np.array(
    [
        [4.0, -0.70, 0.0, -1.0, 0.0],
        [0.0, -1.00, 2.0, -1.5, 0.15],
        [0.0, -1.00, 10.0, -3.0, 0.45],
        [-1.0, -0.32, 10.0, -3.0, 0.45],
    ]
)
"""Parameters a, b, c, d, e of the types 1, 6, 8 and 12."""
_TYPE_CLEARNESS = (1.0, 1.3, 2.2, 6.0)
_STRUCTURE_CLEARNESS = (1.0, 1.15, 2.2, 6.0)
_STRUCTURE = (0.15, 0.45, 0.5, 0.05)
"""s at these values of the clearness; between them s is linear in the clearness' logarithm."""

_HIGHEST_CLEARNESS = 12.0
_WAVES = 24
_WAVELENGTHS = (0.7, 4.0)
"""Shortest and longest wave, in heights of the clouds."""
_WIND_HEIGHTS_PER_S = 0.01
"""10 m/s under clouds at 1 km."""
_WIND_TURNS_IN_S = 5.3 * 86400.0
_CLOUD_LASTS_S = (1200.0, 3600.0)


def cie_sky(
    sun: ArrayLike, dni_w_m2: ArrayLike, dhi_w_m2: ArrayLike, utc_s: ArrayLike, structure: float = 1.0
) -> DomeSky:
    """Return the blended sky of n instants.

    Parameters
    ----------
    sun
        Unit vectors to the apparent sun, shape (n, 3).
    dni_w_m2, dhi_w_m2
        Direct normal and diffuse horizontal irradiance [W/m2], shape (n,). Negative values count as zero.
    utc_s
        The instants [s], shape (n,); they tell where the clouds are.
    structure
        Factor of s; 0 is a smooth sky.
    """
    sun, utc_s = np.asarray(sun, dtype=np.float64), np.asarray(utc_s, dtype=np.float64)
    clearness = _log_clearness(sun, np.maximum(dni_w_m2, 0.0), np.maximum(dhi_w_m2, 0.0))
    strength = structure * np.interp(clearness, np.log(_STRUCTURE_CLEARNESS), _STRUCTURE)

    def radiance(dome: Dome, part: slice) -> NDArray[np.float32]:
        smooth = _blended(dome, sun[part], clearness[part])
        result: NDArray[np.float32] = smooth * np.exp(_cloud_structure(dome, utc_s[part], strength[part]))
        return result

    return dome_sky(sun, dni_w_m2, dhi_w_m2, radiance)


def _log_clearness(sun: Array, dni: Array, dhi: Array) -> Array:
    zenith = np.arccos(np.clip(sun[:, 2], 0.0, 1.0))
    ratio = np.divide(dni, dhi, out=np.zeros(len(dhi)), where=dhi > 0.0)
    result: Array = np.log(np.minimum(1.0 + ratio / (1.0 + 1.041 * zenith**3), _HIGHEST_CLEARNESS))
    return result


def _blended(dome: Dome, sun: Array, clearness: Array) -> NDArray[np.float32]:
    """Return the relative radiance of each patch, shape (n, p): of the two types that the clearness lies between."""
    cosine = np.clip(sun.astype(np.float32) @ dome.directions.T, -1.0, 1.0)
    from_sun = np.arccos(cosine)
    place = np.interp(clearness, np.log(_TYPE_CLEARNESS), np.arange(len(_TYPES)))
    blend: NDArray[np.float32] = np.zeros_like(cosine)
    for number, (a, b, c, d, e) in enumerate(_TYPES.astype(np.float32)):
        share = np.maximum(1.0 - np.abs(place - number), 0.0).astype(np.float32)
        used = np.flatnonzero(share)
        gradation = (1.0 + a * np.exp(b * dome.ring_slant))[dome.ring]
        indicatrix = 1.0 + c * (np.exp(d * from_sun[used]) - np.exp(d * np.float32(np.pi / 2)))
        relative = gradation * (indicatrix + e * cosine[used] ** 2)
        blend[used] += relative * (share[used] / (relative @ dome.weight))[:, None]
    return blend


def _cloud_structure(dome: Dome, utc_s: Array, strength: Array) -> NDArray[np.float32]:
    """Return s g of each patch, shape (n, p)."""
    random = np.random.default_rng(15469)
    length = _random_between(random, _WAVELENGTHS)
    towards, phase = random.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
    pace = 2.0 * np.pi / _random_between(random, _CLOUD_LASTS_S) * random.choice((-1.0, 1.0), _WAVES)
    wave = 2.0 * np.pi / length * np.stack([np.cos(towards), np.sin(towards)])
    directions = dome.directions.astype(np.float64)
    # The clouds' plane, compressed as by a fisheye lens: structure near the horizon must not be finer than a patch.
    plane = 2.0 * directions[:, :2] / (1.0 + directions[:, 2:])
    turned = 2.0 * np.pi * utc_s / _WIND_TURNS_IN_S
    blown = (
        _WIND_HEIGHTS_PER_S * _WIND_TURNS_IN_S / (2.0 * np.pi) * np.stack([np.sin(turned), -np.cos(turned)], axis=-1)
    )
    here = plane @ wave + phase
    then = blown @ wave + utc_s[:, None] * pace
    # cos(here - then), as two products of matrices.
    even = (strength[:, None] * np.cos(then)).astype(np.float32) @ np.cos(here).T.astype(np.float32)
    odd = (strength[:, None] * np.sin(then)).astype(np.float32) @ np.sin(here).T.astype(np.float32)
    result: NDArray[np.float32] = np.float32(np.sqrt(2.0 / _WAVES)) * (even + odd)
    return result


def _random_between(random: np.random.Generator, ends: tuple[float, float]) -> Array:
    low, high = np.log(ends).tolist()
    result: Array = np.exp(random.uniform(low, high, _WAVES))
    return result
