"""The newest value of each telemetry field, read in a thread as the positioner streams them."""

import threading
from collections.abc import Callable
from typing import NamedTuple, Protocol

from drivers.errors import LinkLostError
from drivers.pozsol_wire import DECIMALS, Field, TokenStream, parse_number, parse_status

# What comes first may be an old screen that has waited in the unit since its last listener left.
_IGNORE_FIRST_S = 0.1
_LOOK_AT_ECHO_EVERY_S = 1.0
# An axis turns by a tenth of this between two screens; more means that the unit counts from elsewhere now.
_JUMP_DEG = 2.0
_JUMP_WITHIN_S = 1.0


class Port(Protocol):
    """What the positioner is connected by. Raises `drivers.errors.DeviceError` and nothing else."""

    def read(self) -> bytes:
        """Return what has come; empty after a fraction of a second without anything."""

    def write(self, data: bytes) -> None:
        """Send bytes as one packet."""

    def echoes(self) -> bool:
        """Tell whether what comes is sent back."""

    def has_lines(self) -> bool:
        """Tell whether it has modem lines that are as they were asked for."""

    def close(self) -> None:
        """Release the port; never raises."""


class Value(NamedTuple):
    """A field as it was printed, and when it came [s]."""

    text: bytes
    time_s: float


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

    Attributes
    ----------
    restarted_s
        When the banner has last come, or None.
    lost
        Why nothing comes any more, or None.
    heard
        Whether anything at all has come that looks like telemetry.
    jumped_s
        When an angle has last changed by more than an axis can turn, or None: the unit counts from elsewhere then.
    """

    def __init__(self, port: Port, now: Callable[[], float], *, boot_s: float = 0.0, banner: bytes = b"") -> None:
        self._port = port
        self._now = now
        self._boot_s = boot_s
        self._banner = banner
        self._end = b""
        self._closing = threading.Event()
        self._values: dict[int, Value] = {}
        self._suspect: dict[int, float] = {}
        self.lost: str | None = None
        self.heard = False
        self.jumped_s: float | None = None
        self.restarted_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="heliocube-positioner-reader", daemon=True)
        self._thread.start()

    def get(self, field: int) -> Value | None:
        """Return the newest value of a field, or None if it never came."""
        return self._values.get(field)

    def snapshot(self) -> dict[int, Value]:
        """Return all fields."""
        return dict(self._values)

    def stop(self) -> None:
        """Ask for the end, without waiting for it."""
        self._closing.set()

    def close(self) -> None:
        """Stop listening and close the port; blocks for a fraction of a second."""
        self.stop()
        self._thread.join()

    def _run(self) -> None:
        try:
            self._listen()
        except LinkLostError as error:
            self.lost = error.message
        finally:
            self._port.close()

    def _listen(self) -> None:
        stream = TokenStream()
        now = self._now()
        believe_s, look_s = now + max(_IGNORE_FIRST_S, self._boot_s), now
        while not self._closing.is_set():
            data = self._port.read()
            now = self._now()
            if self._has_banner(data):
                self.restarted_s, believe_s = now, min(believe_s, now)
                stream, self._values = TokenStream(), {}
                data = data.rpartition(self._banner)[2]
            for code, text in stream.feed(data):
                if now >= believe_s:
                    self.heard = True
                    self._take(code, text, now)
            if now >= look_s:
                look_s = now + _LOOK_AT_ECHO_EVERY_S
                if self._port.echoes():
                    raise LinkLostError("positioner", "another program has switched the port's echo on")

    def _has_banner(self, data: bytes) -> bool:
        """Tell whether these bytes complete the banner, in whatever pieces it comes."""
        if not self._banner:
            return False
        text = self._end + data
        self._end = text[-(len(self._banner) - 1) :] if len(self._banner) > 1 else b""
        return self._banner in text

    def _take(self, code: int, text: bytes, now: float) -> None:
        try:
            if code in (Field.A_ANGLE, Field.B_ANGLE):
                if not self._plausible(code, parse_number(code, text), now):
                    return
            elif code in DECIMALS:
                parse_number(code, text)
            elif code == Field.STATUS:
                parse_status(text.decode("latin-1"))
        except ValueError:
            # Bytes were lost on the way; the next screen has it again.
            return
        self._values[code] = Value(text, now)

    def _plausible(self, code: int, angle_deg: float, now: float) -> bool:
        """Tell whether an angle can be; a jump is one once the next value confirms it."""
        known = self._values.get(code)
        if known is None or now - known.time_s > _JUMP_WITHIN_S or abs(angle_deg - float(known.text)) <= _JUMP_DEG:
            self._suspect.pop(code, None)
            return True
        suspect = self._suspect.get(code)
        self._suspect[code] = angle_deg
        if suspect is None or abs(angle_deg - suspect) > _JUMP_DEG:
            return False
        del self._suspect[code]
        self.jumped_s = now
        return True
