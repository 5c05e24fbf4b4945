"""The service manager's watchdog, answered only while the work itself goes on.

A device that is down is a declared state and no reason to kill the service. A control loop that no longer ticks, a scan
that does not end or an event loop that runs late is a reason.
"""

import asyncio
import logging
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate

from daemon.base.clock import Clock
from daemon.base.process import SystemdNotifier
from daemon.cube.acquisition import Acquisition
from daemon.service.tracker import Tracker

log = logging.getLogger("heliocube.watchdog")

_CHECK_EVERY_S = 10.0
_MOST_LATENESS_S = 2.0
_STUCK_AFTER_S = 30.0
_MEASURE_EVERY_S = 0.1
_WORST_OF_S = 60.0

LATENESS_BOUNDS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0)
"""Upper bounds of the counts of a `LoopState`, whose last count has no bound and includes all measurements."""


@dataclass(frozen=True, slots=True)
class LoopState:
    """How late the event loop was, in the machine's seconds.

    Attributes
    ----------
    worst_s
        The most within the last minute or two.
    sum_s
        All delays added.
    counts
        How many measurements were at most as late as each of `LATENESS_BOUNDS_S`, and all of them.
    """

    worst_s: float
    sum_s: float
    counts: tuple[int, ...]


class LoopWatch:
    """Measures how late the event loop runs what is due, ten times a second: it shows a reader or disk that blocks it.

    Parameters
    ----------
    clock
        The service's time.
    speed
        Speed of that clock relative to the machine's.
    look
        Called at each measurement, for what has to be noticed soon.
    """

    def __init__(self, clock: Clock, speed: float, look: Callable[[], object] = lambda: None) -> None:
        self._clock = clock
        self._speed = speed
        self._look = look
        self._counts = [0] * (len(LATENESS_BOUNDS_S) + 1)
        self._sum_s = 0.0
        self._worst_s = self._worst_before_s = 0.0
        self._minute_s = clock.monotonic()

    @property
    def state(self) -> LoopState:
        """What has been measured."""
        worst_s = max(self._worst_s, self._worst_before_s)
        return LoopState(worst_s, self._sum_s, tuple(accumulate(self._counts)))

    async def run(self) -> None:
        """Measure until cancelled."""
        while True:
            due_s = self._clock.monotonic() + _MEASURE_EVERY_S * self._speed
            await asyncio.sleep(_MEASURE_EVERY_S * self._speed)
            self._look()
            self._note(max(self._clock.monotonic() - due_s, 0.0) / self._speed)

    def _note(self, late_s: float) -> None:
        now_s = self._clock.monotonic()
        if now_s - self._minute_s >= _WORST_OF_S * self._speed:
            self._worst_before_s, self._worst_s, self._minute_s = self._worst_s, 0.0, now_s
        self._counts[bisect_left(LATENESS_BOUNDS_S, late_s)] += 1
        self._sum_s += late_s
        self._worst_s = max(self._worst_s, late_s)


class Watchdog:
    """Pings the service manager and keeps its status line.

    Parameters
    ----------
    clock
        The service's time.
    notifier
        Talks to the service manager.
    trackers, acquisition
        The work that must go on; none where the role has none.
    speed
        Speed of the clock relative to the machine's.
    """

    def __init__(
        self,
        clock: Clock,
        notifier: SystemdNotifier,
        trackers: Sequence[Tracker],
        acquisition: Acquisition | None,
        speed: float,
    ) -> None:
        self._clock = clock
        self._notifier = notifier
        self._trackers = tuple(trackers)
        self._acquisition = acquisition
        self._speed = speed
        self._stuck = False

    async def run(self) -> None:
        """Check and ping until cancelled."""
        interval_s = min(self._notifier.watchdog_interval_s or _CHECK_EVERY_S, _CHECK_EVERY_S) * self._speed
        while True:
            due_s = self._clock.monotonic() + interval_s
            await asyncio.sleep(interval_s)
            late_s = (self._clock.monotonic() - due_s) / self._speed
            for tracker in self._trackers:
                tracker.watch_driver()
            trouble = f"the event loop runs {late_s:.1f} s late" if late_s > _MOST_LATENESS_S else self._stuck_part()
            if trouble is None:
                self._notifier.watchdog()
            elif not self._stuck:
                log.error("%s: the watchdog is not answered", trouble)
            self._stuck = trouble is not None
            self._notifier.status(trouble or self._status())

    def _stuck_part(self) -> str | None:
        now_s = self._clock.monotonic()
        for tracker in self._trackers:
            silent_s = now_s - tracker.control.last_tick_s
            if silent_s > _STUCK_AFTER_S * max(self._speed, 1.0):
                return f"{self._name_prefix(tracker)}control has not run for {silent_s:.0f} s"
        if self._acquisition is not None and not self._acquisition.outage.is_down:
            silent_s = now_s - self._acquisition.last_scan_s
            if silent_s > (_STUCK_AFTER_S + self._acquisition.scan_every_s) * max(self._speed, 1.0):
                return f"no scan has ended for {silent_s:.0f} s"
        return None

    def _status(self) -> str:
        if self._trackers:
            return "; ".join(f"{self._name_prefix(one)}{one.control.mode}: {one.control.why}" for one in self._trackers)
        if self._acquisition is not None and self._acquisition.outage.is_down:
            return self._acquisition.outage.reason
        return "acquiring"

    def _name_prefix(self, tracker: Tracker) -> str:
        return f"{tracker.name}: " if len(self._trackers) > 1 else ""
