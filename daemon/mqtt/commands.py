"""What comes in: an operator's commands, carried out like those of the local interface, each with a reply."""

import asyncio
import json
import logging
import math
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from daemon.api.commands import Answer, CommandError, Operator
from daemon.mqtt.connection import Incoming

log = logging.getLogger("heliocube.mqtt")

NAMES = ("stow", "hold", "stop", "auto", "goto", "mode")
MODES = ("auto", "hold", "stow")

_LONGEST_BODY = 4096
_LONGEST_WHY = 200
_AT_ONCE = 8
# What makes things safe is not refused because a queue of wishes stands before it.
_AT_ONCE_SAFE = 64
_KEYS = {"goto": ("a_deg", "b_deg", "why", "id"), "mode": ("mode", "why", "id")}


class Commands:
    """Takes commands and replies to each.

    Parameters
    ----------
    operator
        Carries them out; the guard of every other way is behind it.
    reply
        Called with the name of the command and what came of it.
    """

    def __init__(self, operator: Operator, reply: Callable[[dict[str, Any]], None]) -> None:
        self._operator = operator
        self._reply = reply
        self._running: set[asyncio.Task[None]] = set()

    def take(self, name: str, message: Incoming) -> None:
        """Begin to carry out a command, or refuse it; needs a running loop and does not wait."""
        said: dict[str, Any] = {}
        try:
            _refuse_retained(message)
            said = _body(name, message.payload)
            wanted = str(said["mode"] if name == "mode" else name)
            self._refuse_flood(wanted)
        except CommandError as error:
            log.warning("the command %s over MQTT is refused: %s", name, error)
            self._answer(name, said, accepted=False, done=False, text=str(error))
            return
        task = asyncio.create_task(self._carry_out(name, wanted, said), name=f"mqtt command {wanted}")
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
        if len(self._running) >= (_AT_ONCE_SAFE if wanted in ("stop", "stow") else _AT_ONCE):
            raise CommandError(f"{len(self._running)} commands are being carried out already; ask again")

    async def _carry_out(self, name: str, wanted: str, said: dict[str, Any]) -> None:
        operator, why = self._operator, said.get("why", "asked over MQTT")
        calls: dict[str, Callable[[str], Awaitable[Answer]]] = {
            "stow": operator.stow,
            "hold": operator.hold,
            "stop": operator.stop,
            "auto": operator.auto,
            "goto": partial(operator.goto, said.get("a_deg", math.nan), said.get("b_deg", math.nan)),
        }
        try:
            answer = await calls[wanted](why)
        except CommandError as error:
            self._answer(name, said, accepted=False, done=False, text=str(error))
        else:
            self._answer(name, said, accepted=True, done=answer.done, text=answer.text)

    def _answer(self, name: str, said: dict[str, Any], *, accepted: bool, done: bool, text: str) -> None:
        self._reply({"command": name, "id": said.get("id"), "accepted": accepted, "done": done, "text": text})


def _refuse_retained(message: Incoming) -> None:
    if message.retained:
        raise CommandError("a retained command is ignored, for nobody knows how old it is: publish without retain")


def _body(name: str, payload: bytes) -> dict[str, Any]:
    """Return what a command says, checked; raises `CommandError`."""
    if len(payload) > _LONGEST_BODY:
        raise CommandError(f"the message is longer than {_LONGEST_BODY} bytes", wrong=True)
    if name == "mode" and payload.decode("ascii", "replace") in MODES:
        return {"mode": payload.decode()}
    if not payload.strip():
        found: Any = {}
    else:
        try:
            found = json.loads(payload)
        except (ValueError, RecursionError):
            found = None
    if not isinstance(found, dict):
        raise CommandError('the message is neither empty nor a JSON object, such as {"why": "maintenance"}', wrong=True)
    known = _KEYS.get(name, ("why", "id"))
    for key in found:
        if key not in known:
            raise CommandError(f"the message has {ascii(key)[:40]}, but may have only {', '.join(known)}", wrong=True)
    for key in ("why", "id"):
        if key in found:
            _check_text(key, found[key])
    if name == "mode" and found.get("mode") not in MODES:
        raise CommandError(f"the mode must be one of {', '.join(MODES)}", wrong=True)
    if name == "goto":
        found |= {key: _degrees(found.get(key)) for key in ("a_deg", "b_deg")}
    return found


def _check_text(key: str, value: object) -> None:
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST_WHY or not value.isprintable():
        raise CommandError(f'"{key}" must be one line of text with at most {_LONGEST_WHY} letters', wrong=True)


def _degrees(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CommandError('goto needs two numbers of degrees, such as {"a_deg": -10, "b_deg": 60}', wrong=True)
    try:
        return float(value)
    except OverflowError:
        return math.inf
