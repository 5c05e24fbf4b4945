"""What goes over a line, byte for byte, into a person's file."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from daemon.base.clock import SystemClock, iso_utc
from daemon.base.errors import UserError
from drivers.transcript import Direction, Piece, Tap, line_of, no_tap


@contextmanager
def recorded(path: Path | None) -> Iterator[Tap]:
    """Have a tap that writes a transcript to a new file, whatever thread calls it; None for none.

    Raises
    ------
    UserError
        The file is there already or cannot be written. A disk that is full on the way is told at the end: until then an
        instrument is heard and spoken to all the same, since an axis that moves has to be stopped.
    """
    if path is None:
        yield no_tap
        return
    clock, one = SystemClock(), threading.Lock()
    start_s = clock.monotonic()
    try:
        stream = path.open("x", encoding="utf-8", newline="\n")
    except FileExistsError:
        raise UserError(f"{path} is there already and is not overwritten") from None
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None
    failed: list[OSError] = []

    def write(text: str) -> None:
        if not failed:
            try:
                stream.write(text)
            except OSError as error:
                failed.append(error)

    def tap(direction: Direction, data: bytes) -> None:
        # What is sent and what is received come from two threads, and a text file takes one at a time.
        with one:
            write(line_of(Piece(clock.monotonic() - start_s, direction, data)) + "\n")

    write(f"# heliocube probe, {iso_utc(clock.utc())}\n")
    try:
        yield tap
    finally:
        try:
            stream.close()
        except OSError as error:
            failed.append(error)
        if failed:
            with suppress(OSError):
                path.unlink()
    if failed:
        raise UserError(
            f"{path} cannot be written: {failed[0].strerror}; all else was done: record it again where there is room"
        )
