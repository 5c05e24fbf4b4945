"""Which scan comes next: one cube, one session, numbers that only rise, no old news. No sockets and no clock."""

from dataclasses import dataclass, field, replace
from math import inf

from daemon.base.records import FaceReading, Scan
from daemon.bridge.refusals import Refusal, ScanRefusedError

# For this long after its last scan a cube counts as present, and no other takes its place.
CUBE_TIMEOUT_S = 60.0
DELAY_WINDOW_S = 300.0
SEQUENCE_WINDOW = 64
SESSIONS_REMEMBERED = 64
# A scan no older than this by this machine's clock was not held back during a cube's restart, which takes seconds.
_JUST_MADE_S = 0.25


class SequenceGuard:
    """Follows one session of one source at a time and brings its scans to the receiver's monotonic clock.

    A new session is taken for a restart of the followed one. If the old session sends again, the new one was no restart
    but a second cube under the same name: then the older session is followed again, and the newer one only when the
    older has been silent for `CUBE_TIMEOUT_S`. A session that returns must send a new scan: with a higher number than
    its last, and a stamp that is of now, or later than that of the last scan accepted.

    Parameters
    ----------
    clock_skew_s
        Largest difference between a scan's UTC and the receiver's on arrival.
    late_after_s
        How much longer a scan may have been under way than the fastest of the last five to ten minutes.
    """

    def __init__(self, clock_skew_s: float, late_after_s: float) -> None:
        self._clock_skew_s = clock_skew_s
        self._late_after_s = late_after_s
        self._source: str | None = None
        # The sessions of the source, by trust: the oldest first, and a restart right after the session it replaced.
        self._sessions: list[_Session] = []
        self._followed: _Session | None = None
        self._lost_in_past_sessions = 0
        self._accepted_utc_s = -inf
        self._accepted_at_s = -inf
        self._latest_scan_s = -inf

    @property
    def lost(self) -> int:
        """Sequence numbers that never came, over all sessions."""
        return self._lost_in_past_sessions + sum(session.numbers.lost for session in self._sessions)

    def forget_delays(self) -> None:
        """Forget the shortest time that a scan was under way, and learn it anew."""
        for session in self._sessions:
            session.delays = _SlidingMinimum(DELAY_WINDOW_S)

    def admit(self, scan: Scan, arrival_utc_s: float, arrival_monotonic_s: float) -> Scan:
        """Return `scan` with its monotonic times on the receiver's clock, never decreasing from scan to scan.

        Raises
        ------
        ScanRefusedError
            Of kind ``other_source``, ``second_cube``, ``duplicate``, ``reordered``, ``replayed``, ``skewed`` or
            ``late``.
        """
        head = ScanHead(scan.source, scan.session, scan.sequence, scan.time_utc_s)
        self.screen(head, arrival_utc_s, arrival_monotonic_s)
        session = self._session(head)
        if session is not None:
            # Before the other checks, so that a number counts as having come even if its scan is then refused.
            session.numbers.note(scan.sequence)
            self._refuse_second(session, arrival_monotonic_s)
        self._check_skew(head, arrival_utc_s)
        if session is None:
            session = self._begin(head)
        self._followed = session
        return self._rebase(scan, session, arrival_monotonic_s)

    def screen(self, head: "ScanHead", arrival_utc_s: float, arrival_monotonic_s: float) -> None:
        """Refuse a scan if its head is reason enough; changes nothing. Raises like `admit`, which calls it first."""
        if head.source != self._source and arrival_monotonic_s - self._accepted_at_s < CUBE_TIMEOUT_S:
            raise ScanRefusedError(
                Refusal.OTHER_SOURCE,
                f"is from the cube {head.source} while {self._source} is followed: give each cube a port of its own,"
                " or name the right sender in bridge.accept_from",
            )
        session = self._session(head)
        if session is None:
            self._check_skew(head, arrival_utc_s)
            self._check_stamp(head, arrival_utc_s, "begins")
            return
        if session is self._followed:
            session.numbers.refuse_old(head.sequence)
            return
        if not head.sequence > session.numbers.highest:
            raise ScanRefusedError(Refusal.REPLAYED, f"belongs to the session {head.session}, which has been replaced")
        self._check_stamp(head, arrival_utc_s, "returns to")

    def _session(self, head: "ScanHead") -> "_Session | None":
        if head.source != self._source:
            return None
        for session in self._sessions:
            if session.name == head.session:
                return session
        return None

    def _refuse_second(self, session: "_Session", now_s: float) -> None:
        """Refuse a session while an older one is present."""
        followed = self._followed
        if followed is None or followed is session or not now_s - followed.accepted_at_s < CUBE_TIMEOUT_S:
            return
        if self._sessions.index(followed) < self._sessions.index(session):
            raise ScanRefusedError(
                Refusal.SECOND_CUBE,
                f"is of the session {session.name}, a second cube under the name {self._source}, while the session"
                f" {followed.name} is followed: stop one of the two, or give it a name and a port of its own",
            )

    def _check_skew(self, head: "ScanHead", arrival_utc_s: float) -> None:
        skew_s = head.time_utc_s - arrival_utc_s
        if not (abs(skew_s) <= self._clock_skew_s):
            side = "ahead of" if skew_s > 0 else "behind"
            raise ScanRefusedError(
                Refusal.SKEWED,
                f"is stamped {abs(skew_s):.1f} s {side} this machine's clock, more than {self._clock_skew_s:g} s:"
                " keep both clocks by NTP",
            )

    def _check_stamp(self, head: "ScanHead", arrival_utc_s: float, does: str) -> None:
        # If the last accepted stamp is later than any that could be accepted now, this machine's clock was set back.
        comparable = self._accepted_utc_s <= arrival_utc_s + self._clock_skew_s
        # If it is only later than now, its cube's clock is ahead: a cube with the right time need not wait until then.
        just_made = arrival_utc_s - head.time_utc_s <= _JUST_MADE_S
        if comparable and not just_made and not (head.time_utc_s > self._accepted_utc_s):
            raise ScanRefusedError(
                Refusal.REPLAYED, f"{does} the session {head.session} with a scan older than one accepted before"
            )

    def _begin(self, head: "ScanHead") -> "_Session":
        if head.source != self._source:
            self._lost_in_past_sessions = self.lost
            self._source, self._followed = head.source, None
            self._sessions.clear()
        session = _Session(head.session, _Numbers(head.sequence))
        place = 0 if self._followed is None else self._sessions.index(self._followed) + 1
        self._sessions.insert(place, session)
        if len(self._sessions) > SESSIONS_REMEMBERED:
            oldest = min((one for one in self._sessions if one is not session), key=_accepted_at_s)
            self._lost_in_past_sessions += oldest.numbers.lost
            self._sessions.remove(oldest)
        return session

    def _rebase(self, scan: Scan, session: "_Session", arrival_monotonic_s: float) -> Scan:
        delay_s = arrival_monotonic_s - scan.time_monotonic_s
        offset_s = session.delays.add(arrival_monotonic_s, delay_s)
        lateness_s = delay_s - offset_s
        if not (lateness_s <= self._late_after_s):
            raise ScanRefusedError(
                Refusal.LATE,
                f"took {lateness_s:.1f} s longer on its way than others, more than {self._late_after_s:g} s",
            )
        time_s = scan.time_monotonic_s + offset_s
        if time_s < self._latest_scan_s:
            raise ScanRefusedError(
                Refusal.LATE, "is older by its sender's steady clock than the scan before: that clock must not step"
            )
        self._latest_scan_s = time_s
        self._accepted_at_s = session.accepted_at_s = arrival_monotonic_s
        self._accepted_utc_s = scan.time_utc_s
        east, south, west, zenith = (
            FaceReading(face.irradiance_w_m2, face.quality, face.time_utc_s, face.time_monotonic_s + offset_s)
            for face in scan.faces
        )
        return replace(scan, time_monotonic_s=time_s, east=east, south=south, west=west, zenith=zenith)


@dataclass(frozen=True, slots=True)
class ScanHead:
    """What tells one scan from another: cube, session, number, and UTC [s]."""

    source: str
    session: str
    sequence: int
    time_utc_s: float


class _Numbers:
    """The sequence numbers of one session: the highest, and which of the 64 up to it have come."""

    def __init__(self, first: int) -> None:
        self._first = first
        self.highest = first
        self._seen_bits = 1
        self.lost = 0

    def note(self, number: int) -> None:
        """Note that a number has come; raise `ScanRefusedError` if it is not higher. Call `refuse_old` before."""
        ahead = number - self.highest
        if ahead > 0:
            self.lost += ahead - 1
            self._seen_bits = (
                (self._seen_bits << ahead | 1) & (1 << SEQUENCE_WINDOW) - 1 if ahead < SEQUENCE_WINDOW else 1
            )
            self.highest = number
            return
        self._seen_bits |= 1 << -ahead
        if number > self._first:
            self.lost -= 1
        raise ScanRefusedError(Refusal.REORDERED, f"has the number {number}, after {self.highest}")

    def refuse_old(self, number: int) -> None:
        """Raise `ScanRefusedError` for a number that has come before, or is too far behind to know."""
        behind = self.highest - number
        if behind >= SEQUENCE_WINDOW:
            raise ScanRefusedError(Refusal.REPLAYED, f"has the number {number}, long after {self.highest}")
        if behind >= 0 and self._seen_bits >> behind & 1:
            raise ScanRefusedError(Refusal.DUPLICATE, f"repeats the number {number}")


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


@dataclass(slots=True, eq=False)
class _Session:
    """One run of a cube's program."""

    name: str
    numbers: _Numbers
    delays: _SlidingMinimum = field(default_factory=lambda: _SlidingMinimum(DELAY_WINDOW_S))
    accepted_at_s: float = -inf


def _accepted_at_s(session: _Session) -> float:
    return session.accepted_at_s
