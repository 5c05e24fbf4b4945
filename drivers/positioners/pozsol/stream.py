"""The newest value of each telemetry field, and the thread that reads them as the positioner streams them."""

import math
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, Protocol

from drivers.errors import LinkLostError
from drivers.positioners.pozsol.wire import DECIMALS, Field, TokenStream, parse_number, parse_status

# What comes first may be an old screen that has waited in the unit since its last listener left.
_IGNORE_FIRST_S = 0.1
_LOOK_AT_ECHO_EVERY_S = 1.0
# An axis turns by a tenth of this between two screens, and no faster than that; more means that the unit counts from
# elsewhere now.
_JUMP_DEG = 2.0
_FASTEST_DEG_PER_S = 10.0
_JUMP_WITHIN_S = 1.0
# When nothing was read for so long, the first of what is read then has waited, and some that did not fit is lost.
_PAUSE_S = 0.15
_BACKLOG_S = 0.5
# A read costs its thread's waking, whatever comes: of a unit at rest five screens are taken at once.
_GATHER_S = 0.1
_AT_REST_AFTER_S = 5.0
_TRAVEL = frozenset((Field.A_POSITION, Field.A_DESTINATION, Field.B_POSITION, Field.B_DESTINATION))
_ANGLES: dict[int, float] = {Field.A_ANGLE: _JUMP_DEG, Field.B_ANGLE: _JUMP_DEG}
# What one screen says of an axis holds together, by the code of the angle that it begins with.
_SCREENS: dict[int, int] = {
    Field.A_ANGLE: Field.A_ANGLE,
    Field.A_POSITION: Field.A_ANGLE,
    Field.A_DESTINATION: Field.A_ANGLE,
    Field.B_ANGLE: Field.B_ANGLE,
    Field.B_POSITION: Field.B_ANGLE,
    Field.B_DESTINATION: Field.B_ANGLE,
}
_WHOLE = 3


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
    """A field as it was printed, when it came [s], and its number; NaN for a text."""

    text: bytes
    time_s: float
    number: float = math.nan


class FieldTable:
    """The newest value of each field that can be believed; filled by one thread, read by any.

    An axis's angle, position and destination are always those of one screen: the position of a new count beside the
    angle of the old one would be taken for motion.

    Parameters
    ----------
    jumps
        By field, the change within a second that is believed only once the next value confirms it.

    Attributes
    ----------
    jumped_s
        When an angle has last changed by more than an axis can turn, or None: the unit counts from elsewhere then.
    travelled_s
        When a position or destination has last changed; -inf before it did.
    """

    def __init__(self, jumps: Mapping[int, float] = _ANGLES) -> None:
        self._jumps = jumps
        self._values: dict[int, Value] = {}
        self._suspect: dict[int, float] = {}
        # The axis's screen that is being read, which nobody sees before it is whole; whose angle was not believed.
        self._screen: dict[int, Value] = {}
        self._held: set[int] = set()
        self._taken_s = self._paused_s = self._caught_up_s = -math.inf
        self.jumped_s: float | None = None
        self.travelled_s = -math.inf

    def get(self, field: int) -> Value | None:
        """Return the newest value of a field, or None if it never came."""
        return self._values.get(field)

    def snapshot(self) -> dict[int, Value]:
        """Return all fields."""
        return dict(self._values)

    def forget(self) -> None:
        """Start anew."""
        self._values, self._screen, self._suspect, self._held = {}, {}, {}, set()

    def take(self, tokens: Iterable[tuple[int, bytes]], now_s: float) -> None:
        """Note what has come, but for what cannot be: bytes were lost then, and the next screen has it again."""
        if self._values and now_s - self._taken_s > _PAUSE_S:
            self._paused_s, self._caught_up_s = self._taken_s, now_s + _BACKLOG_S
        self._taken_s = now_s
        for code, text in tokens:
            axis = _SCREENS.get(code)
            if self._screen and (axis not in self._screen or axis == code):
                self._end_screen()
            # Where the angle that began a screen cannot be believed yet, nothing of the axis can.
            if axis != code and axis in self._held:
                continue
            value = self._believed(code, text, now_s)
            if axis is not None:
                self._take_of_axis(axis, code, value)
            elif value is not None:
                self._values[code] = value

    def _take_of_axis(self, axis: int, code: int, value: Value | None) -> None:
        if axis == code:
            (self._held.add if value is None else self._held.discard)(axis)
        if value is None:
            return
        if axis != code and not self._screen:
            # The unit prints it before the angle, or the angle was lost.
            self._values[code] = value
            return
        self._screen[code] = value
        if len(self._screen) == _WHOLE:
            self._end_screen()

    def _end_screen(self) -> None:
        self._values.update(self._screen)
        self._screen = {}

    def _believed(self, code: int, text: bytes, now_s: float) -> Value | None:
        """Return what a field says now, or None if it cannot be."""
        known = self._values.get(code)
        if known is not None and known.text == text:
            # Believed before, and no jump from there.
            self._suspect.pop(code, None)
            return Value(text, now_s, known.number)
        number = math.nan
        try:
            if code in DECIMALS:
                number = parse_number(code, text)
            elif code == Field.STATUS:
                parse_status(text.decode("latin-1"))
        except ValueError:
            return None
        if code in self._jumps and not self._plausible(code, number, now_s):
            return None
        if code in _TRAVEL:
            self.travelled_s = now_s
        return Value(text, now_s, number)

    def _plausible(self, code: int, number: float, now_s: float) -> bool:
        """Tell whether a value can be; a jump is one once the next value confirms it."""
        known, most = self._values.get(code), self._jumps[code]
        if known is None:
            self._suspect.pop(code, None)
            return True
        passed_s = now_s - (min(known.time_s, self._paused_s) if now_s < self._caught_up_s else known.time_s)
        if passed_s > _JUMP_WITHIN_S or abs(number - known.number) <= most + _FASTEST_DEG_PER_S * passed_s:
            self._suspect.pop(code, None)
            return True
        suspect = self._suspect.get(code)
        self._suspect[code] = number
        if suspect is None or abs(number - suspect) > most:
            return False
        del self._suspect[code]
        if code in _ANGLES:
            self.jumped_s = now_s
        return True


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
        How long screens are let come together before they are read, of a unit that rests and was sent nothing lately.

    Attributes
    ----------
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
        self._port = port
        self._now = now
        self._boot_s = boot_s
        self._banner = banner
        self._gather_s = gather_s
        self._end = b""
        self._closing = self._attends = False
        self._woken = threading.Event()
        self._attended_s = -math.inf
        self.table = table or FieldTable()
        self.lost: str | None = None
        self.heard = False
        self.restarted_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="heliocube-positioner-reader", daemon=True)
        self._thread.start()

    def attend(self) -> None:
        """Take every screen as it comes for some seconds, and at once what has come: a command is about to be sent."""
        self._attends = True
        self._woken.set()

    def stop(self) -> None:
        """Ask for the end, without waiting for it."""
        self._closing = True
        self._woken.set()

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
        self._attended_s = now
        while not self._closing:
            data = self._port.read()
            now = self._now()
            if self._has_banner(data):
                self.restarted_s, believe_s = now, min(believe_s, now)
                stream = TokenStream()
                self.table.forget()
                data = data.rpartition(self._banner)[2]
            tokens = stream.feed(data)
            if tokens and now >= believe_s:
                self.heard = True
                self.table.take(tokens, now)
            if now >= look_s:
                look_s = now + _LOOK_AT_ECHO_EVERY_S
                if self._port.echoes():
                    raise LinkLostError("positioner", "another program has switched the port's echo on")
            if self._attends:
                self._attends, self._attended_s = False, now
                self._woken.clear()
            elif now - max(self._attended_s, self.table.travelled_s) > _AT_REST_AFTER_S:
                self._woken.wait(self._gather_s)

    def _has_banner(self, data: bytes) -> bool:
        """Tell whether these bytes complete the banner, in whatever pieces it comes."""
        if not self._banner:
            return False
        text = self._end + data
        self._end = text[max(len(text) - len(self._banner) + 1, 0) :]
        return self._banner in text
