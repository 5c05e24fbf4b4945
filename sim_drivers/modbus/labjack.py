"""A simulated LabJack T7 or T8: the registers of its analogue inputs, as LabJack's own list has them."""

import math
from collections.abc import Callable, Iterator
from typing import Any

from drivers.cube.labjack import (
    AIN_NEGATIVE,
    AIN_RANGE,
    AIN_RESOLUTION,
    AIN_SETTLING_US,
    PRODUCT_ID,
    RANGES_V,
    SERIAL_NUMBER,
    T7,
    T8,
    TEST,
    TEST_WORDS,
    UNIT,
)
from drivers.modbus.pdu import ILLEGAL_ADDRESS, ILLEGAL_VALUE, decode_number, encode_number
from drivers.modbus.server import NoBits, RefusedRequestError

BEST_INDEX = {T7: 12, T8: 16}
"""The highest resolution index of each type; that of a T7 is a T7-Pro's."""
_INPUTS = {T7: 14, T8: 8}
_GROUND = 199
_LONGEST_SETTLING_US = 50000.0
# A sensor's low side is held to ground by a resistor, over which the current of the input drops so much (assumed).
_ABOVE_GROUND_V = 0.002
_NO_READING = -9999.0
# How far beyond its range the converter still measures.
_OVER_RANGE_FACTOR = 1.05
_STEPS = 2.0**15


class SimulatedLabjack(NoBits):
    """The device, as a table of registers.

    Parameters
    ----------
    input_v
        The voltage [V] at an input against the next one (T7) or of its own pair (T8), at a monotonic time; NaN
        while it cannot measure.
    product
        Its type, 7 or 8.
    """

    def __init__(self, input_v: Callable[[int, float], float], product: int = T7) -> None:
        self.address = UNIT
        self.silent = False
        self.delay_s = 0.0
        self.corrupt = 0
        self.deaf_s = 0.0
        self.now_s = 0.0
        self.product = product
        self.serial = 470012345
        self._input_v = input_v
        self.power_cycle(0.0)

    def power_cycle(self, now_s: float) -> None:  # noqa: ARG002 - it is there at once
        """Switch it off and on: the inputs measure in the widest range, those of a T7 against ground."""
        inputs = _INPUTS[self.product]
        self._range_v = [RANGES_V[self.product][-1]] * inputs
        self._negative = [_GROUND] * inputs
        self._resolution = [0] * inputs
        self._settling_us = [0.0] * inputs

    def state(self) -> dict[str, Any]:
        """Return who it is and how its inputs are set."""
        return {"make": f"T{self.product}", "serial": self.serial, "range_v": self._range_v, "silent": self.silent}

    def read(self, function: int, register: int, count: int) -> tuple[int, ...]:  # noqa: ARG002 - one table
        """Return whole values, never a half of one; an input is measured when it is read."""
        known = dict(self._values(register, register + count))
        words: tuple[int, ...] = ()
        while len(words) < count and register + len(words) in known:
            words += known[register + len(words)]
        if len(words) != count:
            raise RefusedRequestError(ILLEGAL_ADDRESS)
        return words

    def write(self, function: int, register: int, values: tuple[int, ...]) -> None:  # noqa: ARG002 - one table
        """Set range, settling time, negative channel or resolution of an input, if its type can do that."""
        known = dict(self._values(0, 0))
        if len(known.get(register, ())) != len(values) or register in (TEST, PRODUCT_ID, SERIAL_NUMBER):
            raise RefusedRequestError(ILLEGAL_ADDRESS)
        if register >= AIN_SETTLING_US:
            self._set_settling((register - AIN_SETTLING_US) // 2, decode_number(values, "float32"))
        elif register >= AIN_RESOLUTION:
            _require(values[0] <= BEST_INDEX[self.product])
            self._resolution[register - AIN_RESOLUTION] = values[0]
        elif register >= AIN_NEGATIVE:
            self._set_negative(register - AIN_NEGATIVE, values[0])
        else:
            ranges = {encode_number(0.0, "float32"): RANGES_V[self.product][-1]}
            ranges |= {encode_number(each, "float32"): each for each in RANGES_V[self.product]}
            _require(values in ranges)
            self._range_v[(register - AIN_RANGE) // 2] = ranges[values]

    def _values(self, begin: int, end: int) -> Iterator[tuple[int, tuple[int, ...]]]:
        """Yield register and words of every value; of the inputs, those between two registers."""
        yield TEST, TEST_WORDS
        yield PRODUCT_ID, encode_number(self.product, "float32")
        yield SERIAL_NUMBER, encode_number(self.serial, "uint32")
        for each in range(len(self._range_v)):
            yield AIN_RANGE + 2 * each, encode_number(self._range_v[each], "float32")
            yield AIN_NEGATIVE + each, (self._negative[each],)
            yield AIN_RESOLUTION + each, (self._resolution[each],)
            yield AIN_SETTLING_US + 2 * each, encode_number(self._settling_us[each], "float32")
            if begin <= 2 * each < end:
                yield 2 * each, encode_number(self._measured(each), "float32")

    def _set_negative(self, each: int, channel: int) -> None:
        if self.product == T7:
            _require(channel == _GROUND or (each % 2 == 0 and channel == each + 1))
            self._negative[each] = channel

    def _set_settling(self, each: int, settling_us: float) -> None:
        if self.product == T7:
            _require(0.0 <= settling_us <= _LONGEST_SETTLING_US)
            self._settling_us[each] = settling_us

    def _measured(self, each: int) -> float:
        range_v, reach_v = self._range_v[each], self._range_v[each] * _OVER_RANGE_FACTOR
        step_v = range_v / _STEPS
        value_v = self._input_v(each, self.now_s)
        if math.isnan(value_v):
            return _NO_READING
        if self.product == T7 and self._negative[each] == _GROUND:
            value_v += _ABOVE_GROUND_V
        return min(max(round(value_v / step_v) * step_v, -reach_v), reach_v)


def _require(right: bool) -> None:
    if not right:
        raise RefusedRequestError(ILLEGAL_VALUE)
