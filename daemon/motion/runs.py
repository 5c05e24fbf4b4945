"""One move or one reference run, from its order to its end: each begins and ends with both axes standing."""

import asyncio
import contextlib
import logging
import math
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, TypeVar

from daemon.base.clock import Clock
from daemon.base.records import Event, Move, MoveOutcome, Pose, Record, Target
from daemon.base.sleeps import SleepGauge
from daemon.base.timeloop import wait_at_most
from daemon.config.sections import MotionSettings
from daemon.motion.doubts import NOT_FINISHED
from daemon.motion.guard import Guard
from daemon.motion.move_watch import MoveWatch, Progress
from daemon.motion.retry import Retries
from drivers.errors import DeviceError, RefusedError
from drivers.interfaces import AxisName, Positioner
from drivers.settings import PositionerSettings
from solar.frames import Limits

log = logging.getLogger("heliocube.motion")

T = TypeVar("T")

_BETWEEN_ATTEMPTS_S = 1.0
# As old as readings may be; a shorter sleep is no reason to end anything.
_SLEPT_S = 15.0
# A positioner gives up a reference run by itself before that, and says why.
_HOMING_WITHIN_S = 900.0
# No unit takes so long to report the end of a run after its axis stands; and a blocked motor gets hot.
_HOMING_STANDS_S = 60.0
_AXES: tuple[AxisName, AxisName] = ("a", "b")


class _HomingFailedError(Exception):
    """A reference run that leaves the reference in doubt."""


class Mover:
    """Carries out moves and reference runs, one at a time.

    Parameters
    ----------
    positioner, guard
        The instrument, and the guard that looks at it and stops it.
    limits, settings, expected
        As for `Motion`.
    retries
        Told how every move ends.
    clock, publish, changed
        As for `Motion`.
    wake
        Set to ask for a look at once.
    poll_every_s
        Interval between looks at what moves.
    """

    def __init__(
        self,
        positioner: Positioner,
        guard: Guard,
        limits: Limits,
        settings: MotionSettings,
        expected: PositionerSettings,
        retries: Retries,
        clock: Clock,
        publish: Callable[[Record], None],
        changed: Callable[[], None],
        wake: asyncio.Event,
        poll_every_s: float,
    ) -> None:
        self._positioner = positioner
        self._guard = guard
        self._limits = limits
        self._settings = settings
        self._expected = expected
        self._retries = retries
        self._clock = clock
        self._publish = publish
        self._on_change = changed
        self._wake = wake
        self._poll_every_s = poll_every_s
        self._interrupted = False
        self._stow = False
        self._sleeps = SleepGauge(clock)
        self._slept_while_homing = False
        self.target: Target | None = None
        self.last_move: Move | None = None
        self.last_move_started_s = -math.inf
        self.last_homed_started_s = -math.inf

    def interrupt(self) -> None:
        """End the run that is on, if any, with a halt; for what is asked for next, only later sleeps count."""
        self._interrupted = self.target is not None or self._guard.homing
        self._sleeps = SleepGauge(self._clock)

    def is_interrupted(self) -> bool:
        """Whether the run that is on is being ended; a sleep of the machine ends a reference run.

        Hours later the person who asked for it may no longer be there.
        """
        if self._guard.homing and self._sleeps.take_s() > _SLEPT_S:
            self._interrupted = self._slept_while_homing = True
        return self._interrupted

    async def move(self, target: Target, *, stow: bool) -> None:
        """Move there, in as many attempts as the settings allow; the record of it is published."""
        self._interrupted, self._stow, self.target = False, stow, target
        start_utc_s, start_s = self._clock.utc(), self._clock.monotonic()
        self.last_move_started_s = start_s
        start = self._guard.pose
        assert start is not None  # noqa: S101 - narrowing; a move is only taken up after a look
        outcome, why = MoveOutcome.LINK_LOST, target.why
        try:
            outcome, why = await self._attempt(target, start)
        except DeviceError as error:
            self._note_outcome(outcome, error.message)
            raise
        except BaseException:
            outcome = MoveOutcome.INTERRUPTED
            raise
        finally:
            end = self._guard.pose or start
            self.target = None
            duration_s = self._clock.monotonic() - start_s
            self.last_move = Move(
                time_utc_s=start_utc_s,
                time_monotonic_s=start_s,
                duration_s=duration_s,
                from_a_deg=start.a_deg,
                from_b_deg=start.b_deg,
                target_a_deg=target.a_deg,
                target_b_deg=target.b_deg,
                end_a_deg=end.a_deg,
                end_b_deg=end.b_deg,
                outcome=outcome,
                why=why,
            )
            self._publish(self.last_move)
        self._note_outcome(outcome, why)
        self._on_change()

    def _note_outcome(self, outcome: MoveOutcome, why: str) -> None:
        if outcome is MoveOutcome.ARRIVED:
            self._retries.forget()
        elif outcome is not MoveOutcome.INTERRUPTED:
            text = f"the last move failed ({outcome}): {why}"
            level = logging.DEBUG
            if outcome is MoveOutcome.LINK_LOST:
                # The outage has its own line in the log.
                self._retries.note_link_loss(text, stow=self._stow)
            elif self._retries.note_failure(self._clock.monotonic(), text, stow=self._stow):
                level = logging.WARNING
            log.log(level, "move failed: %s", why, extra={"fields": {"outcome": outcome}})

    async def _attempt(self, target: Target, start: Pose) -> tuple[MoveOutcome, str]:
        guard = self._guard
        outcome, why = MoveOutcome.INTERRUPTED, target.why
        for attempt in range(self._settings.attempts):
            if attempt:
                if outcome is MoveOutcome.OVERSHOT:
                    # The axis may obey somebody else, and the next attempt may succeed: tell it all the same.
                    self._report(f"{why}; it was stopped")
                await self._pause()
                if guard.doubts.reference is not None:
                    # The count may have begun anew: seen from the old start, the axes would be beyond their targets.
                    start = guard.pose or start
            if guard.anomaly is not None:
                return await self._quell()
            if not guard.watch.settled:
                # The rest of the last move may begin at any moment, and a target that reaches a turning axis is lost.
                await guard.halt()
            if self.is_interrupted():
                return MoveOutcome.INTERRUPTED, target.why
            if not self._stow and self._sleeps.take_s() > _SLEPT_S:
                # The machine has slept: if the move is still wanted, control decides it anew by what is true now.
                break
            guard.note_departure(target)
            # The machine may sleep between the targets of the two axes.
            sleeps = SleepGauge(self._clock)
            try:
                # A tilted module catches the wind, so a stow lays it flat before it turns it.
                await self._positioner.move_to(target.a_deg, target.b_deg, first="b" if self._stow else "a")
                outcome, why = await self._watch_move(target, start, sleeps)
            except RefusedError as error:
                # One axis may have taken the target, or both another one.
                guard.watch.suspend_judging()
                await guard.halt()
                outcome, why = MoveOutcome.REFUSED, error.message
                await self._clear_restart_mark()
                if self.is_interrupted():
                    outcome, why = MoveOutcome.INTERRUPTED, target.why
            if outcome in (MoveOutcome.ARRIVED, MoveOutcome.INTERRUPTED) or self._is_hopeless():
                break
        return outcome, why

    async def _clear_restart_mark(self) -> None:
        """Clear the mark of a restart for a stow that was refused: until then a unit may take no target at all."""
        telemetry = self._guard.telemetry
        if self._stow and telemetry is not None and telemetry.was_reset:
            with contextlib.suppress(RefusedError):
                await self._clear_marks()

    async def _pause(self) -> None:
        """Let time pass between two attempts and watch meanwhile: an axis may begin to move by itself."""
        until_s = self._clock.monotonic() + _BETWEEN_ATTEMPTS_S
        while self._clock.monotonic() < until_s and self._guard.anomaly is None and not self.is_interrupted():
            await wait_at_most(self._wake, min(self._poll_every_s, _BETWEEN_ATTEMPTS_S))
            await self._guard.poll(moving=True)

    async def _quell(self) -> tuple[MoveOutcome, str]:
        """Stop stray motion and return how it ends the move."""
        anomaly = self._guard.anomaly
        assert anomaly is not None  # noqa: S101 - narrowing for the type checker
        return (
            MoveOutcome.INTERRUPTED if await self._guard.stop_unexplained_motion() else MoveOutcome.OVERSHOT,
            anomaly.text,
        )

    def _is_hopeless(self) -> bool:
        telemetry = self._guard.telemetry
        faulty = telemetry is not None and bool(telemetry.faults or telemetry.autonomous)
        return faulty or bool(self._guard.unexplained_motion or self._doubt_why())

    def _doubt_why(self) -> str | None:
        """Return why the move must not go on: a reference lost on the way ends all moves but a stow."""
        return None if self._stow else self._guard.doubts.reference

    async def _watch_move(self, target: Target, start: Pose, sleeps: SleepGauge) -> tuple[MoveOutcome, str]:
        guard = self._guard
        await guard.expect_move()
        watch = MoveWatch(target, start, self._limits, self._settings, self._expected, self._clock.monotonic())
        while True:
            telemetry = await guard.poll(moving=True)
            if sleeps.take_s() > _SLEPT_S:
                # After a sleep control may not want the move any more.
                self._on_change()
            if self._interrupted or telemetry.button_pressed:
                await guard.halt()
                return MoveOutcome.INTERRUPTED, target.why
            if guard.anomaly is not None:
                return await self._quell()
            if (doubt := self._doubt_why()) is not None:
                await guard.halt()
                return MoveOutcome.STALLED, doubt
            progress, why = watch.judge(telemetry, self._clock.monotonic())
            if progress is Progress.ARRIVED:
                guard.watch.note_arrival(telemetry)
                return MoveOutcome.ARRIVED, target.why
            if progress is not Progress.GOING:
                await guard.halt()
                return MoveOutcome(progress.value), why
            await wait_at_most(self._wake, self._poll_every_s)

    async def disable_autonomous_modes(self) -> None:
        """Switch off the modes in which the positioner moves by itself, then halt it: the first stops no motor."""
        try:
            await self._guard.run_guarded(self._positioner.disable_autonomy())
        except RefusedError as error:
            log.debug("own tracking: %s", error.message)
        await self._guard.halt()

    async def clear(self, shown: tuple[str, ...], gives_way: Callable[[], bool]) -> None:
        """Clear the positioner's marks, and forgive the marks and doubts that a person was shown.

        A unit may take seconds to report that it has cleared them; the wait ends when `gives_way` returns True.
        """
        guard = self._guard
        doubt = "" if guard.telemetry is None else guard.telemetry.reference_doubt
        # A doubt that came while the person's order waited was not shown, and still steers the next reference run.
        clear = partial(self._positioner.clear_faults, forgive=not doubt or doubt in shown)
        guard.clearing = True
        try:
            before = await guard.run_guarded(clear(), gives_way)
            guard.doubts.acknowledge(shown, before)
        except RefusedError as error:
            self._report(f"nothing was cleared: {'a stow came first' if gives_way() else error.message}")
            return
        finally:
            guard.clearing = False
        if self._retries.text in shown:
            self._retries.forget()
        guard.forget()
        self._on_change()

    async def home(self, *, anew: bool = False) -> None:
        """Make a reference run of both axes; only a good run of each ends the doubts about the reference.

        `anew`: the run was decided just now, so that no earlier sleep of the machine ends it.
        """
        guard, doubts = self._guard, self._guard.doubts
        # The run clears the unit's faults, and with them what they said about the count.
        faulty = guard.telemetry is not None and bool(guard.telemetry.faults)
        doubted = faulty or doubts.reference is not None
        started_s = self._clock.monotonic()
        self._interrupted = self._slept_while_homing = False
        if anew:
            self._sleeps = SleepGauge(self._clock)
        guard.homing = True
        guard.note_departure(None)
        doubts.homing_begins()
        left: str | None = NOT_FINISHED
        self._report("homing")
        self._on_change()
        try:
            await self._home_both()
            self.last_homed_started_s = started_s
            left = None
        except _HomingFailedError as error:
            await guard.halt()
            left = f"homing failed ({error}), the reference is in doubt: home it"
            self._report(f"homing failed: {error}")
        except RefusedError as error:
            await guard.halt()
            if self.is_interrupted():
                left = NOT_FINISHED if doubted else None
                remedy = ": the machine slept; give 'heliocube home' again" if self._slept_while_homing else ""
                self._report(f"homing was stopped before its end{remedy}")
            else:
                self._report(f"homing refused: {error.message}")
        finally:
            guard.homing = False
            doubts.homing_ends(left)
            self._on_change()

    async def _clear_marks(self) -> None:
        """Clear what the unit shows, and forgive nothing: only a reference run or a person may end a doubt."""
        guard = self._guard
        guard.clearing = True
        try:
            clear = partial(self._positioner.clear_faults, forgive=False)
            await guard.run_guarded(self._unless_interrupted(clear), self.is_interrupted)
            guard.doubts.note_faults_cleared()
        finally:
            guard.clearing = False

    async def _home_both(self) -> None:
        guard = self._guard
        await self._clear_marks()
        for axis in _AXES:
            await self._home_one(axis)
        await guard.halt()
        telemetry = await guard.poll(moving=False)
        if telemetry.reference_doubt:
            raise _HomingFailedError(telemetry.reference_doubt)
        guard.doubts.clear_doubts()
        self._retries.forget()
        self._report("homing finished")

    async def _home_one(self, axis: AxisName) -> None:
        guard = self._guard
        before = await guard.poll(moving=True)
        guard.watch.expect_homing(axis, before)
        home = partial(self._positioner.home, axis)
        await guard.run_guarded(self._unless_interrupted(home), self.is_interrupted)
        begun_s = self._clock.monotonic()
        while True:
            telemetry = await guard.poll(moving=True)
            self._interrupted = self._interrupted or telemetry.button_pressed
            self._refuse_to_go_on()
            if guard.anomaly is not None:
                text = guard.anomaly.text
                await guard.stop_unexplained_motion()
                raise _HomingFailedError(text)
            if not telemetry.homing:
                break
            now_s, stands_since_s = self._clock.monotonic(), guard.watch.stands_since_s
            if now_s - begun_s > _HOMING_WITHIN_S:
                raise _HomingFailedError(f"axis {axis.upper()} has not ended its reference run in time")
            if stands_since_s is not None and now_s - max(stands_since_s, begun_s) > _HOMING_STANDS_S:
                text = f"axis {axis.upper()} has not moved for {_HOMING_STANDS_S:g} s, nor ended its reference run"
                raise _HomingFailedError(text)
            await wait_at_most(self._wake, self._poll_every_s)
        # A doubt about both axes stays until the other one has been homed as well.
        known = before.reference_doubt.split("; ")
        fresh = "; ".join(text for text in telemetry.reference_doubt.split("; ") if text not in known)
        trouble = fresh or ", ".join(telemetry.faults)
        if trouble or telemetry.was_reset:
            raise _HomingFailedError(trouble or "the positioner has restarted")

    async def _unless_interrupted(self, call: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Make a call of the driver and return its result; refuse after a stop, which may come until the very call."""
        self._refuse_to_go_on()
        return await call()

    def _refuse_to_go_on(self) -> None:
        """Raise `RefusedError` after a stop, and after motion that nobody ordered."""
        if self.is_interrupted():
            raise RefusedError("positioner", "a stop came in between")
        if self._guard.unexplained_motion is not None:
            raise RefusedError("positioner", self._guard.unexplained_motion)

    def _report(self, text: str) -> None:
        log.info(text)
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "positioner", text))
