"""The one owner of the positioner: connects, watches, moves, stops and homes it.

One task talks to the positioner, so one target is in flight by construction; only `stop` goes past it. After every
(re)connection nothing moves before the unit has been identified, halted, freed of its own tracking, found referenced,
and given a new target by control: what was wanted before the loss is forgotten. Motion that nobody has ordered is
dealt with by `daemon.motion.guard`.
"""

import asyncio
import logging
from collections.abc import Callable
from random import Random

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.reconnect import Outage, Reconnection
from daemon.base.records import Event, Pose, Record, Target
from daemon.base.state import StateFolder
from daemon.base.timeloop import wait_or_poll
from daemon.config.sections import MotionSettings
from daemon.motion.doubts import Doubts, remedy_of
from daemon.motion.guard import Guard
from daemon.motion.last_call import try_for
from daemon.motion.place import KeptPlace, displacement_text
from daemon.motion.polling import OFTEN, Polling
from daemon.motion.rehoming import Rehoming
from daemon.motion.retry import Retries
from daemon.motion.runs import Mover
from daemon.motion.state import MotionState
from drivers.errors import DeviceError, DriverHungError, RefusedError
from drivers.interfaces import Positioner
from drivers.settings import PositionerSettings
from solar.frames import Limits

log = logging.getLogger("heliocube.motion")

_HALT_AT_END_S = 3.0
_STOP_AT_LOSS_S = 0.3


class Motion(MotionState):
    """Moves the tracker and knows where it stands.

    Parameters
    ----------
    positioner
        The instrument, owned from here on.
    limits
        No target outside them gets past `order`.
    settings, expected
        Tolerances and attempts; what may be expected of the drive.
    clock, random
        The service's time; jitter of reconnection.
    publish
        Called with moves, poses and events.
    changed
        Called when readiness changes, a move or homing run begins or ends, or a button is pressed at the unit, so that
        control looks again at once.
    alarms
        Where the alarms about the positioner are raised.
    folder
        Where doubts, and where the axes rest, are kept over a restart.
    polling, has_fixed_start_pose
        How often to look at the positioner; whether its earlier place of rest tells nothing.
    """

    def __init__(
        self,
        positioner: Positioner,
        limits: Limits,
        settings: MotionSettings,
        expected: PositionerSettings,
        clock: Clock,
        random: Random,
        publish: Callable[[Record], None],
        changed: Callable[[], None],
        alarms: Alarms,
        folder: StateFolder,
        polling: Polling = OFTEN,
        *,
        has_fixed_start_pose: bool = False,
    ) -> None:
        self._positioner = positioner
        self._limits = limits
        self._settings = settings
        self._publish = publish
        self._on_change = changed
        self._polling = polling
        doubts = Doubts(folder, remedy_of(has_reference_run=expected.has_reference_run))
        place = KeptPlace(folder, positioner, doubts.reference, has_fixed_start_pose=has_fixed_start_pose)
        guard = Guard(positioner, expected, doubts, place, clock, publish, alarms, self._note_readiness)
        retries = Retries(settings.retry_after_s, alarms)
        self._has_reference_run = expected.has_reference_run
        self._rehoming = Rehoming(enabled=settings.rehome == "automatic" and expected.has_reference_run)
        self._wake = wake = asyncio.Event()
        every_s = polling.moving_s
        runs = Mover(positioner, guard, limits, settings, expected, retries, clock, publish, changed, wake, every_s)
        super().__init__(guard, runs, retries, Outage(log, "the positioner"), clock)
        self._reconnection = Reconnection(
            self.outage, random, clock.monotonic, self._notify, lost=DeviceError, hopeless=(DriverHungError,)
        )
        # Where to, and whether it is a stow.
        self._wanted_order: tuple[Target, bool] | None = None
        self._home_wanted = False
        self._clear_wanted: tuple[str, ...] | None = None
        self._pose_before_loss: Pose | None = None
        self._was_connected = self._moved_at_loss = self._ended = False
        self._was_ready = (False, False)
        self.may_rehome = False

    @property
    def poll_interval_s(self) -> float:
        """The longest time [s] between two looks at a positioner that answers."""
        return self._polling.idle_s

    @property
    def is_idle(self) -> bool:
        """Whether nothing moves and nothing that was asked for waits to be taken up."""
        asked = self._wanted_order or self._home_wanted or self._clear_wanted is not None or self._guard.must_halt
        return not (self.moving or asked) and self.connected

    @property
    def is_homing_or_queued(self) -> bool:
        """Whether a reference run of ours is on, or was asked for and comes next."""
        return self.homing or self._home_wanted

    def order(self, target: Target, *, stow: bool = False) -> None:
        """Ask for a move; whatever moves is stopped first. The one door for every move in the service.

        Parameters
        ----------
        target
            Where to.
        stow
            A stow goes ahead although the reference is in doubt or the last move failed, B first, and it ends a homing
            run. After stows that failed it waits for its pause to end.

        Raises
        ------
        ValueError
            The target is outside the limits, or not a number.
        RefusedError
            Nothing may move, or the positioner is not ready.
        """
        if not self._limits.contain(target.a_deg, target.b_deg):
            raise ValueError(
                f"target A {target.a_deg:z.2f}, B {target.b_deg:z.2f} deg is outside the limits ({self._limits})"
            )
        self._refuse_frozen()
        obstacle = self.blocked or (None if stow else self.doubt)
        if not self.connected or obstacle:
            raise RefusedError("positioner", f"cannot move: {obstacle or 'no telemetry yet'}")
        if self.homing and not stow:
            raise RefusedError("positioner", "cannot move while homing")
        self._home_wanted = False
        self._wanted_order = target, stow
        self._runs.interrupt()
        self._wake.set()

    def home(self) -> None:
        """Ask for a reference run of both axes; the reset mark and latched faults are cleared by it.

        Raises `RefusedError` when nothing may move, after unexplained motion, without telemetry, while a mode of the
        unit's own stays on, and for a drive that has no reference run.
        """
        if not self._has_reference_run:
            message = "has no reference run: compare its angles with where it points, set it right, then clear it"
            raise RefusedError("positioner", message)
        self._refuse_frozen()
        conflicts = "; ".join(self.identity.setup_conflicts) if self.identity else ""
        unseen = None if self.connected else "no telemetry"
        obstacle = self.unexplained_motion or conflicts or unseen or self._guard.autonomy.text
        if obstacle:
            # Once cleared, the tracker goes to work, however wrong its count is.
            if self.unexplained_motion:
                obstacle += "; give 'heliocube hold' first, so that the tracker waits to be homed"
            raise RefusedError("positioner", f"cannot be homed: {obstacle}")
        self._home_wanted = True
        self._wanted_order = None
        self._runs.interrupt()
        self._wake.set()

    def clear_faults(self, shown: tuple[str, ...] | None = None) -> None:
        """Ask the unit to clear its marks without a reference run, and forgive what a person was shown.

        `shown` is the `concerns` that the person has seen; None means the present ones. Raises `RefusedError` without
        telemetry.
        """
        if not self.connected:
            raise RefusedError("positioner", "cannot be cleared: no telemetry")
        self._clear_wanted = self.concerns if shown is None else shown
        self._wake.set()

    def cancel_waiting_order(self) -> None:
        """Drop an order that has not begun: it comes next, or waits for the pause after a failure."""
        if (order := self._due_order()) is not None:
            self._report_obstacle(stow=order[1])
        self._wanted_order = None

    def cancel_move(self) -> None:
        """Drop the last order, and stop the move to its target; a reference run goes on."""
        self._wanted_order = None
        if self.target is not None:
            self._runs.interrupt()
            self._wake.set()

    def request_stop(self) -> None:
        """Ask for whatever moves to be stopped, by the task that moves it."""
        self._wanted_order = None
        self._home_wanted = False
        self._runs.interrupt()
        self._wake.set()

    def freeze(self, why: str | None) -> None:
        """Let nothing move while there is a reason, and stop what moves until it stands; None lets go.

        After `freeze_permanently` it changes nothing.
        """
        if self._ended:
            return
        if why is not None and self._guard.frozen is None:
            self.request_stop()
            self._drop_clear("a stop came")
            self._guard.halt_wanted = True
        self._guard.frozen = why

    def freeze_permanently(self, why: str) -> None:
        """Let nothing move any more, whatever anybody asks for later."""
        self.freeze(why)
        self._ended = True

    async def stop(self) -> None:
        """Send stop at once, whatever is going on, and forget every target; it is repeated until both axes stand.

        Raises `DeviceError` when the positioner cannot be reached; the stop is then sent again on reconnection.
        """
        self.request_stop()
        self._guard.halt_wanted = True
        await self._positioner.stop()

    async def run(self) -> None:
        """Keep the positioner connected and carry out what is asked, until cancelled.

        Raises `DriverHungError` when only a new process can connect it.
        """
        try:
            await self._reconnection.run(self._serve, self._close, self._forget)
        finally:
            await self._halt_and_close()

    def give_up(self, why: str) -> None:
        """Know nothing any more of a positioner that `run` has left for good."""
        self._forget()
        self.outage.down(self._clock.monotonic(), why)
        self._note_readiness()

    async def _halt_and_close(self) -> None:
        """Whatever ended this task, a cancellation or a defect, must not leave an axis running."""
        try:
            # A move has forgotten its target by now, and an axis just sent off seems to stand until a look shows it.
            if self.connected and (self._guard.rest_pose is None or self.stands_since_s is None):
                await try_for(self._positioner.halt(), _HALT_AT_END_S)
        finally:
            await self._positioner.close()

    async def _connect(self) -> None:
        guard = self._guard
        guard.identity = identity = await self._positioner.open()
        # If the link is lost again before the comparison below, the next connection makes it.
        self._pose_before_loss = guard.rest_pose or self._pose_before_loss
        # A move ordered before the loss, by us or by a program before us, may still be on.
        await guard.halt()
        pose, telemetry = guard.pose, guard.telemetry
        assert pose is not None and telemetry is not None  # noqa: S101, PT018 - narrowing; halt has just looked
        serial = f", serial {identity.serial}" if identity.serial else ""
        told = self._note_link(f"{identity.board}, firmware {identity.firmware}{serial}")
        before, self._pose_before_loss = self._pose_before_loss, None
        tolerance_deg = self._settings.tolerance_deg
        off_course_text = guard.watch.off_course_text(telemetry, tolerance_deg)
        text = (before and displacement_text(before, pose, tolerance_deg)) or off_course_text
        if text and told:
            self._report(text)
        if text and not telemetry.reference_doubt:
            how = "clear or home it" if self._has_reference_run else "clear it"
            guard.doubts.add_doubt("jump", f"{text}: compare the angles with the arms, then {how}")

    def _note_link(self, name: str = "") -> bool:
        """Take note that the unit answers; return whether that was news."""
        if not self._was_connected:
            self._was_connected = True
            if not self.outage.is_down:
                log.info("the positioner is connected: %s", name)
                return True
        return self._reconnection.note_working(name)

    def _forget(self) -> None:
        self._moved_at_loss = self.connected and self._guard.rest_pose is None
        self._guard.note_link_loss()
        self._wanted_order = None
        self._home_wanted = False
        self._drop_clear("the positioner was lost")

    def _drop_clear(self, why: str) -> None:
        if self._clear_wanted is not None:
            self._clear_wanted = None
            self._report(f"nothing was cleared: {why} first")

    async def _close(self) -> None:
        self._note_readiness()
        if self._moved_at_loss:
            # Perhaps only its answers are lost; without this stop an axis that moves goes on to its target.
            await try_for(self._positioner.stop(), _STOP_AT_LOSS_S)
        await self._positioner.close()

    async def _serve(self) -> None:
        await self._connect()
        while True:
            await self._guard.poll(moving=False)
            self._note_link()
            if not await self._do_what_is_asked():
                await wait_or_poll(self._wake, self._polling.idle_s, self._has_work)

    def _has_work(self) -> bool:
        """Glance at a unit that rests; tell whether it has to be looked at, or a pause is over."""
        waits = self._retries.text is not None or self._guard.doubts.reference is not None
        over = waits and (self._due_order() is not None or self._must_rehome() or self._readiness() != self._was_ready)
        return over or not self._guard.glance()

    def _due_order(self) -> tuple[Target, bool] | None:
        # An order waits only for the pause after a failure.
        wanted = self._wanted_order
        is_due = wanted is not None and self._retries.due_s(stow=wanted[1]) <= self._clock.monotonic()
        return wanted if is_due else None

    async def _do_what_is_asked(self) -> bool:
        """Do the most urgent thing; return False if there is nothing to do."""
        guard = self._guard
        telemetry = guard.telemetry
        assert telemetry is not None  # noqa: S101 - narrowing for the type checker; there was a look just now
        if guard.anomaly is not None:
            await guard.stop_unexplained_motion()
            self._on_change()
        elif guard.must_halt:
            await guard.halt()
        elif self._clear_wanted is not None and not self._stow_can_go():
            shown, self._clear_wanted = self._clear_wanted, None
            await self._runs.clear(shown, self._stow_can_go)
        elif telemetry.autonomous:
            if self._home_wanted and guard.autonomy.text:
                # The mode can only be switched off at the unit, by a person who then stands there.
                self._home_wanted = False
                self._report(f"homing refused: {guard.autonomy.text}")
            await self._runs.disable_autonomous_modes()
        elif self._home_wanted:
            self._home_wanted = False
            await self._runs.home()
        elif (order := self._due_order()) is not None:
            (target, stow), self._wanted_order = order, None
            self._drop_clear("a stow came")
            if not self._report_obstacle(stow=stow):
                await self._runs.move(target, stow=stow)
        elif self._must_rehome():
            self._rehoming.began(self._clock.monotonic())
            await self._runs.home(anew=True)
            self._rehoming.ended(good=self._guard.doubts.reference is None)
        else:
            return False
        return True

    def _stow_can_go(self) -> bool:
        """Whether a stow waits that nothing hinders; a unit may take no target after a restart until it is cleared."""
        order, telemetry = self._due_order(), self._guard.telemetry_as_read
        hindered = self.blocked is not None or (telemetry is not None and telemetry.was_reset)
        return order is not None and order[1] and not hindered

    def _report_obstacle(self, *, stow: bool) -> bool:
        """Tell what has come up since an order was taken and hinders it; return whether anything has."""
        obstacle = self.blocked or (None if stow else self._guard.doubts.reference)
        if obstacle is not None:
            self._report(f"no move: {obstacle}")
        return obstacle is not None

    def _must_rehome(self) -> bool:
        doubt = self._guard.doubts.reference
        if doubt is not None and (self._guard.frozen or self.blocked or not self.may_rehome):
            return False
        return self._rehoming.due(doubt, self._clock.monotonic())

    def _note_readiness(self) -> None:
        ready = self._readiness()
        if ready != self._was_ready:
            self._was_ready = ready
            self._on_change()

    def _report(self, text: str) -> None:
        log.info(text)
        self._notify(text)

    def _notify(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "positioner", text))
