"""A simulated LabJack T7: the registers of its analogue inputs, each against the next one or against ground."""

from collections.abc import Callable
from typing import Any

from drivers.cube.labjack import (
    AIN_NEGATIVE,
    AIN_RANGE,
    AIN_RESOLUTION,
    PRODUCT_ID,
    RANGES_V,
    SERIAL_NUMBER,
    TEST,
    TEST_WORDS,
    UNIT,
)
from drivers.modbus.pdu import ILLEGAL_ADDRESS, ILLEGAL_VALUE, words_for
from drivers.modbus.server import NoBits, RefusedRequestError

_INPUTS = 14
_GROUND = 199
# How far beyond its range the converter still measures.
_BEYOND = 1.05
_STEPS = 2.0**15


class SimulatedLabjack(NoBits):
    """The device, as a table of registers.

    Parameters
    ----------
    input_v
        The voltage [V] at an input against the next one, at a monotonic time.
    """

    def __init__(self, input_v: Callable[[int, float], float]) -> None:
        self.address = UNIT
        self.silent = False
        self.delay_s = 0.0
        self.corrupt = 0
        self.now_s = 0.0
        self.product = 7
        self.serial = 470012345
        self._input_v = input_v
        self.power_cycle(0.0)

    def power_cycle(self, now_s: float) -> None:  # noqa: ARG002 - it is there at once
        """Switch it off and on: the inputs measure 10 V against ground again."""
        self._range_v = [10.0] * _INPUTS
        self._negative = [_GROUND] * _INPUTS
        self._resolution = [0] * _INPUTS

    def state(self) -> dict[str, Any]:
        """Return who it is and how its inputs are set."""
        return {"make": f"T{self.product}", "serial": self.serial, "range_v": self._range_v, "silent": self.silent}

    def read(self, function: int, register: int, count: int) -> tuple[int, ...]:  # noqa: ARG002 - one table
        """Return registers; an input is measured when it is read."""
        known = {
            **dict(enumerate(TEST_WORDS, TEST)),
            **dict(enumerate(words_for(self.product, "float32"), PRODUCT_ID)),
            **dict(enumerate(words_for(self.serial, "uint32"), SERIAL_NUMBER)),
        }
        for each in range(_INPUTS):
            known |= dict(enumerate(words_for(self._range_v[each], "float32"), AIN_RANGE + 2 * each))
            known |= {AIN_NEGATIVE + each: self._negative[each], AIN_RESOLUTION + each: self._resolution[each]}
            if register <= 2 * each + 1 and 2 * each < register + count:
                known |= dict(enumerate(words_for(self._measured(each), "float32"), 2 * each))
        try:
            return tuple(known[each] for each in range(register, register + count))
        except KeyError:
            raise RefusedRequestError(ILLEGAL_ADDRESS) from None

    def write(self, function: int, register: int, values: tuple[int, ...]) -> None:  # noqa: ARG002 - one table
        """Set range, negative channel or resolution of an input."""
        each, odd = divmod(register - AIN_RANGE, 2)
        if 0 <= each < _INPUTS and not odd and len(values) == 2:
            range_v = next((known for known in RANGES_V if words_for(known, "float32") == values), None)
            if range_v is None:
                raise RefusedRequestError(ILLEGAL_VALUE)
            self._range_v[each] = range_v
        elif 0 <= register - AIN_NEGATIVE < _INPUTS and len(values) == 1:
            self._negative[register - AIN_NEGATIVE] = values[0]
        elif 0 <= register - AIN_RESOLUTION < _INPUTS and len(values) == 1:
            self._resolution[register - AIN_RESOLUTION] = values[0]
        else:
            raise RefusedRequestError(ILLEGAL_ADDRESS)

    def _measured(self, each: int) -> float:
        range_v, reach_v = self._range_v[each], self._range_v[each] * _BEYOND
        step_v = range_v / _STEPS
        return min(max(round(self._input_v(each, self.now_s) / step_v) * step_v, -reach_v), reach_v)
