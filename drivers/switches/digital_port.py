"""What a multiplexer's driver asks of a digital port, whatever carries it."""

from typing import Protocol


class DaqError(Exception):
    """The port refused a call.

    Parameters
    ----------
    code
        The DAQ driver's error number, negative; None if it gave none.
    reason
        In one sentence.
    """

    def __init__(self, code: int | None, reason: str) -> None:
        super().__init__(reason if code is None else f"{reason} ({code})")
        self.code = code


class DigitalPort(Protocol):
    """Output lines that are written together. Raises `DaqError` and `drivers.errors.DeviceError`, nothing else."""

    async def open(self, highest_line: int) -> str:
        """Reserve the lines from 0 to `highest_line` and return what they belong to; nothing is written."""

    async def close(self) -> None:
        """Release the lines; they keep their state. Never raises."""

    async def write(self, value: int) -> None:
        """Put a value on the lines; returns once it is there."""

    def place(self, highest_line: int) -> str:
        """Return the name of the lines from 0 to `highest_line`, for messages."""
