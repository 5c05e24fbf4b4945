"""The simulated Keithley 2000 without its line: what is set, what is measured and when, triggers, status.

Left out: functions other than DC voltage (they can be selected and read about zero) and the reading buffer.
"""

import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from sim_drivers.scpi import ScpiError, ScpiStatus
from sim_drivers.voltmeter.converter import Converter
from sim_drivers.voltmeter.settings import PRESET, RANGES_V, MeterSettings

MAXIMUM_READINGS = 1024
"""The most readings that one answer can have."""


class VoltmeterInstrument:
    """What the commands of the meter act on.

    Parameters
    ----------
    input_voltage
        What is at the terminals [V], of time [s]. It is asked for the middle of a conversion.
    random
        For the noise.
    line_frequency_hz
        Detected at power-up; sets the length of a power line cycle.
    identity
        What it answers to ``*IDN?``.
    now
        The time of power-up, from which the meter measures freely.
    """

    def __init__(
        self,
        input_voltage: Callable[[float], float],
        random: np.random.Generator,
        *,
        line_frequency_hz: float,
        identity: str,
        now: float,
    ) -> None:
        if not (45.0 <= line_frequency_hz <= 440.0):
            raise ValueError(f"the line frequency must be 45 to 440 Hz, not {line_frequency_hz}")
        self.identity: str = identity
        self.settings: MeterSettings = PRESET
        self.status: ScpiStatus = ScpiStatus()
        self._converter = Converter(input_voltage, random, 1.0 / line_frequency_hz)
        self._now = self._cursor_s = self._ready_s = self._free_since_s = now
        self._free_index = 0
        self._awaits_trigger = False
        self._last: str | None = None
        self._power_up(now)

    @property
    def range_v(self) -> float:
        """The range in use [V]."""
        return self._converter.range_v

    def freeze(self, *, is_frozen: bool = True) -> None:
        """Let every reading be the last one, or measure again."""
        self._converter.repeats_last_reading = is_frozen

    def press_range(self, range_v: float, now: float) -> None:
        """Choose a range at the front panel, which does nothing while the panel is locked out."""
        if range_v not in RANGES_V:
            raise ValueError(f"the meter has the ranges {RANGES_V} V, not {range_v}")
        if self.settings.panel != "RWL":
            self.change(now, range_v=range_v, autorange=False)

    def change(self, now: float, **settings: Any) -> None:
        """Apply settings as a command does; free running starts anew."""
        self.settings = replace(self.settings, **settings)
        self._converter.configure(self.settings, now)
        self._free_since_s, self._free_index = now, 0

    def read(self, cursor_s: float) -> str | None:
        """Measure and answer; None while a trigger has to come first."""
        self.initiate(cursor_s)
        return None if self._awaits_trigger else self._last

    def initiate(self, cursor_s: float) -> None:
        """Leave idle for the programmed number of readings."""
        if self.settings.continuous:
            raise ScpiError(-213)
        if self.settings.trigger_source in ("IMM", "TIM"):
            self._measure(cursor_s)
        else:
            self._awaits_trigger = True

    def trigger(self, cursor_s: float) -> None:
        """Take a trigger from the bus."""
        if self._awaits_trigger and self.settings.trigger_source == "BUS":
            self._awaits_trigger = False
            self._measure(cursor_s)

    def fetch(self, cursor_s: float) -> str:
        """Answer with the latest reading."""
        if self.settings.continuous:
            self._catch_up(cursor_s)
        if self._last is None or self._awaits_trigger:
            raise ScpiError(-230)
        return self._last

    def abort(self) -> None:
        """Go back to idle at once."""
        self._awaits_trigger = False
        self._ready_s = self._cursor_s = self._now

    def reset(self, settings: MeterSettings) -> None:
        """Take all settings from ``*RST`` or from the bench defaults; the front panel stays as it is."""
        self.abort()
        self._last = None
        chosen = {field.name: getattr(settings, field.name) for field in fields(settings)}
        self.change(self._now, **(chosen | {"panel": self.settings.panel}))

    def status_byte(self) -> int:
        """Return the status byte under the present masks."""
        return self.status.byte(self.settings.event_enable, self.settings.request_enable)

    def _power_up(self, now: float) -> None:
        self.settings = PRESET
        self.status = ScpiStatus()
        self._now = now
        self.reset(PRESET)

    def _measure(self, cursor_s: float) -> None:
        count = min(self.settings.sample_count * self.settings.trigger_count, MAXIMUM_READINGS)
        readings = []
        for _ in range(count):
            reading, cursor_s = self._converter.convert(cursor_s)
            readings.append(reading)
        self._last = ",".join(readings)
        self._cursor_s = cursor_s

    def _catch_up(self, cursor_s: float) -> None:
        # Readings of free running that nobody fetches are never computed; the first one is waited for.
        period_s = self._converter.conversion_s
        index = max(math.floor((cursor_s - self._free_since_s) / period_s), 1)
        if index > self._free_index:
            self._free_index = index
            self._last, end_s = self._converter.convert(self._free_since_s + (index - 1) * period_s)
            self._cursor_s = max(cursor_s, end_s)
