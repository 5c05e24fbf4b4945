"""Evaluation of `heliocube calibrate cube`: sensors that lie beside a reference pyranometer."""

from dataclasses import dataclass

import numpy as np

from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.config.sections import CubeSettings
from daemon.studies.calibrate.readings import FaceReadings, ReferenceReadings, span_text
from solar.agreement import Agreement, agreement
from solar.calibration.comparison import ConfidenceInterval, SeriesGain, fitted_offset, lag_s, series_gain
from solar.calibration.selection import block_means, clear_and_stable, night_offset
from solar.ephemeris import Site, sun_position
from solar.frames import Array

MEAN_S = 60.0
_NORMAL_QUANTILE = 1.96
_WIDEST_GAP = 1.5


@dataclass(frozen=True, slots=True)
class FaceResult:
    """One sensor beside the reference.

    Attributes
    ----------
    series
        The sensor's gain, and the series that it comes from.
    offset_mv
        Voltage in the dark, with its 95 % interval.
    gain_uncertainty_percent
        Expanded, k = 2: the series and the reference together.
    before, after
        Agreement with the old gain and the new over the clear and stable minutes.
    """

    series: SeriesGain
    offset_mv: ConfidenceInterval
    gain_uncertainty_percent: float
    before: Agreement
    after: Agreement


@dataclass(frozen=True, slots=True)
class Comparison:
    """All four sensors beside the reference.

    Attributes
    ----------
    faces
        By name.
    utc_s, reference_w_m2, irradiance_w_m2, before_w_m2, incidence_deg
        Minutes of clear and stable sky: shapes (n,), (n,), (n, 4), (n, 4) and (n,); irradiances with the new gains and
        with the old.
    lag_s, lag_known
        How far the sensors' clock is ahead; whether that was found or given, and not taken as 0.
    night_readings
        How many readings at night the offsets are from; 0: the offsets are from a line through the readings.
    minutes
        Common minutes by daylight, those of clear and stable sky among them.
    """

    faces: dict[str, FaceResult]
    utc_s: Array
    reference_w_m2: Array
    irradiance_w_m2: Array
    before_w_m2: Array
    incidence_deg: Array
    lag_s: float
    lag_known: bool
    reference_offset_w_m2: float
    night_readings: int
    minutes: int


def compare(
    reference: ReferenceReadings,
    readings: FaceReadings,
    site: Site,
    cube: CubeSettings,
    *,
    lag: float | None,
    reference_uncertainty_percent: float,
) -> Comparison:
    """Return the sensors' gains, offsets and agreement.

    Parameters
    ----------
    cube
        The settings in force when the readings were made. Their gains are those of 'before', and they turn irradiances
        back into voltages.
    lag
        How far the sensors' clock is ahead [s]; None to find out.
    reference_uncertainty_percent
        Expanded (k = 2) uncertainty of the reference's own calibration.

    Raises
    ------
    UserError
        The two do not overlap, or there is too little clear and stable sky; the sentence says how much there is.
    """
    old = [getattr(cube, name) for name in FACES]
    gains, offsets = np.array([face.gain_w_m2_per_mv for face in old]), np.array([face.offset_mv for face in old])
    voltage = readings.faces if readings.in_mv else readings.faces / gains + offsets
    whole = np.isfinite(voltage).all(axis=-1)
    if not whole.any():
        raise UserError(f"{readings.source} has no instant at which all four faces were read")
    utc_s, voltage = readings.utc_s[whole], voltage[whole]
    if utc_s[-1] - utc_s[0] < MEAN_S:
        raise UserError(f"{readings.source} has readings of less than a minute: measure on cloudless days")
    known = lag
    if known is None:
        found = lag_s(reference.utc_s, reference.ghi_w_m2, utc_s, voltage.mean(axis=-1))
        known = found if np.isfinite(found) else None
    utc_s = utc_s - (known or 0.0)
    reference_zero = zero_of(reference, site)
    dark, dark_error, nights = night_offset(utc_s, voltage, site)
    minute, ghi, mv = _common_minutes(reference, utc_s, voltage)
    spans = f"{reference.source} has {span_text(reference.utc_s)}, {readings.source} has {span_text(utc_s)}"
    if not minute.size:
        raise UserError(f"reference and sensors do not overlap: {spans}; check the files and that times are UTC")
    ghi = ghi - reference_zero
    clear = clear_and_stable(minute, ghi, site)
    daylight = int(np.count_nonzero(sun_position(minute, *site).elevation_deg > 0.0))
    if not daylight:
        raise UserError(
            f"reference and sensors overlap at night alone: {spans}; check the files, --site, and that times are UTC"
        )
    if not clear.any():
        raise UserError(
            f"none of the {daylight} common minutes by daylight has a clear and stable sky; measure on cloudless days, "
            "and check --site"
        )
    minute, ghi, mv = minute[clear], ghi[clear], mv[clear]
    faces = {}
    for place, name in enumerate(FACES):
        offset = ConfidenceInterval(float(dark[place]), float(_NORMAL_QUANTILE * dark_error[place])) if nights else None
        faces[name] = _face(
            name,
            minute,
            ghi,
            mv[:, place],
            offset,
            gains[place],
            offsets[place],
            reference_uncertainty_percent,
            site.longitude_deg,
        )
    new_gains = np.array([face.series.gain_w_m2_per_mv.value for face in faces.values()])
    new_offsets = np.array([face.offset_mv.value for face in faces.values()])
    return Comparison(
        faces=faces,
        utc_s=minute,
        reference_w_m2=ghi,
        irradiance_w_m2=(mv - new_offsets) * new_gains,
        before_w_m2=(mv - offsets) * gains,
        incidence_deg=90.0 - sun_position(minute, *site).elevation_deg,
        lag_s=known or 0.0,
        lag_known=known is not None,
        reference_offset_w_m2=reference_zero,
        night_readings=nights,
        minutes=daylight,
    )


def _common_minutes(reference: ReferenceReadings, utc_s: Array, voltage: Array) -> tuple[Array, Array, Array]:
    """Take means over minutes, and interpolate those of the sensors to the instants of the reference's.

    Two means of the same minute may be almost a minute apart in time, as readings a moment apart may fall in different
    minutes.
    """
    minute, ghi = block_means(reference.utc_s, reference.ghi_w_m2, MEAN_S)
    times, mv = block_means(utc_s, voltage, MEAN_S)
    at_reference = values_at(minute, times, mv)
    common = np.isfinite(at_reference).all(axis=-1)
    return minute[common], ghi[common], at_reference[common]


def zero_of(reference: ReferenceReadings, site: Site) -> float:
    """Return what a reference reads at night [W/m2]; 0 without nights."""
    zero, _, _ = night_offset(reference.utc_s, reference.ghi_w_m2[:, None], site)
    return float(zero[0]) if np.isfinite(zero[0]) else 0.0


def values_at(utc_s: Array, times_s: Array, values: Array) -> Array:
    """Return `values`, shape (n, m) at `times_s`, by straight lines at other instants; NaN outside and in gaps."""
    found = np.full((utc_s.size, values.shape[1]), np.nan)
    if times_s.size < 2:
        return found
    steps = np.diff(times_s)
    place = np.clip(np.searchsorted(times_s, utc_s) - 1, 0, steps.size - 1)
    common = (times_s[0] <= utc_s) & (utc_s <= times_s[-1])
    common &= steps[place] <= _WIDEST_GAP * max(MEAN_S, float(np.median(steps)))
    found[common] = np.stack([np.interp(utc_s[common], times_s, column) for column in values.T], axis=-1)
    return found


def _face(
    name: str,
    utc_s: Array,
    ghi: Array,
    mv: Array,
    offset: ConfidenceInterval | None,
    old_gain: float,
    old_offset: float,
    reference_uncertainty_percent: float,
    longitude_deg: float,
) -> FaceResult:
    try:
        zero = fitted_offset(utc_s, ghi, mv) if offset is None else offset
        series = series_gain(utc_s, ghi, mv - zero.value, longitude_deg)
    except ValueError as error:
        raise UserError(f"the {name} sensor cannot be calibrated: {error}") from None
    gain = series.gain_w_m2_per_mv
    own_percent = 100.0 * gain.half_width / gain.value
    # The effect of an uncertain zero on the gain, at the mean irradiance of the readings.
    zero_percent = 100.0 * zero.half_width / float(np.mean(mv - zero.value))
    total = float(np.sqrt(own_percent**2 + zero_percent**2 + reference_uncertainty_percent**2))
    return FaceResult(
        series,
        zero,
        total,
        before=agreement((mv - old_offset) * old_gain, ghi),
        after=agreement((mv - zero.value) * gain.value, ghi),
    )
