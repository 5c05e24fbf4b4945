"""Whether the grounds on which a target was decided still hold when it is sent."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from daemon.base.records import Decision, Mode
from daemon.rigs.campaign.plant import PlantTracker
from daemon.studies.campaign.watch.clock_steps import ClockSteps
from daemon.studies.campaign.watch.storms import UNSTOWED_MODES

if TYPE_CHECKING:
    from daemon.tracker.wishes import Wish

_LATE_S = 1.0
# A goto may have arrived although the axes truly stand this far beyond a move's tolerance.
_ARRIVAL_MARGIN_DEG = 0.7
_SAME_DEG = 0.01
_DECIDING_MODES = (Mode.TRACKING, Mode.FALLBACK)


class DecisionCheck:
    """Checks how old the grounds of a target are: readings, the clock, and all that is from before a machine's sleep.

    Parameters
    ----------
    fails
        Called with a promise and a text.

    Attributes
    ----------
    steps
        The steps of the clock.
    """

    def __init__(self, fails: Callable[[str, str], None]) -> None:
        self._fails = fails
        self.steps = ClockSteps(fails)
        self._woke_s = -math.inf
        self._unarrived_goto: Wish | None = None
        self._undecided_move_s = math.nan

    def note_service_start(self) -> None:
        """Take note of a new process: it knows nothing from before its start."""
        self._woke_s, self._unarrived_goto = -math.inf, None

    def note_wake_up(self, mount: PlantTracker, slept_s: float, now_s: float) -> None:
        """Take note that the machine has slept for `slept_s`, until now."""
        if slept_s > _stale_s(mount):
            self._woke_s = now_s
            hold, truth = mount.control.wishes.hold if mount.is_served else None, mount.truth()
            if hold is not None and hold.goto_deg is not None:
                ways_deg = (abs(here - there) for here, there in zip(truth, hold.goto_deg, strict=True))
                self._unarrived_goto = (
                    hold if max(ways_deg) > mount.settings.motion.tolerance_deg + _ARRIVAL_MARGIN_DEG else None
                )

    def check(self, mount: PlantTracker, target: tuple[float, float], now_s: float, begun_s: float) -> None:
        """Look at a target [deg] that is sent, by a service that began at `begun_s`."""
        self._check_woken(mount, target, now_s)
        # A second try of the same move is no new decision.
        if now_s - mount.motion.last_move_started_s >= 1.0:
            return
        control = mount.control
        if control.mode is Mode.TRACKING and control.state.scan_age_s > _stale_s(mount):
            self._fails("stale", f"{target} is sent in tracking on readings {control.state.scan_age_s:.0f} s old")
        if control.mode in (Mode.FALLBACK, Mode.NIGHT):
            self.steps.check(mount, target, now_s, begun_s)

    def _check_woken(self, mount: PlantTracker, target: tuple[float, float], now_s: float) -> None:
        """See that nothing from before the last sleep moves the tracker: sun, wind and unit have changed meanwhile."""
        woke_s = self._woke_s
        if woke_s == -math.inf:
            return
        mode, seen, awake = mount.control.mode, mount.motion.telemetry, f"{now_s - woke_s:.1f} s after a sleep"
        if seen is None or seen.time_monotonic_s < woke_s:
            self._fails("slept", f"{target} is sent {awake}, and nobody has looked where the unit stands since")
        if mode in UNSTOWED_MODES and mount.wind_silent_since_s <= woke_s:
            self._fails("slept", f"{target} is sent in mode {mode} {awake}, and the wind has not been heard since")
        if mode is Mode.HOLD and self._unarrived_goto is not None and mount.control.wishes.hold is self._unarrived_goto:
            self._fails("slept", f"{target} is sent {awake}, by a goto of before it that had not arrived")
        if mode not in _DECIDING_MODES:
            self._undecided_move_s = mount.motion.last_move_started_s
            return
        decision = mount.control.state.decision
        # A move ordered in another mode goes on, and may be tried again, until the law has decided. It may lead where
        # the last decision led.
        tried_again = mount.motion.last_move_started_s == self._undecided_move_s
        if tried_again or decision is None or not _is_for_target(decision, target):
            return
        since_s = decision.time_monotonic_s - woke_s
        if since_s < 0.0:
            self._fails("slept", f"{target} is sent in mode {mode} {awake}, and was decided before it")
        elif mode is Mode.TRACKING and decision.irradiances is not None:
            # The first reading covers the time up to it as well.
            covers_s = decision.irradiances.coverage * mount.settings.windows.mean_s
            if covers_s > since_s + _stale_s(mount):
                self._fails("slept", f"{target} is sent {awake} by {covers_s:.0f} s of readings")


def _is_for_target(decision: Decision, target: tuple[float, float]) -> bool:
    decided = (decision.target.a_deg, decision.target.b_deg)
    return all(abs(one - other) < _SAME_DEG for one, other in zip(decided, target, strict=True))


def _stale_s(mount: PlantTracker) -> float:
    """Return how old readings may be [s], with a margin."""
    return mount.settings.safety.scan_stale_s + _LATE_S
