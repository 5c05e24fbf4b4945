"""The simulated electronic load without its line: what is set, what is at the terminals, what trips.

It holds a photovoltaic source at a voltage. Left out: modes other than constant voltage (they can be selected and draw
nothing) and the transient generator.
"""

import math
from typing import Literal, NamedTuple, Protocol

import numpy as np

from sim_drivers.load.dialects import DIALECTS, RATINGS, DialectName
from sim_drivers.pv_source import SourceLight
from sim_drivers.scpi import ScpiStatus

OVERFLOW = 9.9e37
SETTLING_S = 0.003
_DROPPED_S = 0.02
_SETTLED_V = 1e-4
Trip = Literal["over-temperature", "over-voltage", "over-current", "over-power", "reverse-voltage"]
TRIPS: tuple[Trip, ...] = ("over-temperature", "over-voltage", "over-current", "over-power", "reverse-voltage")


class Source(Protocol):
    """What is at the terminals."""

    def light(self, now: float) -> SourceLight:
        """Return the state of the source at a time [s]."""

    def current(self, light: SourceLight, voltage_v: float) -> float:
        """Return the current [A] at a voltage."""

    def voltage(self, light: SourceLight, current_a: float) -> float:
        """Return the voltage [V] at a current."""


class OperatingPoint(NamedTuple):
    """What truly is at the terminals, and whether the set voltage was met."""

    voltage_v: float
    current_a: float
    regulated: bool


class LoadInstrument:
    """What the commands of a load act on.

    Parameters
    ----------
    source
        What feeds it.
    random
        For the noise of readings.
    make
        Whose commands it speaks.
    channel
        Which channel of a mainframe the source is on; of no meaning for a load with one.
    now
        The time of power-up, with the input off.

    Attributes
    ----------
    on, mode, level_v, limit_a
        What is set; see `draws` for whether current flows.
    latched
        The protections that have tripped.
    sweeps
        How often the input has been switched on.
    """

    on: bool
    mode: str
    level_v: float
    limit_a: float
    voltage_range: str
    event_enable: int
    selected: int
    latched: set[Trip]
    scpi: ScpiStatus
    # The voltage from which the terminals settle; None for that of the open circuit.
    _settles_from_v: float | None

    def __init__(
        self, source: Source, random: np.random.Generator, *, make: DialectName, channel: int, now: float
    ) -> None:
        if channel not in DIALECTS[make].channels:
            raise ValueError(f"{make} has the channels {DIALECTS[make].channels}, not {channel}")
        self.make: DialectName = make
        self.dialect = DIALECTS[make]
        self.rating = RATINGS[make]
        self.identity: str = self.dialect.identity
        self.channel = channel
        self.sweeps = 0
        self.source = source
        self._random = random
        self._power_up(now)

    @property
    def draws(self) -> bool:
        """Whether it would draw current: the input is on, in constant voltage, and no protection is latched."""
        return self.on and self.mode.startswith(("VOLT", "CV")) and not self.latched

    def operating_point(self, light: SourceLight) -> OperatingPoint:
        """Return what is at the terminals while the load holds its voltage, or comes as near as it can."""
        held_v, most_a = max(self.level_v, self.rating.least_v), self.limit_a
        drawn_a = self.source.current(light, held_v)
        if not 0.0 <= drawn_a <= most_a:
            drawn_a = most_a if drawn_a > most_a else 0.0
            held_v = self.source.voltage(light, drawn_a)
        return OperatingPoint(held_v, drawn_a, abs(held_v - self.level_v) < 1e-6)

    def read(self, now: float) -> tuple[float, float]:
        """Measure voltage and current; `OVERFLOW` beyond what the load can measure."""
        voltage_v, current_a, _ = self.at_terminals(now)
        rating = self.rating
        return (
            self._reading_of(voltage_v, rating.most_v, rating.noise_v),
            self._reading_of(current_a, rating.most_a, rating.noise_a),
        )

    def at_terminals(self, now: float) -> tuple[float, float, bool]:
        """Return true voltage and current, and whether the set voltage is met; a limit that is passed trips."""
        light = self.source.light(now)
        open_v = self.source.voltage(light, 0.0)
        if open_v > self.rating.most_v:
            self.trip("over-voltage")
        if not self.draws or now < self._dropped_until_s:
            return open_v, 0.0, True
        voltage_v, current_a, regulated = self.operating_point(light)
        left_v = (open_v if self._settles_from_v is None else self._settles_from_v) - voltage_v
        left_v *= math.exp((self._changed_s - now) / SETTLING_S)
        if not abs(left_v) < _SETTLED_V:
            voltage_v += left_v
            current_a = min(max(self.source.current(light, voltage_v), 0.0), self.limit_a)
        if voltage_v * current_a > self.rating.trips_w:
            self.trip("over-power")
            return open_v, 0.0, True
        return voltage_v, current_a, regulated

    def status(self, now: float) -> int:
        """Return the status bits of the channel."""
        bits = sum(self.dialect.bits[trip] for trip in TRIPS if trip in self.latched)
        if self.latched & {"over-current", "over-power", "over-temperature"}:
            bits |= self.dialect.shutdown_bit
        if self.draws and not self.at_terminals(now)[2]:
            bits |= self.dialect.unregulated_bit
        return bits

    def trip(self, name: Trip) -> None:
        """Latch a protection: no current flows until it is cleared."""
        self.latched.add(name)

    def set_level(self, level_v: float, now: float) -> None:
        """Take a new voltage; the terminals follow within some milliseconds."""
        self._settles_from_v, self._changed_s = self.at_terminals(now)[0], now
        self.level_v = level_v

    def switch(self, now: float, *, on: bool) -> None:
        """Switch the input."""
        self._settles_from_v, self._changed_s = None, now
        self.sweeps += on and not self.on
        self.on = on

    def set_mode(self, mode: str, now: float) -> None:
        """Change the mode, which drops the input for a moment."""
        self._dropped_until_s = now + _DROPPED_S
        self._settles_from_v, self._changed_s = None, self._dropped_until_s
        self.mode = mode

    def reset(self, now: float) -> None:
        """Take the settings of ``*RST``: input off."""
        self.on = False
        self.mode = self.dialect.mode
        self.level_v, self.limit_a = self.rating.most_v, self.rating.most_a
        self.voltage_range = "HIGH"
        self.event_enable = 0
        self.selected = self.dialect.channels[0]
        self._settles_from_v, self._changed_s, self._dropped_until_s = None, now, now

    def _power_up(self, now: float) -> None:
        self.scpi = ScpiStatus()
        self.latched = set()
        self.reset(now)

    def _reading_of(self, true: float, most: float, noise: float) -> float:
        reading = true + noise * self._random.standard_normal()
        return reading if abs(true) <= 1.02 * most else OVERFLOW
