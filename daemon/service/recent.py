"""What has come over the bus lately: kept for displays, and handed to those who follow."""

from collections import Counter, defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass

from daemon.base.records import Decision, Event, ModeChange, Move, Record, Scan

_NEWS = 50


@dataclass(frozen=True, slots=True)
class News:
    """One line for people: what happened, and when (UTC, s)."""

    time_utc_s: float
    text: str


class RecentRecords:
    """Keeps the latest records in memory, and counts by tracker; `note` is its subscription to the bus.

    Parameters
    ----------
    several
        Whether there are several trackers: then each line of news begins with the name of its tracker.
    """

    def __init__(self, *, several: bool = False) -> None:
        self._has_several_trackers = several
        self._followers: list[Callable[[Record], None]] = []
        self.news: deque[News] = deque(maxlen=_NEWS)
        self.scans = 0
        self.decisions: Counter[str] = Counter()
        self.moves: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self.scan: Scan | None = None

    def note(self, record: Record) -> None:
        """Take in one record."""
        if isinstance(record, Scan):
            self.scans += 1
            self.scan = record
        elif isinstance(record, Decision):
            self.decisions[record.tracker] += 1
        elif isinstance(record, Move):
            self.moves[record.tracker][record.outcome] += 1
        text = _sentence(record)
        if text is not None:
            if self._has_several_trackers and not isinstance(record, Scan) and record.tracker:
                text = f"{record.tracker}: {text}"
            # A move is recorded with the time of its beginning, and is news when it has ended.
            lasted_s = record.duration_s if isinstance(record, Move) else 0.0
            self.news.append(News(record.time_utc_s + lasted_s, text))
        for follower in self._followers:
            follower(record)

    def follow(self, follower: Callable[[Record], None]) -> None:
        """Call `follower` with every record from now on."""
        self._followers.append(follower)


def _sentence(record: Record) -> str | None:
    if isinstance(record, ModeChange):
        return f"{record.before} -> {record.after}: {record.why}"
    if isinstance(record, Event):
        return f"{record.subject}: {record.text}"
    if isinstance(record, Move):
        text = f"moved to A {record.end_a_deg:+z.1f}, B {record.end_b_deg:z.1f} deg in {record.duration_s:.0f} s"
        if record.outcome != "arrived":
            text += f" ({record.outcome})"
        return f"{text}: {record.why}"
    return None
