"""The tracker's role: from the cube's scans to a target, by way of the state machine."""

import asyncio
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daemon.clock import Clock
from daemon.clockwatch import ClockWatch
from daemon.config import Settings
from daemon.modes import Situation, next_mode
from daemon.motion import Motion
from daemon.optimal import DECIDE_EVERY_S, OptimalPointing
from daemon.pointing import Pointing
from daemon.readings import Readings
from daemon.records import Decision, Event, Irradiances, Mode, ModeChange, Record, Scan, Target
from daemon.stow import OperatorStow, StowSource
from daemon.waiting import wait_at_most
from daemon.wishes import Wishes, WishFile
from drivers.errors import DeviceError, RefusedError
from solar.frames import normal_from_angles, separation_deg

log = logging.getLogger("heliocube.control")

_TICK_S = 5.0
# Longer than a clock's resolution: a timer may fire that much early, and the look after it must find time moved on.
_SHORTEST_WAIT_S = 0.001
# A parked tracker that is not where it should be is sent there again this often.
_REPARK_S = 60.0
_BY_THE_CLOCK = ("chronometric", "optimal")


@dataclass(frozen=True, slots=True)
class ControlState:
    """What control shows of itself.

    Attributes
    ----------
    mode, why, since_utc_s
        The present mode, its reason and its beginning.
    scan
        The newest scan that was accepted, good or bad.
    scan_age_s
        Age of the newest scan with as many good faces as the law needs; infinite before the first.
    irradiances
        Mean over the window, or None.
    decision
        The last one.
    next_decision_s
        Seconds until the next; NaN in modes that do not decide.
    """

    mode: Mode
    why: str
    since_utc_s: float
    scan: Scan | None
    scan_age_s: float
    irradiances: Irradiances | None
    decision: Decision | None
    next_decision_s: float


class Control:
    """Decides what the tracker does, every few seconds, and where it points, every few minutes.

    Parameters
    ----------
    settings
        The whole configuration.
    clock
        The service's time.
    motion
        The only way to the axes.
    pointing
        The laws, the sun and the limits.
    sun_elevation_deg
        Of UTC [s], to tell night from day.
    stow_sources
        Everything besides the operator that may ask for stow.
    wish_file
        Keeps what operators asked for over a restart.
    publish
        Called with decisions, mode changes and events.
    optimal
        The law `optimal`, where it is the law; the others are in `pointing`.
    """

    def __init__(
        self,
        settings: Settings,
        clock: Clock,
        motion: Motion,
        pointing: Pointing,
        sun_elevation_deg: Callable[[float], float],
        stow_sources: Sequence[StowSource],
        wish_file: WishFile,
        publish: Callable[[Record], None],
        optimal: OptimalPointing | None = None,
    ) -> None:
        self._settings = settings
        self.optimal = optimal
        self._clock = clock
        self._motion = motion
        self._pointing = pointing
        self._clock_watch = ClockWatch(clock)
        self._operator = OperatorStow()
        self._stow_sources = (self._operator, *stow_sources)
        self._publish = publish
        self._readings = Readings(settings, clock, sun_elevation_deg, optimal)
        self._wake = asyncio.Event()
        self._wish_file = wish_file
        before = wish_file.load()
        self._stop_why = before.stop
        self._hold_why = before.hold
        if before.stow is not None:
            self._operator.ask(before.stow)
        self._hold_at: Target | None = None
        self.mode = Mode.STARTING
        self.why = "starting"
        self._since_utc_s = clock.utc()
        self._due_s = -math.inf
        self._parked_s = -math.inf
        self._decision: Decision | None = None
        self._last_why = ""
        self.last_tick_s = clock.monotonic()

    # Doors for the bridge, for motion and for operators.

    def receive(self, scan: Scan) -> None:
        """Take in a fresh, authentic scan from the bridge; its monotonic times are on our clock."""
        self._readings.add(scan)
        if self.optimal is not None and self._clock_watch.trusted:
            self.optimal.receive(scan, self._clock.utc())
        self._publish(scan)
        if scan.ok and self.mode in (Mode.STARTING, Mode.FALLBACK):
            # It may be what was waited for.
            self._wake.set()

    def look_again(self) -> None:
        """Ask for an immediate look at the situation."""
        self._wake.set()

    def stow(self, why: str) -> None:
        """Go to the stow position and stay until released."""
        self._stop_why = None
        self._operator.ask(why)
        self._keep_wishes()

    def hold(self, why: str) -> None:
        """Stay where the tracker is; a move in progress is stopped. Stow still goes before it."""
        self._stop_why = None
        self._hold_why, self._hold_at = why, None
        self._keep_wishes()

    def goto(self, a_deg: float, b_deg: float, why: str) -> None:
        """Go to a position and hold there.

        Raises
        ------
        ValueError
            Outside the limits, or not a number.
        RefusedError
            The tracker is stowed, starting or in fault: nothing is kept for later.
        """
        limits = self._settings.limits.limits()
        if not limits.contain(a_deg, b_deg):
            raise ValueError(f"A {a_deg:g}, B {b_deg:g} deg is outside the limits ({limits})")
        if self.mode in (Mode.STARTING, Mode.STOW, Mode.FAULT):
            raise RefusedError("positioner", f"cannot go there in mode {self.mode}: {self.why}")
        self._stop_why = None
        self._hold_why, self._hold_at = why, Target(a_deg, b_deg, why)
        self._parked_s = -math.inf
        self._keep_wishes()

    def auto(self) -> None:
        """Release the stop, stow and hold that an operator asked for."""
        self._operator.release()
        self._stop_why = self._hold_why = self._hold_at = None
        self._keep_wishes()

    async def stop(self, why: str) -> None:
        """Stop the axes at once and keep them stopped until released, even from stowing: somebody may be in reach.

        Raises `DeviceError` when the positioner cannot be reached; it is stopped on reconnection then.
        """
        self._stop_why = why
        self._hold_at = None
        try:
            await self._motion.stop()
        finally:
            self._keep_wishes()

    def _keep_wishes(self) -> None:
        self._wish_file.save(Wishes(stop=self._stop_why, stow=self._operator.reason(0.0), hold=self._hold_why))
        self._wake.set()

    def home(self) -> None:
        """Start a reference run of both axes."""
        self._motion.home()
        self._wake.set()

    def clear_faults(self) -> None:
        """Clear latched faults and doubts about the reference."""
        self._motion.clear_faults()
        self._wake.set()

    @property
    def state(self) -> ControlState:
        """A snapshot for displays."""
        now_s = self._clock.monotonic()
        deciding = self.mode in (Mode.TRACKING, Mode.FALLBACK)
        return ControlState(
            self.mode,
            self.why,
            self._since_utc_s,
            self._readings.newest,
            now_s - self._readings.good_s,
            self._readings.mean(now_s),
            self._decision,
            max(self._due_s - now_s, 0.0) if deciding else math.nan,
        )

    async def run(self) -> None:
        """Look at the situation every few seconds, and at once when asked to, until cancelled."""
        while True:
            self.tick()
            await wait_at_most(self._wake, self._until_next_tick())

    @property
    def next_tick_s(self) -> float:
        """Monotonic time of the next look, unless somebody asks for one before."""
        return self.last_tick_s + self._until_next_tick()

    def _until_next_tick(self) -> float:
        if self.mode in (Mode.TRACKING, Mode.FALLBACK):
            return min(_TICK_S, max(self._due_s - self._clock.monotonic(), _SHORTEST_WAIT_S))
        return _TICK_S

    def tick(self) -> None:
        """Look at the situation once, change mode if it calls for that, and act in the mode."""
        now_s = self._clock.monotonic()
        self._watch_clock()
        if self.optimal is not None and self._clock_watch.trusted:
            self.optimal.turn(self._clock.utc())
        mean = self._readings.mean(now_s)
        mode, why = next_mode(self.mode, self._situation(now_s, mean))
        if mode is not self.mode:
            self._enter(mode, why, now_s)
        self.why = why
        self._motion.may_rehome = mode is Mode.FAULT  # a reference run tilts the module: not in a stow or hold
        self._act(now_s, mean)
        self.last_tick_s = now_s

    def _watch_clock(self) -> None:
        step_s = self._clock_watch.step_s()
        if step_s is not None:
            text = f"the clock was set by {step_s:+.1f} s"
            log.warning(text)
            self._tell(text)

    def _situation(self, now_s: float, mean: Irradiances | None) -> Situation:
        data, data_why, night_why = self._readings.judge(now_s, mean)
        return Situation(
            connected=self._motion.connected,
            blocked_why=self._motion.blocked,
            doubt_why=self._motion.doubt,
            homing=self._motion.homing,
            stow_why=next((why for source in self._stow_sources if (why := source.reason(now_s))), None),
            stop_why=self._stop_why,
            hold_why=self._hold_why,
            night_why=night_why,
            data=data,
            data_why=data_why,
        )

    def _enter(self, mode: Mode, why: str, now_s: float) -> None:
        utc_s = self._clock.utc()
        log.info("%s -> %s: %s", self.mode, mode, why, extra={"fields": {"mode": mode}})
        self._publish(ModeChange(utc_s, now_s, self.mode, mode, why))
        self.mode = mode
        self._since_utc_s = utc_s
        self._due_s = now_s
        self._parked_s = -math.inf
        if mode is Mode.FAULT:
            # Where an operator wanted to go before the fault may be a wrong place to go to after it.
            self._hold_at = None

    def _act(self, now_s: float, mean: Irradiances | None) -> None:
        if self.mode is Mode.STOW:
            self._park(Target(self._settings.safety.stow_a_deg, self._settings.safety.stow_b_deg, self.why), now_s)
        elif self.mode is Mode.NIGHT:
            self._park(Target(self._settings.safety.night_a_deg, self._settings.safety.night_b_deg, "night"), now_s)
        elif self.mode is Mode.HOLD:
            self._hold(now_s)
        elif self.mode in (Mode.TRACKING, Mode.FALLBACK) and now_s >= self._due_s:
            self._decide(now_s, mean)

    def _hold(self, now_s: float) -> None:
        if self._hold_at is not None:
            self._park(self._hold_at, now_s)
        elif self._motion.moving:
            self._motion.rest()

    def _park(self, target: Target, now_s: float) -> None:
        """Bring the tracker to a fixed position and keep it there."""
        if now_s - self._parked_s < _REPARK_S:
            return
        heading = self._motion.target
        if heading is not None and (heading.a_deg, heading.b_deg) == (target.a_deg, target.b_deg):
            return
        pose = self._motion.pose
        tolerance = self._settings.motion.tolerance_deg
        if heading is None and pose is not None and not self._motion.homing:
            apart = max(abs(pose.a_deg - target.a_deg), abs(pose.b_deg - target.b_deg))
            if apart <= tolerance:
                return
        self._parked_s = now_s
        self._order(target)

    def _decide(self, now_s: float, mean: Irradiances | None) -> None:
        rested_s = now_s - self._motion.last_move_started_s
        if rested_s < self._settings.motion.minimum_interval_s:
            self._due_s = now_s + self._settings.motion.minimum_interval_s - rested_s
            return
        law = self._settings.law.name if self.mode is Mode.TRACKING else "chronometric"
        self._due_s = now_s + (DECIDE_EVERY_S if law == "optimal" else self._settings.windows.decide_every_s)
        utc_s = self._clock.utc()
        heading = self._motion.target or self._motion.pose
        if law == "optimal" and self.optimal is not None and heading is not None:
            aim = self.optimal.aim(heading.a_deg, heading.b_deg, utc_s)
        else:
            aim = self._pointing.aim(law, mean, utc_s)
        if law in _BY_THE_CLOCK and not self._clock_watch.trusted:
            aim = replace(aim, target=None, why="the clock was set a short while ago: the sun's position is in doubt")
        target = aim.target or self._standing(aim.why)
        moved = aim.target is not None and self._worth_moving(aim.target) and self._order_within_budget(aim.target)
        log.info("%s", "moving" if moved else "staying", extra={"fields": _told(law, target)})
        self._decision = Decision(
            utc_s,
            now_s,
            self.mode,
            law,
            mean,
            aim.azimuth_deg,
            aim.elevation_deg,
            aim.sun.azimuth_deg,
            aim.sun.elevation_deg,
            target,
            moved,
            aim.estimate,
        )
        self._publish(self._decision)

    def _standing(self, why: str) -> Target:
        pose = self._motion.pose
        return Target(pose.a_deg, pose.b_deg, why) if pose else Target(math.nan, math.nan, why)

    def _worth_moving(self, target: Target) -> bool:
        """Tell whether the target is far enough from where the tracker stands or is already heading."""
        whence = self._motion.target or self._motion.pose
        if whence is None:
            return False
        apart = separation_deg(
            normal_from_angles(whence.a_deg, whence.b_deg), normal_from_angles(target.a_deg, target.b_deg)
        )
        return bool(np.isnan(apart) or apart >= self._settings.motion.deadband_deg)

    def _order_within_budget(self, target: Target) -> bool:
        """Order a move of a law; the budget of `optimal` holds in fallback too."""
        heading = self._motion.target or self._motion.pose
        if self.optimal is None or heading is None:
            return self._order(target)
        distance_deg = abs(heading.a_deg - target.a_deg) + abs(heading.b_deg - target.b_deg)
        if not (self.optimal.affords(distance_deg) and self._order(target)):
            return False
        self.optimal.book(distance_deg)
        return True

    def _order(self, target: Target) -> bool:
        try:
            self._motion.order(target, stow=self.mode is Mode.STOW)
        except (DeviceError, ValueError) as error:
            text = str(error)
            if text != self._last_why:
                log.warning("no move: %s", text)
                self._tell(f"no move: {text}")
            self._last_why = text
            return False
        self._last_why = ""
        return True

    def _tell(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "control", text))


def _told(law: str, target: Target) -> dict[str, str]:
    return {"law": law, "a_deg": f"{target.a_deg:.2f}", "b_deg": f"{target.b_deg:.2f}", "why": target.why}
