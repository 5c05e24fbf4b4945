"""Which scan comes next: one source, one session, numbers that only rise, no old news. No sockets and no clock."""

from collections import deque
from dataclasses import replace
from math import inf

from daemon.base.records import FaceReading, Scan
from daemon.bridge.refusals import Refusal, ScanRefusedError

SOURCE_HELD_S = 60.0
DELAY_WINDOW_S = 300.0
SEQUENCE_WINDOW = 64
SESSIONS_REMEMBERED = 64


class SequenceGuard:
    """Follows one source at a time and brings its scans to the receiver's monotonic clock.

    Parameters
    ----------
    clock_skew_s
        Largest difference between a scan's UTC and the receiver's on arrival.
    late_after_s
        Longest a scan may have been under way beyond the fastest of the last five to ten minutes.
    """

    def __init__(self, clock_skew_s: float, late_after_s: float) -> None:
        self._clock_skew_s = clock_skew_s
        self._late_after_s = late_after_s
        self._source: str | None = None
        self._session = ""
        self._superseded: deque[str] = deque(maxlen=SESSIONS_REMEMBERED)
        self._numbers = _Numbers(0)
        self._delays = _SlidingMinimum(DELAY_WINDOW_S)
        self._lost_before = 0
        self._accepted_utc_s = -inf
        self._accepted_at_s = -inf
        self._latest_scan_s = -inf

    @property
    def lost(self) -> int:
        """Sequence numbers that never came, over all sessions."""
        return self._lost_before + self._numbers.lost

    def admit(self, scan: Scan, arrival_utc_s: float, arrival_monotonic_s: float) -> Scan:
        """Return `scan` with its monotonic times on the receiver's clock, never decreasing from scan to scan.

        Raises
        ------
        RefusedError
            Of kind ``other_source``, ``duplicate``, ``reordered``, ``replayed``, ``skewed`` or ``late``.
        """
        followed = scan.source == self._source
        if not followed and arrival_monotonic_s - self._accepted_at_s < SOURCE_HELD_S:
            raise ScanRefusedError(
                Refusal.OTHER_SOURCE,
                f"is from the cube {scan.source} while {self._source} is followed: give each cube a port of its own,"
                " or name the right sender in bridge.accept_from",
            )
        continued = followed and scan.session == self._session
        if continued:
            # First of all, so that a number counts as having come even where its scan is then refused.
            self._numbers.note(scan.sequence)
        elif followed and scan.session in self._superseded:
            raise ScanRefusedError(Refusal.REPLAYED, f"belongs to the session {scan.session}, which has been replaced")
        self._check_skew(scan, arrival_utc_s)
        if not continued:
            self._begin(scan, arrival_utc_s, followed=followed)
        return self._rebase(scan, arrival_monotonic_s)

    def _check_skew(self, scan: Scan, arrival_utc_s: float) -> None:
        skew_s = scan.time_utc_s - arrival_utc_s
        if not (abs(skew_s) <= self._clock_skew_s):
            side = "ahead of" if skew_s > 0 else "behind"
            raise ScanRefusedError(
                Refusal.SKEWED,
                f"is stamped {abs(skew_s):.1f} s {side} this machine's clock, more than {self._clock_skew_s:g} s:"
                " keep both clocks by NTP",
            )

    def _begin(self, scan: Scan, arrival_utc_s: float, *, followed: bool) -> None:
        # A stamp beyond any that could be accepted now is from before this machine's clock was set back.
        comparable = self._accepted_utc_s <= arrival_utc_s + self._clock_skew_s
        if comparable and not (scan.time_utc_s > self._accepted_utc_s):
            raise ScanRefusedError(
                Refusal.REPLAYED, f"begins the session {scan.session} with a scan older than one accepted before"
            )
        if followed:
            self._superseded.append(self._session)
        else:
            self._superseded.clear()
        self._lost_before += self._numbers.lost
        self._source, self._session = scan.source, scan.session
        self._numbers = _Numbers(scan.sequence)
        self._delays = _SlidingMinimum(DELAY_WINDOW_S)

    def _rebase(self, scan: Scan, arrival_monotonic_s: float) -> Scan:
        delay_s = arrival_monotonic_s - scan.time_monotonic_s
        offset_s = self._delays.add(arrival_monotonic_s, delay_s)
        lateness_s = delay_s - offset_s
        if not (lateness_s <= self._late_after_s):
            raise ScanRefusedError(
                Refusal.LATE,
                f"was {lateness_s:.1f} s longer under way than others, more than {self._late_after_s:g} s",
            )
        time_s = scan.time_monotonic_s + offset_s
        if time_s < self._latest_scan_s:
            raise ScanRefusedError(
                Refusal.LATE, "is older by its sender's steady clock than the scan before: that clock must not step"
            )
        self._latest_scan_s = time_s
        self._accepted_at_s = arrival_monotonic_s
        self._accepted_utc_s = scan.time_utc_s
        east, south, west, zenith = (
            FaceReading(face.irradiance_w_m2, face.quality, face.time_utc_s, face.time_monotonic_s + offset_s)
            for face in scan.faces
        )
        return replace(scan, time_monotonic_s=time_s, east=east, south=south, west=west, zenith=zenith)


class _Numbers:
    """The sequence numbers of one session: the highest, and which of the 64 up to it have come."""

    def __init__(self, first: int) -> None:
        self._first = first
        self._highest = first
        self._seen = 1
        self.lost = 0

    def note(self, number: int) -> None:
        """Take a higher number; raise `ScanRefusedError` for any other."""
        ahead = number - self._highest
        if ahead > 0:
            self.lost += ahead - 1
            self._seen = (self._seen << ahead | 1) & (1 << SEQUENCE_WINDOW) - 1 if ahead < SEQUENCE_WINDOW else 1
            self._highest = number
            return
        if -ahead >= SEQUENCE_WINDOW:
            raise ScanRefusedError(Refusal.REPLAYED, f"has the number {number}, long after {self._highest}")
        bit = 1 << -ahead
        if self._seen & bit:
            raise ScanRefusedError(Refusal.DUPLICATE, f"repeats the number {number}")
        self._seen |= bit
        if number > self._first:
            self.lost -= 1
        raise ScanRefusedError(Refusal.REORDERED, f"has the number {number}, after {self._highest}")


class _SlidingMinimum:
    """The least value of the last one to two windows: old ones expire, so that clock drift does not add up."""

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._began_s = -inf
        self._current = inf
        self._previous = inf

    def add(self, now_s: float, value: float) -> float:
        """Take a value and return the least."""
        age_s = now_s - self._began_s
        if not (age_s < self._window_s):
            self._previous = self._current if age_s < 2 * self._window_s else inf
            self._current = inf
            self._began_s = now_s
        self._current = min(self._current, value)
        return min(self._current, self._previous)
