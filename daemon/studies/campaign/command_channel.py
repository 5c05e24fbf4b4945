"""How a person's commands reach a service: by calls, in the process."""

import asyncio
import json
from dataclasses import dataclass
from typing import Protocol

from daemon.service.operator import Operator
from daemon.service.operator_commands import Operators, parse
from daemon.service.service import Service


@dataclass(frozen=True, slots=True)
class CommandReply:
    """The answer to a command: whether all of it is said to be done, and a sentence."""

    done: bool
    text: str


class CommandChannel(Protocol):
    """A way for commands to a service. Raises `daemon.service.operator.CommandError` if a command is refused."""

    def has(self, name: str) -> bool:
        """Tell whether there is a command."""

    async def give(
        self, service: Service, name: str, value: tuple[float, ...], why: str, place: int | None = 0
    ) -> CommandReply:
        """Give a command to the tracker at a place, or one to all, and wait for its answer."""


class DirectCommandChannel:
    """Calls in the process."""

    def has(self, name: str) -> bool:
        """Tell whether there is a command."""
        return hasattr(Operator, name)

    async def give(
        self, service: Service, name: str, value: tuple[float, ...], why: str, place: int | None = 0
    ) -> CommandReply:
        """Give a command to the tracker at a place, or one to all, and wait for its answer."""
        if place is None:
            command = parse(name, json.dumps({"why": why}).encode(), "campaign")
            found = await Operators(service.trackers, 1.0).carry_out(command)
            return CommandReply(found["done"], found["text"])
        answer = await getattr(Operator(service.trackers[place], 1.0), name)(*value, why)
        return CommandReply(answer.done, answer.text)


class SharedCommandChannel:
    """Gives one command to all trackers, though the person of each tracker asks for it.

    Parameters
    ----------
    door
        Through which the command goes.
    """

    def __init__(self, door: CommandChannel) -> None:
        self._door = door
        self._reply_task: asyncio.Task[CommandReply] | None = None

    def has(self, name: str) -> bool:
        """Tell whether there is a command."""
        return self._door.has(name)

    async def give(
        self,
        service: Service,
        name: str,
        value: tuple[float, ...],
        why: str,
        place: int | None = None,  # noqa: ARG002 - whoever asks, it is for all
    ) -> CommandReply:
        """Give the command, if nobody has yet, and wait for its answer."""
        if self._reply_task is None:
            self._reply_task = asyncio.create_task(self._door.give(service, name, value, why, None), name=name)
        return await self._reply_task
