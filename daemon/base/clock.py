"""Time as the service knows it: monotonic seconds for intervals, UTC seconds for stamps."""

import math
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime, tzinfo
from functools import lru_cache
from typing import Protocol

FIRST_UTC_S, END_UTC_S = 0.0, 7_258_118_400.0
"""Records and sun positions have times in this range: from 1970, where a clock that was never set begins, to 2199."""
LEAST_SHOWN_UTC_S, MOST_SHOWN_UTC_S = -6e10, 2.5e11
"""Kept times lie in this range, because a date and time can be shown for no other."""


class Clock(Protocol):
    """Everything in the service that needs the time is given one of these."""

    def monotonic(self) -> float:
        """Return seconds on a clock that never steps; the same clock as the event loop's timers."""

    def utc(self) -> float:
        """Return seconds since 1970-01-01T00:00Z; may step when the machine's clock is set."""

    def asleep_s(self) -> float | None:
        """Return for how long the machine has slept since some fixed instant [s], or None where nothing tells.

        `monotonic` stood still meanwhile.
        """


class SystemClock:
    """The machine's own clocks."""

    def monotonic(self) -> float:
        """Return seconds of the machine's monotonic clock."""
        return time.monotonic()

    def utc(self) -> float:
        """Return seconds of the machine's real-time clock."""
        return time.time()

    def asleep_s(self) -> float | None:
        """Return for how long the machine has slept [s], by a clock that goes on in a sleep; None except on Linux."""
        if not sys.platform.startswith("linux"):
            return None
        # clock_gettime(2): CLOCK_BOOTTIME goes on in a sleep, and nobody can set it.
        return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()


class LoopClock:
    """A clock that follows an event loop whose time is scaled or virtual.

    Parameters
    ----------
    loop_time
        The loop's ``time`` method.
    start_utc_s
        UTC at the moment of construction.

    Attributes
    ----------
    monotonic
        Returns seconds of the loop's time.
    """

    def __init__(self, loop_time: Callable[[], float], start_utc_s: float) -> None:
        # Not wrapped in a method: a simulated day asks for it two million times.
        self.monotonic = loop_time
        self._offset_s = start_utc_s - loop_time()

    def utc(self) -> float:
        """Return the start plus what the loop's time has run since."""
        return self.monotonic() + self._offset_s

    def asleep_s(self) -> float:
        """Return 0: its monotonic time and its UTC always run together."""
        return 0.0


def iso_utc(utc_s: float) -> str:
    """Return a UTC instant [s] as ISO 8601 with milliseconds, cut and not rounded, and Z."""
    whole_s = math.floor(utc_s)
    minutes, milliseconds = divmod(whole_s * 1000 + round((utc_s - whole_s) * 1e6) // 1000, 60_000)
    return f"{_minute(minutes)}{milliseconds // 1000:02d}.{milliseconds % 1000:03d}Z"


def minute_utc(utc_s: float) -> str:
    """Return a UTC instant [s] as a person reads it in a sentence, cut to the minute: ``2022-10-12 10:18 UTC``."""
    return f"{iso_utc(utc_s)[:16].replace('T', ' ')} UTC"


def local_time(utc_s: float, zone: tzinfo | None = None) -> datetime:
    """Return an instant [s] as the clocks of a zone show it; None stands for this machine's zone.

    UTC where the machine's zone cannot be used: its offset is more than a day, as of ``TZ=UTC+25``, or it has no such
    instant.
    """
    there = datetime.fromtimestamp(utc_s, UTC)
    try:
        return there.astimezone(zone)
    except (ValueError, OverflowError):
        return there


# Five instants to a scan, nearly all of them in the same minute.
@lru_cache(maxsize=256)
def _minute(minutes: int) -> str:
    return datetime.fromtimestamp(minutes * 60.0, UTC).strftime("%Y-%m-%dT%H:%M:")
