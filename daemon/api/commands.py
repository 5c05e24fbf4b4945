"""The operator's commands, and what the tracker did upon them, from its own telemetry."""

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass

from daemon.control import Control
from daemon.motion import Motion
from daemon.records import Event, Mode
from daemon.service import Service
from drivers.errors import DeviceError

log = logging.getLogger("heliocube.operator")

_WAIT_S = 3.0
_LOOK_EVERY_S = 0.02


class CommandError(Exception):
    """A command was not carried out; the message is one sentence.

    Parameters
    ----------
    sentence
        Why, and what to do.
    wrong
        True where the command itself was at fault, False where the state of the tracker was.
    """

    def __init__(self, sentence: str, *, wrong: bool = False) -> None:
        super().__init__(sentence)
        self.wrong = wrong


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a command.

    Attributes
    ----------
    done
        Whether its effect was seen in the telemetry before the wait ended.
    text
        What the tracker did, in a sentence.
    """

    done: bool
    text: str


class Operator:
    """Carries commands to control and to motion, and waits until their effect can be seen.

    Every command raises `CommandError` when it is not carried out.

    Parameters
    ----------
    service
        Whose tracker is commanded.
    speed
        How many times as fast as the machine's the service's clock runs: nobody at a terminal waits longer for it.
    """

    def __init__(self, service: Service, speed: float) -> None:
        self._service = service
        self._speed = speed

    async def stow(self, why: str) -> Answer:
        """Go to the stow position and stay; a move to anywhere else is stopped first, before anything else."""
        control, motion = self._note("stow", why)
        stopping = motion.moving and control.mode is not Mode.STOW
        control.stow(why)
        lost = await _send_stop(motion) if stopping else None
        control.tick()
        safety = self._service.settings.safety
        done = await self._until(lambda: self._goes_to(safety.stow_a_deg, safety.stow_b_deg))
        return Answer(done and lost is None, self._seen())

    async def hold(self, why: str) -> Answer:
        """Stay here; a move in progress is stopped."""
        self._refuse_in_stow("hold")
        control, motion = self._note("hold", why)
        asked_s = self._service.clock.monotonic()
        control.hold(why)
        control.tick()
        done = await self._until(lambda: _rests(motion, asked_s))
        return Answer(done and control.mode is Mode.HOLD, self._seen())

    async def stop(self, why: str) -> Answer:
        """Stop the axes at once and keep them stopped until 'auto', even from a stow."""
        control, motion = self._note("stop", why)
        asked_s, heading = self._service.clock.monotonic(), motion.target
        try:
            await control.stop(why)
            lost = None
        except DeviceError as error:
            lost = str(error)
        control.tick()
        if lost is not None:
            raise CommandError(f"stop could not be sent, and is sent as soon as the positioner answers: {lost}")
        done = await self._until(lambda: _rests(motion, asked_s))
        if done and heading is not None:
            way = f"stopped on the way to A {heading.a_deg:+.1f}, B {heading.b_deg:.1f} deg; "
            return Answer(done, way + self._seen())
        return Answer(done, self._seen())

    async def goto(self, a_deg: float, b_deg: float, why: str) -> Answer:
        """Go to a position inside the limits and hold there."""
        limits = self._service.settings.limits.limits()
        if not limits.contain(a_deg, b_deg):
            raise CommandError(f"A {a_deg:g}, B {b_deg:g} deg is outside the limits ({limits})", wrong=True)
        self._refuse_in_stow("goto")
        _, motion = self._tracker()
        if obstacle := _obstacle(motion):
            raise CommandError(f"the tracker cannot go anywhere: {obstacle}")
        if motion.homing:
            raise CommandError("the tracker is homing and goes nowhere before its end; 'heliocube stop' ends it")
        control, motion = self._note(f"goto A {a_deg:g}, B {b_deg:g} deg", why)
        control.goto(a_deg, b_deg, why)
        control.tick()
        done = await self._until(lambda: self._goes_to(a_deg, b_deg))
        return Answer(done, self._seen())

    async def auto(self, why: str) -> Answer:
        """End hold and stow that an operator asked for."""
        control, _ = self._note("auto", why)
        control.auto()
        control.tick()
        return Answer(done=True, text=self._seen())

    async def home(self, why: str) -> Answer:
        """Start a reference run of both axes."""
        self._refuse_in_stow("home")
        self._require_telemetry("homed")
        control, motion = self._note("home", why)
        control.home()
        done = await self._until(lambda: motion.homing)
        return Answer(done, self._seen())

    async def clear(self, why: str) -> Answer:
        """Clear latched faults and doubts about the reference."""
        self._require_telemetry("cleared of faults")
        control, motion = self._note("clear faults", why)
        control.clear_faults()
        done = await self._until(lambda: _obstacle(motion) is None)
        control.tick()
        return Answer(done, self._seen())

    async def relearn(self, why: str) -> Answer:
        """Forget the albedo and the gains that the law `optimal` has learned."""
        control, _ = self._tracker()
        if control.optimal is None:
            law = self._service.settings.law.name
            raise CommandError(f"there is nothing to forget: the law {law} learns nothing, only optimal does")
        self._note("relearn", why)
        control.optimal.relearn()
        return Answer(done=True, text="albedo and gains are learned anew")

    def _tracker(self) -> tuple[Control, Motion]:
        control, motion = self._service.control, self._service.motion
        if control is None or motion is None:
            raise CommandError("this is the cube's process and has no tracker: ask that of the tracker")
        return control, motion

    def _note(self, command: str, why: str) -> tuple[Control, Motion]:
        control, motion = self._tracker()
        clock = self._service.clock
        log.info("%s: %s", command, why)
        self._service.bus.publish(Event(clock.utc(), clock.monotonic(), "operator", f"{command}: {why}"))
        return control, motion

    def _refuse_in_stow(self, command: str) -> None:
        control, _ = self._tracker()
        if control.mode is Mode.STOW:
            raise CommandError(
                f"no {command} while the tracker is stowed ({control.why}): 'heliocube auto' ends a stow that was"
                " asked for; one for the wind ends with the wind"
            )

    def _require_telemetry(self, what: str) -> None:
        _, motion = self._tracker()
        if not motion.connected:
            raise CommandError(f"the tracker cannot be {what}: {_obstacle(motion)}")

    async def _until(self, seen: Callable[[], bool]) -> bool:
        clock = self._service.clock
        deadline_s = clock.monotonic() + _WAIT_S * self._speed
        while not seen():
            if clock.monotonic() >= deadline_s:
                return False
            await asyncio.sleep(_LOOK_EVERY_S * self._speed)
        return True

    def _goes_to(self, a_deg: float, b_deg: float) -> bool:
        _, motion = self._tracker()
        if motion.target is not None:
            return (motion.target.a_deg, motion.target.b_deg) == (a_deg, b_deg)
        tolerance_deg, pose = self._service.settings.motion.tolerance_deg, motion.pose
        if pose is None or not motion.connected or motion.moving:
            return False
        return abs(pose.a_deg - a_deg) <= tolerance_deg and abs(pose.b_deg - b_deg) <= tolerance_deg

    def _seen(self) -> str:
        """Return where the tracker is, what it does, and in which mode, as telemetry and control have it."""
        control, motion = self._tracker()
        mode = f"mode {control.mode}: {control.why}"
        if motion.pose is None or not motion.connected:
            return f"the tracker does not answer ({_obstacle(motion)}); {mode}"
        where = f"A {motion.pose.a_deg:+.1f}, B {motion.pose.b_deg:.1f} deg"
        if motion.homing:
            return f"homing, now at {where}; {mode}"
        if motion.target is not None:
            target = motion.target
            return f"moving to A {target.a_deg:+.1f}, B {target.b_deg:.1f} deg, now at {where}; {mode}"
        return f"standing at {where}; {mode}"


async def _send_stop(motion: Motion) -> str | None:
    """Send stop at once; return why that was not possible."""
    try:
        await motion.stop()
    except DeviceError as error:
        return str(error)
    return None


def _rests(motion: Motion, since_s: float) -> bool:
    pose = motion.pose
    return not motion.moving and pose is not None and pose.time_monotonic_s >= since_s


def _obstacle(motion: Motion) -> str | None:
    if motion.connected:
        return motion.blocked or motion.doubt
    return motion.outage.reason or "the positioner has not answered yet"
