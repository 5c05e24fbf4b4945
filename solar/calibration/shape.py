"""Relative gains, attitude and albedo of a cube in place, from its own readings under clear sky.

What falls on a face at one instant is, for every sky model of :mod:`solar.skies.sky`, linear in two numbers of that
instant: the beam B = DNI + C (C the circumsolar part) and the uniform part D. Equation (1) of Andriamahefa et al.
(2023) with these parts, for a face with cosine of incidence c and vertical component u of its normal:

    I = B [c+ r(c) + rho s (1 - u)/2] + D [(1 + u)/2 + h phi sqrt(1 - u u) + rho (1 - u)/2],   s = sin(elevation)

r is the sensor's cosine response, phi = H/D the sky model's horizon band and h the share of it that the data want. Four
faces less two unknowns leave two equations at every instant, whatever the atmosphere does; B and D are eliminated by
variable projection (Golub & Pereyra 1973, SIAM J. Numer. Anal. 10, 413).

One combination stays open. On an upright cube the face in shade reads v (D + rho G)/2, and D = G - B s, so that only
v (1 + rho) can be told: v, the vertical faces' mean gain over the zenith face's, and the albedo trade against each
other. So v is an argument here, and :mod:`solar.calibration.anchor` finds it, and the scale, from a clear-sky model.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from solar.calibration.attitude import Attitude, face_normals
from solar.ephemeris import Site, extraterrestrial_dni, sun_direction
from solar.frames import FACE_NORMALS, Array
from solar.skies.sky import SkyModel, sky

# Within this of grazing incidence (80 deg) the cosine error of a face exceeds the 1 % that its maker promises.
_GRAZING_COSINE = np.array([-0.05, np.cos(np.radians(80.0))])
_OUTLIER = 4.0
_ROUNDS = 4
# ln gain of east and south against the mean of the vertical faces; yaw and the two leans [deg]; albedo; horizon.
_START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.5])
_LOWER = np.array([-0.5, -0.5, -30.0, -20.0, -20.0, 0.0, -1.0])
_UPPER = np.array([0.5, 0.5, 30.0, 20.0, 20.0, 1.0, 3.0])
_SCALES = np.array([0.01, 0.01, 0.5, 0.5, 0.5, 0.1, 0.5])
_STEPS = 1e-5 * _SCALES
COSINE_ERROR = 0.008
# Largest diffuse share of the irradiance at which the models of sky and clear sky still hold: haze and thin cloud raise
# it. Over a measured year a limit of 0.25 let tilts come out more than 0.3 deg wrong; with 0.45 one in five did.
HIGHEST_DIFFUSE = 0.22


@dataclass(frozen=True, slots=True)
class RelativeCalibration:
    """What clear skies tell without knowing how bright they are.

    Attributes
    ----------
    response
        What each face reads over what falls on it, the zenith face's taken as 1, shape (4,).
    attitude, albedo
        Of the cube and the ground.
    horizon
        Share of the sky model's horizon band that the data want: 1 if the model is right; 0 by definition for models
        without a band.
    beam_w_m2, uniform_w_m2
        B and D of the instants used, on the zenith face's scale, shape (n,).
    dhi_w_m2
        Diffuse horizontal irradiance on that scale by the sky model, shape (n,).
    utc_s
        The instants used, shape (n,).
    residual
        Root mean square of what is left, as a share of the zenith face's reading.
    """

    response: Array
    attitude: Attitude
    albedo: float
    horizon: float
    beam_w_m2: Array
    uniform_w_m2: Array
    dhi_w_m2: Array
    utc_s: Array
    residual: float


def fit_relative_calibration(
    utc_s: Array,
    faces_w_m2: Array,
    site: Site,
    *,
    vertical: float = 1.0,
    model: SkyModel = "perez1990",
    cosine_error: float = COSINE_ERROR,
) -> RelativeCalibration:
    """Fit relative gains, attitude and albedo to clear-sky readings by the equation of this module.

    Parameters
    ----------
    utc_s, faces_w_m2
        Instants of clear sky, shape (n,), and what the faces read then, offsets taken off, shape (n, 4).
    vertical
        v: geometric mean of the vertical faces' responses over the zenith face's.
    model
        Sky model whose horizon band and circumsolar share are assumed.
    cosine_error
        Beam that the sensors miss at 80 deg of incidence, as a share; it grows with the fourth power of the angle.

    Raises
    ------
    ValueError
        There are too few instants, or too few are left without outliers.
    """
    if utc_s.size < _START.size:
        raise ValueError(f"{utc_s.size} instants cannot determine {_START.size} numbers")
    sun = sun_direction(utc_s, *site)
    extra = extraterrestrial_dni(utc_s)
    phi = np.zeros(utc_s.size)
    used = np.ones(utc_s.size, dtype=np.bool_)
    free = np.ones(_START.size, dtype=np.bool_)
    free[-1] = model == "perez1990"
    found = np.where(free, _START, 0.0)
    for _ in range(_ROUNDS):
        problem = _Projection(sun[used], faces_w_m2[used], phi[used], site.latitude_deg, vertical, cosine_error)
        found = _solve(problem, found, free)
        whole = _Projection(sun, faces_w_m2, phi, site.latitude_deg, vertical, cosine_error)
        left, beam, uniform = whole.evaluate(found)
        dhi, phi = _sky_shape(model, sun, beam, uniform, extra)
        size = np.sqrt(np.mean(left**2, axis=-1))
        used = size <= np.median(size) * _OUTLIER
        used &= dhi <= HIGHEST_DIFFUSE * (beam * sun[:, 2] + uniform)
        if np.count_nonzero(used) < _START.size:
            raise ValueError("the readings fit no clear sky: too few instants are left after outliers")
    return RelativeCalibration(
        response=_responses(found, vertical),
        attitude=Attitude(*found[2:5].tolist()),
        albedo=float(found[5]),
        horizon=float(found[6]),
        beam_w_m2=beam[used],
        uniform_w_m2=uniform[used],
        dhi_w_m2=dhi[used],
        utc_s=utc_s[used],
        residual=float(np.sqrt(np.mean(left[used] ** 2))),
    )


def _solve(problem: "_Projection", start: Array, free: NDArray[np.bool_]) -> Array:
    def whole(values: Array) -> Array:
        parameters = start.copy()
        parameters[free] = values
        return parameters

    solved = least_squares(
        lambda values: problem.evaluate(whole(values))[0].ravel(),
        start[free],
        jac=lambda values: problem.slopes(whole(values))[:, free],
        bounds=(_LOWER[free], _UPPER[free]),
        x_scale=_SCALES[free],
    )
    return whole(solved.x)


def _responses(parameters: Array, vertical: float) -> Array:
    """Return the responses at parameters, shape (..., 7) to (..., 4)."""
    east, south = np.exp(parameters[..., 0]), np.exp(parameters[..., 1])
    one = np.ones_like(east)
    return np.stack([vertical * east, vertical * south, vertical / (east * south), one], axis=-1)


class _Projection:
    """The readings against the model with B and D eliminated at every instant."""

    def __init__(
        self, sun: Array, faces_w_m2: Array, phi: Array, latitude_deg: float, vertical: float, cosine_error: float
    ) -> None:
        self._sun, self._phi, self._latitude_deg = sun, phi, latitude_deg
        self._vertical, self._cosine_error = vertical, cosine_error
        nominal = sun @ FACE_NORMALS.T
        grazing = (nominal > _GRAZING_COSINE[0]) & (nominal < _GRAZING_COSINE[1])
        self._weight = np.where(grazing | ~np.isfinite(faces_w_m2), 0.0, 1.0 / faces_w_m2[:, 3:])
        self._readings = np.where(np.isfinite(faces_w_m2), faces_w_m2, 0.0)

    def slopes(self, parameters: Array) -> Array:
        """Return the residuals' differences by each parameter, shape (4 n, 7).

        By one call for all: with some hundred instants the calls take longer than the numbers.
        """
        steps = np.where(parameters + _STEPS <= _UPPER, _STEPS, -_STEPS)
        left, _, _ = self.evaluate(np.vstack([parameters, parameters + np.diag(steps)]))
        return np.asarray(((left[1:] - left[0]) / steps[:, None, None]).reshape(steps.size, -1).T, np.float64)

    def evaluate(self, parameters: Array) -> tuple[Array, Array, Array]:
        """Return residuals (..., n, 4) over the zenith face's reading, B and D (..., n) at parameters (..., 7)."""
        albedo, horizon = parameters[..., 5, None], parameters[..., 6, None, None]
        normals = face_normals(parameters[..., 2:5], self._latitude_deg)
        up = np.clip(normals[..., 2], -1.0, 1.0)
        ground = (albedo * (1.0 - up) / 2.0)[..., None, :]
        response = _responses(parameters, self._vertical)[..., None, :] * self._weight
        cosine = np.clip(self._sun @ np.swapaxes(normals, -1, -2), 0.0, 1.0)
        sensed = 1.0 - self._cosine_error * np.minimum(np.degrees(np.arccos(cosine)) / 80.0, 1.0) ** 4
        to_beam = response * (cosine * sensed + ground * self._sun[:, 2:])
        band = horizon * self._phi[:, None] * np.sqrt(1.0 - up * up)[..., None, :]
        to_uniform = response * ((1.0 + up)[..., None, :] / 2.0 + band + ground)
        read = self._readings * self._weight
        bb, uu = np.sum(to_beam**2, axis=-1), np.sum(to_uniform**2, axis=-1)
        bu = np.sum(to_beam * to_uniform, axis=-1)
        br, ur = np.sum(to_beam * read, axis=-1), np.sum(to_uniform * read, axis=-1)
        determinant = bb * uu - bu * bu
        beam, uniform = (uu * br - bu * ur) / determinant, (bb * ur - bu * br) / determinant
        return read - to_beam * beam[..., None] - to_uniform * uniform[..., None], beam, uniform


def _sky_shape(model: SkyModel, sun: Array, beam: Array, uniform: Array, extra: Array) -> tuple[Array, Array]:
    """Return DHI, and H/D, of the sky `model` that has this beam (with its circumsolar part) and uniform part."""
    circumsolar = np.zeros(beam.shape)
    beam, uniform = np.maximum(beam, 0.0), np.maximum(uniform, 1.0)
    for _ in range(12):
        dhi = uniform + circumsolar * sun[:, 2]
        overhead = sky(model, sun, beam - circumsolar, dhi, extra)
        circumsolar = 0.5 * (circumsolar + overhead.circumsolar_w_m2)
    return dhi, overhead.horizon_w_m2 / np.maximum(overhead.uniform_w_m2, 1.0)
