"""The one owner of the positioner: connects, watches, moves, stops and homes it.

One task talks to the positioner, so one target is in flight by construction; only `stop` goes past it. After every
(re)connection nothing moves before the unit has been identified, stopped, freed of its own tracking, found referenced,
and given a new target by control: what was wanted before the loss is forgotten.
"""

import asyncio
import contextlib
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from daemon.alarms import Alarms
from daemon.backoff import Backoff
from daemon.clock import Clock
from daemon.config import Motion as MotionSettings
from daemon.config_instruments import PositionerSettings
from daemon.follow import Follow, Progress
from daemon.outage import Outage
from daemon.records import Event, Move, MoveOutcome, Pose, Record, Target
from daemon.waiting import wait_at_most
from drivers.errors import DeviceError, DriverHungError, RefusedError
from drivers.interfaces import Axis, Positioner, PositionerIdentity, Telemetry
from solar.frames import Limits

log = logging.getLogger("heliocube.motion")

_HOMING_POLL_S = 1.0
_STOPPING_POLL_S = 0.5
_BETWEEN_ATTEMPTS_S = 1.0
_AXES: tuple[Axis, Axis] = ("a", "b")


@dataclass(frozen=True, slots=True)
class Polling:
    """How often the positioner is looked at, at rest and on its way."""

    idle_s: float = 5.0
    moving_s: float = 0.5


OFTEN = Polling()


class Motion:
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
        Called when readiness changes or a move or homing run begins or ends, so that control looks again at once.
    alarms
        Where what a person has to know is raised.
    polling
        How often to look at the positioner.
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
        polling: Polling = OFTEN,
    ) -> None:
        self._positioner = positioner
        self._limits = limits
        self._settings = settings
        self._expected = expected
        self._clock = clock
        self._publish = publish
        self._changed = changed
        self._alarms = alarms
        self._frozen: str | None = None
        self.stands_since_s: float | None = None
        self.unexplained: str | None = None
        self._polling = polling
        self._backoff = Backoff(random)
        self._wake = asyncio.Event()
        self._wanted: Target | None = None
        self._stowing = False
        self._home_wanted = False
        self._clear_wanted = False
        self._interrupt = False
        self._failed_s = -math.inf
        self._failed_why = ""
        self._was_ready = False
        self._doubt: str | None = None
        self._own_moves: tuple[str, ...] = ()
        self.outage = Outage(log, "the positioner")
        self.identity: PositionerIdentity | None = None
        self.telemetry: Telemetry | None = None
        self.pose: Pose | None = None
        self.target: Target | None = None
        self.homing = False
        self.last_move: Move | None = None
        self.last_move_started_s = -math.inf

    @property
    def blocked(self) -> str | None:
        """Why nothing at all can be moved, or None; also None before the first contact."""
        telemetry = self.telemetry
        if telemetry is None:
            return self.outage.reason if self.outage.is_down else None
        if telemetry.faults:
            return f"the positioner reports {', '.join(telemetry.faults)}"
        if telemetry.autonomous:
            return "the positioner's own sun tracking is on"
        return None

    @property
    def doubt(self) -> str | None:
        """Why only a stow may be ordered though the axes could move, or None."""
        if self._doubt:
            return self._doubt
        if self._failed_s + self._settings.retry_after_s > self._clock.monotonic():
            return self._failed_why
        return None

    @property
    def concerns(self) -> tuple[str, ...]:
        """Every fault and doubt that is shown at present."""
        faults = () if self.telemetry is None else self.telemetry.faults
        return (*faults, *((doubt,) if (doubt := self.doubt) is not None else ()))

    def freeze(self, why: str | None) -> None:
        """Let nothing move while there is a reason, and stop what moves."""
        if why is not None and self._frozen is None:
            self.rest()
        self._frozen = why

    @property
    def connected(self) -> bool:
        """Whether telemetry is coming in."""
        return self.telemetry is not None

    @property
    def moving(self) -> bool:
        """Whether a move or a homing run is on."""
        return self.target is not None or self.homing

    @property
    def resting(self) -> bool:
        """Whether nothing moves and nothing that was asked for waits to be taken up."""
        return not (self.moving or self._wanted or self._home_wanted or self._clear_wanted) and self.connected

    def order(self, target: Target, *, stow: bool = False) -> None:
        """Ask for a move; whatever moves is stopped first. The one door for every move in the service.

        Parameters
        ----------
        target
            Where to.
        stow
            A stow goes ahead although the reference is in doubt or the last move failed, and it ends a homing run.

        Raises
        ------
        ValueError
            The target is outside the limits, or not a number.
        RefusedError
            The positioner is not ready.
        """
        if not self._limits.contain(target.a_deg, target.b_deg):
            raise ValueError(
                f"target A {target.a_deg:.2f}, B {target.b_deg:.2f} deg is outside the limits ({self._limits})"
            )
        if self._frozen is not None:
            raise RefusedError("positioner", self._frozen)
        obstacle = self.blocked or (None if stow else self.doubt)
        if not self.connected or obstacle:
            raise RefusedError("positioner", f"cannot move: {obstacle or 'no telemetry yet'}")
        if self.homing and not stow:
            raise RefusedError("positioner", "cannot move while homing")
        self._home_wanted = False
        self._wanted, self._stowing = target, stow
        self._interrupt = self.moving
        self._wake.set()

    def home(self) -> None:
        """Ask for a reference run of both axes; the reset mark and latched faults are cleared by it."""
        if self._frozen is not None:
            raise RefusedError("positioner", self._frozen)
        self._home_wanted = True
        self._wanted = None
        self._interrupt = self.moving
        self._wake.set()

    def clear_faults(self, shown: tuple[str, ...] = ()) -> None:  # noqa: ARG002 - the stand-in forgives all
        """Ask the unit to clear latched faults and the reset mark without a reference run."""
        self._clear_wanted = True
        self._wake.set()

    def rest(self) -> None:
        """Ask for whatever moves to be stopped, by the task that moves it."""
        self._wanted = None
        self._home_wanted = False
        self._interrupt = self.moving
        self._wake.set()

    async def stop(self) -> None:
        """Send stop at once, whatever is going on, and forget every target.

        Raises `DeviceError` when the positioner cannot be reached; the stop is then sent again on reconnection.
        """
        self.rest()
        await self._positioner.stop()

    async def run(self) -> None:
        """Keep the positioner connected and carry out what is asked, until cancelled.

        Raises `DriverHungError` when only a new process can connect it.
        """
        try:
            while True:
                try:
                    await self._connect()
                    await self._serve()
                except DriverHungError:
                    raise
                except DeviceError as error:
                    await self._lost(error)
                    await asyncio.sleep(self._backoff.next_s())
        finally:
            await self._positioner.close()

    async def _connect(self) -> None:
        self._wanted = None
        self._home_wanted = False
        self.identity = await self._positioner.open()
        # A move ordered before the loss, by us or by a program before us, may still be on.
        await self._positioner.stop()
        await self._positioner.disable_autonomy()
        before = self.pose
        await self._look(moving=False)
        assert self.pose is not None  # noqa: S101 - narrowing for the type checker; _look has just set it
        name = f"{self.identity.board}, firmware {self.identity.firmware}, serial {self.identity.serial}"
        if self.outage.up(self._clock.monotonic()):
            self._publish_event(f"positioner back: {name}")
        else:
            log.info("the positioner is connected: %s", name)
        if before is not None and self._jumped(before, self.pose):
            self._tell(
                f"positioner stands at A {self.pose.a_deg:.1f}, B {self.pose.b_deg:.1f} deg; before the loss it was "
                f"A {before.a_deg:.1f}, B {before.b_deg:.1f} deg"
            )
        self._backoff.reset()

    def _jumped(self, before: Pose, after: Pose) -> bool:
        tolerance = self._settings.tolerance_deg
        return not (abs(before.a_deg - after.a_deg) <= tolerance and abs(before.b_deg - after.b_deg) <= tolerance)

    async def _lost(self, error: DeviceError) -> None:
        self.telemetry = None
        self.stands_since_s = None
        self.target = None
        self.homing = False
        self._wanted = None
        first = not self.outage.is_down
        self.outage.down(self._clock.monotonic(), str(error))
        if first:
            self._publish_event(f"positioner lost: {error}")
        self._note_readiness()
        await self._positioner.close()

    async def _serve(self) -> None:
        while True:
            telemetry = await self._look(moving=False)
            if self._clear_wanted:
                self._clear_wanted = False
                await self._positioner.clear_faults()
                await self._look(moving=False)
                self._forgive()
                continue
            if self._home_wanted or self._must_rehome():
                self._home_wanted = False
                await self._home()
                continue
            if telemetry.autonomous:
                await self._positioner.disable_autonomy()
                continue
            if self._wanted is not None:
                target, self._wanted = self._wanted, None
                await self._move(target)
                continue
            await wait_at_most(self._wake, self._polling.idle_s)

    def _must_rehome(self) -> bool:
        return self._settings.rehome == "automatic" and self._doubt is not None and not (self.blocked or self._frozen)

    def _doubtful(self) -> str | None:
        """Return why the move in progress must not go on: a reference lost on the way ends all moves but a stow."""
        return None if self._stowing else self._doubt

    def _forgive(self) -> None:
        self._doubt = None
        self._failed_s = -math.inf

    async def _look(self, *, moving: bool) -> Telemetry:
        before, telemetry = self.telemetry, await self._positioner.read_telemetry()
        self.telemetry = telemetry
        if before is None or (before.position_a, before.position_b) != (telemetry.position_a, telemetry.position_b):
            self.stands_since_s = None
        elif self.stands_since_s is None:
            self.stands_since_s = telemetry.time_monotonic_s
        if telemetry.own_moves and telemetry.own_moves != self._own_moves:
            # Slow screens: it is known only some seconds after the connection.
            self._own_moves = telemetry.own_moves
            text = f"the positioner may move by itself: {', '.join(telemetry.own_moves)}"
            log.warning(text)
            self._publish_event(text)
        if telemetry.was_reset:
            self._doubt = "the positioner has restarted and may have lost its reference: home it, or clear the mark"
        elif before is not None and before.faults and not telemetry.faults and not self.homing:
            self._doubt = f"{', '.join(before.faults)} cleared by itself, the reference may be lost: home it"
        now_s = self._clock.monotonic()
        self.pose = Pose(self._clock.utc(), now_s, telemetry.a_deg, telemetry.b_deg, moving)
        self._publish(self.pose)
        self._note_readiness()
        return telemetry

    def _note_readiness(self) -> None:
        ready = self.connected and self.blocked is None and self.doubt is None
        if ready is not self._was_ready:
            self._was_ready = ready
            self._changed()

    async def _move(self, target: Target) -> None:
        self._interrupt = False
        self.target = target
        start_utc_s, start_s = self._clock.utc(), self._clock.monotonic()
        self.last_move_started_s = start_s
        start = self.pose
        assert start is not None  # noqa: S101 - narrowing; a move is only taken up after a look
        outcome, why = MoveOutcome.LINK_LOST, target.why
        try:
            outcome, why = await self._attempt(target, start)
        except BaseException as error:
            # Whatever ended this task, a cancellation or a defect, must not leave an axis running.
            await self._try_to_stop()
            if not isinstance(error, DeviceError):
                outcome = MoveOutcome.INTERRUPTED
            raise
        finally:
            end = self.pose or start
            self.target = None
            self.last_move = Move(
                start_utc_s,
                start_s,
                self._clock.monotonic() - start_s,
                start.a_deg,
                start.b_deg,
                target.a_deg,
                target.b_deg,
                end.a_deg,
                end.b_deg,
                outcome,
                why,
            )
            self._publish(self.last_move)
        self._count(outcome, why)
        self._changed()

    def _count(self, outcome: MoveOutcome, why: str) -> None:
        if outcome is MoveOutcome.ARRIVED:
            self._failed_s = -math.inf
        elif outcome is not MoveOutcome.INTERRUPTED:
            self._failed_s = self._clock.monotonic()
            self._failed_why = f"the last move failed ({outcome}): {why}"
            log.warning("move failed: %s", why, extra={"fields": {"outcome": outcome}})

    async def _attempt(self, target: Target, start: Pose) -> tuple[MoveOutcome, str]:
        outcome, why = MoveOutcome.REFUSED, target.why
        for attempt in range(self._settings.attempts):
            if attempt:
                await asyncio.sleep(_BETWEEN_ATTEMPTS_S)
            if self._interrupt:
                return MoveOutcome.INTERRUPTED, target.why
            try:
                await self._positioner.move_to(target.a_deg, target.b_deg)
            except RefusedError as error:
                outcome, why = MoveOutcome.REFUSED, error.message
                continue
            outcome, why = await self._follow(target, start)
            if outcome in (MoveOutcome.ARRIVED, MoveOutcome.INTERRUPTED) or self.blocked or self._doubtful():
                break
        return outcome, why

    async def _follow(self, target: Target, start: Pose) -> tuple[MoveOutcome, str]:
        follow = Follow(target, start, self._limits, self._settings, self._expected, self._clock.monotonic())
        while True:
            telemetry = await self._look(moving=True)
            if self._interrupt:
                await self._come_to_rest()
                return MoveOutcome.INTERRUPTED, target.why
            if (doubt := self._doubtful()) is not None:
                await self._come_to_rest()
                return MoveOutcome.STALLED, doubt
            progress, why = follow.judge(telemetry, self._clock.monotonic())
            if progress is Progress.ARRIVED:
                return MoveOutcome.ARRIVED, target.why
            if progress is not Progress.GOING:
                await self._come_to_rest()
                return MoveOutcome(progress.value), why
            await wait_at_most(self._wake, self._polling.moving_s)

    async def _come_to_rest(self) -> None:
        """Send stop until two looks agree that nothing moves."""
        deadline_s = self._clock.monotonic() + self._expected.telemetry_stale_s + 10.0
        before = await self._look(moving=True)
        while self._clock.monotonic() < deadline_s:
            await self._positioner.stop()
            await asyncio.sleep(_STOPPING_POLL_S)
            after = await self._look(moving=True)
            if (before.position_a, before.position_b) == (after.position_a, after.position_b):
                return
            before = after
        self._tell("the positioner keeps moving after stop")

    async def _home(self) -> None:
        self._interrupt = False
        self.homing = True
        self._doubt = "homing was not finished, the reference is in doubt: home it" if self._doubt else None
        self._tell("homing")
        self._changed()
        try:
            await self._positioner.clear_faults()
            for axis in _AXES:
                await self._positioner.home(axis)
                while (await self._look(moving=True)).homing and not self._interrupt:
                    await wait_at_most(self._wake, _HOMING_POLL_S)
                if self._interrupt:
                    await self._come_to_rest()
                    self._tell("homing was stopped before its end")
                    return
            self._forgive()
            self._tell("homing finished")
        except RefusedError as error:
            self._tell(f"homing refused: {error.message}")
        except BaseException:
            await self._try_to_stop()
            raise
        finally:
            self.homing = False
            self._changed()

    async def _try_to_stop(self) -> None:
        with contextlib.suppress(DeviceError):
            await self._positioner.stop()

    def _tell(self, text: str) -> None:
        log.info(text)
        self._publish_event(text)

    def _publish_event(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "positioner", text))
