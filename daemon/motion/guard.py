"""The one rule of motion, in its one place.

An axis that moves without an order of ours, or against a stop, is stopped until it stands; this is reported, and blocks
every further move until a person has looked. Every look at the positioner goes through here and is judged here.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any, TypeVar

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.records import Event, Pose, Record, Target
from daemon.base.sleeps import SleepGauge
from daemon.motion.alarms import AutonomousModeMonitor, Currents, update_alarms
from daemon.motion.doubts import Doubts
from daemon.motion.place import KeptPlace
from daemon.motion.stop_monitor import StopMonitor
from daemon.motion.watch import BLOCKED_UNTIL_CLEARED, AxisWatch, MotionAnomaly
from drivers.errors import DeviceError, StillMovingError
from drivers.interfaces import Positioner, PositionerIdentity, Repeating, Telemetry
from drivers.settings import PositionerSettings

log = logging.getLogger("heliocube.motion")

T = TypeVar("T")

MOVING_POLL_INTERVAL_S = 0.5
# Pauses between the tries to stop a positioner that does not listen; they never end while it moves.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 4.0
# Within this time a positioner reports buttons and restarts, however slow its status is.
_STATUS_WITHIN_S = 4.0
_STATUS_LATE_S = 1.0
_POSE_EVERY_S = 5.0
_POSE_CHANGED_DEG = 0.05
# Once an axis has stood for so long, time alone tells nothing new: no motor can still be running out.
_JUDGED_AFTER_S = 5.0
_TELL_BUTTONS_EVERY_S = 600.0


class Guard:
    """Looks at the positioner, and stops it.

    Parameters
    ----------
    positioner
        The instrument.
    expected
        What may be expected of the drive.
    doubts
        What a person has to look at, kept over a restart.
    place
        Where the axes rest, kept over a restart.
    clock, publish, alarms
        The service's time; where poses and events go; where alarms are raised.
    polled
        Called after every poll.

    Attributes
    ----------
    rest_pose
        Where the tracker stood when it was seen last with nothing ordered; None while something is ordered.
    identity
        Identity of the unit that is or was connected last.
    frozen
        Why nothing may move at present, or None.
    halt_wanted
        Somebody wants both axes to be stopped, and they have not been seen to stand since.
    homing, clearing
        A reference run of ours is on; the unit's marks are being cleared by us.
    anomaly
        Motion that nothing explains, not yet dealt with by `stop_unexplained_motion`.
    autonomy
        Whether a mode of the positioner's own stays on.
    """

    def __init__(
        self,
        positioner: Positioner,
        expected: PositionerSettings,
        doubts: Doubts,
        place: KeptPlace,
        clock: Clock,
        publish: Callable[[Record], None],
        alarms: Alarms,
        polled: Callable[[], None],
    ) -> None:
        self._positioner = positioner
        self._repeats = positioner if isinstance(positioner, Repeating) else None
        self.doubts = doubts
        self._place = place
        self._clock = clock
        self._publish = publish
        self._alarms = alarms
        self._polled = polled
        self.watch = watch = AxisWatch(expected)
        # As long as the slowest motion takes for three steps of a rounded position.
        self._stop_monitor = StopMonitor(watch.same_place, 3.0 * expected.resolution() / expected.slowest_deg_per_s)
        self._currents = Currents(expected.current_alarm_a)
        self.autonomy = AutonomousModeMonitor()
        self._own_moves: tuple[str, ...] = ()
        self._reported_pose: Pose | None = None
        self._pressed_s = self._reported_buttons_s = self._judged_s = float("-inf")
        self._sleeps = SleepGauge(clock)
        self._anomaly_telemetry: Telemetry | None = None
        self._reset_before = False
        self._motion_under_inquiry: str | None = None
        self._halted_faults: tuple[str, ...] = ()
        self._alarmed_state: tuple[object, ...] = ()
        self._telemetry: Telemetry | None = None
        self._read: Telemetry | None = None
        self._pose: Pose | None = None
        # Target of a move, until the axes rest again.
        self._target: Target | None = None
        # Time of the last glance, monotonic and UTC [s].
        self._last_glance_s: tuple[float, float] | None = None
        self.rest_pose: Pose | None = None
        self.identity: PositionerIdentity | None = None
        self.frozen: str | None = None
        self.halt_wanted = False
        self.homing = False
        self.clearing = False
        self.anomaly: MotionAnomaly | None = None

    @property
    def telemetry(self) -> Telemetry | None:
        """The newest look; None while the link is down."""
        self._apply_glance_time()
        return self._telemetry

    @property
    def telemetry_as_read(self) -> Telemetry | None:
        """The newest look as it was read: it shows the same as `telemetry`, but its times may be 5 s older."""
        return self._telemetry

    @property
    def pose(self) -> Pose | None:
        """Where the tracker was seen last."""
        self._apply_glance_time()
        return self._pose

    def glance(self) -> bool:
        """Glance at axes at rest; return False where telemetry has to be read and judged, or a pose is to be published.

        Telemetry that only repeats the last look was judged before, and time alone changes nothing about it.
        """
        told, since_s, now_s = self._reported_pose, self.watch.stands_since_s, self._clock.monotonic()
        if self.rest_pose is None or told is None or now_s - told.time_monotonic_s >= _POSE_EVERY_S:
            return False
        if since_s is None or now_s - since_s < _JUDGED_AFTER_S or self._currents.has_pending_fault:
            return False
        again_s = self._repeats.repeated_s(self._read) if self._repeats and self._read else None
        if again_s is None:
            return False
        self._last_glance_s = again_s, self._clock.utc()
        return True

    def _apply_glance_time(self) -> None:
        """Give the last look the time of the last glance, so that its age shows that the positioner is watched."""
        repeated, telemetry, pose = self._last_glance_s, self._telemetry, self._pose
        if repeated is None or telemetry is None or pose is None:
            return
        self._last_glance_s, (at_s, utc_s) = None, repeated
        self._telemetry = telemetry.with_time(at_s)
        self._pose = replace(pose, time_monotonic_s=at_s, time_utc_s=utc_s)
        self.watch.note_repeat(self._telemetry)

    @property
    def unexplained_motion(self) -> str | None:
        """What moved without an order or did not stop, or None."""
        return self.doubts.incident or self._motion_under_inquiry

    @property
    def must_halt(self) -> bool:
        """Whether somebody wants a halt, a fault has come up, or a motor is on that should be off.

        With a fault on one axis the other may be moving, or about to.
        """
        faults = self._telemetry.faults if self._telemetry else ()
        new_fault = any(name not in self._halted_faults for name in faults)
        return self.halt_wanted or new_fault or self._currents.wants_stop

    @property
    def stands_since_s(self) -> float | None:
        """Monotonic time since which both axes have been seen unmoved; None while a stop is on its way."""
        return None if self.halt_wanted else self.watch.stands_since_s

    def note_link_loss(self) -> None:
        """Know nothing until the link is back, but keep motion that was seen and that no button explains."""
        anomaly = self.anomaly
        if anomaly is not None and self._pressed_s <= anomaly.seen_s - _STATUS_WITHIN_S:
            self.doubts.add_incident("motion", anomaly.incident_text(self.frozen))
        self._telemetry = self.anomaly = None
        self.homing = self.clearing = False
        self.watch.forget()

    def forget(self) -> None:
        """Forget the currents told of, and where an axis would stand if a doubt were right: a person has looked."""
        self._currents.forget()
        self._place.note_departure(None)

    def note_departure(self, target: Target | None) -> None:
        """Take note that the axes are about to be sent off (None: to home): they go there even if the service dies."""
        self.rest_pose, self._target = None, target
        self._place.note_departure(target)

    async def poll(self, *, moving: bool) -> Telemetry:
        """Read and judge telemetry; `moving` says whether something was ordered to move."""
        before, telemetry = self.telemetry, await self._positioner.read_telemetry()
        self._telemetry = self._read = telemetry
        if self._halted_faults:
            self._halted_faults = tuple(name for name in self._halted_faults if name in telemetry.faults)
        self._note_own_moves(telemetry)
        if telemetry.button_pressed:
            self._pressed_s = telemetry.status_monotonic_s
        self.doubts.see(telemetry, clearing=self.clearing)
        self._judge(before, telemetry)
        self._currents.update(telemetry, None if moving else self.watch.stands_since_s)
        self.autonomy.update(telemetry)
        self._raise_alarms(telemetry)
        self._note_pose(telemetry, moving=moving)
        self._polled()
        return telemetry

    def _raise_alarms(self, telemetry: Telemetry) -> None:
        alarmed = self.doubts.change_count, telemetry.faults, self.identity, self._currents.text, self.autonomy.text
        if alarmed != self._alarmed_state:
            self._alarmed_state = alarmed
            update_alarms(self._alarms, self.doubts, self.identity, telemetry, self._currents, self.autonomy)

    async def expect_move(self) -> None:
        """Let motion towards the destinations pass from now on: the unit has just confirmed a target."""
        self.watch.expect(await self._positioner.read_telemetry())

    async def halt(self) -> None:
        """Stop both axes until telemetry shows them standing; does not give up while the link is there."""
        self.halt_wanted = True
        start_s, pause_s = self._clock.monotonic(), _FIRST_PAUSE_S
        while True:
            try:
                await self._poll_during(self._positioner.halt(), lambda: self._poll_halt(start_s))
                break
            except StillMovingError:
                await self._poll_halt(start_s)
                await asyncio.sleep(pause_s)
                pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
        self.halt_wanted = False
        self._currents.note_stop(self._clock.monotonic())
        # The next look may still show a status from before the stop.
        self._judged_s = self._clock.monotonic()
        telemetry = await self.poll(moving=False)
        self.watch.note_rest(telemetry)
        self._halted_faults = telemetry.faults

    async def stop_unexplained_motion(self) -> bool:
        """Stop stray motion until the axes stand; return whether a person or a restart explains it.

        Motion that nothing explains is reported and blocks every move.
        """
        anomaly, seen = self.anomaly, self._anomaly_telemetry
        assert anomaly is not None and seen is not None  # noqa: S101, PT018 - narrowing for the type checker
        text = anomaly.incident_text(self.frozen)
        if self._pressed_s <= anomaly.seen_s - _STATUS_WITHIN_S:
            self._motion_under_inquiry = text
        explained = False
        try:
            await self.halt()
            self.anomaly = None
            explained = await self._wait_for_explanation(anomaly, seen)
        finally:
            self._motion_under_inquiry = None
            if not explained:
                self.doubts.add_incident("motion", text)
        return explained

    async def _poll_halt(self, start_s: float) -> None:
        telemetry = await self.poll(moving=True)
        # A person who presses a button moves the axis against any stop.
        if self._stop_monitor.is_ignoring_stop(telemetry, max(start_s, self._pressed_s)):
            text = "the positioner does not obey stop: switch off the supply of its motors"
            self.doubts.add_incident("deaf", f"{text}; {BLOCKED_UNTIL_CLEARED}")

    async def run_guarded(self, call: Coroutine[Any, Any, T], ends: Callable[[], bool] = lambda: False) -> T:
        """Return what a call of the driver returns; meanwhile poll the positioner and stop stray motion.

        When `ends` returns True, a stop is sent to end the call, which is then refused.
        """

        async def poll_and_quell() -> None:
            await self.poll(moving=self.homing)
            if self.anomaly is not None:
                await self.stop_unexplained_motion()
            elif ends():
                await self._positioner.stop()

        return await self._poll_during(call, poll_and_quell)

    async def _poll_during(self, call: Coroutine[Any, Any, T], poll: Callable[[], Coroutine[Any, Any, None]]) -> T:
        task = asyncio.ensure_future(call)
        try:
            while True:
                await asyncio.wait((task,), timeout=MOVING_POLL_INTERVAL_S)
                if task.done():
                    return task.result()
                await poll()
        finally:
            task.cancel()
            # Also collect the error of a call that failed just as this is cancelled: nobody else would.
            with contextlib.suppress(asyncio.CancelledError, DeviceError):
                await task

    def _judge(self, before: Telemetry | None, telemetry: Telemetry) -> None:
        anomaly = self.watch.update(telemetry, self._clock.monotonic() + self._sleeps.take_s())
        told = telemetry.homing and telemetry.status_monotonic_s > self._judged_s + _STATUS_LATE_S
        # During a move of ours the homing bit alone says nothing: it may come from the other axis' motion.
        own_run = told and not self.watch.is_motion_expected
        # A run that ends at its switch before the next look has set the count anew, and shows only as a jump.
        ended = anomaly is not None and anomaly.is_count_jump and before is not None and before.aims_home
        if not self.homing and (own_run or ended or (anomaly is not None and (told or telemetry.aims_home))):
            text = "the positioner made a reference run of its own"
            self.doubts.add_doubt("own run", f"{text}, its count may have changed: home it")
            anomaly = MotionAnomaly(text, telemetry.time_monotonic_s) if anomaly is None or ended else anomaly
        if anomaly is None:
            return
        if anomaly.is_count_jump:
            self.doubts.add_doubt("jump", f"{anomaly.text}, the reference may be lost: {self.doubts.remedy}")
            # On the rest of a way the unit would go on by the wrong count, perhaps beyond a limit.
            self.halt_wanted |= self.rest_pose is None
        elif self.anomaly is None:
            self.anomaly = anomaly
            self._anomaly_telemetry = telemetry
            self._reset_before = before is not None and before.was_reset

    async def _wait_for_explanation(self, anomaly: MotionAnomaly, seen: Telemetry) -> bool:
        """Wait for a status that is younger than the motion; tell whether a person or a restart explains it."""
        deadline_s = self._clock.monotonic() + _STATUS_WITHIN_S
        while True:
            telemetry = await self.poll(moving=False)
            if self.anomaly is not None:
                await self.halt()
                self.anomaly = None
            if self._pressed_s > anomaly.seen_s - _STATUS_WITHIN_S:
                self._report_buttons(anomaly)
                return True
            restarted = telemetry.was_reset and not (self._reset_before or telemetry.autonomous)
            if restarted and self.watch.same_place(seen, telemetry):
                # The count has changed with the restart, and nothing has moved since: that is a doubt.
                return True
            if self._clock.monotonic() >= deadline_s or telemetry.status_monotonic_s > anomaly.seen_s + _STATUS_LATE_S:
                return False
            await asyncio.sleep(MOVING_POLL_INTERVAL_S)

    def _note_own_moves(self, telemetry: Telemetry) -> None:
        # The drive's own moves may be known only some seconds after the connection.
        if telemetry.own_moves and telemetry.own_moves != self._own_moves:
            self._own_moves = telemetry.own_moves
            text = f"the positioner may move by itself: {', '.join(telemetry.own_moves)}"
            log.warning(text)
            self._publish(self._event(text))

    def _note_pose(self, telemetry: Telemetry, *, moving: bool) -> None:
        now_s, told = self._clock.monotonic(), self._reported_pose
        pose = Pose(
            time_utc_s=self._clock.utc(),
            time_monotonic_s=now_s,
            a_deg=telemetry.a_deg,
            b_deg=telemetry.b_deg,
            moving=moving,
        )
        self._pose = pose
        self.rest_pose = pose if self.watch.settled and not moving else None
        if self.rest_pose is None:
            self._place.note_departure(self._target)
        else:
            self._target = None
            self._place.note_rest(pose)
        if (
            told is None
            or moving
            or telemetry.button_pressed
            or told.moving
            or now_s - told.time_monotonic_s >= _POSE_EVERY_S
            or not (abs(pose.a_deg - told.a_deg) <= _POSE_CHANGED_DEG)
            or not (abs(pose.b_deg - told.b_deg) <= _POSE_CHANGED_DEG)
        ):
            self._reported_pose = pose
            self._publish(pose)

    def _report_buttons(self, anomaly: MotionAnomaly) -> None:
        if anomaly.seen_s - self._reported_buttons_s > _TELL_BUTTONS_EVERY_S:
            self._reported_buttons_s = anomaly.seen_s
            text = f"{anomaly.text}: a button is pressed at the unit"
            log.info(text)
            self._publish(self._event(text))

    def _event(self, text: str) -> Event:
        return Event(self._clock.utc(), self._clock.monotonic(), "positioner", text)
