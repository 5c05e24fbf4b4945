"""The simulated electronic load without its line: what is set, what is at the terminals, what trips.

It holds a photovoltaic source at a voltage. Left out: modes other than constant voltage (they can be selected and draw
nothing) and the transient generator.
"""

from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from sim_drivers.load.dialects import DIALECTS, RATINGS, DialectName
from sim_drivers.pv_source import SourceLight
from sim_drivers.scpi import ScpiStatus
from solar.frames import Array

OVERFLOW = 9.9e37
SETTLING_S = 0.003
_DROPPED_S = 0.02
_SETTLED = 1e-4
Trip = Literal["over-temperature", "over-voltage", "over-current", "over-power", "reverse-voltage"]
TRIPS: tuple[Trip, ...] = ("over-temperature", "over-voltage", "over-current", "over-power", "reverse-voltage")


class Source(Protocol):
    """What is at the terminals; `SourceLight` may hold arrays of the voltages' shape."""

    def light(self, now: float) -> SourceLight:
        """Return the state of the source at a time [s]."""

    def current(self, light: SourceLight, voltage_v: ArrayLike) -> Array:
        """Return the current [A] at a voltage."""

    def voltage(self, light: SourceLight, current_a: ArrayLike) -> Array:
        """Return the voltage [V] at a current."""


class Held(NamedTuple):
    """What truly is at the terminals, arrays of one shape, and whether the set voltage was met."""

    voltage_v: Array
    current_a: Array
    regulated: np.ndarray


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
    # What the terminals come from, None for the open circuit.
    _before_v: float | None

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

    def hold(self, light: SourceLight, level_v: ArrayLike) -> Held:
        """Return what is at the terminals while the load holds `level_v`, or comes as near as it can."""
        level, least_v, most_a = np.asarray(level_v, dtype=np.float64), self.rating.least_v, self.limit_a
        held_v = np.maximum(level, least_v)
        drawn_a = self.source.current(light, held_v)
        if (drawn_a > most_a).any():
            drawn_a = np.minimum(drawn_a, most_a)
            held_v = np.where(drawn_a < most_a, held_v, self.source.voltage(light, most_a))
        if (drawn_a < 0.0).any():
            held_v = np.where(drawn_a < 0.0, self.source.voltage(light, 0.0), held_v)
            drawn_a = np.maximum(drawn_a, 0.0)
        return Held(held_v, drawn_a, np.abs(held_v - level) < 1e-6)

    def trace(self, first: SourceLight, last: SourceLight, levels_v: Array, settle_s: float) -> tuple[Array, Array]:
        """Return the voltages and currents read at one level after another; fewer than the levels if it trips.

        The light goes evenly from `first` to `last`; the input is on before and, unless it trips, after.
        """
        count = levels_v.size
        light = SourceLight(*(np.linspace(before, after, count) for before, after in zip(first, last, strict=True)))
        voltage_v, current_a, _ = self.hold(light, levels_v)
        left = np.exp(-settle_s / SETTLING_S)
        if left > _SETTLED:
            before_v = np.concatenate([[float(self.source.voltage(first, 0.0))], voltage_v[:-1]])
            voltage_v = voltage_v + (before_v - voltage_v) * left
            current_a = np.clip(self.source.current(light, voltage_v), 0.0, self.limit_a)
        beyond = np.flatnonzero(voltage_v * current_a > self.rating.trips_w)
        if beyond.size:
            self.trip("over-power")
            voltage_v, current_a = voltage_v[: beyond[0]], current_a[: beyond[0]]
        return self._read_voltage(voltage_v), self._read_current(current_a)

    def read(self, now: float) -> tuple[float, float]:
        """Measure voltage and current; `OVERFLOW` beyond what the load can measure."""
        voltage_v, current_a, _ = self.at_terminals(now)
        return float(self._read_voltage(np.array(voltage_v))), float(self._read_current(np.array(current_a)))

    def at_terminals(self, now: float) -> tuple[float, float, bool]:
        """Return true voltage and current, and whether the set voltage is met; a limit that is passed trips."""
        light = self.source.light(now)
        open_v = float(self.source.voltage(light, 0.0))
        if open_v > self.rating.most_v:
            self.trip("over-voltage")
        if not self.draws or now < self._dropped_until_s:
            return open_v, 0.0, True
        held = self.hold(light, self.level_v)
        settled_v, before_v = float(held.voltage_v), open_v if self._before_v is None else self._before_v
        voltage_v = settled_v + (before_v - settled_v) * float(np.exp((self._changed_s - now) / SETTLING_S))
        current_a = float(np.clip(self.source.current(light, voltage_v), 0.0, self.limit_a))
        if voltage_v * current_a > self.rating.trips_w:
            self.trip("over-power")
            return open_v, 0.0, True
        return voltage_v, current_a, bool(held.regulated)

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
        self._before_v, self._changed_s = self.at_terminals(now)[0], now
        self.level_v = level_v

    def switch(self, now: float, *, on: bool) -> None:
        """Switch the input."""
        self._before_v, self._changed_s = None, now
        self.sweeps += on and not self.on
        self.on = on

    def set_mode(self, mode: str, now: float) -> None:
        """Change the mode, which drops the input for a moment."""
        self._dropped_until_s = now + _DROPPED_S
        self._before_v, self._changed_s = None, self._dropped_until_s
        self.mode = mode

    def reset(self, now: float) -> None:
        """Take the settings of ``*RST``: input off."""
        self.on = False
        self.mode = self.dialect.mode
        self.level_v, self.limit_a = self.rating.most_v, self.rating.most_a
        self.voltage_range = "HIGH"
        self.event_enable = 0
        self.selected = self.dialect.channels[0]
        self._before_v, self._changed_s, self._dropped_until_s = None, now, now

    def _power_up(self, now: float) -> None:
        self.scpi = ScpiStatus()
        self.latched = set()
        self.reset(now)

    def _read_voltage(self, true: Array) -> Array:
        return self._seen(true, self.rating.most_v, self.rating.noise_v)

    def _read_current(self, true: Array) -> Array:
        return self._seen(true, self.rating.most_a, self.rating.noise_a)

    def _seen(self, true: Array, most: float, noise: float) -> Array:
        readings = true + noise * self._random.standard_normal(true.shape)
        return np.where(np.abs(true) <= 1.02 * most, readings, OVERFLOW)
