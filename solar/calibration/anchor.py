"""The scale of the gains in place: how bright a clear sky is, by a model whose haze is fitted day by day.

The zenith face reads e_z G and the vertical faces see a beam e_v B. Under a clear sky both follow from the sun's
elevation, the water vapour and the aerosol optical depth of the day a_d:

    ln Z = ln e_z + ln G(a_d),   ln B_v = ln e_v + ln B(a_d)

As in a Langley plot, the change with air mass tells a_d, and then the level tells e_z and e_v. G and B are those of the
simplified Solis model, Ineichen (2008), B with the circumsolar part of the sky model. A priori the responses are 1 give
or take the sensors' tolerance. The model's GHI and DNI are fitted each for itself, and its DHI closes with them to 3 %
only; over a measured year GHI and DNI as they are gave the smaller errors. What the water vapour is has to be known: G
falls by 2 % with each centimetre.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from solar.calibration.selection import CLEAR_WATER_CM, clear_sky_ghi
from solar.ephemeris import DAY_S, Site, extraterrestrial_dni, sun_direction
from solar.frames import Array
from solar.sky import SkyModel, sky

# One sigma: of the model for one clear instant, and of a sensor's sensitivity before it has been calibrated (5 % is the
# maker's limit).
_GLOBAL_SIGMA, _BEAM_SIGMA = 0.01, 0.03
_TOLERANCE = 0.05
# What clear days are like before anything is known of this one: 0.08 at 550 nm, and the spread of its logarithm.
_USUAL_AOD, _LN_AOD_SIGMA = 0.06, 0.4
# Instants minutes apart share the model's error: a day counts as its two halves.
_PER_DAY = 2.0
_LOWEST_AOD, _HIGHEST_AOD = 0.01, 0.45
_DEPTHS = 40


class Anchor(NamedTuple):
    """Readings over truth: of the zenith face, and of the vertical faces in the geometric mean."""

    zenith: float
    vertical: float


def clear_sky_anchor(
    utc_s: Array,
    zenith_w_m2: Array,
    beam_w_m2: Array,
    site: Site,
    *,
    model: SkyModel = "perez1990",
    water_cm: float = CLEAR_WATER_CM,
) -> Anchor:
    """Return the responses that a clear-sky model explains best.

    Parameters
    ----------
    utc_s
        Instants of clear sky, shape (n,).
    zenith_w_m2
        What the zenith face reads, turned to the horizontal, shape (n,).
    beam_w_m2
        B as the vertical faces read it, shape (n,).
    water_cm
        Precipitable water.
    """
    sun, extra = sun_direction(utc_s, *site), extraterrestrial_dni(utc_s)
    _, day = np.unique(np.floor(utc_s / DAY_S), return_inverse=True)
    weight = np.sqrt(np.minimum(_PER_DAY / np.bincount(day), 1.0))[day]
    ln_zenith, ln_beam = np.log(zenith_w_m2), np.log(beam_w_m2)
    low, high = np.log(_LOWEST_AOD), np.log(_HIGHEST_AOD)

    # The model at a few depths, interpolated between them, costs a hundredth of the model at every step of the fit.
    depths = np.linspace(low, high, _DEPTHS)
    ghi, dni, dhi = clear_sky_ghi(site, utc_s, np.exp(depths)[:, None], water_cm)
    overhead = sky(model, sun, dni, dhi, extra)
    table = np.log(np.stack([ghi, overhead.dni_w_m2 + overhead.circumsolar_w_m2], axis=1))
    instants = np.arange(utc_s.size)

    def residuals(parameters: Array) -> Array:
        ln_aod = parameters[2:]
        place = (ln_aod - low) / (high - low) * (_DEPTHS - 1)
        before = np.clip(np.floor(place).astype(np.int64), 0, _DEPTHS - 2)
        share, begin = (place - before)[day], before[day]
        lower, upper = table[begin, :, instants].T, table[begin + 1, :, instants].T
        ln_ghi, ln_model_beam = lower + (upper - lower) * share
        return np.concatenate(
            [
                weight * (ln_zenith - ln_ghi - parameters[0]) / _GLOBAL_SIGMA,
                weight * (ln_beam - ln_model_beam - parameters[1]) / _BEAM_SIGMA,
                (ln_aod - np.log(_USUAL_AOD)) / _LN_AOD_SIGMA,
                [parameters[0] / _TOLERANCE, parameters[1] / (_TOLERANCE / np.sqrt(3.0))],
            ]
        )

    days = int(day.max()) + 1
    bounds = ([-0.5, -0.5, *[low] * days], [0.5, 0.5, *[high] * days])
    start = [0.0, 0.0, *[np.log(_USUAL_AOD)] * days]
    scales = [0.01, 0.01, *[0.1] * days]
    solved = least_squares(residuals, start, bounds=bounds, loss="soft_l1", x_scale=scales)
    return Anchor(*np.exp(solved.x[:2]).tolist())
