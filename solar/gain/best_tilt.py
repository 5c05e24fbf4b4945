"""The tilt at which a device receives the most, by latitude: what Maiga (2022), VIII, leaves open, answered.

The energy of a vertical axis is sin(beta) C + cos(beta) S, with C and S the sums of cos and sin of the elevation. That
is one cosine of the tilt, so its best tilt is atan2(C, S), exactly, and what a wrong tilt loses is known too: a tilt
that is off by x receives cos(x) of the best, at every latitude.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import cosdg

from solar.frames import Array
from solar.gain.geometry import DAYS, HOURS_PER_RAD, sun_path
from solar.gain.horizontal import horizontal_parts
from solar.gain.static import static_energy
from solar.gain.vertical import half_day_cosine, half_day_sine

# The search begins at every second degree and goes on by these steps; 20 of each make one of the step before.
_CLOSER_DEG = (0.1, 0.005, 0.00025)


class BestTilt(NamedTuple):
    """The best tilt [deg] and the energy [h] it receives; NaN and 0 where there is no sun."""

    tilt_deg: Array
    energy_h: Array


def best_tilt_vertical(phi_deg: ArrayLike, days: ArrayLike = DAYS) -> BestTilt:
    """Return the best tilt of a vertical-axis tracker by latitude, for the sum over `days`, shape (m,).

    From the exact value of Maiga (2022), (15). The result has the shape of `phi_deg`.
    """
    day = sun_path(np.asarray(phi_deg, dtype=np.float64)[..., None], days)
    cosine, sine = half_day_cosine(day).sum(axis=-1), half_day_sine(day).sum(axis=-1)
    return _peak(2.0 * HOURS_PER_RAD * cosine, 2.0 * HOURS_PER_RAD * sine, np.zeros(cosine.shape))


def best_tilt_horizontal(phi_deg: ArrayLike, lambda_deg: ArrayLike = 0.0, days: ArrayLike = DAYS) -> BestTilt:
    """Return the best tilt of the paper's horizontal-axis tracker; as :func:`best_tilt_vertical`.

    From the full-day value of Maiga (2022), (29); latitude and azimuth deviation broadcast together.
    """
    parts = horizontal_parts(np.asarray(phi_deg, dtype=np.float64)[..., None], days)
    level, southward, upward = (part.sum(axis=-1) for part in parts)
    cos_lambda = cosdg(np.asarray(lambda_deg, dtype=np.float64))
    return _peak(cos_lambda * southward, upward, cos_lambda * level)


def best_tilt_static(phi_deg: ArrayLike, lambda_deg: ArrayLike = 0.0, days: ArrayLike = DAYS) -> BestTilt:
    """Return the best tilt of a static panel with one face, searched to 0.001 deg; as :func:`best_tilt_vertical`.

    The energy is the exact clipped value of Maiga (2022), (1).
    """
    phi, deviation = np.broadcast_arrays(
        np.asarray(phi_deg, dtype=np.float64), np.asarray(lambda_deg, dtype=np.float64)
    )
    best = BestTilt(np.full(phi.shape, np.nan), np.zeros(phi.shape))
    for at in np.ndindex(phi.shape):
        # At the poles every direction is as good as its opposite; the tilt towards the equator is the one to name.
        tilts = np.copysign(1.0, phi[at]) * np.linspace(90.0, -90.0, 91)
        for closer_deg in (*_CLOSER_DEG, 0.0):
            energy = static_energy(phi[at], tilts[:, None], days, deviation[at]).clip_h.sum(axis=-1)
            top = energy.max()
            if not top > 0.0:
                break
            best.tilt_deg[at] = tilts[np.argmax(energy >= top * (1.0 - 1e-12))]
            best.energy_h[at] = top
            tilts = np.clip(best.tilt_deg[at] + closer_deg * np.arange(-20.0, 21.0), -90.0, 90.0)
    return best


def tilt_tolerance_deg(loss: float) -> float:
    """Return how far [deg] a vertical axis' tilt may be from the best one for a `loss` (0.01 is 1 %) of its energy.

    The energy is E(beta) = E(best) cos(beta - best), so the tolerance is arccos(1 - loss) at every latitude.
    """
    if not (0.0 <= loss <= 1.0):
        raise ValueError(f"a loss is a share in 0..1, not {loss}")
    return float(np.degrees(np.arccos(1.0 - loss)))


def _peak(by_sine: Array, by_cosine: Array, constant: Array) -> BestTilt:
    """Maximum of constant + by_sine sin(beta) + by_cosine cos(beta) for by_cosine >= 0, so that |beta| <= 90 deg."""
    height = np.hypot(by_sine, by_cosine)
    tilt = np.where(height > 0.0, np.degrees(np.arctan2(by_sine, by_cosine)), np.nan)
    return BestTilt(tilt, height + constant)
