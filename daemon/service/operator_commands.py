"""An operator's command as text: one parser with one set of sentences, and one answer, whatever way it came.

The command line and other programs come over HTTP, the rest over MQTT; both hand on what they got, and no more.
"""

import json
import math
from dataclasses import dataclass
from typing import Any

from daemon.service.operator import Answer, CommandError, Operator

NAMES = ("stow", "snow", "hold", "stop", "auto", "goto", "home", "clear", "relearn", "maintenance", "mode")
MODES = ("auto", "hold", "stow", "snow", "maintenance")
URGENT = ("stop", "stow", "maintenance")
LONGEST_BODY = 4096

_LONGEST_LINE = 200
_LINES = ("why", "by", "id")
_OWN_KEYS = {"goto": ("a_deg", "b_deg"), "mode": ("mode",)}


class BodyError(CommandError):
    """What came with a command cannot be meant."""

    def __init__(self, sentence: str) -> None:
        super().__init__(sentence, wrong=True)


@dataclass(frozen=True, slots=True)
class Command:
    """One command that can be meant.

    Attributes
    ----------
    name
        As it was given.
    wanted
        What is to be done: for ``mode`` the mode, else the name.
    why, by
        The reason, and who asks.
    identifier
        What the answer repeats, or None.
    a_deg, b_deg
        Of a goto; NaN of others.
    """

    name: str
    wanted: str
    why: str
    by: str
    identifier: str | None
    a_deg: float = math.nan
    b_deg: float = math.nan

    async def carry_out(self, operator: Operator) -> dict[str, Any]:
        """Return the answer as JSON; raises `CommandError` where the command is refused."""
        if self.wanted == "goto":
            answer = await operator.goto(self.a_deg, self.b_deg, self.why, self.by)
        else:
            answer = await getattr(operator, self.wanted)(self.why, self.by)
        return answer_json(self.name, self.identifier, answer)


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
        One of `NAMES`.
    content
        Empty, or a JSON object; for ``mode`` also the bare name of one.
    way
        Over which it came, such as ``HTTP``: who asked, where the body does not say.

    Raises
    ------
    BodyError
        The body cannot be meant, in one sentence.
    """
    found = _object(name, content)
    known = (*_OWN_KEYS.get(name, ()), *_LINES)
    for key in found:
        if key not in known:
            raise BodyError(f"the body has {ascii(key)[:40]}, but may have only {', '.join(known)}")
    for key in _LINES:
        _check_line(key, found.get(key, "-"))
    wanted = found.get("mode") if name == "mode" else name
    if name == "mode" and wanted not in MODES:
        raise BodyError(f"the mode must be one of {', '.join(MODES)}")
    why, by = found.get("why", "an operator asked"), found.get("by", way)
    place = [_degrees(found.get(key)) for key in ("a_deg", "b_deg")] if name == "goto" else [math.nan] * 2
    return Command(name, str(wanted), why, by, found.get("id"), *place)


def _object(name: str, content: bytes) -> dict[str, Any]:
    if len(content) > LONGEST_BODY:
        raise BodyError(f"the body is longer than {LONGEST_BODY} bytes")
    if name == "mode" and content.decode("ascii", "replace") in MODES:
        return {"mode": content.decode()}
    if not content.strip():
        return {}
    try:
        found = json.loads(content)
    except (ValueError, RecursionError):
        raise BodyError("the body is not JSON") from None
    if not isinstance(found, dict):
        raise BodyError('the body is not a JSON object, such as {"why": "maintenance"}')
    return found


def _check_line(key: str, value: object) -> None:
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST_LINE or not value.isprintable():
        raise BodyError(f'"{key}" must be one line of text with at most {_LONGEST_LINE} letters')


def _degrees(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BodyError('goto needs two numbers of degrees, such as {"a_deg": -10, "b_deg": 60}')
    try:
        return float(value)
    except OverflowError:
        return math.inf
