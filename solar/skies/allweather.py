"""The all-weather sky of Perez, Seals & Michalsky (1993): radiance over the whole dome.

Relative radiance of a point at zenith angle zeta and at the angle gamma from the sun (Solar Energy 50, 235, and the
erratum in 51, 423):

    (1 + a exp(b / cos zeta)) (1 + c exp(d gamma) + e cos^2 gamma)

scaled so that a horizontal plane receives DHI. Unlike the sky of 1990, the light around the sun is broad.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array
from solar.skies.dome import Dome, DomeSky, dome_sky

# Per clearness bin, two lines each: a1 a2 a3 a4, b1 .. b4, c1 .. c4, d1 .. d4, e1 .. e4.
_COEFFICIENTS = np.array(
    [
        [1.3525, -0.2576, -0.2690, -1.4366, -0.7670, 0.0007, 1.2734, -0.1233, 2.8000, 0.6004],
        [1.2375, 1.0000, 1.8734, 0.6297, 0.9738, 0.2809, 0.0356, -0.1246, -0.5718, 0.9938],
        [-1.2219, -0.7730, 1.4148, 1.1016, -0.2054, 0.0367, -3.9128, 0.9156, 6.9750, 0.1774],
        [6.4477, -0.1239, -1.5798, -0.5081, -1.7812, 0.1080, 0.2624, 0.0672, -0.2190, -0.4285],
        [-1.1000, -0.2515, 0.8952, 0.0156, 0.2782, -0.1812, -4.5000, 1.1766, 24.7219, -13.0812],
        [-37.7000, 34.8438, -5.0000, 1.5218, 3.9229, -2.6204, -0.0156, 0.1597, 0.4199, -0.5562],
        [-0.5484, -0.6654, -0.2672, 0.7117, 0.7234, -0.6219, -5.6812, 2.6297, 33.3389, -18.3000],
        [-62.2500, 52.0781, -3.5000, 0.0016, 1.1477, 0.1062, 0.4659, -0.3296, -0.0876, -0.0329],
        [-0.6000, -0.3566, -2.5000, 2.3250, 0.2937, 0.0496, -5.6812, 1.8415, 21.0000, -4.7656],
        [-21.5906, 7.2492, -3.5000, -0.1554, 1.4062, 0.3988, 0.0032, 0.0766, -0.0656, -0.1294],
        [-1.0156, -0.3670, 1.0078, 1.4051, 0.2875, -0.5328, -3.8500, 3.3750, 14.0000, -0.9999],
        [-7.1406, 7.5469, -3.4000, -0.1078, -1.0750, 1.5702, -0.0672, 0.4016, 0.3017, -0.4844],
        [-1.0000, 0.0211, 0.5025, -0.5119, -0.3000, 0.1922, 0.7023, -1.6317, 19.0000, -5.0000],
        [1.2438, -1.9094, -4.0000, 0.0250, 0.3844, 0.2656, 1.0468, -0.3788, -2.4517, 1.4656],
        [-1.0500, 0.0289, 0.4260, 0.3590, -0.3250, 0.1156, 0.7781, 0.0025, 31.0625, -14.5000],
        [-46.1148, 55.3750, -7.2312, 0.4050, 13.3500, 0.6234, 1.5000, -0.6426, 1.8564, 0.5636],
    ]
).reshape(8, 20)
_CLEARNESS_BOUNDS = np.array([1.065, 1.23, 1.5, 1.95, 2.8, 4.5, 6.2])
_HIGHEST_CLEARNESS = 12.0


def all_weather_sky(sun: ArrayLike, dni_w_m2: ArrayLike, dhi_w_m2: ArrayLike, dni_extra_w_m2: ArrayLike) -> DomeSky:
    """Return the all-weather sky of n instants.

    Parameters
    ----------
    sun
        Unit vectors to the apparent sun, shape (n, 3).
    dni_w_m2, dhi_w_m2, dni_extra_w_m2
        Direct normal, diffuse horizontal and extraterrestrial normal irradiance [W/m2], shape (n,). Negative values
        count as zero. With the sun below the horizon there is diffuse light only, its parameters those of the horizon.
    """
    sun = np.asarray(sun, dtype=np.float64)
    sine = np.clip(sun[:, 2], 0.0, 1.0)
    dni = np.where(sine > 0.0, np.maximum(dni_w_m2, 0.0), 0.0)
    dhi = np.maximum(np.asarray(dhi_w_m2, dtype=np.float64), 0.0)
    shape = _shape_parameters(sine, dni, dhi, np.asarray(dni_extra_w_m2, dtype=np.float64))
    return dome_sky(sun, dni, dhi, lambda dome, part: _relative_radiance(dome, sun[part], shape[part]))


def _shape_parameters(sine: Array, dni: Array, dhi: Array, extra: Array) -> Array:
    """Return the five parameters a, b, c, d, e of each instant, shape (n, 5)."""
    zenith = np.arccos(sine)
    air_mass = 1.0 / (sine + 0.50572 * (96.07995 - np.degrees(zenith)) ** -1.6364)
    brightness = np.maximum(dhi * air_mass / extra, 0.01)
    ratio = np.divide(dni, dhi, out=np.zeros_like(dhi), where=dhi > 0.0)
    clearness = np.minimum(1.0 + ratio / (1.0 + 1.041 * zenith**3), _HIGHEST_CLEARNESS)
    row = np.digitize(clearness, _CLEARNESS_BOUNDS)
    # The fit does not reach below this brightness in the middle bins.
    brightness = np.where((row >= 1) & (row <= 4), np.maximum(brightness, 0.2), brightness)
    k = _COEFFICIENTS[row].reshape(-1, 5, 4)
    d, z = brightness[:, None], zenith[:, None]
    parameters: Array = k[..., 0] + k[..., 1] * z + d * (k[..., 2] + k[..., 3] * z)
    overcast = row == 0
    k, d, z = k[overcast], brightness[overcast], zenith[overcast]
    parameters[overcast, 2] = np.exp((d * (k[:, 2, 0] + k[:, 2, 1] * z)) ** k[:, 2, 2]) - k[:, 2, 3]
    parameters[overcast, 3] = -np.exp(d * (k[:, 3, 0] + k[:, 3, 1] * z)) + k[:, 3, 2] + d * k[:, 3, 3]
    return parameters


def _relative_radiance(dome: Dome, sun: Array, shape: Array) -> NDArray[np.float32]:
    """Radiance of each patch, shape (n, p), never negative, of any scale."""
    a, b, c, d, e = (shape[:, index : index + 1].astype(np.float32) for index in range(5))
    cosine = np.clip(sun.astype(np.float32) @ dome.directions.T, -1.0, 1.0)
    gradation = (1.0 + a * np.exp(b * dome.ring_slant))[:, dome.ring]
    indicatrix = 1.0 + c * np.exp(d * np.arccos(cosine)) + e * cosine * cosine
    result: NDArray[np.float32] = np.maximum(gradation * indicatrix, 0.0)
    return result
