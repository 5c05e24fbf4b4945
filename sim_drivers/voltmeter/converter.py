"""The measuring half of the simulated voltmeter: how long a reading takes and what it reads."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from sim_drivers.voltmeter.settings import RANGES_V, MeterSettings

OVERFLOW = "9.9E37"
OVERRANGE, DOWNRANGE = 1.2, 0.1
HIGHEST_V = 1010.0
# How many integration times a conversion takes with and without autozero: these fit the data sheet's 30 readings/s
# at 1 PLC with autozero, 50/s without, 5/s at 10 PLC.
_WITH_AUTOZERO, _WITHOUT_AUTOZERO, _FASTEST_S = 2.0, 1.2, 0.0005
_RANGE_CHANGE_S = 0.03
# Noise of the 10 V range by integration time, data sheet; it shrinks with the range down to a twentieth.
_NOISE_NPLC = (0.01, 0.1, 1.0, 10.0)
_NOISE_V = (150e-6, 22e-6, 4e-6, 1.5e-6)
_NOISE_FLOOR = 0.05
_NOISE_BLOCK = 512
# Without autozero the zero wanders by 2 ppm of range + 5 uV within ten minutes.
_DRIFT_S, _DRIFT_OF_RANGE, _DRIFT_V = 600.0, 2e-6, 5e-6


class Converter:
    """Turns the voltage at the terminals into readings.

    Parameters
    ----------
    input_voltage
        What is at the terminals [V], of time [s].
    random
        For the noise.
    line_period_s
        One power line cycle.

    Attributes
    ----------
    repeats_last_reading
        A fault: every reading is the last one, to the digit.
    """

    def __init__(
        self, input_voltage: Callable[[float], float], random: np.random.Generator, line_period_s: float
    ) -> None:
        self._input_voltage = input_voltage
        self._random = random
        self._line_period_s = line_period_s
        self.repeats_last_reading = False
        self._last_reading: str | None = None
        self._noise: list[float] = []
        self.range_v = RANGES_V[-1]
        self._autozero_off_s = 0.0
        self._was_autozero = True
        self.configure(MeterSettings(), 0.0)

    def configure(self, settings: MeterSettings, now: float) -> None:
        """Take new settings; the filter starts anew."""
        if self._was_autozero and not settings.autozero:
            self._autozero_off_s = now
        self._was_autozero = settings.autozero
        self._settings = settings
        share = _WITH_AUTOZERO if settings.autozero else _WITHOUT_AUTOZERO
        single_s = max(settings.nplc * self._line_period_s * share, _FASTEST_S)
        repeats = settings.filter_count if settings.filter_on and settings.filter_kind == "REP" else 1
        self.conversion_s = settings.trigger_delay_s + single_s * repeats
        self._middle_s = settings.trigger_delay_s + 0.5 * single_s * repeats
        if not settings.autorange:
            self.range_v = settings.range_v
        noise_v = math.exp(float(np.interp(math.log(settings.nplc), np.log(_NOISE_NPLC), np.log(_NOISE_V))))
        self._noise_v = noise_v / math.sqrt(repeats)
        moving = settings.filter_on and settings.filter_kind == "MOV"
        self._window: deque[float] | None = deque(maxlen=settings.filter_count) if moving else None

    def convert(self, start_s: float) -> tuple[str, float]:
        """Return a reading that begins at `start_s`, and when it is done."""
        if self.repeats_last_reading and self._last_reading is not None:
            return self._last_reading, start_s + self.conversion_s
        self._last_reading, end_s = self._measure(start_s)
        return self._last_reading, end_s

    def _measure(self, start_s: float) -> tuple[str, float]:
        settings = self._settings
        value = self._input_voltage(start_s + self._middle_s) if settings.function == "VOLT:DC" else 0.0
        if settings.autorange and self._choose_range(abs(value)):
            start_s += _RANGE_CHANGE_S
        end_s = start_s + self.conversion_s
        if not self._noise:
            self._noise = self._random.standard_normal(_NOISE_BLOCK).tolist()
        value += self._noise.pop() * self._noise_v * max(self.range_v / 10.0, _NOISE_FLOOR)
        if not settings.autozero:
            drifted = min((end_s - self._autozero_off_s) / _DRIFT_S, 1.0)
            value += (_DRIFT_OF_RANGE * self.range_v + _DRIFT_V) * drifted
        if self._window is not None:
            value = self._filtered(self._window, value)
        if not (abs(value) <= min(OVERRANGE * self.range_v, HIGHEST_V)):
            return settings.formatted(f"{'-' if value < 0 else '+'}{OVERFLOW}", overflow=True), end_s
        if settings.reference_on:
            value -= settings.reference_v
        if settings.math_on:
            value *= settings.math_factor
        return settings.formatted(f"{value:+.8E}"), end_s

    def _filtered(self, window: deque[float], value: float) -> float:
        # The first conversion fills the whole window.
        window.extend([value] * (1 if window else self._settings.filter_count))
        return sum(window) / len(window)

    def _choose_range(self, level_v: float) -> bool:
        index = before = RANGES_V.index(self.range_v)
        while index + 1 < len(RANGES_V) and level_v > OVERRANGE * RANGES_V[index]:
            index += 1
        while index > 0 and level_v < DOWNRANGE * RANGES_V[index]:
            index -= 1
        self.range_v = RANGES_V[index]
        if index != before and self._window is not None:
            self._window.clear()
        return index != before
