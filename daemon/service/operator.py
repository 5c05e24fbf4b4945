"""The operator's commands, and what the tracker then did, by its own telemetry."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum

from daemon.base.records import Event, Mode, Pose, Target
from daemon.motion.motion import Motion
from daemon.service.tracker import Tracker
from daemon.tracker.wishes import Wishes
from drivers.errors import DeviceError, RefusedError

log = logging.getLogger("heliocube.operator")

# A stop shows at once; a move in another direction is first stopped, and turns round.
_WAIT_S = 3.0
_WAIT_FOR_MOTION_S = 6.0
# A unit that sends its status every 3.24 s shows only in the second one that its marks are cleared, which a reference
# run does first. The command line and the dashboard wait 15 s for an answer.
_WAIT_FOR_STATUS_S = 12.0
_LOOK_EVERY_S = 0.02
# A disk at work takes milliseconds; a person is not kept waiting for a bad one.
_WAIT_FOR_DISK_S = 0.4
# Telemetry tells tenths of a degree.
_NEARER_DEG = 0.15
# A stop that comes so soon after another one, which is in force, has been sent already.
_SAME_STOP_S = 0.2
_MOST_REASONS_SHOWN = 2


class CommandError(Exception):
    """A command was not carried out; the message is one sentence, and for several trackers a line each after it.

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


class Effect(StrEnum):
    """What the telemetry has shown of a command's effect before the answer."""

    DONE = "done"
    UNDER_WAY = "under-way"
    NOT_SEEN = "not-seen"


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a command.

    Attributes
    ----------
    seen
        ``done``: it has arrived, or stands; ``under-way``: it is seen to move there, or to home; ``not-seen``: neither.
    text
        What the tracker did, in a sentence; for several trackers at once a line each, failures first.
    """

    seen: Effect
    text: str

    @property
    def done(self) -> bool:
        """Whether the telemetry has shown the whole effect."""
        return self.seen is Effect.DONE


class Operator:
    """Carries commands to control and to motion, and waits until their effect can be seen.

    Every command raises `CommandError` when it is not carried out. `why` and `by` are one line each: the reason, and
    the person, for the records.

    Parameters
    ----------
    tracker
        The tracker that is commanded.
    speed
        Speed of the service's clock relative to the machine's: a person waits by the machine's clock.
    """

    def __init__(self, tracker: Tracker, speed: float) -> None:
        self.log_name = tracker.log_name
        self._tracker = tracker
        self._control, self._motion = tracker.control, tracker.motion
        self._clock = tracker.clock
        self._speed = speed
        self._stop_sent_s = -math.inf

    async def stop(self, why: str, by: str = "") -> Answer:
        """Stop the axes at once and keep them stopped until 'auto', even from a stow."""
        control, motion = self._control, self._motion
        now_s = self._clock.monotonic()
        if control.wishes.stop is not None and now_s - self._stop_sent_s < _SAME_STOP_S * self._speed:
            before = control.wishes
            if control.join_stop(why, by):
                self._note("stop", why, by)
            seen = await self._wait_until_seen(lambda: Effect.DONE if _is_standing(motion, now_s) else None)
            return await self._answer(seen, self._describe_tracker(), before)
        return await self._stop_and_answer("stop", control.stop(why, by), motion.target, why, by)

    async def maintenance(self, why: str, by: str = "") -> Answer:
        """Stop the axes, keep them still and the alarms silent until 'auto'."""
        control, motion = self._control, self._motion
        with _as_command_errors():
            control.refuse_if_stopped("maintenance")
        return await self._stop_and_answer("maintenance", control.maintenance(why, by), motion.target, why, by)

    async def _stop_and_answer(
        self, name: str, command: Awaitable[None], heading: Target | None, why: str, by: str
    ) -> Answer:
        """Send the stop first; write and report it afterwards."""
        control, motion = self._control, self._motion
        asked_s, before, lost = self._clock.monotonic(), control.wishes, None
        try:
            await command
            self._stop_sent_s = asked_s
        except DeviceError as error:
            # If the link is down, the last try to reopen it tells why; the command's own error tells only that it is.
            lost = motion.outage.reason if motion.outage.is_down else str(error)
        self._note(name, why, by)
        control.tick()
        if lost is not None:
            noted = "" if name == "stop" else f"{name} is noted, but "
            unsent = f"{noted}stop could not be sent, and is sent as soon as the positioner answers: {lost}"
            raise CommandError(f"{unsent}{before.replaced_note(control.wishes, unsent)}{await self._unsaved_clause()}")
        seen = await self._wait_until_seen(lambda: Effect.DONE if _is_standing(motion, asked_s) else None)
        way = ""
        if seen is Effect.DONE and heading is not None:
            way = f"stopped on the way to A {heading.a_deg:+z.1f}, B {heading.b_deg:z.1f} deg; "
        return await self._answer(seen, f"{way}{self._describe_tracker()}", before)

    async def stow(self, why: str, by: str = "") -> Answer:
        """Go to the stow position and stay; a move to anywhere else is stopped first, before anything else."""
        control, motion = self._control, self._motion
        with _as_command_errors():
            control.refuse_if_stopped("stow")
        if motion.moving and control.mode is not Mode.STOW:
            await _try_to_stop(motion)
        safety, before = self._tracker.settings.safety, control.wishes
        with _as_command_errors():
            control.stow(why, by)
        self._note("stow", why, by)
        control.tick()
        return await self._wait_for_approach(safety.stow_a_deg, safety.stow_b_deg, before)

    async def snow(self, why: str, by: str = "") -> Answer:
        """Go to the snow position and stay; a stow goes before it."""
        control = self._control
        before = control.wishes
        with _as_command_errors():
            control.snow(why, by)
        self._note("snow", why, by)
        control.tick()
        settings = self._tracker.settings
        place = settings.limits.limits().clip(settings.safety.snow_a_deg, settings.safety.snow_b_deg)
        return await self._wait_for_approach(place.a_deg, place.b_deg, before)

    async def hold(self, why: str, by: str = "") -> Answer:
        """Stay here; a move in progress is stopped."""
        control, motion = self._control, self._motion
        asked_s, before = self._clock.monotonic(), control.wishes
        with _as_command_errors():
            control.hold(why, by)
        self._note("hold", why, by)
        control.tick()
        if control.mode is not Mode.STOW and not motion.is_homing_or_queued:
            # Even a tracker at rest is polled once more. A stow or a reference run goes before a hold.
            motion.request_stop()

        def seen() -> Effect | None:
            if motion.homing:
                return Effect.UNDER_WAY
            return Effect.DONE if control.mode is Mode.HOLD and _is_standing(motion, asked_s) else None

        return await self._answer(await self._wait_until_seen(seen), self._describe_tracker(), before)

    async def goto(self, a_deg: float, b_deg: float, why: str, by: str = "") -> Answer:
        """Go to a position inside the limits and hold there."""
        control, motion = self._control, self._motion
        before = control.wishes
        with _as_command_errors():
            control.check_goto(a_deg, b_deg)
            if motion.is_homing_or_queued:
                raise CommandError(
                    "the tracker is on a reference run and takes no target until it has ended; 'heliocube stop' ends it"
                )
            if obstacle := _obstacle(motion):
                raise CommandError(f"the tracker cannot go anywhere: {obstacle}")
            control.goto(a_deg, b_deg, why, by)
        self._note(f"goto A {a_deg:g}, B {b_deg:g} deg", why, by)
        control.tick()
        return await self._wait_for_approach(a_deg, b_deg, before)

    async def auto(self, why: str, by: str = "", later: Callable[[Wishes], str | None] = lambda _: None) -> Answer:
        """End all that persons asked for: stop, maintenance, stow, snow, hold and goto; nothing if one came later."""
        control = self._control
        before = control.wishes
        if (kept := later(before)) is not None:
            raise CommandError(
                f"auto was given before the wish that it would end, so give it again; the tracker is {kept}"
            )
        control.auto()
        self._note("auto", why, by)
        control.tick()
        ended = "; ".join(before.describe_ended(control.wishes))
        return await self._answer(Effect.DONE, f"{self._describe_tracker()}{f'; released: {ended}' if ended else ''}")

    async def home(self, why: str, by: str = "") -> Answer:
        """Start a reference run of both axes."""
        control, motion = self._control, self._motion
        with _as_command_errors():
            control.check_home()
            self._require_telemetry("homed")
            control.home()
        asked_s, begin = self._clock.monotonic(), motion.pose
        self._note("home", why, by)

        def seen() -> Effect | None:
            nonlocal begin
            if motion.last_homed_started_s >= asked_s:
                return Effect.DONE
            telemetry, pose = motion.telemetry, motion.pose
            if not motion.homing or telemetry is None or pose is None or telemetry.time_monotonic_s < asked_s:
                # A move that is on is stopped before the run begins.
                begin = pose
                return None
            # An axis that stands at its end switch first leaves it, which the unit calls a move.
            moves = begin is not None and _largest_axis_offset_deg(pose, begin) >= _NEARER_DEG
            return Effect.UNDER_WAY if telemetry.homing or moves else None

        return Answer(await self._wait_until_seen(seen, _WAIT_FOR_STATUS_S), self._describe_tracker())

    async def clear(self, why: str, by: str = "") -> Answer:
        """Clear the faults and doubts that are shown now; what came unseen or comes later stays.

        A person who clears has looked: the alarms that wait for that are acknowledged.
        """
        control, motion = self._control, self._motion
        with _as_command_errors():
            control.refuse_if_stopped("clear")
            self._require_telemetry("cleared of faults")
            shown, asked_s = control.clear_faults(), self._clock.monotonic()
        self._note("clear faults", why, by)
        self._tracker.alarms.acknowledge(by or "clear", why="clear", latched=True)

        def seen() -> Effect | None:
            looked = motion.telemetry is not None and motion.telemetry.time_monotonic_s >= asked_s
            return Effect.DONE if looked and not set(shown) & set(motion.concerns) else None

        found = await self._wait_until_seen(seen, _WAIT_FOR_STATUS_S)
        control.tick()
        forgiven = f"forgiven: {'; '.join(shown)}" if shown else "nothing was shown that could be cleared"
        return Answer(found, f"{forgiven if found is Effect.DONE else 'not cleared yet'}; {self._describe_tracker()}")

    async def relearn(self, why: str, by: str = "") -> Answer:
        """Forget what the law has learned of the site."""
        control, shadow = self._control, self._tracker.shadow
        with _as_command_errors():
            control.refuse_if_stopped("relearn")
        if control.pointing.law.learned is None and (shadow is None or shadow.albedo is None):
            raise CommandError(f"there is nothing to forget: the law {control.pointing.chosen.name} learns nothing")
        self._note("relearn", why, by)
        control.pointing.relearn()
        if shadow is not None:
            shadow.relearn()
        return Answer(Effect.DONE, "the law has forgotten the site and learns it again")

    def _note(self, command: str, why: str, by: str) -> None:
        text, now_s = f"{command}: {why}{f' ({by})' if by else ''}", self._clock.monotonic()
        self._tracker.log_command(text)
        self._tracker.publish(Event(self._clock.utc(), now_s, "operator", text))

    def _require_telemetry(self, what: str) -> None:
        motion = self._motion
        if not motion.connected:
            raise CommandError(f"the tracker cannot be {what}: {_obstacle(motion)}")

    async def _wait_for_approach(self, a_deg: float, b_deg: float, before: Wishes) -> Answer:
        """Wait until the tracker is seen to stand at a place or to come nearer to it."""
        motion = self._motion
        approach = _Approach(motion, Target(a_deg, b_deg, ""), self._tracker.settings.motion.tolerance_deg)
        found = await self._wait_until_seen(approach.seen, _WAIT_FOR_MOTION_S)
        return await self._answer(found, self._describe_tracker(), before)

    async def _answer(self, seen: Effect, text: str, before: Wishes | None = None) -> Answer:
        """Return what came of a command that changes what is kept, and whether a restart would forget it."""
        beside = "" if before is None else before.replaced_note(self._control.wishes, text)
        return Answer(seen, f"{text}{beside}{await self._unsaved_clause()}")

    async def _unsaved_clause(self) -> str:
        """Give the disk a moment, and return what it has not taken by then, as the end of an answer."""
        folder = self._tracker.folder
        await self._wait_until_seen(lambda: None if folder.is_writing else Effect.DONE, _WAIT_FOR_DISK_S)
        if self._tracker.unsaved_state_text is not None:
            return f"; not kept: {self._tracker.unsaved_state_text}"
        return "" if folder.unsaved is None else f"; not kept yet: {folder.unsaved}"

    async def _wait_until_seen(self, seen: Callable[[], Effect | None], within_s: float = _WAIT_S) -> Effect:
        clock = self._clock
        deadline_s = clock.monotonic() + within_s * self._speed
        while (found := seen()) is None:
            if clock.monotonic() >= deadline_s:
                return Effect.NOT_SEEN
            await asyncio.sleep(_LOOK_EVERY_S * self._speed)
        return found

    def _describe_tracker(self) -> str:
        """Return where the tracker is, what it does, and in which mode, as telemetry and control have it."""
        control, motion = self._control, self._motion
        mode = f"mode {control.mode}: {control.why}"
        if motion.pose is None or not motion.connected:
            return f"the tracker does not answer ({_obstacle(motion)}); {mode}"
        where = f"A {motion.pose.a_deg:+z.1f}, B {motion.pose.b_deg:z.1f} deg"
        if motion.homing:
            return f"homing, now at {where}; {mode}"
        if (target := motion.heading) is not None:
            return f"moving to A {target.a_deg:+z.1f}, B {target.b_deg:z.1f} deg, now at {where}; {mode}"
        return f"{'moving' if motion.stands_since_s is None else 'standing'} at {where}; {mode}"


class _Approach:
    """Watches a tracker come nearer to a place."""

    def __init__(self, motion: Motion, place: Target, tolerance_deg: float) -> None:
        self._motion = motion
        self._place = place
        self._tolerance_deg = tolerance_deg
        self._farthest_deg = self._distance_deg()

    def seen(self) -> Effect | None:
        """Return what the latest telemetry shows, or None for nothing yet."""
        motion = self._motion
        if motion.pose is None or not motion.connected:
            return None
        if motion.target is None:
            near = not motion.homing and _largest_axis_offset_deg(motion.pose, self._place) <= self._tolerance_deg
            return Effect.DONE if near and motion.stands_since_s is not None else None
        distance_deg = self._distance_deg()
        self._farthest_deg = max(self._farthest_deg, distance_deg)
        heads = (motion.target.a_deg, motion.target.b_deg) == (self._place.a_deg, self._place.b_deg)
        return Effect.UNDER_WAY if heads and distance_deg <= self._farthest_deg - _NEARER_DEG else None

    def _distance_deg(self) -> float:
        pose, place = self._motion.pose, self._place
        return 0.0 if pose is None else abs(pose.a_deg - place.a_deg) + abs(pose.b_deg - place.b_deg)


@contextmanager
def _as_command_errors() -> Iterator[None]:
    """Turn what control refuses into a sentence for the operator."""
    try:
        yield
    except RefusedError as error:
        raise CommandError(error.message) from None
    except ValueError as error:
        raise CommandError(str(error), wrong=True) from None


async def _try_to_stop(motion: Motion) -> None:
    """Send stop at once. Motion reports a link that is lost; that is no reason to give the command up."""
    try:
        await motion.stop()
    except DeviceError as error:
        log.warning("stop could not be sent: %s", error)


def _is_standing(motion: Motion, asked_s: float) -> bool:
    """Whether telemetry from after a command shows both axes unmoved, and about to stay where they are."""
    telemetry, stands_s = motion.telemetry, motion.stands_since_s
    # A reference run of the unit's own shows in its destinations before an axis has turned by more than its jitter.
    if telemetry is None or stands_s is None or motion.moving or telemetry.aims_home:
        return False
    return telemetry.time_monotonic_s >= asked_s


def _largest_axis_offset_deg(pose: Pose, place: Target | Pose) -> float:
    return max(abs(pose.a_deg - place.a_deg), abs(pose.b_deg - place.b_deg))


def _obstacle(motion: Motion) -> str:
    """Return why it cannot move, empty if it can; only the first reasons, for nobody reads many in a sentence."""
    if not motion.connected:
        return motion.outage.reason or "the positioner has not answered yet"
    reasons = (motion.blocked or motion.doubt or "").split("; ")
    more = len(reasons) - _MOST_REASONS_SHOWN
    shown = "; ".join(reasons[:_MOST_REASONS_SHOWN])
    return f"{shown}; and {more} more, which 'heliocube status' shows" if more > 0 else shown
