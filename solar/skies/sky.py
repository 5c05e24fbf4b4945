"""Irradiance on planes of any orientation, from a beam, a model of the diffuse sky and a Lambertian ground.

A sky model splits the diffuse irradiance into three parts: one that comes from around the sun and falls like the beam,
one that is uniform over the vault, and one from a band at the horizon. The split depends on the sky alone; any number
of planes can then be evaluated at little cost. The plane-of-array sum is equation (1) of Andriamahefa et al. (2023)
with the circumsolar and horizon parts C and H added to the uniform part D:

    I = (DNI + C) cos(theta) + D (1 + cos beta)/2 + H sin(beta) + rho GHI (1 - cos beta)/2

Models
------
isotropic
    All diffuse irradiance is uniform: Liu & Jordan (1961).
haydavies
    A circumsolar share equal to DNI over the extraterrestrial normal irradiance: Hay & Davies (1980).
perez1990
    Circumsolar and horizon shares by clearness, brightness and zenith angle: Perez et al. (1990), Solar Energy 44,
    271, coefficients of all sites. Values agree with ``pvlib.irradiance.perez`` at sun elevations above 5 deg; below,
    what the model's bounded 1/cos(zenith) takes from the circumsolar part stays in the uniform part, so that a
    horizontal plane always receives the global irradiance.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array, direction_from_azimuth

SkyModel = Literal["isotropic", "haydavies", "perez1990"]
SKY_MODELS: tuple[SkyModel, ...] = get_args(SkyModel)

# Perez et al. (1990), table 6: upper bound of each clearness bin, then F11 F12 F13 F21 F22 F23 of each bin.
_CLEARNESS_BOUNDS = np.array([1.065, 1.23, 1.5, 1.95, 2.8, 4.5, 6.2])
_PEREZ = np.array(
    [
        [-0.008, 0.588, -0.062, -0.060, 0.072, -0.022],
        [0.130, 0.683, -0.151, -0.019, 0.066, -0.029],
        [0.330, 0.487, -0.221, 0.055, -0.064, -0.026],
        [0.568, 0.187, -0.295, 0.109, -0.152, -0.014],
        [0.873, -0.392, -0.362, 0.226, -0.462, 0.001],
        [1.132, -1.237, -0.412, 0.288, -0.823, 0.056],
        [1.060, -1.600, -0.359, 0.264, -1.127, 0.131],
        [0.678, -0.327, -0.250, 0.156, -1.377, 0.251],
    ]
)
_PEREZ_KAPPA = 1.041
_NO_DIFFUSE_W_M2 = 1e-6
_LOWEST_SINE = {"haydavies": 0.01745, "perez1990": float(np.cos(np.radians(85.0)))}


@dataclass(frozen=True, slots=True)
class Sky:
    """The sky at one instant or many, ready to shine on planes.

    Attributes
    ----------
    sun
        Unit vector(s) to the apparent sun, shape (..., 3), in the frame of :mod:`solar.frames`.
    ghi_w_m2, dni_w_m2, dhi_w_m2
        Global horizontal, direct normal and diffuse horizontal irradiance, shape (...). They are closed: GHI = DNI
        sin(elevation) + DHI, and DNI is zero while the sun is below the horizon.
    circumsolar_w_m2
        Diffuse irradiance from around the sun, on a plane that faces it, shape (...).
    uniform_w_m2
        Horizontal irradiance of the uniform part of the vault, shape (...).
    horizon_w_m2
        Irradiance that the band at the horizon adds to a vertical plane, shape (...); negative where the horizon is
        darker than the vault.
    """

    sun: Array
    ghi_w_m2: Array
    dni_w_m2: Array
    dhi_w_m2: Array
    circumsolar_w_m2: Array
    uniform_w_m2: Array
    horizon_w_m2: Array

    def beam_on(self, normals: ArrayLike) -> Array:
        """Return beam and circumsolar irradiance [W/m2] on planes; zero where the sun is behind the plane.

        `normals` are unit vectors of shape (..., 3) whose leading shape broadcasts with the sky's.
        """
        return (self.dni_w_m2 + self.circumsolar_w_m2) * np.maximum(_cosine(normals, self.sun), 0.0)

    def irradiance_on(self, normals: ArrayLike, albedo: float = 0.2) -> Array:
        """Return the plane-of-array irradiance [W/m2] of planes with unit normals, never negative.

        `normals` have shape (..., 3); their leading shape and the sky's broadcast to the result's shape. Four faces
        over n instants: normals of shape (4, 1, 3), a sky of shape (n,), a result of shape (4, n). `albedo` is the
        reflectivity of the ground.
        """
        up = np.clip(np.asarray(normals, dtype=np.float64)[..., 2], -1.0, 1.0)
        towards_sun = np.maximum(_cosine(normals, self.sun), 0.0)
        diffuse = (
            self.circumsolar_w_m2 * towards_sun
            + self.uniform_w_m2 * (1.0 + up) / 2.0
            + self.horizon_w_m2 * np.sqrt(1.0 - up * up)
        )
        ground = albedo * self.ghi_w_m2 * (1.0 - up) / 2.0
        total: Array = self.dni_w_m2 * towards_sun + np.maximum(diffuse, 0.0) + ground
        return total


def sky(model: SkyModel, sun: ArrayLike, dni_w_m2: ArrayLike, dhi_w_m2: ArrayLike, dni_extra_w_m2: ArrayLike) -> Sky:
    """Split direct normal and diffuse horizontal irradiance into the parts of a sky `model`.

    Parameters
    ----------
    sun
        Unit vector(s) to the apparent sun, shape (..., 3).
    dni_w_m2, dhi_w_m2, dni_extra_w_m2
        Direct normal, diffuse horizontal and extraterrestrial normal irradiance [W/m2], broadcasting with the leading
        shape of `sun`. Negative values, such as a pyranometer's at night, count as zero; NaN gives NaN.

    Raises
    ------
    ValueError
        For a model that is not one of ``SKY_MODELS``.
    """
    if model not in SKY_MODELS:
        raise ValueError(f"there is no sky model {model!r}; choose one of {', '.join(SKY_MODELS)}")
    sun = np.asarray(sun, dtype=np.float64)
    sine, dni, dhi, extra = np.broadcast_arrays(
        np.clip(sun[..., 2], -1.0, 1.0),
        np.maximum(dni_w_m2, 0.0),
        np.maximum(dhi_w_m2, 0.0),
        np.asarray(dni_extra_w_m2, dtype=np.float64),
    )
    up = sine > 0.0
    dni = np.where(up, dni, 0.0)
    sine = np.where(up, sine, 0.0)
    if model == "isotropic":
        near_sun = horizon = np.zeros(dhi.shape)
    elif model == "haydavies":
        near_sun, horizon = np.minimum(dni / extra, 1.0), np.zeros(dhi.shape)
    else:
        near_sun, horizon = _perez_coefficients(sine, dni, dhi, extra)
    near_sun, horizon = np.where(up, near_sun, 0.0), np.where(up, horizon, 0.0)
    circumsolar = dhi * near_sun / np.maximum(sine, _LOWEST_SINE.get(model, np.inf))
    return Sky(
        sun=sun,
        ghi_w_m2=dni * sine + dhi,
        dni_w_m2=dni,
        dhi_w_m2=dhi,
        circumsolar_w_m2=circumsolar,
        uniform_w_m2=dhi - circumsolar * sine,
        horizon_w_m2=dhi * horizon,
    )


def plane_of_array(
    normals: ArrayLike,
    sun: ArrayLike,
    dni_w_m2: ArrayLike,
    dhi_w_m2: ArrayLike,
    dni_extra_w_m2: ArrayLike,
    *,
    model: SkyModel = "perez1990",
    albedo: float = 0.2,
) -> Array:
    """Return the irradiance [W/m2] on planes in one call; arguments and shapes as :func:`sky` and :class:`Sky` say."""
    return sky(model, sun, dni_w_m2, dhi_w_m2, dni_extra_w_m2).irradiance_on(normals, albedo)


def normal_from_tilt(tilt_deg: ArrayLike, azimuth_deg: ArrayLike, latitude_deg: float) -> Array:
    """Return unit normal(s), shape (..., 3), of planes tilted from the horizontal towards an azimuth [deg]."""
    return direction_from_azimuth(azimuth_deg, 90.0 - np.asarray(tilt_deg, dtype=np.float64), latitude_deg)


def _perez_coefficients(sine: Array, dni: Array, dhi: Array, extra: Array) -> tuple[Array, Array]:
    """Circumsolar and horizon coefficients F1 and F2 of Perez et al. (1990)."""
    zenith = np.arccos(sine)
    # Relative air mass of Kasten & Young (1989), Applied Optics 28, 4735.
    air_mass = 1.0 / (sine + 0.50572 * (96.07995 - np.degrees(zenith)) ** -1.6364)
    # A fitted model: skies brighter than any that it was fitted to are taken as the brightest.
    brightness = np.minimum(dhi * air_mass / extra, 1.0)
    weight = _PEREZ_KAPPA * zenith**3
    # Clearness is ((DHI + DNI)/DHI + k z^3)/(1 + k z^3). Without diffuse light its bin does not matter.
    ratio = np.divide(dni, dhi, out=np.zeros(dhi.shape), where=dhi > _NO_DIFFUSE_W_M2)
    clearness = 1.0 + ratio / (1.0 + weight)
    row: NDArray[np.float64] = _PEREZ[np.digitize(clearness, _CLEARNESS_BOUNDS)]
    f1 = row[..., 0] + row[..., 1] * brightness + row[..., 2] * zenith
    f2 = row[..., 3] + row[..., 4] * brightness + row[..., 5] * zenith
    return np.maximum(f1, 0.0), f2


def _cosine(normals: ArrayLike, sun: Array) -> Array:
    planes = np.asarray(normals, dtype=np.float64)
    return planes[..., 0] * sun[..., 0] + planes[..., 1] * sun[..., 1] + planes[..., 2] * sun[..., 2]
