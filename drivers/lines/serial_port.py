"""An instrument's USB serial port: raw before anything is read from it, held by one program, closed to other commands.

A tty of Linux starts out with echo: what the instrument sends comes back to it, and a positioner may take its own
telemetry for commands. So before anything else echo is switched off, and what was waiting is thrown away; whether
echo stays off is checked from time to time.
"""

import errno
import importlib
import os
import select
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from drivers.errors import ConnectError, LinkLostError
from drivers.transcript import Tap, no_tap

SerialForm = Literal["8N1", "8E1", "8O1", "8N2"]

_READ_S = 0.2
_WRITE_S = 0.9
# How often a write that waits for room checks whether the port has been closed.
_LOOK_EVERY_S = 0.05
_LARGEST_READ = 4096


class SerialPort:
    """An open port; `read` may run in one thread and `write` in another.

    Parameters
    ----------
    device
        Role of the instrument, for errors.
    path
        Name of the port.
    require_allowed
        Raises `ValueError` for bytes that are no command that may be sent: the last gate before the wire.
    tap
        Told what is sent and received.
    baud_rate, form
        Speed; data bits, parity and stop bits. A USB device that is its own port uses neither.
    read_s
        How long a read waits for something to come.
    dtr, rts
        Levels of the two modem lines from opening on. Linux raises both for an instant at every open, whatever is
        wanted here. A port without such lines, a pseudo-terminal say, is used as it is: `has_modem_lines` tells.

    Raises
    ------
    ConnectError
        The port is not there, held by another program, not permitted, or no serial port.
    """

    def __init__(
        self,
        device: str,
        path: str,
        require_allowed: Callable[[bytes], None],
        tap: Tap = no_tap,
        *,
        dtr: bool = True,
        rts: bool = True,
        baud_rate: int = 9600,
        form: SerialForm = "8N1",
        read_s: float = _READ_S,
    ) -> None:
        import serial  # noqa: PLC0415 - loaded only where there is a port; it needs termios or Windows

        self._device = device
        self._path = path
        self._require_allowed = require_allowed
        self._tap = tap
        first = open_raw(device, path)
        # Windows opens every port exclusively and knows no such option.
        exclusive = True if os.name == "posix" else None
        unusable: tuple[type[BaseException], ...] = (OSError, ValueError, *terminal_errors())
        try:
            self._port: Any = serial.Serial(None, timeout=read_s, write_timeout=_WRITE_S, exclusive=exclusive)
            self._port.port, self._port.dtr, self._port.rts = path, dtr, rts
            self._port.baudrate, self._port.parity, self._port.stopbits = baud_rate, form[1], int(form[2])
            self._port.open()
        except unusable as error:
            raise port_open_error(device, path, error) from error
        finally:
            if first is not None:
                os.close(first)
        # pyserial's TypeError: the port was closed under the call.
        self._gone_errors: tuple[type[BaseException], ...] = (OSError, TypeError, *terminal_errors())

    def read(self) -> bytes:
        """Return what has come; empty after a while without anything."""
        try:
            data: bytes = self._read_available() or self._port.read(1)
            if len(data) == 1:
                data += self._read_available()
        except self._gone_errors as error:
            raise LinkLostError(self._device, f"{self._path} is gone; has it been unplugged?") from error
        if data:
            self._tap("<", data)
        return data

    def _read_available(self) -> bytes:
        """Return what has come already; pyserial takes five calls for that, a load if a unit never pauses."""
        if os.name != "posix":
            data: bytes = self._port.read(min(self._port.in_waiting, _LARGEST_READ))
            return data
        try:
            return os.read(self._port.fileno(), _LARGEST_READ)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send one command, within a second; `ValueError` for bytes that may not be sent."""
        self._require_allowed(data)
        try:
            self._put(data)
        except self._gone_errors as error:
            raise LinkLostError(self._device, f"{self._path} takes no data: {error}") from error
        self._tap(">", data)

    def _put(self, data: bytes) -> None:
        """Write all; pyserial reports a timeout for what was written if the process then got no processor time."""
        if os.name != "posix":
            self._port.write(data)
            return
        end_s = time.monotonic() + _WRITE_S
        while data:
            try:
                data = data[os.write(self._port.fileno(), data) :]
            except BlockingIOError:
                left_s = end_s - time.monotonic()
                if left_s <= 0:
                    raise TimeoutError(f"no data was accepted within {_WRITE_S:g} s") from None
                select.select([], [self._port.fileno()], [], min(left_s, _LOOK_EVERY_S))

    def discard(self) -> None:
        """Throw away what has come and was not read."""
        try:
            self._port.reset_input_buffer()
        except self._gone_errors as error:
            raise LinkLostError(self._device, f"{self._path} is gone; has it been unplugged?") from error

    def has_echo(self) -> bool:
        """Tell whether somebody has switched the terminal's echo on again."""
        if sys.platform == "win32":
            return False
        import termios  # noqa: PLC0415 - not there on Windows

        try:
            local_modes: int = termios.tcgetattr(self._port.fileno())[3]
        except (OSError, TypeError, termios.error) as error:
            raise LinkLostError(self._device, f"{self._path} is gone: {error}") from error
        return bool(local_modes & (termios.ECHO | termios.ICANON))

    def has_modem_lines(self) -> bool:
        """Tell whether the port has modem lines, so that DTR and RTS are as they were asked for."""
        try:
            # Reading the other side's line fails where there are none; pyserial hides that when it sets its own.
            return isinstance(self._port.dsr, bool)
        except self._gone_errors:
            return False

    def close(self) -> None:
        """Release the port; a read in another thread ends."""
        self._port.close()


def port_open_error(device: str, path: str, error: BaseException) -> ConnectError:
    """Return the error for a port that cannot be opened, with the remedy."""
    number = getattr(error, "errno", None)
    text = str(error)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or "FileNotFoundError" in text:
        return ConnectError(device, f"there is no {path}: is it plugged in and powered?")
    if number == errno.EACCES or "PermissionError" in text:
        remedy = "is it open in another program?" if os.name == "nt" else "add this user to the group that owns it"
        return ConnectError(device, f"{path} may not be opened; {remedy}")
    if number in (errno.EAGAIN, errno.EBUSY):
        return ConnectError(device, f"{path} is held by another program{_holder(path)}")
    return ConnectError(device, f"{path} cannot be opened: {text}")


LONGEST_DRAIN_S = 3.0
"""How long data that nobody asked for is thrown away, until it counts as endless."""


def unsolicited_data_error(device: str) -> ConnectError:
    """Return the error for a device that sends on and on although nobody has asked it."""
    return ConnectError(
        device, "the device there keeps sending unasked: is it the right instrument, at the right speed?"
    )


def open_raw(device: str, path: str) -> int | None:
    """Return a descriptor on the port, made raw and empty before anything else happened; None where none is needed."""
    if sys.platform == "win32":
        return None
    import fcntl  # noqa: PLC0415 - not there on Windows
    import termios  # noqa: PLC0415
    import tty  # noqa: PLC0415

    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise port_open_error(device, path, error) from error
    try:
        # Another program that holds the port has set it up as it needs: do not touch it.
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        tty.setraw(descriptor, termios.TCSANOW)
        termios.tcflush(descriptor, termios.TCIOFLUSH)
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    except OSError as error:
        os.close(descriptor)
        raise port_open_error(device, path, error) from error
    except termios.error as error:
        os.close(descriptor)
        raise ConnectError(device, f"{path} is not a serial port") from error
    return descriptor


def _holder(path: str) -> str:
    """Return who has the port open, as far as this user may know."""
    try:
        wanted = os.path.realpath(path)
        for link in Path("/proc").glob("[0-9]*/fd/*"):
            try:
                if str(link.readlink()) != wanted or link.parts[2] == str(os.getpid()):
                    continue
                # A container's terminals may have the same names as this machine's.
                if not link.samefile(wanted):
                    continue
                name = (link.parents[1] / "comm").read_text(encoding="utf-8", errors="replace").strip()
            except OSError:
                continue
            return f" ({name}, process {link.parts[2]})"
    except OSError:
        pass
    return ""


def terminal_errors() -> tuple[type[Exception], ...]:
    """Return what the terminal layer of POSIX raises beside OSError."""
    try:
        terminals = importlib.import_module("termios")
    except ImportError:
        return ()
    return (terminals.error,)
