"""A simulated meter with a scanner card: the converter and the line of the simulated Keithley 2000, four channels.

Left out is what the driver has no use for: other functions than DC voltage, limits, and more than one scan in memory.
"""

from collections.abc import Callable, Collection, Sequence
from itertools import cycle, islice
from typing import Literal

import numpy as np

from sim_drivers.scpi import ScpiError
from sim_drivers.voltmeter.core import VoltmeterCore
from sim_drivers.voltmeter.instrument import MAXIMUM_READINGS

ScannerMake = Literal["keithley2000-scan", "dmm6500", "daq6510", "agilent34970a"]

IDENTITIES: dict[str, str] = {
    "keithley2000-scan": "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02",
    "dmm6500": "KEITHLEY INSTRUMENTS,MODEL DMM6500,04340543,1.7.12b",
    "daq6510": "KEITHLEY INSTRUMENTS,MODEL DAQ6510,04340543,1.7.12b",
    "agilent34970a": "HEWLETT-PACKARD,34970A,0,13-2-2",
}
CARDS: dict[str, str] = {
    "keithley2000-scan": "2000-SCAN",
    "dmm6500": "2000,10-Chan Mux,0.0.0a,1234567",
    "daq6510": "7700,20Ch Mux w/CJC,0.0.0a,1234567",
    "agilent34970a": "HEWLETT-PACKARD,34901A,0,1.0",
}
NO_CARD: dict[str, str] = {"agilent34970a": "HEWLETT-PACKARD,0,0,0"}
_LONGEST_NUMBER = 9
_HARDWARE_MISSING = -241
_RELAY_S = 0.005
# How fast an open channel drifts from the voltage of the one before it (assumed: 50 pA into 1 nF of cable).
_DRIFT_V_PER_S = 0.05


class ScannerInstrument(VoltmeterCore):
    """What the commands of a scanning meter act on.

    Parameters
    ----------
    make
        Whose commands it speaks.
    sensor_v
        What is at a channel [V] at a time [s]; None where nothing is connected: such a channel of a Keithley 2000
        floats away from the voltage of the one before it.
    random
        For the noise and for corrupted replies.
    slots
        Numbers of the slots that have a card; its first ten channels are used.
    now
        The time of power-up.

    Attributes
    ----------
    card
        What the card in its slot says that it is; empty where there is no card.
    scan_list
        The channels that a scan takes.
    scanning
        Whether a trigger takes a scan, for a make that has to be told so.
    """

    def __init__(
        self,
        make: ScannerMake,
        sensor_v: Callable[[int, float], float | None],
        random: np.random.Generator,
        *,
        slots: Collection[int] = (1,),
        line_frequency_hz: float = 50.0,
        now: float = 0.0,
    ) -> None:
        self.make = make
        self.slots = tuple(slots)
        self.card = CARDS[make]
        self.scan_list: tuple[int, ...] = ()
        self.scanning = False
        self.scans = 1
        self.with_channels = False
        self._sensor_v = sensor_v
        self._held_v, self._held_at_s = 0.0, now
        self._channel: int | None = None
        self._buffer_of_scan: tuple[tuple[str, int], ...] = ()
        self._scanned_s = now
        super().__init__(
            self._at_the_terminals, random, line_frequency_hz=line_frequency_hz, identity=IDENTITIES[make], now=now
        )

    def channels(self, text: str) -> tuple[int, ...]:
        """Read a channel list; `ScpiError` for text that is none, and for a channel that the card does not have."""
        if not (text.startswith("(@") and text.endswith(")")):
            raise ScpiError(-224)
        counts_slots = self.make in ("daq6510", "agilent34970a")
        there = {(100 * slot if counts_slots else 0) + number for slot in self.slots for number in range(1, 11)}
        found: list[int] = []
        for part in text[2:-1].split(","):
            first, _, last = part.strip().partition(":")
            ends = [_channel(end) for end in (first, last or first)]
            if not there.issuperset(ends):
                raise ScpiError(-222)
            found += range(ends[0], ends[1] + 1)
        if not found or not there.issuperset(found):
            raise ScpiError(-222)
        if not self.card:
            raise ScpiError(_HARDWARE_MISSING)
        return tuple(found)

    def scan(self, cursor_s: float) -> tuple[tuple[str, int], ...]:
        """Measure every channel of the list; return the readings with their channels, in the order of the scan."""
        if not self.scan_list:
            raise ScpiError(-221)
        # This family takes its channels in ascending order, whatever order they were given in.
        order = sorted(self.scan_list) if self.make == "agilent34970a" else self.scan_list
        self._buffer_of_scan = self._measure_channels(order, cursor_s)
        return self._buffer_of_scan

    def begin_scan(self, cursor_s: float) -> None:
        """Scan while the commands after this one are carried out."""
        if cursor_s < self._scanned_s:
            raise ScpiError(-213)
        self.scan(cursor_s)
        self._scanned_s, self._cursor_s = self._cursor_s, cursor_s

    def wait(self) -> None:
        """Let what follows wait for the end of the scan."""
        self._cursor_s = max(self._cursor_s, self._scanned_s)

    def abort(self) -> None:
        """Go back to idle at once."""
        super().abort()
        self._scanned_s = self._now

    def _measure(self, cursor_s: float) -> None:
        if not self.scanning:
            super()._measure(cursor_s)
            return
        if not self.scan_list:
            raise ScpiError(-221)
        settings = self.settings
        count = min(settings.sample_count * settings.trigger_count, MAXIMUM_READINGS)
        pairs = self._measure_channels(tuple(islice(cycle(self.scan_list), count)), cursor_s)
        parts = [part for text, channel in pairs for part in (text, str(channel))[: len(settings.elements)]]
        self._last = ",".join(parts)

    def _measure_channels(self, channels: Sequence[int], cursor_s: float) -> tuple[tuple[str, int], ...]:
        """Measure channels one after another."""
        readings = []
        for channel in channels:
            self._channel = channel
            text, cursor_s = self._converter.convert(cursor_s + _RELAY_S)
            # The converter adds its own channel where one is asked for: keep the reading alone.
            readings.append((text.partition(",")[0], channel))
        self._channel, self._cursor_s = None, cursor_s
        return tuple(readings)

    def clear_buffer(self) -> None:
        """Forget what was measured."""
        self._buffer_of_scan = ()

    def buffered(self, first: int, last: int) -> tuple[tuple[str, int], ...]:
        """Return readings of the buffer, counted from 1; `ScpiError` for those that are not there, or not yet."""
        if self._cursor_s < self._scanned_s or not 1 <= first <= last <= len(self._buffer_of_scan):
            raise ScpiError(-222)
        return self._buffer_of_scan[first - 1 : last]

    def forget_scan(self) -> None:
        """Have no scan list, as after ``*RST``."""
        self.scan_list, self.scanning, self.scans, self.with_channels = (), False, 1, False
        self.clear_buffer()

    def _at_the_terminals(self, now_s: float) -> float:
        value_v = None if self._channel is None else self._sensor_v(self._channel, now_s)
        if value_v is None:
            # The other makes have 10 Mohm across their inputs after *RST, the 2000 more than 10 Gohm.
            floats = self.make == "keithley2000-scan"
            return self._held_v + _DRIFT_V_PER_S * (now_s - self._held_at_s) if floats else 0.0
        self._held_v, self._held_at_s = value_v, now_s
        return value_v

    def _power_up(self, now: float) -> None:
        super()._power_up(now)
        self.forget_scan()


def _channel(text: str) -> int:
    if not text.isdecimal():
        raise ScpiError(-224)
    if len(text) > _LONGEST_NUMBER:
        raise ScpiError(-222)
    return int(text)
