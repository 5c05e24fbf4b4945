"""Calibration beside a reference pyranometer, outdoors and horizontal, in the manner of ISO 9847.

Both instruments see the same sky. Readings are brought to one clock, clear and stable periods are cut into series, each
series gives a ratio of sums, series that stray are dropped, and the mean ratio is the gain:

    gain_j = sum(E_ref) / sum(V - V_0),   E = gain (V - V_0)
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from solar.calibration.in_place import jackknife_error
from solar.calibration.selection import block_means
from solar.ephemeris import solar_days
from solar.frames import Array

SERIES_S = 1200.0
_HOUR_S = 3600.0
LARGEST_LAG_S = 300.0
_LARGEST_DEVIATION = 0.02
_LEAST_IN_SERIES = 5
_LEAST_SERIES = 3
_LEAST_CORRELATION = 0.5
_LAG_STEPS = 6
_SMOOTHED_STEPS = 4.0


class ConfidenceInterval(NamedTuple):
    """An estimate and the half-width of its 95 % confidence interval, in one unit."""

    value: float
    half_width: float


@dataclass(frozen=True, slots=True)
class SeriesGain:
    """The gain of one sensor.

    Attributes
    ----------
    gain_w_m2_per_mv
        Its interval is by the scatter of the series alone; the caller adds the error of the reference's calibration.
    series_gains, series_utc_s
        Ratio and middle of each series, shape (k,).
    kept
        Which series were not dropped, shape (k,).
    """

    gain_w_m2_per_mv: ConfidenceInterval
    series_gains: Array
    series_utc_s: Array
    kept: NDArray[np.bool_]


def lag_s(
    reference_utc_s: Array, reference: Array, sensor_utc_s: Array, sensor: Array, largest_s: float = LARGEST_LAG_S
) -> float:
    """Return by how much the sensor's clock is ahead of the reference's [s]; NaN where the readings do not tell.

    argmax over L of corr(d reference(t), d sensor(t + L)): the lag with the largest correlation between the changes of
    both, refined by a parabola through its neighbours.
    Both are smoothed over four of the longer steps first: linear interpolation weakens faster changes between the
    readings and would draw the lag towards a whole number of steps. Under clouds the lag is found to a twentieth of the
    longer step; under a steady sky nothing moves and the correlation stays low.

    Parameters
    ----------
    reference_utc_s, reference, sensor_utc_s, sensor
        Increasing instants [s] and readings in any units, shapes (n,) and (m,), without NaN.
    """
    if min(reference_utc_s.size, sensor_utc_s.size) < 20:
        return float("nan")
    longest_s = max(float(np.median(np.diff(times))) for times in (reference_utc_s, sensor_utc_s))
    step_s = max(1.0, longest_s / _LAG_STEPS)
    begin_s, end_s = max(reference_utc_s[0], sensor_utc_s[0]), min(reference_utc_s[-1], sensor_utc_s[-1])
    grid = np.arange(begin_s + largest_s, end_s - largest_s, step_s)
    width = max(1, round(_SMOOTHED_STEPS * longest_s / step_s))
    if grid.size < width + 20:
        return float("nan")
    change = _change(np.interp(grid, reference_utc_s, reference), width)
    lags = np.arange(-np.floor(largest_s / step_s), np.floor(largest_s / step_s) + 1) * step_s
    likeness = np.array(
        [_correlation(change, _change(np.interp(grid + lag, sensor_utc_s, sensor), width)) for lag in lags]
    )
    best = int(np.argmax(likeness))
    if not likeness[best] >= _LEAST_CORRELATION or best in (0, lags.size - 1):
        return float("nan")
    before, at, after = likeness[best - 1 : best + 2]
    bend = before - 2.0 * at + after
    return float(lags[best] + (0.5 * (before - after) / bend * step_s if bend else 0.0))


def series_gain(
    utc_s: Array, reference_w_m2: Array, net_mv: Array, longitude_deg: float = 0.0, series_s: float = SERIES_S
) -> SeriesGain:
    """Return the gain of a sensor from simultaneous readings under clear and stable sky.

    Series of `series_s` with fewer than 5 readings are not used. Those whose ratio is more than 2 % off the mean of the
    others kept are dropped, the worst first, until none is, as ISO 9847 does. The interval is Student's over days
    where there are three or more, because the series of a day share its errors, and else over series.

    Parameters
    ----------
    utc_s, reference_w_m2, net_mv
        Instants [s], the reference's irradiance and the sensor's voltage less its offset, shapes (n,), without NaN.
    longitude_deg
        Of the place, by which its days begin.

    Raises
    ------
    ValueError
        There are fewer than 3 series, or fewer than 3 are left; the text says which.
    """
    place = np.floor(utc_s / series_s)
    number, index = np.unique(place, return_inverse=True)
    count = np.bincount(index)
    reference, voltage = (np.bincount(index, values) for values in (reference_w_m2, net_mv))
    whole = (count >= _LEAST_IN_SERIES) & (voltage > 0.0)
    if np.count_nonzero(whole) < _LEAST_SERIES:
        raise ValueError(
            f"only {np.count_nonzero(whole)} series of clear and stable sky; at least {_LEAST_SERIES} are needed"
        )
    ratios, middles = reference[whole] / voltage[whole], (number[whole] + 0.5) * series_s
    kept = np.ones(ratios.size, dtype=np.bool_)
    for _ in ratios:
        deviation = np.where(kept, np.abs(ratios / ratios[kept].mean() - 1.0), 0.0)
        worst = int(np.argmax(deviation))
        if deviation[worst] <= _LARGEST_DEVIATION:
            break
        kept[worst] = False
        if np.count_nonzero(kept) < _LEAST_SERIES:
            raise ValueError("the series disagree by more than 2 %: fewer than 3 are left after outliers")
    _, daily = block_means(solar_days(middles[kept], longitude_deg), ratios[kept], 1.0)
    independent = daily if daily.size >= _LEAST_SERIES else ratios[kept]
    width = stats.t.ppf(0.975, independent.size - 1) * np.std(independent, ddof=1) / np.sqrt(independent.size)
    return SeriesGain(ConfidenceInterval(float(ratios[kept].mean()), float(width)), ratios, middles, kept)


def fitted_offset(utc_s: Array, reference_w_m2: Array, voltage_mv: Array) -> ConfidenceInterval:
    """Return the voltage [mV] at which a straight line through the readings reaches zero irradiance.

    V = V_0 + E / gain, for sensors whose nights were not recorded: the intercept V_0 of the least-squares line of
    voltage on irradiance. Its 95 % interval is the wider one of the line's own and of a jackknife over the hours of the
    day: cosine response and levelling bend the line, alike on all days, and minutes of one hour share that. If the
    cosine response errs alike all day, its effect on the line does not show in full. Readings of shape (n,) without
    NaN; raises `ValueError` for fewer than 3.
    """
    if reference_w_m2.size < 3:
        raise ValueError(f"a line through {reference_w_m2.size} readings gives no offset")
    line = stats.linregress(reference_w_m2, voltage_mv)
    half = stats.t.ppf(0.975, reference_w_m2.size - 2) * line.intercept_stderr
    hour = np.floor(utc_s / _HOUR_S) % 24.0
    hours = np.unique(hour)
    # An hour left out must leave a line.
    if hours.size >= _LEAST_SERIES:
        each = np.array([np.polyfit(reference_w_m2[hour != one], voltage_mv[hour != one], 1)[-1:] for one in hours])
        half = max(half, stats.t.ppf(0.975, hours.size - 1) * jackknife_error(each)[0])
    return ConfidenceInterval(float(line.intercept), float(half))


def _change(values: Array, width: int) -> Array:
    """Return the changes of the mean over `width` values, less their own mean."""
    change = values[width:] - values[:-width]
    return np.asarray(change - change.mean(), dtype=np.float64)


def _correlation(first: Array, second: Array) -> float:
    length = float(np.sqrt(np.sum(first * first) * np.sum(second * second)))
    return float(np.sum(first * second)) / length if length > 0.0 else 0.0
