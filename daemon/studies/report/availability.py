"""The quality of the records, in the terms of IEC 61724-1: available, valid, flagged and missing data, and the gaps."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daemon.base.records import FACES, Quality
from daemon.studies.report.material import Material
from daemon.studies.report.yields import sun_up
from solar.frames import Array

_LEAST_GAP_S = 60.0
_LEAST_GAP_SCANS = 3.0
_USUAL_INTERVAL_S = 5.0
# Share of an interval: the first and the last scan do not come at exact instants.
_JITTER = 0.05


@dataclass(frozen=True, slots=True)
class Count:
    """Scans of one kind of time, all or daylight.

    Attributes
    ----------
    expected
        One in every interval, from the beginning of the reporting period to its end.
    recorded, valid
        Scans that are there, and scans of which all four readings are good.
    """

    expected: int
    recorded: int
    valid: int

    @property
    def available_pct(self) -> float:
        """Data availability: recorded of expected [%]; NaN where none is expected."""
        return _share(self.recorded, self.expected)

    @property
    def valid_pct(self) -> float:
        """Valid of expected [%]; NaN where none is expected."""
        return _share(self.valid, self.expected)

    @property
    def flagged(self) -> int:
        """Recorded, but with a reading that is not good."""
        return self.recorded - self.valid

    @property
    def missing(self) -> int:
        """Expected, but not there."""
        return max(self.expected - self.recorded, 0)


@dataclass(frozen=True, slots=True)
class Gap:
    """A stretch without scans [s UTC]."""

    start_utc_s: float
    end_utc_s: float


@dataclass(frozen=True, slots=True)
class Availability:
    """The state of the records of a span.

    Attributes
    ----------
    interval_s
        The usual time from one scan to the next.
    period, daylight
        The counts of the whole period, and of its daylight.
    faces
        By face, in daylight: how many readings had each quality.
    gaps
        Those longer than a minute and than three intervals.
    """

    interval_s: float
    period: Count
    daylight: Count
    faces: dict[str, dict[str, int]]
    gaps: tuple[Gap, ...]


def availability_of(material: Material) -> Availability:
    """Return how good the records of a span are."""
    span, scans = material.span, material.tables["scans"]
    utc_s = material.times_of("scans")
    interval_s = _interval_s(utc_s)
    valid: NDArray[np.bool_] = np.isfinite(material.faces()).min(axis=1, initial=True)
    missing = _missing_times(utc_s, span.start_utc_s, span.end_utc_s, interval_s)
    up, missing_up = sun_up(material, utc_s) > 0.0, sun_up(material, missing) > 0.0
    return Availability(
        interval_s=interval_s,
        period=_count(utc_s.size, missing.size, valid),
        daylight=_count(int(up.sum()), int(missing_up.sum()), valid[up]),
        faces={
            face: {quality: int((scans[f"{face}_quality"][up] == quality).sum()) for quality in Quality}
            for face in FACES
            if f"{face}_quality" in scans
        },
        gaps=_gaps(utc_s, span.start_utc_s, span.end_utc_s),
    )


def longest_interval_s(utc_s: Array) -> float:
    """Return the longest time [s] between two records of one kind that is no gap, from the instants of all of them."""
    return max(_LEAST_GAP_S, _LEAST_GAP_SCANS * _interval_s(utc_s))


def _interval_s(utc_s: Array) -> float:
    # Records may stand in a table twice; they must not count as an interval of zero.
    apart_s = np.diff(np.unique(utc_s))
    return float(np.median(apart_s)) if apart_s.size > 1 else _USUAL_INTERVAL_S


def _count(recorded: int, missing: int, valid: NDArray[np.bool_]) -> Count:
    return Count(recorded + missing, recorded, int(valid.sum()))


def _missing_times(utc_s: Array, start_s: float, end_s: float, interval_s: float) -> Array:
    """Return the instants at which missing scans should have been made."""
    if not utc_s.size:
        return np.arange(start_s, end_s, interval_s)
    before = int(max((utc_s[0] - start_s) / interval_s - _JITTER, 0.0))
    behind = max(math.ceil((end_s - utc_s[-1]) / interval_s - _JITTER) - 1, 0)
    counts = np.maximum(np.round(np.diff(utc_s) / interval_s).astype(int) - 1, 0)
    places = np.flatnonzero(counts).tolist()
    parts = [utc_s[place] + interval_s * np.arange(1, counts[place] + 1) for place in places]
    first, last = start_s + interval_s * np.arange(before), utc_s[-1] + interval_s * np.arange(1, behind + 1)
    return np.concatenate([first, *parts, last])


def _gaps(utc_s: Array, start_s: float, end_s: float) -> tuple[Gap, ...]:
    edges = np.concatenate([[start_s], utc_s, [end_s]])
    long = np.flatnonzero(np.diff(edges) > longest_interval_s(utc_s))
    return tuple(Gap(float(edges[place]), float(edges[place + 1])) for place in long.tolist())


def _share(part: int, whole: int) -> float:
    return 100.0 * part / whole if whole else np.nan
