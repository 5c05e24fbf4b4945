"""The thread that reads the telemetry as the positioner streams it."""

import contextlib
import threading
from collections.abc import Callable
from typing import Protocol

from drivers.errors import LinkLostError
from drivers.positioners.pozsol.table import FieldTable
from drivers.positioners.pozsol.wire import TokenStream

# What comes first may be an old screen that has waited in the unit since its last listener left.
_IGNORE_FIRST_S = 0.1
_LOOK_AT_ECHO_EVERY_S = 1.0
# Every read wakes its thread, however little has come. So screens, one every 20 ms, are gathered for two turns of those
# that tell of the axes; they are not gathered while a command is about to show its effect.
_GATHER_S = 0.25
_ATTENDS_FOR_S = 1.0
# More than comes in that time: the process stood still, and newer data waits in the port.
_BACKLOG_BYTES = 2048


class Port(Protocol):
    """What the positioner is connected by. Raises `drivers.errors.DeviceError` and nothing else."""

    def read(self) -> bytes:
        """Return what has come; empty after a fraction of a second without anything."""

    def write(self, data: bytes) -> None:
        """Send bytes as one packet."""

    def has_echo(self) -> bool:
        """Tell whether what comes is sent back."""

    def has_modem_lines(self) -> bool:
        """Tell whether it has modem lines that are as they were asked for."""

    def close(self) -> None:
        """Release the port; never raises."""


class TelemetryReader:
    """Listens to a port until it is closed or lost.

    Parameters
    ----------
    port
        Read from and closed in this thread.
    now
        The service's monotonic time [s].
    boot_s
        How long the unit may take to restart because the port was opened. What comes before its banner, or before this
        time is over, is from before the restart and not believed.
    banner
        What the unit prints when it has restarted; empty if nothing is known of that.
    gather_s
        How long screens are gathered before they are read, while the unit was sent nothing lately.

    Attributes
    ----------
    port
        What it listens to; commands are sent through it.
    restarted_s
        When the banner has last come, or None.
    lost
        Why nothing comes any more, or None.
    heard
        Whether anything at all has come that looks like telemetry.
    table
        The newest values.
    """

    def __init__(
        self,
        port: Port,
        now: Callable[[], float],
        *,
        boot_s: float = 0.0,
        banner: bytes = b"",
        table: FieldTable | None = None,
        gather_s: float = _GATHER_S,
    ) -> None:
        self.port = port
        self._now = now
        self._boot_s = boot_s
        self._banner = banner
        self._gather_s = gather_s
        self._banner_tail = b""
        self._closing = self._attends = False
        # Released to wake the reader; to wait for it costs a third less than for an event.
        self._bell = threading.Lock()
        self._bell.acquire()
        self._attended_s: float
        self.table = table or FieldTable()
        self.lost: str | None = None
        self.heard = False
        self.restarted_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="heliocube-positioner-reader", daemon=True)
        self._thread.start()

    def read_promptly(self) -> None:
        """Read at once what has come, and for a second each screen as it comes: a command is about to be sent."""
        self._attends = True
        self._wake_reader()

    def stop(self) -> None:
        """Ask for the end, without waiting for it."""
        self._closing = True
        self._wake_reader()

    def close(self) -> None:
        """Stop listening and close the port; blocks for a fraction of a second."""
        self.stop()
        self._thread.join()

    def _wake_reader(self) -> None:
        # It may have been released already.
        with contextlib.suppress(RuntimeError):
            self._bell.release()

    def _run(self) -> None:
        try:
            self._listen()
        except LinkLostError as error:
            self.lost = error.message
        finally:
            self.port.close()

    def _listen(self) -> None:
        stream = TokenStream()
        now = self._now()
        believe_s, look_s = now + max(_IGNORE_FIRST_S, self._boot_s), now
        self._attended_s, waited_s = now, 0.0
        while not self._closing:
            data = self.port.read()
            now = self._now()
            if self._banner and self._has_banner(data):
                self.restarted_s, believe_s = now, min(believe_s, now)
                stream = TokenStream()
                self.table.forget()
                data = data.rpartition(self._banner)[2]
            tokens = stream.feed_tokens(data)
            if tokens and now >= believe_s:
                self.heard = True
                self.table.take(tokens, now, waited_s)
            if now >= look_s:
                look_s = now + _LOOK_AT_ECHO_EVERY_S
                if self.port.has_echo():
                    raise LinkLostError("positioner", "another program has switched the port's echo on")
            waited_s = 0.0 if len(data) >= _BACKLOG_BYTES else self._gather(now)

    def _gather(self, now_s: float) -> float:
        """Let screens come together, for less time if `read_promptly` is called; return the longest wait [s]."""
        if self._attends:
            self._attends, self._attended_s = False, now_s
            self._bell.acquire(blocking=False)
        if now_s - self._attended_s < _ATTENDS_FOR_S:
            return 0.0
        self._bell.acquire(timeout=self._gather_s)
        return self._gather_s

    def _has_banner(self, data: bytes) -> bool:
        """Tell whether these bytes complete the banner, in whatever pieces it comes."""
        text = self._banner_tail + data
        self._banner_tail = text[max(len(text) - len(self._banner) + 1, 0) :]
        return self._banner in text
