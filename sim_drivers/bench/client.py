"""How a bench is told something: one line of JSON in, one out, over a unix socket.

A request is ``{"verb": "unplug", "arguments": ["voltmeter"]}``, a reply ``{"ok": true, "result": ...}`` or
``{"ok": false, "error": "one sentence"}``.
"""

import json
import socket
from pathlib import Path
from typing import Any

SOCKET_NAME = "control"
_TIMEOUT_S = 10.0


class BenchError(Exception):
    """A command that the bench cannot carry out, in one sentence; or a bench that is not there."""


def request(directory: Path, verb: str, arguments: list[str]) -> Any:
    """Send one command to the bench in a directory and return what it tells; blocks.

    Raises
    ------
    BenchError
        No bench is there, or it refuses.
    """
    line = json.dumps({"verb": verb, "arguments": arguments}).encode() + b"\n"
    try:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(_TIMEOUT_S)
            connection.connect(str(directory / SOCKET_NAME))
            connection.sendall(line)
            with connection.makefile("rb") as stream:
                text = stream.readline()
    except OSError as error:
        raise BenchError(
            f"{directory}: no bench answers there ({error.strerror or error}); start one with"
            f" 'heliocube bench --dir {directory}'"
        ) from error
    if not text:
        raise BenchError(f"{directory}: the bench has ended")
    reply = json.loads(text)
    if not reply["ok"]:
        raise BenchError(reply["error"])
    return reply["result"]
