"""What must not grow without bound: lines of the log, moves, and memory."""

import gc
import logging
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from daemon.base.records import Move, Record
from daemon.studies.campaign.schedule import Schedule

LINES_OF_AN_OUTAGE = 50
LINES_OF_A_COMMAND = 8
MOVES_OF_AN_HOUR = 70
"""A law may order one in a minute; the rest is a margin."""
MOVES_OF_AN_EVENT = 6
WARM_AFTER_S = 3600.0
"""By then the windows of laws and judgements are full, and modules that are imported on first use are there."""
MOST_NEW_OBJECTS = 2_000
"""Objects, and items in queues, of each tracker: less than two for each minute of a day."""
# Not lists: the simulated sky keeps its numbers there, some hours at a time. A table of numbers alone gc does not list.
_CONTAINERS = frozenset((dict, set, deque))
_ROUTINE = ("moving", "staying")
_HOUR_S = 3600


class LogLine(NamedTuple):
    """One line of the service's log, at a time [s] of the run."""

    at_s: float
    level: str
    name: str
    text: str


class GrowthCheck(logging.Handler):
    """Keeps the service's log lines with their time, and compares lines, moves and memory with what happened.

    Parameters
    ----------
    now
        The loop's time [s].

    Attributes
    ----------
    lines
        All lines so far.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        super().__init__(logging.INFO)
        self._now = now
        self.lines: list[LogLine] = []
        self._objects_when_warm: int | None = None

    def note_memory_baseline(self, records: Sequence[Record]) -> None:
        """Count what is in memory, to be compared with at the end."""
        self._objects_when_warm = self._count_objects(records)

    def _count_objects(self, records: Sequence[Record]) -> int:
        """Return how much is in memory, apart from what the campaign itself keeps."""
        gc.collect()
        found = gc.get_objects()
        kept = len(records) + len(self.lines)
        return len(found) + sum(len(one) for one in found if type(one) in _CONTAINERS) - kept

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line."""
        self.lines.append(LogLine(self._now(), record.levelname, record.name, record.getMessage()))

    def check(self, schedule: Schedule, records: Sequence[Record], fails: Callable[[str, str], None]) -> None:
        """Compare each hour's lines and moves with what happened then, and the memory with the first hour's."""
        self._check_lines(schedule, fails)
        self._check_memory(schedule, records, fails)
        moves = Counter(int(record.time_monotonic_s // _HOUR_S) for record in records if isinstance(record, Move))
        events = Counter(int(event.at_s // _HOUR_S) for event in schedule.events)
        for hour, count in moves.items():
            allowed = schedule.trackers * (MOVES_OF_AN_HOUR + MOVES_OF_AN_EVENT * (events[hour] + events[hour - 1]))
            if count > allowed:
                fails("moves", f"{count} moves in hour {hour}, {allowed} allowed")

    def _check_memory(self, schedule: Schedule, records: Sequence[Record], fails: Callable[[str, str], None]) -> None:
        if self._objects_when_warm is None:
            return
        more, allowed = self._count_objects(records) - self._objects_when_warm, schedule.trackers * MOST_NEW_OBJECTS
        if more > allowed:
            fails("leak", f"{more} more objects and items in memory than after the first hour, {allowed} allowed")

    def _check_lines(self, schedule: Schedule, fails: Callable[[str, str], None]) -> None:
        written: Counter[int] = Counter()
        happened: Counter[int] = Counter()
        for line in self.lines:
            if line.text not in _ROUTINE:
                written[int(line.at_s // _HOUR_S)] += 1
        for event in schedule.events:
            hour = int(event.at_s // _HOUR_S)
            if event.what == "command":
                happened[hour] += LINES_OF_A_COMMAND
                continue
            for during in range(hour, int((event.at_s + event.lasts_s) // _HOUR_S) + 1):
                happened[during] += LINES_OF_AN_OUTAGE
        for hour, count in written.items():
            allowed = schedule.trackers * (happened[hour] + LINES_OF_AN_OUTAGE)
            if count > allowed and hour < schedule.hours:
                texts = Counter(line.text for line in self.lines if int(line.at_s // _HOUR_S) == hour)
                fails("log", f"{count} lines in hour {hour}, {allowed} allowed; most: {texts.most_common(3)}")
