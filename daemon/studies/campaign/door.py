"""How a person's commands reach a service: by calls, in the process."""

from dataclasses import dataclass
from typing import Protocol

from daemon.service.operator import Operator
from daemon.service.service import Service


@dataclass(frozen=True, slots=True)
class DoorReply:
    """What is said to have come of a command: whether all of it is done, and a sentence."""

    done: bool
    text: str


class Door(Protocol):
    """A way for commands. Raises `daemon.service.operator.CommandError` for what is refused."""

    def has(self, name: str) -> bool:
        """Tell whether there is a command."""

    async def give(self, service: Service, name: str, value: tuple[float, ...], why: str) -> DoorReply:
        """Give a command and wait for its answer."""


class DirectDoor:
    """Calls in the process."""

    def has(self, name: str) -> bool:
        """Tell whether there is a command."""
        return hasattr(Operator, name)

    async def give(self, service: Service, name: str, value: tuple[float, ...], why: str) -> DoorReply:
        """Give a command and wait for its answer."""
        answer = await getattr(Operator(service.trackers[0], 1.0), name)(*value, why)
        return DoorReply(answer.done, answer.text)
