"""Records the bytes on a line in a file that a person names."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from daemon.base.clock import SystemClock, iso_utc
from daemon.base.errors import UserError
from drivers.transcript import Direction, Tap, TranscriptEntry, line_of, no_tap


@contextmanager
def record_transcript(path: Path | None) -> Iterator[Tap]:
    """Yield a tap that writes a transcript to a new file, from any thread; with None it writes nothing.

    Raises
    ------
    UserError
        The file is there already or cannot be written. That the disk became full meanwhile is reported only at the end:
        until then the dialogue with the instrument goes on, since an axis that moves has to be stopped.
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
        # Two threads call this, one for what is sent and one for what is received; a text file takes one at a time.
        with one:
            write(line_of(TranscriptEntry(clock.monotonic() - start_s, direction, data)) + "\n")

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
