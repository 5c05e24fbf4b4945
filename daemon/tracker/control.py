"""The tracker's role: from the cube's scans to a target, by way of the state machine."""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.clock_watch import ClockWatch, clock_step_text, sleep_text
from daemon.base.records import Decision, Estimate, Event, Irradiances, Mode, ModeChange, Pose, Record, Scan, Target
from daemon.base.recurrence import Recurrence, ReportStyle
from daemon.base.sleeps import SleepGauge
from daemon.base.state import StateFolder
from daemon.base.timeloop import wait_at_most
from daemon.config.settings import Settings
from daemon.motion.motion import Motion
from daemon.tracker.budget import DayBudget
from daemon.tracker.modes import DataState, Situation, next_mode
from daemon.tracker.operator_interface import OperatorInterface
from daemon.tracker.orders import Orders
from daemon.tracker.parking import Parking
from daemon.tracker.phase import ALONE, Phase
from daemon.tracker.pointing import DecisionPreview, NamedLaw, Pointing, PoseAndTarget, ask_law, preview_decision
from daemon.tracker.readings import Readings
from daemon.tracker.reminders import Reminders
from daemon.tracker.stow_watch import StowWatch
from drivers.errors import DeviceError

log = logging.getLogger("heliocube.control")

_TICK_S = 5.0
# Asking a law takes milliseconds, and displays ask once a second.
_FORESEE_EVERY_S = 10.0
# Longer than a clock's resolution: a timer may fire that much early, and the tick after it must find time moved on.
_SHORTEST_WAIT_S = 0.001
# This many changes between the same two modes are logged one by one.
_FEW_CHANGES = 8


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


class Control(OperatorInterface):
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
        The law, and the one that needs no readings.
    readings
        What the cube's scans are good for.
    stow_watch
        Everything besides the operator that may ask for stow.
    orders
        What persons asked for.
    publish
        Called with decisions, mode changes and events.
    alarms
        Where alarms are raised.
    folder
        Where state is kept over a restart.
    clock_watch
        Tells whether the time of day may be used.
    phase
        When its turn is among the trackers of the process.
    """

    def __init__(
        self,
        settings: Settings,
        clock: Clock,
        motion: Motion,
        pointing: Pointing,
        readings: Readings,
        stow_watch: StowWatch,
        orders: Orders,
        publish: Callable[[Record], None],
        alarms: Alarms,
        folder: StateFolder,
        clock_watch: ClockWatch | None = None,
        phase: Phase = ALONE,
    ) -> None:
        super().__init__(settings, motion, orders, Parking(motion, settings.motion.tolerance_deg, self._order), phase)
        self.pointing = pointing
        self._clock = clock
        self._clock_watch = ClockWatch(clock) if clock_watch is None else clock_watch
        self._stow_watch = stow_watch
        self._sleeps = SleepGauge(clock)
        self._publish = publish
        self._alarms = alarms
        self._reminders = Reminders(clock, settings.site, alarms, publish)
        self._folder = folder
        self.budget = DayBudget(settings.motion, settings.site.place(), folder, alarms, clock.utc())
        self._readings = readings
        self._since_utc_s = clock.utc()
        self._due_s = -math.inf
        self._decision: Decision | None = None
        self._data, self._wind_known = DataState.WAITING, False
        self._last_refusal = ""
        self._decision_preview: tuple[object, DecisionPreview | None] | None = None
        self._preview_from_s = clock.monotonic() + phase.delay_s(_FORESEE_EVERY_S)
        self._changes: dict[frozenset[Mode], Recurrence] = {}
        self.last_tick_s = clock.monotonic()

    # Entry points for the bridge, for motion and for operators.

    def receive(self, scan: Scan, utc_s: float) -> None:
        """Take in a fresh, authentic scan that has come at this UTC [s]; its monotonic times are on our clock."""
        self._readings.add(scan)
        if self._clock_watch.trusted:
            self.pointing.receive(scan, utc_s)
        if (self.mode in (Mode.STARTING, Mode.FALLBACK) or self._must_wait) and scan.ok:
            # This scan may be what the decision waits for.
            self._decide_in_turn()

    def note(self, record: Record) -> None:
        """Take in a record of the bus: each pose comes with the telemetry that may show a pressed button."""
        if isinstance(record, Pose) and self._orders.note_buttons(self._motion.telemetry):
            self._freeze()
            self._keep_wishes()
            self._warn("a button is pressed at the unit: the tracker is held until 'heliocube auto'")

    @property
    def state(self) -> ControlState:
        """A snapshot for displays."""
        now_s = self._clock.monotonic()
        deciding = self.mode in (Mode.TRACKING, Mode.FALLBACK)
        return ControlState(
            mode=self.mode,
            why=self.why,
            since_utc_s=self._since_utc_s,
            scan=self._readings.newest,
            scan_age_s=now_s - self._readings.newest_good_scan_s,
            irradiances=self._readings.mean(now_s),
            decision=self._decision,
            next_decision_s=max(self._due_s - now_s, 0.0) if deciding else math.nan,
        )

    def preview_decision(self) -> DecisionPreview | None:
        """Return what the next decision would be were the light to stay as it is; None in modes that do not decide."""
        if self.mode not in (Mode.TRACKING, Mode.FALLBACK):
            return None
        now_s, known = self._clock.monotonic(), (self.mode, self._decision, self._motion.target)
        if now_s >= self._preview_from_s or (self._decision_preview is not None and self._decision_preview[0] != known):
            in_s = max(self._due_s - now_s, 0.0)
            self._preview_from_s = self._phase.next_s(now_s, _FORESEE_EVERY_S)
            ahead = preview_decision(
                self._deciding_law,
                self._readings.mean(now_s),
                self._pose_and_target,
                self._clock.utc() + in_s,
                self._settings.motion.deadband_deg,
                sun_known=self._clock_watch.trusted,
                may_move=self.budget.waits_why(self._clock_watch.believed_utc_s + in_s) is None,
            )
            self._decision_preview = known, ahead
        return None if self._decision_preview is None else self._decision_preview[1]

    @property
    def _deciding_law(self) -> NamedLaw:
        by_readings = self.mode is Mode.TRACKING and not self.budget.is_reserved_for_sun
        return self.pointing.chosen if by_readings else self.pointing.fallback

    @property
    def _pose_and_target(self) -> PoseAndTarget:
        return PoseAndTarget(self._motion.pose, self._motion.heading)

    async def run(self) -> None:
        """Tick every few seconds, and at once on request, until cancelled."""
        while True:
            self.tick()
            await wait_at_most(self._wake, self._until_next_tick())

    @property
    def next_tick_s(self) -> float:
        """Monotonic time of the next tick, unless one is requested before."""
        return self.last_tick_s + self._until_next_tick()

    @property
    def _must_wait(self) -> bool:
        """Whether decisions are held back, because readings are not good at present or the wind was not heard yet."""
        return not self._wind_known or (self.mode is Mode.TRACKING and self._data is not DataState.FRESH)

    def _until_next_tick(self) -> float:
        now_s = self._clock.monotonic()
        tick_s = self._phase.next_s(now_s, _TICK_S) - now_s
        if not self._must_wait and self.mode in (Mode.TRACKING, Mode.FALLBACK):
            return min(tick_s, max(self._due_s - now_s, _SHORTEST_WAIT_S))
        return tick_s

    def tick(self) -> None:
        """Judge the situation once, change mode if it calls for that, and act in the mode."""
        now_s = self._clock.monotonic()
        self._watch_clock(now_s)
        self.budget.begin_day_if_due(self._clock_watch.believed_utc_s)
        self.pointing.begin_day_if_due(self._clock_watch.believed_utc_s)
        self._freeze()
        mean = self._readings.mean(now_s)
        situation = self._situation(now_s, mean)
        self._data = situation.data
        at_stow = situation.stow_why is not None and self.at_stow
        mode, why = next_mode(self.mode, situation, at_stow=at_stow)
        self._reminders.watch_stow(None if at_stow else situation.stow_why, self.wishes)
        if mode is not self.mode:
            if self.mode is Mode.STOW and situation.stow_why is None:
                # If the next mode does not decide at once, a move to the stow position would go on.
                self._motion.cancel_move()
            self._enter(mode, why, now_s)
        self.why = why
        self._motion.may_rehome = mode is Mode.FAULT and self._wind_known and self.wishes.allow_rehoming
        self._act(now_s, mean)
        self._alarms.mute(muted=self.wishes.maintenance is not None)
        self._reminders.remind(self.wishes, sun_known=self._clock_watch.trusted)
        self._reminders.watch(self._motion, mode, situation, sun_known=self._clock_watch.trusted)
        self._folder.retry()
        self._alarms.set("not-kept", self._folder.trouble)
        self._alarms.set("law-failed", self.pointing.failed_why)
        self.last_tick_s = now_s

    def _watch_clock(self, now_s: float) -> None:
        if (step_s := self._clock_watch.step_s()) is not None:
            self._warn(clock_step_text(step_s, self._clock.utc()))
        if (slept_s := self._sleeps.take_s()) > self._settings.safety.scan_stale_s:
            # By the monotonic clock, which stands still during a sleep, old readings seem fresh.
            self._warn(sleep_text(slept_s))
            self._readings.forget()
            self._stow_watch.note_sleep(now_s)
            if (text := self._orders.end_goto_on_its_way(self._parking.stands_at)) is not None:
                self._warn(text)

    def _situation(self, now_s: float, mean: Irradiances | None) -> Situation:
        data, data_why, night_why = self._readings.judge(now_s, mean, sun_known=self._clock_watch.trusted)
        asked = self._orders.stow.reason(now_s)
        stow_why = "; ".join((*([asked] if asked else []), *self._stow_watch.reasons(now_s))) or None
        self._wind_known = (waiting_why := self._stow_watch.waiting_why(now_s)) is None
        if waiting_why is not None:
            # Wait; go to no night or (below) snow position: it may be steeper than where the tracker lay in a storm.
            data, data_why, night_why = DataState.WAITING, waiting_why, None
        wishes = self.wishes
        return Situation(
            connected=self._motion.connected,
            blocked_why=self._motion.blocked,
            doubt_why=self._motion.doubt,
            homing=self._motion.is_homing_or_queued,
            maintenance_why=wishes.describe("maintenance"),
            stop_why=wishes.describe("stop"),
            buttons_why=wishes.describe("buttons"),
            stow_why=stow_why,
            snow_why=wishes.snow.why if wishes.snow and waiting_why is None else None,
            hold_why=self._orders.why_held(self._parking.stands_at),
            night_why=night_why,
            data=data,
            data_why=data_why,
        )

    @property
    def at_stow(self) -> bool:
        """Whether the tracker surely stands in the stow position; False if the axes are in doubt or not seen."""
        safety, motion = self._settings.safety, self._motion
        sure = motion.connected and motion.blocked is None and motion.doubt is None
        return sure and self._parking.stands_at(safety.stow_a_deg, safety.stow_b_deg)

    def _enter(self, mode: Mode, why: str, now_s: float) -> None:
        utc_s = self._clock.utc()
        self._log_mode(mode, why, now_s)
        self._publish(ModeChange(time_utc_s=utc_s, time_monotonic_s=now_s, before=self.mode, after=mode, why=why))
        kept_s = self._settings.safety.keep_pose_s if (self.mode, mode) == (Mode.TRACKING, Mode.FALLBACK) else 0.0
        self.mode = mode
        self._since_utc_s = utc_s
        self._due_s = max(now_s, self._readings.newest_good_scan_s + kept_s)
        self._parking.forget()
        # An order that has not begun yet was given for a reason that is no longer in force.
        self._motion.cancel_waiting_order()
        if mode is Mode.FAULT:
            self._orders.end_goto("a fault")

    def _log_mode(self, mode: Mode, why: str, now_s: float) -> None:
        """Log a change of mode; if two modes keep alternating, say so once: every change is recorded anyway."""
        changes = self._changes.setdefault(frozenset((self.mode, mode)), Recurrence(_FEW_CHANGES, reminds=False))
        said = changes.note(now_s)
        often = f" ({changes.how_often(now_s)} between these two)" if said is ReportStyle.SUMMARY else ""
        level = logging.DEBUG if said is ReportStyle.SILENT else logging.INFO
        log.log(level, "%s -> %s: %s%s", self.mode, mode, why, often, extra={"fields": {"mode": mode}})

    def _act(self, now_s: float, mean: Irradiances | None) -> None:
        safety = self._settings.safety
        if self.mode is Mode.STOW:
            self._parking.park(Target(safety.stow_a_deg, safety.stow_b_deg, self.why), now_s)
        elif self.mode is Mode.NIGHT:
            self._parking.park(Target(safety.night_a_deg, safety.night_b_deg, "night"), now_s)
        elif self.mode is Mode.SNOW:
            snow = self._settings.limits.limits().clip(safety.snow_a_deg, safety.snow_b_deg)
            self._parking.park(Target(*snow, self.why), now_s)
        elif self.mode is Mode.HOLD:
            self._hold(now_s)
        elif self.mode in (Mode.TRACKING, Mode.FALLBACK) and now_s >= self._due_s and not self._must_wait:
            self._decide(now_s, mean)

    def _hold(self, now_s: float) -> None:
        if self.wishes.standstill_reason is None and self._orders.hold_at is not None:
            self._parking.park(self._orders.hold_at, now_s)
        elif self._motion.moving:
            self._motion.request_stop()

    def _decide(self, now_s: float, mean: Irradiances | None) -> None:
        rested_s = now_s - self._motion.last_move_started_s
        if rested_s < self._settings.motion.minimum_interval_s:
            self._due_s = now_s + self._settings.motion.minimum_interval_s - rested_s
            return
        chosen, utc_s, known = self._deciding_law, self._clock.utc(), self._pose_and_target
        self._due_s = self._phase.next_s(now_s, chosen.law.decide_every_s)
        said = ask_law(chosen, mean, known, utc_s, sun_known=self._clock_watch.trusted)
        answer, target = said
        # Read the name after asking (a law that fails gives way) and before a move (it may use up the law's share).
        law = self._deciding_law.name
        worth_it = said.worth_moving(known.heading, self._settings.motion.deadband_deg)
        waits_why = self.budget.waits_why(self._clock_watch.believed_utc_s) if worth_it else None
        if waits_why is not None:
            target = replace(target, why=f"{target.why}; {waits_why}")
        moved = worth_it and waits_why is None and self._order_within_budget(target)
        told = {"law": law, "a_deg": f"{target.a_deg:z.2f}", "b_deg": f"{target.b_deg:z.2f}", "why": target.why}
        log.info("%s", "moving" if moved else "staying", extra={"fields": told})
        self._decision = Decision(
            time_utc_s=utc_s,
            time_monotonic_s=now_s,
            mode=self.mode,
            law=law,
            irradiances=mean,
            direction_azimuth_deg=answer.azimuth_deg,
            direction_elevation_deg=answer.elevation_deg,
            sun_azimuth_deg=answer.sun.azimuth_deg,
            sun_elevation_deg=answer.sun.elevation_deg,
            target=target,
            moved=moved,
            estimate=Estimate(answer.beam_w_m2, answer.diffuse_w_m2, answer.albedo),
        )
        self._publish(self._decision)

    def _order_within_budget(self, target: Target) -> bool:
        """Order a move of a law within the day's limits; the law's own plan holds in fallback too."""
        heading = self._motion.heading or self._motion.pose
        if heading is None:
            return self._order(target)
        distance_deg = abs(heading.a_deg - target.a_deg) + abs(heading.b_deg - target.b_deg)
        refused = not self.pointing.law.affords(distance_deg) or self.budget.refusal(distance_deg) is not None
        if refused or not self._order(target):
            return False
        self.budget.book(distance_deg)
        self.pointing.book(distance_deg)
        return True

    def _order(self, target: Target) -> bool:
        try:
            self._motion.order(target, stow=self.mode is Mode.STOW)
        except (DeviceError, ValueError) as error:
            text = str(error)
            if text != self._last_refusal:
                self._warn(f"no move: {text}")
            self._last_refusal = text
            return False
        self._last_refusal = ""
        return True

    def _warn(self, text: str) -> None:
        log.warning("%s", text)
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "control", text))
