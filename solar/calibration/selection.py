"""Which instants of a record are fit to calibrate by: clear and stable sky, and its means."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pvlib.atmosphere import alt2pres
from pvlib.clearsky import simplified_solis

from solar.ephemeris import Site, extraterrestrial_dni, sun_position
from solar.frames import Array

# A clear continental atmosphere: aerosol optical depth at 700 nm and precipitable water.
CLEAR_AOD700 = 0.1
CLEAR_WATER_CM = 1.5
DARK_BELOW_DEG = -6.0


class StabilityCriteria(NamedTuple):
    """What counts as a clear and stable sky.

    Attributes
    ----------
    window_s
        Span around an instant that is looked at.
    spread
        Largest standard deviation of the clear-sky index in it, as a share of its mean.
    lowest, highest
        Bounds of that mean: wide enough for a sensor whose gain is 10 % wrong, too high for any overcast sky.
    elevation_deg
        Lowest sun.
    coverage
        Least share of the window that readings must cover.
    """

    window_s: float = 1800.0
    spread: float = 0.01
    lowest: float = 0.8
    highest: float = 1.25
    elevation_deg: float = 10.0
    coverage: float = 0.8


def clear_sky_ghi(
    site: Site, utc_s: Array, aod700: float | Array = CLEAR_AOD700, water_cm: float = CLEAR_WATER_CM
) -> tuple[Array, Array, Array]:
    """Return (GHI, DNI, DHI) [W/m2] of a cloudless sky at instants of shape (n,).

    The simplified Solis model, Ineichen (2008), Solar Energy 82, 758, for an aerosol optical depth at 700 nm, which
    may be an array that broadcasts with the instants, and a column of precipitable water.
    """
    irradiance = simplified_solis(
        sun_position(utc_s, *site).elevation_deg,
        aod700=aod700,
        precipitable_water=water_cm,
        pressure=alt2pres(site.altitude_m),
        dni_extra=extraterrestrial_dni(utc_s),
    )
    return irradiance["ghi"], irradiance["dni"], irradiance["dhi"]


def clear_and_stable(
    utc_s: Array, irradiance_w_m2: Array, site: Site, stability: StabilityCriteria | None = None
) -> NDArray[np.bool_]:
    """Tell for each instant whether the sky around it is clear and stable, by a horizontal sensor alone.

    ISO 9847 asks for stable cloudless sky. The irradiance over that of a clear sky must be nearly constant over a
    window centred on the instant, whatever its value within wide bounds, because the sensor's gain is what is sought.

    Parameters
    ----------
    utc_s
        Increasing instants [s], shape (n,).
    irradiance_w_m2
        Global horizontal irradiance by a sensor of roughly known gain, shape (n,); NaN is no reading.
    """
    wanted = StabilityCriteria() if stability is None else stability
    if utc_s.size < 3:
        return np.zeros(utc_s.size, dtype=np.bool_)
    high = sun_position(utc_s, *site).elevation_deg >= wanted.elevation_deg
    clear_w_m2, _, _ = clear_sky_ghi(site, utc_s)
    index = np.where(high, irradiance_w_m2 / np.where(high, clear_w_m2, 1.0), np.nan)
    step_s = float(np.median(np.diff(utc_s)))
    series = pd.Series(index, index=pd.to_datetime(utc_s, unit="s"))
    rolling = series.rolling(pd.Timedelta(seconds=wanted.window_s), center=True, closed="both")
    mean, spread = rolling.mean().to_numpy(), rolling.std(ddof=0).to_numpy()
    enough = rolling.count().to_numpy() * step_s >= wanted.coverage * wanted.window_s
    stable = (spread <= wanted.spread * mean) & (wanted.lowest <= mean) & (mean <= wanted.highest)
    return np.asarray(stable & enough & np.isfinite(index), dtype=np.bool_)


def block_means(utc_s: Array, values: Array, span_s: float) -> tuple[Array, Array]:
    """Return (middles [s], means) over blocks k = floor(t / `span_s`).

    `values` have shape (n,) or (n, m). A mean is over the readings that are there; a block without any is left out, and
    NaN stands where a column has none. Middles are the mean instants of the readings, so that a half-filled block is
    not stamped with a time at which nobody measured.
    """
    if not utc_s.size:
        return utc_s, values
    table = values if values.ndim == 2 else values[:, None]
    _, place = np.unique(np.floor(utc_s / span_s), return_inverse=True)
    present = np.isfinite(table)
    sums = np.stack([np.bincount(place, np.where(p, c, 0.0)) for c, p in zip(table.T, present.T, strict=True)], axis=-1)
    counts = np.stack([np.bincount(place, p) for p in present.T.astype(np.float64)], axis=-1)
    means = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)
    origin = float(utc_s[0])
    middles = origin + np.bincount(place, utc_s - origin) / np.bincount(place)
    return middles, means.reshape(-1, *values.shape[1:])


def night_offset(utc_s: Array, readings: Array, site: Site) -> tuple[Array, Array, int]:
    """Return each column's median at night, the standard error of it, and the number of night readings.

    Night is the sun 6 deg and more below the horizon. ISO 9847 takes the zero reading off both instruments. The
    standard error is 1.2533 sigma/sqrt(n) of a median, sigma by the median absolute deviation, with readings of
    half an hour counted as one because they share their drift. NaN without any reading.

    Parameters
    ----------
    utc_s, readings
        Instants [s], shape (n,), and readings in any unit, shape (n, m).
    """
    dark = sun_position(utc_s, *site).elevation_deg < DARK_BELOW_DEG
    seen = readings[dark & np.isfinite(readings).all(axis=-1)]
    if not seen.size:
        nothing = np.full(readings.shape[-1], np.nan)
        return nothing, nothing, 0
    middle = np.median(seen, axis=0)
    sigma = 1.4826 * np.median(np.abs(seen - middle), axis=0)
    pieces = np.unique(np.floor(utc_s[dark] / 1800.0)).size
    return middle, 1.2533 * sigma / np.sqrt(pieces), len(seen)
