"""The simulated POZSOL36A1 positioner with its two axes: bytes in, bytes out, time as an argument.

Behaves as the maker's public firmware does in an emulator; docs/hardware.md tells how that is compared and where they
differ. A checksum on commands is left out: older firmware had one, but how it was formed is not known. Commands that
set the clock are accepted and change nothing; parameter writes change what the slow screens print, not how the axes
move.
"""

import math
import re
import struct

from drivers.interfaces import AxisName
from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field
from sim_drivers.pozsol import faults, screens
from sim_drivers.pozsol.screens import Readout
from sim_drivers.pozsol.setup import Setup
from sim_drivers.pozsol.unit import POLL_S, PositionerUnit
from solar.frames import Angles

DEAF = "deaf"
"""The fault of a unit that sends telemetry but takes no commands."""
FAULTS = (*faults.FAULTS, DEAF)
"""Everything that `PositionerCore.inject` can do."""

_FIRST_PARAMETER = 70
_REBOOT_S = 1.0
_SPACE = rb"[ \t\n\v\f\r]*"
_HEX = re.compile(_SPACE + rb"([+-]?)0x([0-9a-f]+\.?[0-9a-f]*|\.[0-9a-f]+)(p[+-]?\d+)?", re.IGNORECASE)
_DECIMAL = re.compile(_SPACE + rb"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)", re.IGNORECASE)
_NO_NUMBER = re.compile(_SPACE + rb"[+-]?(?:nan|inf)", re.IGNORECASE)
_WHOLE = re.compile(_SPACE + rb"([+-]?\d+)")
_LARGEST_WHOLE = (1 << 31) - 1
_JOG: dict[bytes, tuple[AxisName, bool]] = {
    b"1": ("b", True),
    b"2": ("a", True),
    b"3": ("b", False),
    b"4": ("a", False),
}


class PositionerCore:
    """The unit and its link.

    Time [s] never runs backwards between calls. The cost of `advance` grows with what happens, not with time.

    Parameters
    ----------
    now
        The time of power-up; the reset mark is not set by this one.
    setup
        Mechanics and settings.
    """

    def __init__(self, now: float = 0.0, setup: Setup | None = None) -> None:
        self._unit = PositionerUnit(now, setup or Setup())
        self.parameters = screens.default_parameters(self._unit.setup)
        self._start_s = self._now = now
        self._buffer = bytearray(wire.MAXIMUM_PACKET)
        self._poll_s = math.inf
        self._deaf = self._mislays_packet = False
        self._reboot_s = math.inf
        self._slot = self._slow_index = self._link_counter = 0
        self._cached_live_screens = b""
        self._standstill: int | None = None

    @property
    def setup(self) -> Setup:
        """How the unit is built and set."""
        return self._unit.setup

    def feed(self, data: bytes, now: float) -> None:
        """Take in bytes from the host, in the packets that the link makes of them."""
        self.advance(now)
        for start in range(0, len(data), wire.MAXIMUM_PACKET):
            packet = data[start : start + wire.MAXIMUM_PACKET]
            if self._mislays_packet:
                self._mislays_packet = False
                continue
            self._buffer[: len(packet)] = packet
        if data and self._poll_s == math.inf:
            self._poll_s = self._start_s + POLL_S * (math.floor((now - self._start_s) / POLL_S) + 1)

    def enumerate_usb(self, now: float) -> None:
        """Connect the cable, or connect it anew: the first packet after that is lost, as the firmware mislays it."""
        self.advance(now)
        self._mislays_packet = True

    def advance(self, now: float) -> None:
        """Let everything happen that is due until `now`; `ValueError` if that lies in the past."""
        if not (now >= self._now):
            raise ValueError(f"the positioner has been advanced to {self._now} s and cannot go back to {now} s")
        if self._poll_s <= now:
            self._unit.advance(self._poll_s)
            self._poll(self._poll_s)
        if self._reboot_s <= now:
            self._unit.advance(self._reboot_s)
            self._restart(self._reboot_s, keep_position=True)
        self._unit.advance(now)
        self._now = now

    def next_event(self, now: float) -> float | None:
        """Return when the state next changes by itself, or None if it does not."""
        self.advance(now)
        due_s = min(self._poll_s, self._reboot_s, self._unit.due_s)
        return None if due_s == math.inf else due_s

    def truth(self, now: float) -> Angles:
        """Return where the axes really stand, which is not what the unit reports once its reference is lost."""
        self.advance(now)
        return self._unit.truth(now)

    def next_screen(self, now: float) -> bytes:
        """Return the next screen in the unit's own order; a host pulls one every 20 ms."""
        readout = self.readout(now)
        self._slot = self._slot % screens.SLOTS + 1
        if self._slot < screens.SLOTS:
            return screens.fast_screen(self._slot, readout)
        text = screens.slow_screen(self._slow_index, readout, self.parameters)
        self._slow_index = (self._slow_index + 1) % len(screens.SLOW_SCREENS)
        self._link_counter = (self._link_counter + 1) % 100
        return text

    def screens(self, now: float) -> bytes:
        """Return all screens as they would read now, in one piece, without touching their rotation."""
        readout = self.readout(now)
        fast = [screens.fast_screen(slot, readout) for slot in range(1, screens.SLOTS)]
        slow = [screens.slow_screen(i, readout, self.parameters) for i in range(len(screens.SLOW_SCREENS))]
        return b"".join(fast + slow)

    def live_screens(self, now: float) -> bytes:
        """Return only what changes while axes move (both axes, supply, mode, status); cheaper than `screens`."""
        self.advance(now)
        standstill = self._unit.standstill_version
        if standstill is None or standstill != self._standstill:
            self._cached_live_screens, self._standstill = screens.live_screens(self.readout(now)), standstill
        return self._cached_live_screens

    def readout(self, now: float) -> Readout:
        """Return what the screens are printed from."""
        self.advance(now)
        return self._unit.readout(now, self._link_counter)

    def changes(self, now: float) -> int:
        """Return how often anything has changed so far; motion that goes on as it was is no change."""
        self.advance(now)
        return self._unit.changes

    def position_and_destination(self, name: AxisName, now: float) -> tuple[float, float]:
        """Return position and destination [mm] that the unit shows of an axis, without the rest of the screen."""
        self.advance(now)
        return self._unit.axes[name].counted_mm(now), self._unit.destination(name, now)

    def shown_deg(self, name: AxisName, now: float) -> float:
        """Return the angle [deg] that the unit shows of an axis."""
        self.advance(now)
        return self._unit.axes[name].counted_deg(now)

    def inject(self, fault: str, now: float) -> None:
        """Cause one of `FAULTS`; `ValueError` for anything else. Conditions last until `repair`."""
        self._inject(fault, now, present=True)

    def repair(self, fault: str, now: float) -> None:
        """End a condition that `inject` began; what it has latched stays latched until the host clears it."""
        self._inject(fault, now, present=False)

    def power_cycle(self, now: float, *, keep_position: bool = True) -> None:
        """Switch off and on: faults are gone, the reset mark is set, the count is kept or starts at 0."""
        self.advance(now)
        self._restart(now, keep_position)

    def _inject(self, fault: str, now: float, *, present: bool) -> None:
        self.advance(now)
        if fault == DEAF:
            self._deaf = present
            return
        faults.inject(self._unit, fault, now, present=present)

    def _restart(self, now: float, keep_position: bool) -> None:
        self._unit.power_cycle(now, keep_position=keep_position)
        self._buffer = bytearray(wire.MAXIMUM_PACKET)
        self._poll_s = self._reboot_s = math.inf
        self._mislays_packet = True
        self._start_s = now

    def _poll(self, now: float) -> None:
        self._poll_s = math.inf
        text = bytes(self._buffer).split(b"\0", 1)[0]
        # Only the first byte is cleared: the rest of a command stays behind a shorter one that follows.
        self._buffer[0] = 0
        # Only at the very beginning does the unit take a `$` for the start of a command.
        if not self._deaf and text.startswith(b"$") and len(text) > 1:
            self._execute(text[1], text[2:], now)

    def _execute(self, code: int, value: bytes, now: float) -> None:
        unit, letter = self._unit, value[:1].lower()
        if code in (Field.A_ANGLE, Field.B_ANGLE):
            unit.go_to_angle("a" if code == Field.A_ANGLE else "b", _number(value), now)
        elif code in (Field.A_DESTINATION, Field.B_DESTINATION):
            unit.go_to_position("a" if code == Field.A_DESTINATION else "b", _whole(value), now)
        elif code == Field.MODE and letter in (b"n", b"y"):
            unit.switch_tracking(letter == b"y", now)
        elif code == Field.ACTION:
            self._act(letter, now)
        elif code == Field.STATUS:
            unit.clear(now)
        elif code == Field.REBOOT and value[:5].lower() == b"reset":
            self._reboot_s = now + _REBOOT_S
        elif code >= _FIRST_PARAMETER and code in self.parameters:
            self.parameters[code] = value.split(b"$", 1)[0].strip().decode("latin-1")

    def _act(self, letter: bytes, now: float) -> None:
        if letter == wire.STOP.encode():
            self._unit.stop(now)
        elif letter in (wire.HOME_A.encode(), wire.HOME_B.encode()):
            self._unit.home("a" if letter == wire.HOME_A.encode() else "b", now)
        elif letter in _JOG:
            axis, outwards = _JOG[letter]
            self._unit.jog(axis, outwards, now)
        else:
            self._unit.note_action(now)


def _number(value: bytes) -> float:
    """Read the number at the start of a value as the unit's C library does; without one it is 0."""
    if _NO_NUMBER.match(value):
        return math.nan
    try:
        if match := _HEX.match(value):
            sign, digits, power = match.groups()
            number = float.fromhex((sign + b"0x" + digits + (power or b"")).decode())
        else:
            match = _DECIMAL.match(value)
            number = float(match[1]) if match else 0.0
        # The unit holds it in single precision.
        return float(struct.unpack("f", struct.pack("f", number))[0])
    except OverflowError:
        return math.nan


def _whole(value: bytes) -> int:
    """Read the whole number at the start of a value; the unit takes a negative one for a very large one."""
    match = _WHOLE.match(value)
    number = int(match[1]) if match else 0
    return number if 0 <= number <= _LARGEST_WHOLE else _LARGEST_WHOLE
