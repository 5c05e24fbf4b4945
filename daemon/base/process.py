"""What every process needs: log lines of a sentence and its fields, signals, messages to the service manager."""

import asyncio
import contextlib
import gc
import logging
import os
import re
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from types import FrameType
from typing import TYPE_CHECKING

from daemon.base.alarms.kinds import with_tracker_option
from daemon.base.clock import Clock, iso_utc

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

# sd-daemon(3): syslog's priorities, in front of each line of standard error.
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_DEBUG_PRIORITY = 7
# sd_listen_fds(3): what the manager hands over begins here.
_FIRST_INHERITED_DESCRIPTOR = 3
_BARRIER_S = 5.0
_PLAIN_VALUE = re.compile(r'[^\s="\\]+')
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\r": "\\r", "\t": "\\t"}


CURRENT_TRACKER: ContextVar[str] = ContextVar("tracker", default="")
"""Which of several trackers, or of several services, the present task works for: every line that it logs names it."""


def configure_logging(stream: "SupportsWrite[str]", journal: bool, level: int = logging.INFO) -> None:
    """Send every record of the process to `stream`, warnings of the interpreter included.

    Parameters
    ----------
    stream
        Usually standard error.
    journal
        True under systemd: lines begin with their priority, such as ``<4>``, and bear no time, which the journal adds.
        False: UTC and level stand in front.
    level
        The least level that is written.
    """
    handler = logging.StreamHandler(stream)
    handler.setFormatter(LineFormatter(journal))
    logging.basicConfig(handlers=[handler], level=level, force=True)
    logging.captureWarnings(True)


@contextlib.contextmanager
def simulated_time_in_log(clock: Clock) -> Iterator[None]:
    """Begin each warning, without `configure_logging`, with the clock's time, and with the tracker if several."""
    handler = logging.lastResort
    if handler is None:
        yield
        return
    before = handler.formatter
    handler.setFormatter(_SimulatedTimeFormatter(clock))
    try:
        yield
    finally:
        handler.setFormatter(before)


def freeze_startup_objects() -> None:
    """Exclude what the start has made from garbage collection: it stays, and each collection blocked the loop 0.2 s."""
    gc.collect()
    gc.freeze()


class _SimulatedTimeFormatter(logging.Formatter):
    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def format(self, record: logging.LogRecord) -> str:
        name = CURRENT_TRACKER.get()
        return f"{iso_utc(self._clock.utc())[:19]}Z {f'{name}: ' if name else ''}{super().format(record)}"


class LineFormatter(logging.Formatter):
    """Writes a record as its sentence and the fields of ``extra={"fields": {...}}``.

    The traceback of an exception follows in lines of its own (each with the priority, in the journal), because an
    exception that reaches the log was not expected; what is expected is logged as a sentence.

    Parameters
    ----------
    journal
        As for `configure_logging`.
    """

    def __init__(self, journal: bool) -> None:
        super().__init__()
        self._journal = journal

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, and the traceback's lines if there is one."""
        message = with_tracker_option(record.getMessage().strip(), CURRENT_TRACKER.get() or None)
        line = " ".join([_escape(message), *_fields(record)])
        lines = [line, *self._traceback(record)]
        if self._journal:
            return "\n".join(f"<{_priority(record.levelno)}>{line}" for line in lines)
        lines[0] = f"{iso_utc(record.created)} {record.levelname:<7} {line}"
        return "\n".join(lines)

    def _traceback(self, record: logging.LogRecord) -> list[str]:
        if record.exc_info and not record.exc_text:
            record.exc_text = self.formatException(record.exc_info)
        parts = [part for part in (record.exc_text, record.stack_info) if part]
        return [line for part in parts for line in part.splitlines() if line.strip()]


def _fields(record: logging.LogRecord) -> list[str]:
    name = CURRENT_TRACKER.get()
    fields: dict[str, object] = ({"tracker": name} if name else {}) | getattr(record, "fields", {})
    return [f"{key}={_value(value)}" for key, value in fields.items()]


def _value(value: object) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    if text.isprintable() and _PLAIN_VALUE.fullmatch(text):
        return text
    return '"' + _escape(text, quote=True) + '"'


def _escape(text: str, quote: bool = False) -> str:
    """Keep a record on its line, whatever a device sent: control characters are written out."""
    shown = []
    for character in text:
        if quote and character in _ESCAPES:
            shown.append(_ESCAPES[character])
        elif character.isprintable():
            shown.append(character)
        else:
            shown.append(_ESCAPES.get(character, f"\\x{ord(character):02x}"))
    return "".join(shown)


def _priority(level: int) -> int:
    return next((priority for least, priority in _PRIORITIES if level >= least), _DEBUG_PRIORITY)


class SystemdNotifier:
    """Tells systemd how the service is; says nothing where there is no systemd.

    A message that cannot be delivered at once is dropped: the service never waits for its manager, nor fails by it.

    Parameters
    ----------
    environment
        The process' environment: ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID`` are looked at.
    pid
        Of this process; a watchdog that is meant for another one is not ours to answer.
    """

    def __init__(self, environment: Mapping[str, str], pid: int) -> None:
        path = environment.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the NUL byte of Linux's abstract socket names.
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._interval_s = _interval_s(environment, pid)
        self._unclaimed_descriptors = _inherited_descriptors(environment, pid)

    @property
    def watchdog_interval_s(self) -> float | None:
        """How often to call `watchdog` [s], half of what the manager allows; None when it does not watch us."""
        return self._interval_s

    def ready(self) -> None:
        """Tell that start-up is finished."""
        self._send("READY=1")

    def status(self, text: str) -> None:
        """Set the line that ``systemctl status`` shows."""
        self._send("STATUS=" + " ".join(text.split()))

    def watchdog(self) -> None:
        """Tell that the service is alive."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Tell that shut-down has begun."""
        self._send("STOPPING=1")

    def store_socket(self, name: str, opened: socket.socket) -> None:
        """Give the manager a socket to hold while this process ends and the next one begins (FileDescriptorStoreMax=).

        Parameters
        ----------
        name
            By which the next process finds it; letters, digits, hyphens.
        opened
            The socket; the caller keeps it as well.
        """
        self._send(f"FDSTORE=1\nFDNAME={name}", opened)

    def take_stored_socket(self, name: str) -> socket.socket | None:
        """Return the socket that a process before this one gave the manager under a name, or None.

        All other sockets that it gave are closed, and the manager has let go of them when this returns: nobody would
        read from them, and one may have the port that is wanted now.
        """
        found, handed, self._unclaimed_descriptors = None, self._unclaimed_descriptors, []
        for other, number in handed:
            if other == name and found is None:
                os.set_inheritable(number, False)
                found = socket.socket(fileno=number)
                continue
            os.close(number)
            if other != name:
                self._send(f"FDSTOREREMOVE=1\nFDNAME={other}")
        if handed and found is None:
            self._wait_until_done()
        return found

    def _wait_until_done(self) -> None:
        """Wait until the manager has done what it was told so far, as sd_notify_barrier(3) does."""
        ours, theirs = socket.socketpair()
        with ours:
            with theirs:
                self._send("BARRIER=1", theirs)
            ours.settimeout(_BARRIER_S)
            with contextlib.suppress(OSError):
                ours.recv(1)

    def _send(self, message: str, handed: socket.socket | None = None) -> None:
        if sys.platform == "win32" or not self._address or not hasattr(socket, "AF_UNIX"):
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)
                sender.connect(self._address)
                if handed is None:
                    sender.send(message.encode())
                else:
                    socket.send_fds(sender, [message.encode()], [handed.fileno()])
        except OSError:
            return


def _interval_s(environment: Mapping[str, str], pid: int) -> float | None:
    microseconds = environment.get("WATCHDOG_USEC", "")
    if not (microseconds.isdecimal() and int(microseconds) > 0):
        return None
    if environment.get("WATCHDOG_PID", str(pid)) != str(pid):
        return None
    return int(microseconds) / 2e6


def _inherited_descriptors(environment: Mapping[str, str], pid: int) -> list[tuple[str, int]]:
    """Return name and number of each descriptor that the manager handed to this process."""
    count = environment.get("LISTEN_FDS", "")
    if not count.isdecimal() or environment.get("LISTEN_PID", "") != str(pid):
        return []
    names = environment.get("LISTEN_FDNAMES", "").split(":")
    return list(zip(names, range(_FIRST_INHERITED_DESCRIPTOR, _FIRST_INHERITED_DESCRIPTOR + int(count)), strict=False))


@contextlib.contextmanager
def on_signals(stop: Callable[[], object]) -> Iterator[Callable[[], None]]:
    """Call `stop` on SIGINT, SIGTERM and SIGHUP; works on Windows too, where event loops know no signal handlers.

    Once a signal has come, the end of the process has begun: after the block all of them are ignored. The block is
    given a function that begins the end without a signal. A SIGHUP that is ignored at the start, as under nohup, stays
    ignored.
    """
    numbers = [signal.SIGINT, signal.SIGTERM]
    if sys.platform != "win32" and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    ends = False

    def end(*_: object) -> None:
        nonlocal ends
        ends = True
        stop()

    before = {number: signal.signal(number, end) for number in numbers}
    try:
        yield end
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if ends else handler)


@contextlib.contextmanager
def signals_as_ctrl_c() -> Iterator[None]:
    """Treat SIGTERM, and the SIGHUP of a lost connection, as Ctrl-C, so that work in progress ends in order.

    A signal that is ignored at the start, as under nohup, stays ignored. The same signal counts once.
    """
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    heard = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, _ctrl_c) for number in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _ctrl_c(number: int, frame: FrameType | None) -> None:
    # Only once: `timeout` signals the process and its group, and the second signal would cut short the orderly end.
    signal.signal(number, signal.SIG_IGN)
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        # A running event loop sets a handler of its own, which ends its tasks in order.
        handler(signal.SIGINT, frame)
        return
    # If SIGINT was ignored at the start, as in the background of a script, no event loop has set one.
    with contextlib.suppress(RuntimeError):
        asyncio.get_running_loop().call_soon_threadsafe(_cancel_tasks_and_interrupt, frame)
        return
    signal.default_int_handler(signal.SIGINT, frame)


def _cancel_tasks_and_interrupt(frame: FrameType | None) -> None:
    """Leave the running loop from outside of any task: raised in one, KeyboardInterrupt would come again at its end."""
    for task in asyncio.all_tasks():
        task.cancel()
    signal.default_int_handler(signal.SIGINT, frame)
