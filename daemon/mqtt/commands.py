"""What comes in: an operator's commands, carried out like those of the local interface, each with a reply."""

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from daemon.mqtt.connection import Incoming
from daemon.service.operator import CommandError
from daemon.service.operator_commands import URGENT, Command, Operators, parse, refusal_json

log = logging.getLogger("heliocube.mqtt")

_AT_ONCE = 8
# What makes things safe is not refused because a queue of wishes stands before it.
_AT_ONCE_SAFE = 64


class Commands:
    """Takes commands and replies to each.

    Parameters
    ----------
    operators
        Carry them out; the guard of every other way is behind them.
    reply
        Called with the name of the command and what came of it.
    """

    def __init__(self, operators: Operators, reply: Callable[[dict[str, Any]], None]) -> None:
        self._operators = operators
        self._reply = reply
        self._running: set[asyncio.Task[None]] = set()

    def take(self, name: str, message: Incoming) -> None:
        """Begin to carry out a command, or refuse it; needs a running loop and does not wait."""
        command: Command | None = None
        try:
            _refuse_retained(message)
            command = parse(name, message.payload, "MQTT")
            self._refuse_flood(command.wanted)
        except CommandError as error:
            log.warning("the command %s over MQTT is refused: %s", name, error)
            self._reply(refusal_json(name, None if command is None else command.identifier, str(error)))
            return
        task = asyncio.create_task(self._carry_out(command), name=f"mqtt command {command.wanted}")
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    async def run(self) -> None:
        """Rest until cancelled; then end what is being waited for."""
        try:
            await asyncio.Event().wait()
        finally:
            running = tuple(self._running)
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)

    def _refuse_flood(self, wanted: str) -> None:
        if len(self._running) >= (_AT_ONCE_SAFE if wanted in URGENT else _AT_ONCE):
            raise CommandError(f"{len(self._running)} commands are being carried out already; ask again")

    async def _carry_out(self, command: Command) -> None:
        try:
            self._reply(await self._operators.carry_out(command))
        except CommandError as error:
            self._reply(refusal_json(command.name, command.identifier, str(error)))


def _refuse_retained(message: Incoming) -> None:
    if message.retained:
        raise CommandError("a retained command is ignored, for nobody knows how old it is: publish without retain")
