"""An operator's command as text: one parser with one set of sentences, and one answer, whatever way it came.

The command line and other programs give commands over HTTP, the rest over MQTT; both hand on just what they got.
"""

import asyncio
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, NoReturn

from daemon.base.alarms.alarms import Alarms
from daemon.base.alarms.kinds import with_tracker_option
from daemon.base.json_names import DuplicateNameError, reject_duplicate_names
from daemon.base.process import CURRENT_TRACKER
from daemon.base.recurrence import RateLimit
from daemon.service.acknowledge import acknowledge
from daemon.service.command_bodies import DEFAULT_REASON, AcknowledgeBody, AutoBody, GotoBody, ModeBody, validate_body
from daemon.service.operator import Answer, CommandError, Effect, Operator
from daemon.service.tracker import Tracker
from daemon.tracker.wishes import Wishes

COMMAND_NAMES = (
    "stow",
    "snow",
    "hold",
    "stop",
    "auto",
    "goto",
    "home",
    "clear",
    "relearn",
    "maintenance",
    "mode",
    "acknowledge",
)
URGENT = ("stop", "stow", "maintenance")
LONGEST_BODY = 4096

# Only over MQTT may a command arrive late, and so tell its time: over HTTP it lasts no longer than its connection.
_LINES_OF = {"MQTT": ("time",)}
# What may be asked of all trackers at once: nobody in a hurry has to remember names.
COMMANDS_FOR_ALL = ("stop", "stow")
# How many commands one way may give at once, and then how many a second. A stop is never refused.
_AT_ONCE = 20
_PER_S, _URGENT_PER_S = 2.0, 5.0


class BodyError(CommandError):
    """What came with a command is not understood."""

    def __init__(self, sentence: str) -> None:
        super().__init__(sentence, wrong=True)


class TooManyError(CommandError):
    """More commands came over one way than are carried out."""


@dataclass(frozen=True, slots=True)
class Command:
    """One command that was understood.

    Attributes
    ----------
    name
        As it was given.
    action
        What is to be done: for ``mode`` the mode, else the name.
    channel
        Over which it came, such as ``HTTP``.
    why, by
        The reason, and who asks.
    identifier
        What the answer repeats, or None.
    time_utc_s
        When it was given, where the body says; only a command that comes over a broker may be old.
    tracker
        Which is meant, or None where it is not said.
    a_deg, b_deg
        The position of a goto; NaN for other commands.
    alarm
        Which is acknowledged, or None for all.
    shown
        For auto: the `latest` of each wish that the person was shown; None where that is not said.
    """

    name: str
    action: str
    channel: str
    why: str
    by: str
    identifier: str | None
    time_utc_s: float | None = None
    tracker: str | None = None
    a_deg: float = math.nan
    b_deg: float = math.nan
    alarm: str | None = None
    shown: dict[str, str | None] | None = None

    def with_tracker(self, trackers: Sequence[str]) -> "Command":
        """Return the command for the tracker that a query names, if any; `CommandError` if another is named besides.

        A stop is for all trackers then, as nobody can tell which was meant.
        """
        named = list(dict.fromkeys([*filter(None, (self.tracker,)), *trackers]))
        if self.action == "stop":
            named = [name for name in named if name]
            return replace(self, tracker=named[0] if len(named) == 1 else None)
        if len(named) > 1:
            first, own, other = "query" if self.tracker is None else "body", *(ascii(name)[:40] for name in named[:2])
            raise CommandError(f"the {first} names the tracker {own}, and the query {other}", wrong=True)
        return replace(self, tracker=named[0] if named else None)

    async def carry_out(self, operator: Operator) -> Answer:
        """Return what one tracker did; raises `CommandError` where the command is refused."""
        if self.action == "goto":
            return await operator.goto(self.a_deg, self.b_deg, self.why, self.by)
        if self.action == "auto":
            return await operator.auto(self.why, self.by, self._later_wish_text)
        answer: Answer = await getattr(operator, self.action)(self.why, self.by)
        return answer

    def _later_wish_text(self, wishes: Wishes) -> str | None:
        """Return in words a wish that came after this command was given, or that its giver was not shown; or None."""
        later = None if self.time_utc_s is None else wishes.describe_newer_than(self.time_utc_s)
        return later or (None if self.shown is None else wishes.describe_unshown(self.shown))


class Operators:
    """The operators of all trackers of a process: a command is carried out by the one that it names.

    Parameters
    ----------
    trackers
        The trackers of the process; none in a cube's process.
    speed
        Speed of the service's clock relative to the machine's.
    cube_alarms
        The alarms of no tracker, to be acknowledged as well; or None.
    beside
        Other trackers of the process: of the commands that come this way, only a stop that names one reaches them.
    """

    def __init__(
        self,
        trackers: Sequence[Tracker],
        speed: float,
        cube_alarms: Alarms | None = None,
        beside: Sequence[Tracker] = (),
    ) -> None:
        self._trackers = {tracker.name: tracker for tracker in (*trackers, *beside)}
        self._own_operators = {tracker.name: Operator(tracker, speed) for tracker in trackers}
        self._all_operators = self._own_operators | {tracker.name: Operator(tracker, speed) for tracker in beside}
        self._alarms = {} if cube_alarms is None else {"": cube_alarms}
        self._alarms |= {tracker.name: tracker.alarms for tracker in trackers}
        self._speed = speed
        self._clock = trackers[0].clock if trackers else None
        self._limits: dict[tuple[str, bool], RateLimit] = {}

    async def carry_out(self, command: Command) -> dict[str, Any]:
        """Return the answer as JSON; raises `CommandError` where the command is refused, by one tracker or by all.

        Raises `TooManyError` beyond twenty commands at once and then two a second (five if urgent), counted for each
        way on its own; a stop always passes.
        """
        if command.action == "acknowledge":
            self._refuse_too_many(command)
            answer = acknowledge(self._alarms, command.tracker, command.alarm, command.by, command.why)
            return answer_json(command.name, command.identifier, answer)
        if self._is_stop_for_unknown_tracker(command):
            await self._stop_all(command)
        chosen = self._operators_meant(command)
        self._refuse_too_many(command)
        if len(chosen) == 1:
            ((_, operator),) = chosen.items()
            return answer_json(command.name, command.identifier, await _carry_out_by(operator, command))
        return answer_json(
            command.name, command.identifier, await self._carry_out_by_each(self._own_operators, command)
        )

    def answer_if_stopped(self, command: Command) -> dict[str, Any] | None:
        """Return the answer to a stop for trackers that are all stopped already; None where one is not.

        Raises `CommandError` as `carry_out` does.
        """
        for_all = self._is_stop_for_unknown_tracker(command)
        chosen = self._all_operators if for_all else self._operators_meant(command)
        stops = [self._trackers[name].control.wishes.describe("stop") for name in chosen]
        if None in stops:
            return None
        if for_all:
            raise CommandError(
                f"{self._unknown_tracker_text(command)}; so the stop is for all: all are stopped", wrong=True
            )
        stopped = f"the tracker is {stops[0]}" if len(stops) == 1 else f"all {len(stops)} trackers are stopped"
        text = f"{stopped}; so many stops wait for their answers that this one does not wait for telemetry"
        return answer_json(command.name, command.identifier, Answer(Effect.NOT_SEEN, text))

    def _is_stop_for_unknown_tracker(self, command: Command) -> bool:
        return (
            command.action == "stop"
            and bool(self._own_operators)
            and command.tracker not in (None, *self._own_operators)
        )

    def _operators_meant(self, command: Command) -> dict[str, Operator]:
        if not self._own_operators:
            raise CommandError("this process reads the cube and has no tracker: ask the tracker's process")
        names = ", ".join(self._own_operators)
        if command.tracker is None:
            if len(self._own_operators) == 1 or command.action in COMMANDS_FOR_ALL:
                return self._own_operators
            how = with_tracker_option(f"heliocube {command.action}", "NAME")
            raise CommandError(
                f"'{command.action}' needs the name of a tracker: '{how}', where NAME is one of {names}", wrong=True
            )
        if command.tracker not in self._own_operators:
            raise CommandError(self._unknown_tracker_text(command), wrong=True)
        return {command.tracker: self._own_operators[command.tracker]}

    def _unknown_tracker_text(self, command: Command) -> str:
        names, meant = ", ".join(self._own_operators), ascii(command.tracker)[:40]
        if command.tracker in self._all_operators:
            return f"this is for {names}, but the body names the tracker {meant}"
        return f"there is no tracker {meant}; the trackers are {', '.join(self._all_operators)}"

    async def _stop_all(self, command: Command) -> NoReturn:
        """Stop all trackers after a stop for one that is unknown here, and say so: nobody can tell which was meant."""
        try:
            found = (await self._carry_out_by_each(self._all_operators, command)).text
        except CommandError as error:
            found = str(error)
        raise CommandError(f"{self._unknown_tracker_text(command)}; so the stop is for all: {found}", wrong=True)

    def _refuse_too_many(self, command: Command) -> None:
        if command.action == "stop" or self._clock is None:
            return
        urgent = command.action in URGENT
        per_s = _URGENT_PER_S if urgent else _PER_S
        limit = self._limits.setdefault((command.channel, urgent), RateLimit(per_s / self._speed, _AT_ONCE))
        if not limit.admit(self._clock.monotonic()):
            raise TooManyError(
                f"more than {per_s:g} commands a second came over {command.channel}; ask again in a second"
            )

    async def _carry_out_by_each(self, chosen: Mapping[str, Operator], command: Command) -> Answer:
        """Return what several trackers did at once; a refusal by one does not keep the others from doing it."""
        outcomes = await asyncio.gather(
            *(_carry_out_by(operator, command) for operator in chosen.values()), return_exceptions=True
        )
        for found in outcomes:
            if isinstance(found, BaseException) and not isinstance(found, CommandError):
                raise found
        by_name = dict(zip(chosen, outcomes, strict=True))
        refusing = [name for name, found in by_name.items() if not isinstance(found, Answer)]
        seen = {name: found.seen for name, found in by_name.items() if isinstance(found, Answer)}
        unseen = [name for name in seen if seen[name] is Effect.NOT_SEEN]
        lines = _line_per_tracker(by_name, [*refusing, *unseen])
        if len(refusing) == len(by_name):
            raise CommandError(f"NOT done by any of {len(by_name)} trackers:{lines}")
        if refusing:
            raise CommandError(f"NOT done by {len(refusing)} of {len(by_name)} trackers, {', '.join(refusing)}:{lines}")
        worst = next(each for each in (Effect.NOT_SEEN, Effect.UNDER_WAY, Effect.DONE) if each in seen.values())
        but = f", no effect seen yet at {', '.join(unseen)}" if unseen else ""
        return Answer(worst, f"all {len(by_name)} trackers{but}:{lines}")


async def _carry_out_by(operator: Operator, command: Command) -> Answer:
    """Let an operator carry out a command; log lines, and commands named in the answer, bear its tracker's name."""
    before, tracker = CURRENT_TRACKER.set(operator.log_name), operator.log_name or None
    try:
        answer = await command.carry_out(operator)
        return replace(answer, text=with_tracker_option(answer.text, tracker))
    except CommandError as error:
        raise CommandError(with_tracker_option(str(error), tracker), wrong=error.wrong) from error
    finally:
        CURRENT_TRACKER.reset(before)


def _line_per_tracker(by_name: Mapping[str, Answer | BaseException], first: Sequence[str]) -> str:
    """Return what came of a command, a line for each tracker; `first` are those that somebody has to look at."""
    width = max(map(len, by_name)) + 1
    named = [*first, *(name for name in by_name if name not in first)]
    return "".join(f"\n  {f'{name}:':<{width}}  {_sentence(by_name[name])}" for name in named)


def _sentence(outcome: Answer | BaseException) -> str:
    return outcome.text if isinstance(outcome, Answer) else str(outcome)


def answer_json(name: str, identifier: str | None, answer: Answer) -> dict[str, Any]:
    """Return what came of a command as JSON."""
    return {
        "command": name,
        "id": identifier,
        "accepted": True,
        "done": answer.done,
        "state": answer.seen.value,
        "text": answer.text,
    }


def refusal_json(name: str, identifier: str | None, sentence: str) -> dict[str, Any]:
    """Return why nothing came of a command as JSON."""
    return {
        "command": name,
        "id": identifier,
        "accepted": False,
        "done": False,
        "state": "refused",
        "text": sentence,
    }


def parse(name: str, content: bytes, way: str) -> Command:
    """Return the command of a name and a body.

    Parameters
    ----------
    name
        One of `COMMAND_NAMES`.
    content
        Empty, or a JSON object; for ``mode`` also the bare name of one; for ``stop`` anything.
    way
        Over which it came, such as ``HTTP``; it stands for the person where the body names nobody.

    Raises
    ------
    BodyError
        The body is not understood, in one sentence.
    """
    try:
        found = _object(name, content)
    except BodyError:
        # Such a stop is for all trackers: nobody can tell which was meant.
        if name != "stop":
            raise
        found = {}
    more = _LINES_OF.get(way, ())
    try:
        body = validate_body(name, found, more)
    except ValueError as error:
        raise BodyError(str(error)) from None
    place = (body.a_deg, body.b_deg) if isinstance(body, GotoBody) else (math.nan, math.nan)
    return Command(
        name=name,
        action=body.mode if isinstance(body, ModeBody) else name,
        channel=way,
        why=body.why or DEFAULT_REASON,
        by=body.by or way,
        identifier=body.id or None,
        time_utc_s=_utc_s(found["time"]) if "time" in found and name != "stop" else None,
        tracker=body.tracker or None,
        a_deg=place[0],
        b_deg=place[1],
        alarm=(body.alarm or None) if isinstance(body, AcknowledgeBody) else None,
        shown=body.shown if isinstance(body, AutoBody) else None,
    )


def _object(name: str, content: bytes) -> dict[str, Any]:
    if len(content) > LONGEST_BODY:
        raise BodyError(f"the body is longer than {LONGEST_BODY} bytes")
    if not content.strip():
        return {}
    if name == "mode" and not content.lstrip().startswith(b"{"):
        return {"mode": content.decode("ascii", "replace")}
    try:
        found = json.loads(content, object_pairs_hook=_object_with_escaped_names)
    except DuplicateNameError as error:
        raise BodyError(f"the body has {error.name} twice") from None
    except (ValueError, RecursionError):
        raise BodyError("the body is not JSON") from None
    if not isinstance(found, dict):
        raise BodyError('the body is not a JSON object, such as {"why": "maintenance"}')
    return found


def _object_with_escaped_names(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    # Half a letter (a lone surrogate) has no encoding: escape it, so that no check meets one.
    return reject_duplicate_names([(name.encode("utf-8", "backslashreplace").decode(), value) for name, value in pairs])


def _utc_s(text: str) -> float:
    try:
        time = datetime.fromisoformat(text)
        if time.tzinfo is not None:
            return time.timestamp()
    except (ValueError, OverflowError):
        pass
    raise BodyError(f'"time" must be ISO 8601 with its zone, such as 2026-06-21T10:00:00Z, not {ascii(text)[:40]}')
