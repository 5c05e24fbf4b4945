"""The simulated multiplexer behind a digital port: an 8-to-1 switch with three address lines and an enable.

The port is that of a USB-6008: after power-up, a reset and a loss of USB all lines read high, which selects the last
input.
"""

from collections import deque
from collections.abc import Callable
from typing import Literal

ENABLE_LINE = 3
ALL_HIGH = 0b1111
DEVICE_LOST = -201003

Enable = Literal["tied", "active-high", "active-low"]


class DaqWriteError(Exception):
    """The digital port did not take a value; `code` is the DAQ driver's error number."""

    def __init__(self, code: int) -> None:
        super().__init__(f"DAQ error {code}")
        self.code = code


class MultiplexerCore:
    """One of eight inputs on one output. Time [s] is an argument.

    Parameters
    ----------
    inputs
        Voltage [V] of an input, 0 to 7, at a time [s]; None where nothing is connected.
    latency_s
        From a write to its effect on the lines.
    enable
        Whether the switch's enable is tied on, or wired to line 3 with one polarity or the other. Switched off, no
        input is on the output.
    address_lines
        Which line of the port drives address bit 0, 1 and 2; anything but (0, 1, 2) is a wiring mistake.
    """

    def __init__(
        self,
        inputs: Callable[[int, float], float | None],
        *,
        latency_s: float = 0.002,
        enable: Enable = "tied",
        address_lines: tuple[int, int, int] = (0, 1, 2),
    ) -> None:
        if not (latency_s >= 0):
            raise ValueError(f"the latency of a write must not be negative, not {latency_s} s")
        if sorted(address_lines) != [0, 1, 2]:
            raise ValueError(f"the address lines must be 0, 1 and 2 in some order, not {address_lines}")
        self.latency_s = latency_s
        self._inputs = inputs
        self._enable = enable
        self._address_lines = address_lines
        self._stuck_bits: dict[int, bool] = {}
        self._errors: deque[int] = deque()
        self._pending: deque[tuple[float, int]] = deque()
        self._port = ALL_HIGH
        self._input_of = [self._decode(port) for port in range(ALL_HIGH + 1)]
        self._selected = self._input_of[ALL_HIGH]
        self._held_v = 0.0
        self._inputs_left_s: dict[int, float] = {}

    def write(self, port_value: int, now: float) -> None:
        """Put a value on the port.

        Raises `ValueError` beyond 0..15, and `DaqWriteError` if `fail_next` asked for it.
        """
        if not 0 <= port_value <= ALL_HIGH:
            raise ValueError(f"the port has four lines: a value of 0 to {ALL_HIGH} can be written, not {port_value}")
        if self._errors:
            raise DaqWriteError(self._errors.popleft())
        self._catch_up(now)
        self._pending.append((now + self.latency_s, port_value))

    def selected(self, now: float) -> int | None:
        """Return the input that is on the output, or None with the switch disabled."""
        self._catch_up(now)
        return self._selected

    def output_voltage(self, now: float) -> float:
        """Return the voltage [V] at the output; a floating output keeps what it last had."""
        self._catch_up(now)
        voltage_v = None if self._selected is None else self._inputs(self._selected, now)
        if voltage_v is None:
            return self._floating_voltage_v()
        self._held_v = voltage_v
        self._inputs_left_s.clear()
        return voltage_v

    def power_cycle(self, now: float) -> None:
        """Let all lines go high, as at power-up, on a reset of the device and when its USB is pulled."""
        self._catch_up(now)
        self._pending.clear()
        self._set_port(ALL_HIGH, now)

    def fail_next(self, code: int = DEVICE_LOST, times: int = 1) -> None:
        """Make the next writes fail with an error number of the DAQ driver, which is negative."""
        if not code < 0:
            raise ValueError(f"errors of the DAQ driver are negative, {code} would be a warning")
        self._errors.extend([code] * times)

    def stick(self, address_bit: int, high: bool, now: float) -> None:
        """Freeze one address bit of the switch, so that two inputs answer for one."""
        if address_bit not in (0, 1, 2):
            raise ValueError(f"the switch has address bits 0, 1 and 2, not {address_bit}")
        self._catch_up(now)
        self._stuck_bits[address_bit] = high
        self._rewire(now)

    def unstick(self, now: float) -> None:
        """Free all address bits."""
        self._catch_up(now)
        self._stuck_bits.clear()
        self._rewire(now)

    def _rewire(self, now: float) -> None:
        self._input_of = [self._decode(port) for port in range(ALL_HIGH + 1)]
        self._set_port(self._port, now)

    def _catch_up(self, now: float) -> None:
        while self._pending and self._pending[0][0] <= now:
            at, port = self._pending.popleft()
            self._set_port(port, at)

    def _set_port(self, port: int, at: float) -> None:
        self._port = port
        selected = self._input_of[port]
        if selected != self._selected:
            if self._selected is not None:
                self._inputs_left_s.pop(self._selected, None)
                self._inputs_left_s[self._selected] = at
            self._selected = selected

    def _decode(self, port: int) -> int | None:
        if self._enable != "tied" and bool(port >> ENABLE_LINE & 1) is not (self._enable == "active-high"):
            return None
        address = 0
        for bit, line in enumerate(self._address_lines):
            address |= self._stuck_bits.get(bit, port >> line & 1) << bit
        return address

    def _floating_voltage_v(self) -> float:
        # Inputs are asked only now for the voltage that they had when they were left, the newest first.
        while self._inputs_left_s:
            voltage_v = self._inputs(*self._inputs_left_s.popitem())
            if voltage_v is not None:
                self._held_v = voltage_v
                self._inputs_left_s.clear()
        return self._held_v
