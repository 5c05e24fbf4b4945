"""A serial port that is a pseudo-terminal under a name of its own, with a plug that can be pulled.

No second descriptor of the port is kept open: the line then hangs up when its last user closes it, and so this side
knows whether anybody is there, as a USB device does. The port is left in the mode that the operating system gives it,
with echo, as a freshly plugged port has it.
"""

import asyncio
import contextlib
import errno
import os
import select
import termios
from collections.abc import Callable
from enum import Enum, auto
from pathlib import Path

from sim_drivers.bench.client import BenchError

LOOK_EVERY_S = 0.01
_CHUNK = 4096
_LOCAL_MODES = 3


class _ReadOutcome(Enum):
    DATA = auto()
    NOTHING = auto()
    HANG_UP = auto()


class PtyPort:
    """The device's side of a serial port.

    Parameters
    ----------
    link
        Path of the symbolic link that users open; it leads to another pseudo-terminal after each replug.
    on_bytes
        Called with what a user has sent, as soon as it is there.
    """

    def __init__(self, link: Path, on_bytes: Callable[[bytes], None]) -> None:
        self.link = link
        self._on_bytes = on_bytes
        self._master: int | None = None
        self._reading = False
        self._paused = False
        self._look_timer: asyncio.TimerHandle | None = None

    @property
    def plugged(self) -> bool:
        """Whether the port is there at all."""
        return self._master is not None

    @property
    def in_use(self) -> bool:
        """Whether a user has the port open."""
        if self._master is None:
            return False
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        return not any(events & (select.POLLHUP | select.POLLERR) for _, events in poll.poll(0))

    @property
    def echoes(self) -> bool:
        """Whether what is sent to the user comes back."""
        return self._master is not None and bool(termios.tcgetattr(self._master)[_LOCAL_MODES] & termios.ECHO)

    def check_place(self) -> None:
        """Raise `BenchError` where something else has the name: only a link is taken for what a bench has left."""
        if os.path.lexists(self.link) and not self.link.is_symlink():
            raise BenchError(f"{self.link} exists and is not a port of a bench: move it, or take another folder")

    def plug(self) -> None:
        """Make the port appear; does nothing if it is there. Raises as `check_place`."""
        if self._master is not None:
            return
        self.check_place()
        master, slave = os.openpty()
        os.set_blocking(master, False)
        beside = self.link.with_name(f".{self.link.name}.new")
        beside.unlink(missing_ok=True)
        beside.symlink_to(os.ttyname(slave))
        os.close(slave)
        # In one step, so that nobody ever meets a link that leads nowhere.
        beside.replace(self.link)
        self._master = master
        self._wait_for_user()

    def unplug(self) -> None:
        """Make the port vanish; its user is hung up on."""
        self.link.unlink(missing_ok=True)
        self._stop_reading()
        if self._look_timer is not None:
            self._look_timer.cancel()
            self._look_timer = None
        if self._master is not None:
            os.close(self._master)
            self._master = None

    def send(self, data: bytes) -> bool:
        """Send to the user; return whether all of it found room. Nothing is kept for a user who is not there."""
        if not data or self._master is None or not self.in_use:
            return False
        try:
            return os.write(self._master, data) == len(data)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise
            return False

    def pause(self) -> None:
        """Take in nothing more; what is sent meanwhile waits in the port."""
        self._paused = True
        self._stop_reading()

    def resume(self) -> None:
        """Take in what has been sent, and go on."""
        self._paused = False
        if self._master is not None:
            self._wait_for_user()

    def _wait_for_user(self) -> None:
        loop = asyncio.get_running_loop()
        if self._look_timer is not None:
            self._look_timer.cancel()
            self._look_timer = None
        if self._paused or self._reading or self._master is None:
            return
        if self.in_use:
            self._reading = True
            loop.add_reader(self._master, self._read)
        else:
            while self._read_chunk() is _ReadOutcome.DATA:
                pass
            # A hung-up descriptor counts as readable all the time: it is looked at now and then instead.
            self._look_timer = loop.call_later(LOOK_EVERY_S, self._wait_for_user)

    def _read(self) -> None:
        if self._read_chunk() is _ReadOutcome.HANG_UP:
            self._stop_reading()
            self._forget_unread()
            self._wait_for_user()

    def _read_chunk(self) -> _ReadOutcome:
        if self._master is None:
            return _ReadOutcome.HANG_UP
        try:
            data = os.read(self._master, _CHUNK)
        except BlockingIOError:
            return _ReadOutcome.NOTHING
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            data = b""
        if not data:
            return _ReadOutcome.HANG_UP
        self._on_bytes(data)
        return _ReadOutcome.DATA

    def _forget_unread(self) -> None:
        """Drop what the user who has left did not read, as the driver of a serial port does at its last close."""
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                termios.tcflush(slave, termios.TCIFLUSH)
            finally:
                os.close(slave)

    def _stop_reading(self) -> None:
        if self._reading and self._master is not None:
            with contextlib.suppress(RuntimeError):
                asyncio.get_running_loop().remove_reader(self._master)
        self._reading = False
