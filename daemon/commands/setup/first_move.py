"""The first moves of a rig: a few degrees, one axis at a time, judged by telemetry and stopped by any key."""

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from daemon.base.clock import Clock
from daemon.rigs.first_look import watch_telemetry
from drivers.errors import DeviceError, RefusedError
from drivers.interfaces import AxisName, Positioner, Telemetry
from solar.frames import Limits

Say = Callable[[str], object]
Pressed = Callable[[], bool]
Look = Callable[[Telemetry], object]

STEP_DEG = 2.0
_STOP_TEST_DEG = 5.0
_LOOK_EVERY_S = 0.1
_STILL_S = 1.0
_BEGINS_WITHIN_S = 10.0
_MARGIN_S = 20.0
# Telemetry has tenths of a degree, and an axis yields a little when the other one moves.
_POSE_SLACK_DEG = 0.7
# How far an axis must have gone for the stop to have stopped a motion.
_UNDER_WAY_DEG = 0.3
_STOP_UNSEEN_TEXT = "the stop could not be seen in telemetry: SWITCH THE MOTORS' SUPPLY OFF"


class FirstMoveError(DeviceError):
    """The move was stopped because of telemetry or a person."""

    def __init__(self, message: str) -> None:
        super().__init__("positioner", message)


@dataclass(frozen=True, slots=True)
class Bounds:
    """The bounds by which a first move is judged.

    Attributes
    ----------
    limits
        Both angles stay inside them.
    tolerance_deg
        Distance from the target that counts as arrived.
    slowest_deg_per_s
        A slower move has failed.
    """

    limits: Limits
    tolerance_deg: float
    slowest_deg_per_s: float


@dataclass(frozen=True, slots=True)
class Leg:
    """One move: an axis on its way, and the other one, which has to stay.

    Attributes
    ----------
    axis
        The axis that moves.
    from_deg, to_deg
        Where it starts and where it is to go.
    other_deg
        Where the other axis stands.
    """

    axis: AxisName
    from_deg: float
    to_deg: float
    other_deg: float

    @property
    def targets(self) -> tuple[float, float]:
        """A and B at the end of the leg."""
        return (self.to_deg, self.other_deg) if self.axis == "a" else (self.other_deg, self.to_deg)

    @property
    def direction(self) -> str:
        """The direction of the move, for a person who watches."""
        words = ("to the west", "to the east") if self.axis == "a" else ("flatter", "steeper")
        return words[self.to_deg < self.from_deg]

    def angle(self, seen: Telemetry) -> float:
        """Return the moving axis' angle [deg]."""
        return seen.a_deg if self.axis == "a" else seen.b_deg

    def objection(self, seen: Telemetry, tolerance_deg: float) -> str | None:
        """Return a sentence on why telemetry forbids to go on, or None; an angle that is no number forbids it too."""
        angle, other = self.angle(seen), seen.b_deg if self.axis == "a" else seen.a_deg
        way = math.copysign(1.0, self.to_deg - self.from_deg)
        name, still = self.axis.upper(), "B" if self.axis == "a" else "A"
        if seen.needs_homing:
            return f"it cannot be relied on: {seen.needs_homing}"
        if seen.button_pressed:
            return "somebody presses a button on its box"
        if not (angle - self.from_deg) * way >= -_POSE_SLACK_DEG:
            went = f"from {self.from_deg:z.1f} to {angle:z.1f} deg, and not to {self.to_deg:z.1f}"
            return f"{name} went the wrong way: {went}"
        if not (angle - self.to_deg) * way <= tolerance_deg:
            return f"{name} went beyond {self.to_deg:z.1f} deg, to {angle:z.1f}"
        if not abs(other - self.other_deg) <= _POSE_SLACK_DEG:
            return f"{still} moved, to {other:z.1f} deg, where only {name} should"
        return None


def reason_not_to_move(seen: Telemetry, conflicts: tuple[str, ...], limits: Limits) -> str | None:
    """Return a sentence on why nothing may be moved from here, or None."""
    if conflicts:
        return f"it contradicts the configuration, so no move is made: {'; '.join(conflicts)}"
    if why := seen.needs_homing:
        return f"it has to be homed first, because of: {why}; 'heliocube home' does that once the service runs"
    if seen.autonomous:
        return "a mode of its own is on and may move it"
    if not _is_within_limits(limits, seen):
        where = f"A {seen.a_deg:z.1f}, B {seen.b_deg:z.1f} deg"
        return f"it stands at {where}, outside the limits {limits}; 'back' widens them"
    return None


def _is_within_limits(limits: Limits, seen: Telemetry) -> bool:
    """Tell whether the angles are within the limits, apart from the error of telemetry; NaN is not."""
    slack_deg = _POSE_SLACK_DEG
    outer = Limits(
        limits.a_min_deg - slack_deg,
        limits.a_max_deg + slack_deg,
        limits.b_min_deg - slack_deg,
        limits.b_max_deg + slack_deg,
    )
    return outer.contain(seen.a_deg, seen.b_deg)


async def first_move(
    positioner: Positioner, bounds: Bounds, clock: Clock, say: Say, pressed: Pressed, look: Look
) -> float:
    """Move A and B out and back, then A once more for a person to stop; return the slower axis' speed [deg/s].

    Parameters
    ----------
    positioner
        Not yet open; closed when this ends, and halted if it ends early.
    pressed
        Tells whether a key has been pressed.
    look
        Called with telemetry before anything moves; raises `DeviceError` if nothing may move.

    Raises
    ------
    DeviceError
        Telemetry, a person or the device was against it: the axes were halted, or the sentence says that this was not
        seen.
    """
    try:
        identity = await positioner.open()
        await positioner.halt()
        await positioner.disable_autonomy()
        start = await watch_telemetry(positioner, clock)
        why_not = reason_not_to_move(start, identity.setup_conflicts, bounds.limits)
        if why_not is not None:
            raise RefusedError("positioner", why_not)
        look(start)
        return await _legs(positioner, start, bounds, clock, say, pressed)
    finally:
        await positioner.close()


async def _legs(
    positioner: Positioner, start: Telemetry, bounds: Bounds, clock: Clock, say: Say, pressed: Pressed
) -> float:
    speeds = []
    a_deg, b_deg = bounds.limits.clip(start.a_deg, start.b_deg)
    axes: tuple[tuple[AxisName, float], ...] = (("a", a_deg), ("b", b_deg))
    for axis, here_deg in axes:
        for target_deg in (_step_target_deg(axis, here_deg, STEP_DEG, bounds.limits), here_deg):
            leg = await _from_here(positioner, axis, target_deg, bounds, pressed)
            say(f"{axis.upper()} from {leg.from_deg:z.1f} to {leg.to_deg:z.1f} deg, {leg.direction}: any key stops it")
            speeds.append(await run_leg(positioner, leg, bounds, clock, pressed))
            await _halt_if_pressed(positioner, pressed)
            say(f"  arrived, at {speeds[-1]:.2f} deg/s")
    leg = await _from_here(
        positioner, "a", _step_target_deg("a", a_deg, _STOP_TEST_DEG, bounds.limits), bounds, pressed
    )
    begins = await positioner.read_telemetry()
    say(f"now the stop: A goes to {leg.to_deg:z.1f} deg. PRESS ANY KEY on the way, when you see it move")
    await run_leg(positioner, leg, bounds, clock, pressed)
    if not pressed():
        raise FirstMoveError("arrived before a key was pressed, so the stop is not proven")
    stands = await positioner.read_telemetry()
    if not abs(stands.a_deg - begins.a_deg) >= _UNDER_WAY_DEG:
        raise FirstMoveError("the key came before the axis moved, so the stop is not proven")
    say(f"  stopped by the key: it stands at A {stands.a_deg:z.1f}, B {stands.b_deg:z.1f} deg")
    return min(speeds)


async def _from_here(
    positioner: Positioner, axis: AxisName, target_deg: float, bounds: Bounds, pressed: Pressed
) -> Leg:
    """Return the leg from where the axes stand; the other axis has to stay there."""
    await _halt_if_pressed(positioner, pressed)
    seen = await positioner.read_telemetry()
    here = bounds.limits.clip(seen.a_deg, seen.b_deg)
    from_deg, other_deg = here if axis == "a" else (here.b_deg, here.a_deg)
    return Leg(axis, from_deg, target_deg, other_deg)


async def _halt_if_pressed(positioner: Positioner, pressed: Pressed) -> None:
    """If a key was pressed, halt and raise: an axis may still move although it is within tolerance of its target."""
    if pressed():
        with _reporting_failed_halt(FirstMoveError("was stopped by a key")):
            await positioner.halt()
        raise FirstMoveError("was stopped by a key, and stands")


def _step_target_deg(axis: AxisName, here_deg: float, step_deg: float, limits: Limits) -> float:
    """Return an angle a step away, or as far as limits allow, preferably up with A, which is west, and down with B."""
    low_deg, high_deg = (limits.a_min_deg, limits.a_max_deg) if axis == "a" else (limits.b_min_deg, limits.b_max_deg)
    up_deg, down_deg = min(step_deg, high_deg - here_deg), min(step_deg, here_deg - low_deg)
    ways = (up_deg, -down_deg) if axis == "a" else (-down_deg, up_deg)
    return here_deg + max(ways, key=lambda way: round(abs(way), 3))


async def run_leg(positioner: Positioner, leg: Leg, bounds: Bounds, clock: Clock, pressed: Pressed) -> float:
    """Make one leg until it has arrived or a key is pressed, and return its speed [deg/s]; on any other end, halt.

    Raises
    ------
    DeviceError
        Telemetry was against it, or there was none. The axes stand, or the sentence says that this was not seen.
    """
    try:
        await positioner.move_to(*leg.targets, first=leg.axis)
        return await _watch_leg(positioner, leg, bounds, clock, pressed)
    except BaseException as error:
        with _reporting_failed_halt(error):
            await positioner.halt()
        raise


@contextlib.contextmanager
def _reporting_failed_halt(first: BaseException) -> Iterator[None]:
    try:
        yield
    except DeviceError as error:
        raise FirstMoveError(f"{first}; then {error.message}; {_STOP_UNSEEN_TEXT}") from error


async def _watch_leg(positioner: Positioner, leg: Leg, bounds: Bounds, clock: Clock, pressed: Pressed) -> float:
    begin_s = clock.monotonic()
    latest_s = begin_s + abs(leg.to_deg - leg.from_deg) / bounds.slowest_deg_per_s + _MARGIN_S
    track = _MotionTimes(begin_s)
    while True:
        await asyncio.sleep(_LOOK_EVERY_S)
        seen, now_s = await positioner.read_telemetry(), clock.monotonic()
        track.note(seen, now_s)
        if pressed():
            await positioner.halt()
            return track.speed(leg)
        objection = leg.objection(seen, bounds.tolerance_deg)
        if objection is not None:
            raise FirstMoveError(f"{objection}; it was stopped")
        if abs(leg.angle(seen) - leg.to_deg) <= bounds.tolerance_deg and now_s - track.last_s >= _STILL_S:
            return track.speed(leg)
        if track.first_s is None and now_s > begin_s + _BEGINS_WITHIN_S:
            raise FirstMoveError("took the target and did not move; is the motors' supply on?")
        if now_s > latest_s:
            raise FirstMoveError(f"did not arrive: {leg.axis.upper()} stands at {leg.angle(seen):z.1f} deg")


class _MotionTimes:
    """When motion began and ended, by the drive's counts."""

    def __init__(self, begin_s: float) -> None:
        self.first_s: float | None = None
        self.last_s = begin_s
        self._start: Telemetry | None = None
        self._seen: Telemetry | None = None

    def note(self, seen: Telemetry, now_s: float) -> None:
        last = self._seen
        self._start, self._seen = self._start or seen, seen
        if last is not None and (seen.position_a, seen.position_b) != (last.position_a, last.position_b):
            self.first_s, self.last_s = self.first_s or now_s - _LOOK_EVERY_S, now_s

    def speed(self, leg: Leg) -> float:
        """Return the speed of the leg's axis [deg/s], 0 if it was not seen to move."""
        if self.first_s is None or self._start is None or self._seen is None:
            return 0.0
        return abs(leg.angle(self._seen) - leg.angle(self._start)) / (self.last_s - self.first_s)
