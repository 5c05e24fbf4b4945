"""The scale of the gains in place: how bright a clear sky is, by a model whose haze is fitted day by day.

The zenith face reads e_z G and the vertical faces see a beam e_v B. Under a clear sky both follow from the sun's
elevation, the water vapour and the aerosol optical depth of the day a_d:

    ln Z = ln e_z + ln G(a_d),   ln B_v = ln e_v + ln B(a_d)

As in a Langley plot, the change with air mass tells a_d, and then the level tells e_z and e_v. G and B are those of the
simplified Solis model, Ineichen (2008), B with the circumsolar part of the sky model. A priori the responses are 1 give
or take the sensors' tolerance, and the water vapour is as stated give or take half a centimetre, which changes G by
2 %. The model fits GHI and DNI separately, so that its DHI closes with them to 3 % only; over a measured year GHI and
DNI as they are gave the smaller errors.

The model's own level may be off too, by as much for G as for B: on the right of both equations stands one more unknown,
a priori 0 give or take 1.2 %. A response that is known from elsewhere (:mod:`.level`) is one equation more.

The fit itself tells how surely the level is known, with what was known beforehand (Bayes' rule, linear about the
solution): the inverse of J' J.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from solar.calibration.level import KnownResponse
from solar.calibration.selection import CLEAR_WATER_CM, clear_sky_ghi
from solar.ephemeris import Site, extraterrestrial_dni, solar_days, sun_direction
from solar.frames import Array
from solar.skies.sky import SkyModel, sky

# One sigma: of the model for one clear instant, whose aerosol drifts through the day, and of a sensor's sensitivity
# before it has been calibrated (5 % is the maker's limit).
_GLOBAL_SIGMA, _BEAM_SIGMA = 0.015, 0.05
_TOLERANCE = 0.05
# How far the model's own level is off, which no number of days averages out. Chosen from 2015 at Lyngby, a year that
# nothing else was chosen from, and whose errors were larger than the fit alone told.
_MODEL_SIGMA = 0.012
# The optical depth of clear days before anything is known of this one, 0.08 at 550 nm; the spread of its logarithm.
_USUAL_AOD, _LN_AOD_SIGMA = 0.06, 0.6
# One sigma of the water vapour that the user gives [cm].
_WATER_SIGMA_CM = 0.5
# Instants minutes apart share the model's error: a day counts as its two halves.
_PER_DAY = 2.0
_LOWEST_AOD, _HIGHEST_AOD = 0.01, 0.45
_DEPTHS = 40


class ClearSkyResponse(NamedTuple):
    """Readings over truth.

    Attributes
    ----------
    zenith, vertical
        Of the zenith face, and of the vertical faces in the geometric mean.
    zenith_error, vertical_error, ratio_error
        Relative standard errors of both and of vertical over zenith.
    """

    zenith: float
    vertical: float
    zenith_error: float
    vertical_error: float
    ratio_error: float


def fit_clear_sky_response(
    utc_s: Array,
    zenith_w_m2: Array,
    beam_w_m2: Array,
    site: Site,
    *,
    model: SkyModel = "perez1990",
    water_cm: float = CLEAR_WATER_CM,
    zenith: KnownResponse | None = None,
    vertical: KnownResponse | None = None,
) -> ClearSkyResponse:
    """Return the responses that a clear-sky model explains best, and what is known of them from elsewhere.

    Least squares of the two equations of this module, with the model of Ineichen (2008), Solar Energy 82, 758.

    Parameters
    ----------
    utc_s
        Instants of clear sky, shape (n,).
    zenith_w_m2
        What the zenith face reads, turned to the horizontal, shape (n,).
    beam_w_m2
        B as the vertical faces read it, shape (n,).
    water_cm
        Precipitable water, roughly.
    zenith, vertical
        What is known of e_z and e_v from elsewhere; None for nothing.
    """
    sun, extra = sun_direction(utc_s, *site), extraterrestrial_dni(utc_s)
    _, day = np.unique(solar_days(utc_s, site.longitude_deg), return_inverse=True)
    weight = np.sqrt(np.minimum(_PER_DAY / np.bincount(day), 1.0))[day]
    ln_zenith, ln_beam = np.log(zenith_w_m2), np.log(beam_w_m2)
    low, high = np.log(_LOWEST_AOD), np.log(_HIGHEST_AOD)

    # The model at a few depths, interpolated between them, costs a hundredth of the model at every step of the fit.
    depths = np.linspace(low, high, _DEPTHS)

    def ln_model(water: float) -> Array:
        ghi, dni, dhi = clear_sky_ghi(site, utc_s, np.exp(depths)[:, None], water)
        overhead = sky(model, sun, dni, dhi, extra)
        return np.log(np.stack([ghi, overhead.dni_w_m2 + overhead.circumsolar_w_m2], axis=1))

    table = ln_model(water_cm)
    per_cm = (ln_model(water_cm + _WATER_SIGMA_CM) - table) / _WATER_SIGMA_CM
    instants = np.arange(utc_s.size)

    def residuals(parameters: Array) -> Array:
        ln_zenith_response, ln_vertical_response, more_cm, ln_level = parameters[:4]
        ln_aod = parameters[4:]
        place = (ln_aod - low) / (high - low) * (_DEPTHS - 1)
        before = np.clip(np.floor(place).astype(np.int64), 0, _DEPTHS - 2)
        share, begin = (place - before)[day], before[day]
        lower, upper = ((table[at, :, instants] + more_cm * per_cm[at, :, instants]).T for at in (begin, begin + 1))
        ln_ghi, ln_model_beam = lower + (upper - lower) * share
        return np.concatenate(
            [
                weight * (ln_zenith - ln_ghi - ln_level - ln_zenith_response) / _GLOBAL_SIGMA,
                weight * (ln_beam - ln_model_beam - ln_level - ln_vertical_response) / _BEAM_SIGMA,
                (ln_aod - np.log(_USUAL_AOD)) / _LN_AOD_SIGMA,
                [
                    ln_zenith_response / _TOLERANCE,
                    ln_vertical_response / (_TOLERANCE / np.sqrt(3.0)),
                    more_cm / _WATER_SIGMA_CM,
                    ln_level / _MODEL_SIGMA,
                ],
                [(parameters[at] - np.log(tie.response)) / tie.error for at, tie in known],
            ]
        )

    known = [(at, tie) for at, tie in enumerate((zenith, vertical)) if tie is not None]
    days = int(day.max()) + 1
    # The water vapour is off by three sigma at most, and never zero.
    least_cm = max(-3.0 * _WATER_SIGMA_CM, 0.05 - water_cm)
    bounds = ([-0.5, -0.5, least_cm, -0.1, *[low] * days], [0.5, 0.5, 3.0 * _WATER_SIGMA_CM, 0.1, *[high] * days])
    start = [0.0, 0.0, 0.0, 0.0, *[np.log(_USUAL_AOD)] * days]
    scales = [0.01, 0.01, 0.2, 0.01, *[0.1] * days]
    solved = least_squares(residuals, start, bounds=bounds, loss="soft_l1", x_scale=scales)
    covariance = np.linalg.inv(solved.jac.T @ solved.jac)[:2, :2]
    of_zenith, of_vertical = np.exp(solved.x[:2]).tolist()
    both = np.array([-1.0, 1.0])
    return ClearSkyResponse(of_zenith, of_vertical, *np.sqrt([*np.diag(covariance), both @ covariance @ both]).tolist())
