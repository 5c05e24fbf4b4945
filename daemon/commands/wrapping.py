"""Wraps lines to the width of a terminal. It imports little: the answer to a stop goes through it."""

import os
from textwrap import wrap
from typing import TextIO

# For a terminal that does not tell its width.
_COLUMNS = 80


def wrapped(text: str, stream: TextIO, *, hang: int = 2) -> str:
    """Return text with lines that fit the terminal behind a stream, broken between words; unchanged for file or pipe.

    A broken line goes on `hang` columns to the right of its beginning, or fewer if a long word needs the room.
    """
    if not stream.isatty():
        return text
    columns = _columns(stream)
    lines: list[str] = []
    for line in text.split("\n"):
        begins = len(line) - len(line.lstrip())
        room = columns - begins - max(map(len, line.split()), default=0)
        indent = " " * (begins + min(hang, max(room, 2)))
        parts = wrap(line, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
        lines += parts or [""]
    return "\n".join(lines)


def _columns(stream: TextIO) -> int:
    told = os.environ.get("COLUMNS", "")
    try:
        return int(told) if told.isdigit() else os.get_terminal_size(stream.fileno()).columns or _COLUMNS
    except OSError:
        return _COLUMNS
