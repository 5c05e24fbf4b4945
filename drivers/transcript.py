r"""What went over a link, byte for byte: one line of text for each piece, to be written, read and compared.

A line is the time [s], ``>`` for sent or ``<`` for received, and the bytes as a JSON string of Latin-1 characters::

    0.000 > "*IDN?\n"
    0.041 < "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02\n"
"""

import json
from collections.abc import Callable, Iterable
from typing import Literal, NamedTuple

Direction = Literal[">", "<"]
Tap = Callable[[Direction, bytes], object]
"""Told each piece that was sent or received; called in the instrument's thread."""


def no_tap(_direction: Direction, _data: bytes) -> None:
    """Do nothing."""


class TranscriptEntry(NamedTuple):
    """Bytes that went one way at a time [s]."""

    time_s: float
    direction: Direction
    data: bytes


def line_of(piece: TranscriptEntry) -> str:
    """Return the line that stands for a piece."""
    return f"{piece.time_s:.3f} {piece.direction} {json.dumps(piece.data.decode('latin-1'))}"


def parse(lines: Iterable[str]) -> list[TranscriptEntry]:
    """Read lines back; empty ones and those that begin with ``#`` are remarks.

    Raises
    ------
    ValueError
        A line is not of that form; the message has its number.
    """
    pieces = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            time_text, direction, text = line.rstrip("\n").split(" ", 2)
            data = json.loads(text).encode("latin-1")
            sent = (">", "<").index(direction) == 0
            pieces.append(TranscriptEntry(float(time_text), ">" if sent else "<", data))
        except (ValueError, AttributeError) as error:
            raise ValueError(f"line {number} of the transcript is not 'time > \"bytes\"': {line.strip()!r}") from error
    return pieces
