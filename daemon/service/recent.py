"""What has come over the bus lately: kept for displays, and handed to whoever listens."""

import asyncio
from collections import Counter, deque
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
    """Keeps the latest records in memory; `note` is its subscription to the bus."""

    def __init__(self) -> None:
        self._scans: deque[Scan] = deque(maxlen=_SCANS)
        self._listeners: list[asyncio.Queue[Record]] = []
        self.news: deque[News] = deque(maxlen=_NEWS)
        self.counts: Counter[str] = Counter()
        self.moves: Counter[str] = Counter()
        self.scan: Scan | None = None
        self.decision: Decision | None = None

    def note(self, record: Record) -> None:
        """Take in one record."""
        self.counts[type(record).__name__] += 1
        if isinstance(record, Scan):
            self.scan = record
            self._scans.append(record)
        elif isinstance(record, Decision):
            self.decision = record
        elif isinstance(record, Move):
            self.moves[record.outcome] += 1
        text = _told(record)
        if text is not None:
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
        return list(islice((scan for scan in self._scans if scan.time_utc_s > utc_s), most))

    @contextmanager
    def listening(self) -> Iterator[asyncio.Queue[Record]]:
        """Give a queue of all records from now on; one who does not keep up loses the oldest."""
        queue: asyncio.Queue[Record] = asyncio.Queue(_PER_LISTENER)
        self._listeners.append(queue)
        try:
            yield queue
        finally:
            self._listeners.remove(queue)


def _told(record: Record) -> str | None:
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
