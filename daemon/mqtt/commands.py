"""What comes in: an operator's commands, carried out like those of the local interface, each with a reply."""

import asyncio
import logging
from collections import Counter
from collections.abc import Callable
from typing import Any

from daemon.base.clock import Clock
from daemon.base.recurrence import LogBudget, RateLimit
from daemon.config.links import MqttSettings
from daemon.mqtt.connection import Incoming
from daemon.mqtt.replay_guard import ReplayGuard
from daemon.service.operator import CommandError
from daemon.service.operator_commands import URGENT, Command, Operators, parse, refusal_json

log = logging.getLogger("heliocube.mqtt")

# Each kind has its own limit, so that a queue of wishes does not refuse a command that makes things safe. A stop is
# never refused: above its limit, a stop waits for no effect if the tracker is stopped already.
_AT_ONCE = {"wish": 8, "safe": 64, "stop": 64}
# More replies than this are not sent, because telemetry would have to wait for them.
_REPLIES_PER_S, _REPLIES_AT_ONCE = 10.0, 50
_SETTLE_EVERY_S = 60.0


class Commands:
    """Takes commands and replies to each, except in a flood.

    Parameters
    ----------
    operators
        Carry them out, with the same checks as for commands that come in by other ways.
    reply
        Called with the answer as one JSON object, which has the name of the command.
    settings
        Whether a command must bear a time, and how old it may be.
    clock
        The service's time.
    speed
        The clock runs this many times as fast as the machine's.
    """

    def __init__(
        self,
        operators: Operators,
        reply: Callable[[dict[str, Any]], None],
        settings: MqttSettings,
        clock: Clock,
        speed: float = 1.0,
    ) -> None:
        self._operators = operators
        self._reply = reply
        self._clock = clock
        self._speed = speed
        self._dates = ReplayGuard(settings, clock)
        self._budget = LogBudget("commands over MQTT are refused")
        # A limit for each kind, so that a person who stops the tracker in a flood of wishes reads that it stands.
        self._reply_limits = {kind: RateLimit(_REPLIES_PER_S / speed, _REPLIES_AT_ONCE) for kind in _AT_ONCE}
        self._running: set[asyncio.Task[None]] = set()
        # How many of each kind wait for their effect. Counted here, as a count of all tasks at each command of a flood
        # would take too long.
        self._waiting: Counter[str] = Counter()

    def take(self, name: str, message: Incoming) -> None:
        """Begin to carry out a command, or refuse it; needs a running loop and does not wait."""
        command: Command | None = None
        try:
            _refuse_retained(message)
            _refuse_empty(message)
            command = parse(name, message.payload, "MQTT")
            # Before the date is checked: a command that is refused for want of room is not remembered, and may be given
            # again.
            room = self._has_room_for(command.action)
            _refuse_overdue(message, command)
            self._dates.check(command)
        except CommandError as error:
            self._refuse(name, None if command is None else command.identifier, error)
            return
        work = self._carry_out(command) if room else self._stop_unless_stopped(command)
        task = asyncio.create_task(work, name=f"mqtt command {command.action}")
        self._running.add(task)
        task.add_done_callback(self._running.discard)
        if room:
            kind = _kind(command.action)
            self._waiting[kind] += 1
            task.add_done_callback(lambda _: self._waiting.subtract((kind,)))

    async def run(self) -> None:
        """Report when a flood is over, until cancelled; then end the commands that still wait for their effect."""
        try:
            while True:
                await asyncio.sleep(_SETTLE_EVERY_S * self._speed)
                self._log(self._budget.poll_flood_summary(self._clock.monotonic()))
        finally:
            running = tuple(self._running)
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)

    def _has_room_for(self, wanted: str) -> bool:
        """Return whether a command may wait for its effect; if not, refuse it unless it is a stop."""
        kind = _kind(wanted)
        room = self._waiting[kind] < _AT_ONCE[kind]
        if not room and kind != "stop":
            raise CommandError(f"{len(self._running)} commands are being carried out already; ask again")
        return room

    async def _stop_unless_stopped(self, command: Command) -> None:
        """Carry out a stop if a tracker is not stopped yet; otherwise other commands wait for the same effect already.

        This is looked at when its turn comes, so that an `auto` before it has ended the stop that was in force.
        """
        try:
            answer = self._operators.answer_if_stopped(command)
        except CommandError as error:
            self._refuse(command.name, command.identifier, error)
            return
        if answer is None:
            await self._carry_out(command)
        else:
            self._answer(answer, "stop")

    async def _carry_out(self, command: Command) -> None:
        try:
            answer = await self._operators.carry_out(command)
        except CommandError as error:
            self._refuse(command.name, command.identifier, error)
        else:
            self._answer(answer, _kind(command.action))

    def _refuse(self, name: str, identifier: str | None, error: CommandError) -> None:
        # With several trackers the sentence has a line for each, and the log gets one line.
        sentence = " ".join(str(error).split())
        self._log(self._budget.spend(self._clock.monotonic(), f"the command {name} over MQTT is refused: {sentence}"))
        self._answer(refusal_json(name, identifier, str(error)), _kind(name))

    def _answer(self, found: dict[str, Any], kind: str) -> None:
        if self._reply_limits[kind].admit(self._clock.monotonic()):
            self._reply(found)

    def _log(self, line: str) -> None:
        if line:
            log.warning("%s", line)


def _kind(wanted: str) -> str:
    if wanted == "stop":
        return "stop"
    return "safe" if wanted in URGENT else "wish"


def _refuse_retained(message: Incoming) -> None:
    if message.retained:
        raise CommandError("a retained command is ignored, because its age is not known: publish without retain")


def _refuse_overdue(message: Incoming, command: Command) -> None:
    """Refuse a command that was given while the service stood still: its sender saw the service offline."""
    if message.overdue and command.time_utc_s is None and command.action != "stop":
        raise CommandError(
            "it was read only after the broker had given the connection up, so its age is not known: give it again"
        )


def _refuse_empty(message: Incoming) -> None:
    """Refuse the message that clears a retained command: it comes as an empty message that is not retained."""
    if not message.payload.strip():
        raise CommandError("an empty message is not a command, because it is how a retained one is cleared: publish {}")
