"""The weather over the simulated rig: what every source of weather offers, and the built-in generator.

The generator's randomness is a function of (seed, quantity, instant) and of nothing else, so that the weather of an
instant is the same in whatever order or chunks it is asked for.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray
from pvlib.atmosphere import alt2pres
from pvlib.clearsky import simplified_solis

from solar.ephemeris import DAY_S, Site, extraterrestrial_dni, sun_position
from solar.frames import Array

WeatherKind = Literal["clear", "overcast", "variable", "broken"]

YEAR_S = 365.2425 * DAY_S
SPELL_S = 1500.0
BLEND_S = 240.0
# With these periods the cloud field changes by up to 0.01 a second: an edge takes 3 s or more to pass the sun.
EDGE = 0.03
CLOUD_PERIODS_S = (600.0, 210.0, 60.0)
CLOUD_WEIGHTS = (0.5, 0.35, 0.15)
# Chosen only to match the statistics of 149 days of a measured year (Lyngby, 2016, one-minute values; those on which
# the beam exceeded 120 W/m2 for 15 to 75 % of the time). The measured values, then these: changes past 120 W/m2 an hour
# 5.5, 6.5; minutes from one to the next, median 2.9, 2.4; length of the stretch that a minute lies in, mean 54, 49;
# time with less than 2, 30 and 70 % of the clear beam 47, 62 and 72 %, 47, 59 and 70 %; mean diffuse light in these
# four classes as a share of the clear GHI 0.36 0.52 0.48 0.32, 0.37 0.53 0.47 0.34.
BROKEN_PERIODS_S = (7200.0, 1200.0, 240.0, 60.0)
BROKEN_WEIGHTS = (0.4, 0.3, 0.2, 0.1)
BROKEN_COVER = 0.56
BROKEN_EDGE = 0.15
BROKEN_DEPTH = 0.2


class WeatherError(ValueError):
    """There is no weather to simulate with; the message is one sentence for the user."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """The weather at n instants, each field of shape (n,).

    Attributes
    ----------
    ghi_w_m2, dni_w_m2, dhi_w_m2
        Global horizontal, direct normal and diffuse horizontal irradiance, never negative.
    wind_speed_m_s, temp_air_degc
        NaN where they are not known.
    """

    ghi_w_m2: Array
    dni_w_m2: Array
    dhi_w_m2: Array
    wind_speed_m_s: Array
    temp_air_degc: Array


class Weather(Protocol):
    """A source of weather. Instants are arrays of shape (n,) [s since 1970-01-01 UTC]."""

    def at(self, utc_s: Array) -> Conditions:
        """Return the weather at those instants; `WeatherError` where there is none."""

    def covers(self, utc_s: Array) -> NDArray[np.bool_]:
        """Tell for each instant whether there is weather."""


class GeneratedWeather:
    """Made-up weather of one kind over one site, for any instant, day and night.

    Parameters
    ----------
    kind
        ``clear``: the simplified Solis clear sky (Ineichen 2008) with a haze that changes over days. ``overcast``: no
        beam, and diffuse light of 10 to 35 % of the clear-sky GHI that changes over minutes. ``variable``: spells of
        tens of minutes of clear sky, thick cloud and broken cloud; broken cloud blocks the beam with ramps of seconds
        and brightens the sky beside it, so that irradiance towards the sun exceeds that of a clear sky. ``broken``:
        thin and thick cloud and sun in turn, each for seconds or hours, as a year of measurements has them.
    seed
        Another seed is another weather of the same kind.

    Raises
    ------
    ValueError
        For a kind that does not exist.
    """

    def __init__(self, kind: WeatherKind, site: Site, seed: int) -> None:
        if kind not in get_args(WeatherKind):
            raise ValueError(f"there is no weather {kind!r}; choose one of {', '.join(get_args(WeatherKind))}")
        self._kind = kind
        self._site = site
        self._noise = Noise(seed)

    def covers(self, utc_s: Array) -> NDArray[np.bool_]:
        """Tell that there is weather always."""
        return np.ones(np.shape(utc_s), dtype=np.bool_)

    def at(self, utc_s: Array) -> Conditions:
        """Return the weather at instants of shape (n,)."""
        utc_s = np.asarray(utc_s, dtype=np.float64)
        elevation_deg = sun_position(utc_s, *self._site).elevation_deg
        clear = simplified_solis(
            elevation_deg,
            aod700=0.05 + 0.1 * self._noise.smooth("haze", utc_s, 2 * DAY_S),
            precipitable_water=1.5,
            pressure=alt2pres(self._site.altitude_m),
            dni_extra=extraterrestrial_dni(utc_s),
        )
        clear_dni, clear_dhi = clear["dni"], clear["dhi"]
        sine = np.maximum(np.sin(np.radians(elevation_deg)), 0.0)
        clear_ghi = clear_dni * sine + clear_dhi
        thick_dhi = clear_ghi * (0.1 + 0.25 * self._noise.fractal("thickness", utc_s, (2400.0, 600.0), (0.7, 0.3)))
        if self._kind == "clear":
            dni, dhi = clear_dni, clear_dhi
        elif self._kind == "overcast":
            dni, dhi = np.zeros(utc_s.shape), thick_dhi
        elif self._kind == "broken":
            blocked, cloud, flanks = self._broken_clouds(utc_s)
            dni = clear_dni * (1.0 - blocked)
            dhi = (1.0 - blocked) * (clear_dhi + flanks * clear_ghi) + blocked * cloud * clear_ghi
        else:
            blocked, brokenness, edge = self._clouds(utc_s)
            dni = clear_dni * (1.0 - blocked)
            # Sunlit flanks of broken clouds scatter towards the cube, most of all those beside the sun.
            flanks = brokenness * clear_ghi * (0.08 + 0.2 * edge * (1.0 - blocked))
            dhi = clear_dhi + blocked * (thick_dhi - clear_dhi) * (1.0 - 0.4 * brokenness) + flanks
        return Conditions(
            ghi_w_m2=dni * sine + dhi,
            dni_w_m2=dni,
            dhi_w_m2=dhi,
            wind_speed_m_s=self._wind(utc_s),
            temp_air_degc=self._temperature(utc_s),
        )

    def _clouds(self, utc_s: Array) -> tuple[Array, Array, Array]:
        """How far the beam is blocked, how broken the cloud is, how near its edge the sun stands; each 0..1."""
        cover, brokenness = self._spell(utc_s)
        field = self._noise.fractal("clouds", utc_s, CLOUD_PERIODS_S, CLOUD_WEIGHTS)
        inside = cover - field
        blocked = smoothstep(inside / EDGE + 0.5)
        edge = np.exp(-((inside / 0.06) ** 2))
        return blocked, brokenness, edge

    def _broken_clouds(self, utc_s: Array) -> tuple[Array, Array, Array]:
        """How far the beam is blocked, and the light of the cloud and of its flanks as shares of the clear GHI."""
        inside = BROKEN_COVER - self._noise.fractal("broken", utc_s, BROKEN_PERIODS_S, BROKEN_WEIGHTS)
        blocked = smoothstep(inside / BROKEN_EDGE + 0.5)
        thick = smoothstep((inside - 0.5 * BROKEN_EDGE) / BROKEN_DEPTH)
        # Thin cloud scatters most of what it takes from the beam forward, thick cloud sends it back.
        return blocked, 0.55 - 0.4 * thick, 0.05 + 0.15 * np.exp(-((inside / BROKEN_EDGE) ** 2))

    def _spell(self, utc_s: Array) -> tuple[Array, Array]:
        """Cloud cover (below 0 clear, above 1 closed) and brokenness; spells blend into one another."""
        slot = np.floor(utc_s / SPELL_S).astype(np.int64)
        spell = slot - (utc_s < self._spell_begin_utc_s(slot)) + (utc_s >= self._spell_begin_utc_s(slot + 1))
        share = smoothstep((utc_s - self._spell_begin_utc_s(spell)) / BLEND_S)
        before, now = self._spell_state(spell - 1), self._spell_state(spell)
        cover, brokenness = before + (now - before) * share
        return cover, brokenness

    def _spell_begin_utc_s(self, spell: NDArray[np.int64]) -> Array:
        """When spells begin [s UTC]: every 25 min, give or take 10 min."""
        return (spell + 0.8 * (self._noise.uniform("begin", spell) - 0.5)) * SPELL_S

    def _spell_state(self, spell: NDArray[np.int64]) -> Array:
        """Cover and brokenness of whole spells: 35 % clear, 30 % thick, 35 % broken."""
        kind = self._noise.uniform("spell", spell)
        broken = 0.38 + 0.24 * self._noise.uniform("cover", spell)
        cover = np.where(kind < 0.35, -0.02, np.where(kind < 0.65, 1.02, broken))
        return np.array([cover, np.where(kind < 0.65, 0.0, 1.0)])

    def _wind(self, utc_s: Array) -> Array:
        mean = 2.5 + 4.0 * self._noise.smooth("wind", utc_s, 10800.0)
        return mean * (0.75 + 0.5 * self._noise.fractal("gusts", utc_s, (120.0, 15.0), (0.5, 0.5)))

    def _temperature(self, utc_s: Array) -> Array:
        """Warmest in mid-afternoon and a month after the solstice."""
        latitude_deg, longitude_deg, altitude_m = self._site
        yearly = 27.0 - 0.35 * abs(latitude_deg) - 0.0065 * altitude_m
        season = -0.22 * latitude_deg * np.cos(2 * np.pi * (utc_s / YEAR_S - 20 / 365))
        hour_angle = 2 * np.pi * ((utc_s / DAY_S + longitude_deg / 360.0) % 1.0 - 15 / 24)
        day_to_day = 6.0 * (self._noise.smooth("warmth", utc_s, 1.5 * DAY_S) - 0.5)
        return yearly + season + (2.0 if self._kind == "overcast" else 5.0) * np.cos(hour_angle) + day_to_day


class Noise:
    """Random functions of time: each is fixed by the seed and a name, and can be evaluated anywhere."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def uniform(self, name: str, index: NDArray[np.int64]) -> Array:
        """Return independent numbers in 0..1, one for each integer `index`."""
        key = np.random.SeedSequence([self._seed, *name.encode()]).generate_state(1, np.uint64)
        # The output function of SplitMix64 (Steele, Lea & Flood 2014) turns a counter into white noise.
        with np.errstate(over="ignore"):
            mixed = key + index.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
            mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            mixed ^= mixed >> np.uint64(31)
        unit: Array = (mixed >> np.uint64(11)) * 2.0**-53
        return unit

    def smooth(self, name: str, utc_s: Array, period_s: float) -> Array:
        """Return a smooth function within 0..1 that is independent of itself after `period_s`."""
        phase = utc_s / period_s
        knot = np.floor(phase).astype(np.int64)
        before, after = self.uniform(name, knot), self.uniform(name, knot + 1)
        return before + (after - before) * smoothstep(phase - knot)

    def fractal(self, name: str, utc_s: Array, periods_s: tuple[float, ...], weights: tuple[float, ...]) -> Array:
        """Return a weighted sum of :meth:`smooth` functions of several periods; weights that add up to 1 give 0..1."""
        total = np.zeros(np.shape(utc_s))
        for period_s, weight in zip(periods_s, weights, strict=True):
            total += weight * self.smooth(f"{name} {period_s:g}", utc_s, period_s)
        return total


def smoothstep(x: Array) -> Array:
    """Return 0 below 0, 1 above 1, and a smooth rise between."""
    share = np.clip(x, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


class WeatherInParts:
    """Several weathers in turn, each blending into the next over 4 min about its beginning.

    Parameters
    ----------
    parts
        When each begins [s UTC], rising, and the weather itself; the first one is also the weather before.

    Raises
    ------
    ValueError
        There is no part, or they are not in the order of time.
    """

    def __init__(self, parts: Sequence[tuple[float, Weather]]) -> None:
        if not parts:
            raise ValueError("weather in parts needs one part at least")
        begins = [begin_utc_s for begin_utc_s, _ in parts]
        if not all(one < other for one, other in itertools.pairwise(begins)):
            raise ValueError(f"the parts of the weather must begin one after another, not at {begins}")
        self._parts = tuple(parts)

    def covers(self, utc_s: Array) -> NDArray[np.bool_]:
        """Tell for each instant whether every part has weather for it."""
        covered: NDArray[np.bool_] = np.all([weather.covers(utc_s) for _, weather in self._parts], axis=0)
        return covered

    def at(self, utc_s: Array) -> Conditions:
        """Return the weather at instants of shape (n,)."""
        now = self._parts[0][1].at(utc_s)
        values = {field.name: getattr(now, field.name) for field in fields(Conditions)}
        for begin_utc_s, weather in self._parts[1:]:
            then = weather.at(utc_s)
            share = smoothstep((np.asarray(utc_s) - begin_utc_s) / BLEND_S + 0.5)
            values = {name: value + share * (getattr(then, name) - value) for name, value in values.items()}
        return Conditions(**values)
