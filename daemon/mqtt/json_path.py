"""Finding one value in a JSON message."""

import json
import re
from typing import Any

_FORM = re.compile(r"[^.\[\]\s]+(\.[^.\[\]\s]+)*")


def check_path(text: str) -> str:
    """Return `text` if it is a path of names and list positions with full stops between; `ValueError` if not."""
    if text and _FORM.fullmatch(text) is None:
        raise ValueError(f"{text!r} is no path such as wind.speed or sensors.0.speed")
    return text


def find(payload: bytes, path: str) -> Any:
    """Return the value at `path` of a message; with an empty path the message itself, as JSON or else as text.

    Raises
    ------
    ValueError
        In one sentence: the message is no JSON, or has nothing there.
    """
    try:
        found = json.loads(payload)
    except (ValueError, RecursionError):
        if path:
            raise ValueError("the message is not JSON") from None
        return payload.decode("utf-8", "replace").strip()
    for step in path.split(".") if path else ():
        if isinstance(found, dict) and step in found:
            found = found[step]
        elif isinstance(found, list) and step.isdecimal() and int(step) < len(found):
            found = found[int(step)]
        else:
            raise ValueError(f"the message has nothing at {path}")
    return found
