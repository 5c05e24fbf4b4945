"""What has come over the bus lately: kept for displays, and handed to whoever listens."""

import asyncio
from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice

from daemon.base.records import Decision, Event, ModeChange, Move, Record, Scan

# A day of scans at the usual pace.
_SCANS = 17_280
_NEWS = 50
_PER_LISTENER = 500


@dataclass(frozen=True, slots=True)
class News:
    """One line for people: what happened, and when (UTC, s)."""

    time_utc_s: float
    text: str


class Recent:
    """Keeps the latest records in memory, and counts by tracker; `note` is its subscription to the bus.

    Parameters
    ----------
    several
        Whether there are several trackers: then each line of news begins with the name of its own.
    """

    def __init__(self, *, several: bool = False) -> None:
        self._several = several
        self._scan_log: deque[Scan] = deque(maxlen=_SCANS)
        self._listeners: list[asyncio.Queue[Record]] = []
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
            self._scan_log.append(record)
        elif isinstance(record, Decision):
            self.decisions[record.tracker] += 1
        elif isinstance(record, Move):
            self.moves[record.tracker][record.outcome] += 1
        text = _sentence(record)
        if text is not None:
            if self._several and not isinstance(record, Scan) and record.tracker:
                text = f"{record.tracker}: {text}"
            self.news.append(News(record.time_utc_s, text))
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(record)

    @property
    def listeners(self) -> int:
        """How many queues are being filled."""
        return len(self._listeners)

    def scans_since(self, utc_s: float, most: int) -> list[Scan]:
        """Return the oldest scans that ended after `utc_s`, at most `most` of them, oldest first."""
        return list(islice((scan for scan in self._scan_log if scan.time_utc_s > utc_s), most))

    @contextmanager
    def listening(self) -> Iterator[asyncio.Queue[Record]]:
        """Give a queue of all records from now on; one who does not keep up loses the oldest."""
        queue: asyncio.Queue[Record] = asyncio.Queue(_PER_LISTENER)
        self._listeners.append(queue)
        try:
            yield queue
        finally:
            self._listeners.remove(queue)


def _sentence(record: Record) -> str | None:
    if isinstance(record, ModeChange):
        return f"{record.before} -> {record.after}: {record.why}"
    if isinstance(record, Event):
        return f"{record.subject}: {record.text}"
    if isinstance(record, Move):
        text = f"moved to A {record.end_a_deg:+.1f}, B {record.end_b_deg:.1f} deg in {record.duration_s:.0f} s"
        if record.outcome != "arrived":
            text += f" ({record.outcome})"
        return f"{text}: {record.why}"
    return None
