"""Measured weather and its gaps: bridged up to an hour, dark while the sun is down, otherwise missing data.

`simulate`, `run` and the studies treat gaps alike. While weather is missing by day, the simulated cube does not answer.
"""

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from daemon.base.clock import Clock
from daemon.base.errors import UserError
from drivers.errors import ConnectError
from drivers.interfaces import Cube, CubeReading
from sim_drivers.weather import WeatherError
from sim_drivers.weather_files import LONGEST_GAP_S, MeasuredWeather, load_weather, site_mismatch
from solar.ephemeris import Site, sun_position
from solar.frames import Array

_STEP_S = 60.0
# No scan takes longer, so a scan that has begun ends before a gap.
_AHEAD_S = 60.0


def missing_by_day(weather: MeasuredWeather, site: Site, utc_s: Array) -> Array:
    """Return those of the instants [s UTC] at which the sun is up and the file has no weather, within it or outside."""
    uncovered = utc_s[~weather.covers(utc_s)]
    return uncovered[sun_position(uncovered, *site).elevation_deg > 0.0] if uncovered.size else uncovered


def gap_note(
    weather: MeasuredWeather, site: Site, from_utc_s: float = -math.inf, to_utc_s: float = math.inf
) -> str | None:
    """Return a sentence on how much daylight is missing within the weather in a span of time, or None."""
    begin, end = max(from_utc_s, weather.start_utc_s), min(to_utc_s, weather.end_utc_s)
    missing = missing_by_day(weather, site, np.arange(begin, end, _STEP_S))
    if not missing.size:
        return None
    edges = np.flatnonzero(np.diff(weather.utc_s) > LONGEST_GAP_S)
    first = edges[np.searchsorted(weather.utc_s[edges + 1], missing[0])]
    hours = missing.size * _STEP_S / 3600.0
    return (
        f"{weather.name} has gaps of more than {LONGEST_GAP_S / 60.0:g} min: {hours:.1f} h of daylight are missing, the"
        f" first after {_iso(weather.utc_s[first])}, until {_iso(weather.utc_s[first + 1])}"
    )


def read_weather(path: Path) -> MeasuredWeather:
    """Read a weather file; `UserError` if it cannot be used."""
    try:
        return load_weather(path)
    except WeatherError as error:
        raise UserError(str(error)) from error


def weather_notes(
    weather: MeasuredWeather, site: Site, from_utc_s: float = -math.inf, to_utc_s: float = math.inf
) -> list[str]:
    """Return what a person should know of a file: impossible values, missing daylight, another site than `site`."""
    notes = (weather.note(), gap_note(weather, site, from_utc_s, to_utc_s), site_mismatch(weather, site))
    return [note for note in notes if note]


def merge_to_minutes(weathers: Sequence[MeasuredWeather], site: Site) -> tuple[tuple[Array, Array, Array], list[str]]:
    """Return whole minutes [s UTC] with DNI and DHI [W/m2] at each, and notes on the files for people.

    A gap between two files is bridged like one within a file, and reported as missing if it is too long. Where files
    overlap, the first counts. Raises `UserError` if no two whole minutes follow each other.
    """
    parts = zip(*map(_minutes, weathers), strict=True)
    utc_s, dni, dhi = (np.concatenate(columns) for columns in parts)
    utc_s, first = np.unique(utc_s, return_index=True)
    name = weathers[0].name if len(weathers) == 1 else "the weather of all files"
    if not utc_s.size:
        raise UserError(f"{name} has no two records within an hour with a whole minute between them")
    unknown = np.full(utc_s.size, np.nan)
    values = {"ghi": dni[first], "dni": dni[first], "dhi": dhi[first], "wind_speed": unknown, "temp_air": unknown}
    together = MeasuredWeather(name, utc_s, values)
    minutes = _minutes(together)
    if not (np.diff(minutes[0]) <= _STEP_S).any():
        raise UserError(f"{name} has only single minutes: name a file with at least two records within an hour")
    notes = [note for weather in weathers for note in (weather.note(), site_mismatch(weather, site))]
    return minutes, [note for note in (*notes, gap_note(together, site)) if note]


def _minutes(weather: MeasuredWeather) -> tuple[Array, Array, Array]:
    minutes = np.arange(np.ceil(weather.start_utc_s / _STEP_S), weather.end_utc_s / _STEP_S + 1e-6) * _STEP_S
    minutes = minutes[weather.covers(minutes)]
    conditions = weather.at(minutes)
    return minutes, conditions.dni_w_m2, conditions.dhi_w_m2


class CubeInGaps:
    """A simulated cube that does not answer while its weather is missing by day; beyond the file the weather raises.

    Parameters
    ----------
    cube
        The cube that answers while there is weather.
    weather, site, clock
        The weather, the place and the time.
    """

    def __init__(self, cube: Cube, weather: MeasuredWeather, site: Site, clock: Clock) -> None:
        self._cube = cube
        self._weather = weather
        self._site = site
        self._clock = clock

    async def open(self) -> str:
        """Connect, as soon as there is weather; raises `ConnectError` before."""
        self._refuse_in_gap()
        return await self._cube.open()

    async def close(self) -> None:
        """Release the instruments."""
        await self._cube.close()

    async def read(self) -> CubeReading:
        """Return a reading of all faces; raises `ConnectError` while there is no weather."""
        self._refuse_in_gap()
        return await self._cube.read()

    def _refuse_in_gap(self) -> None:
        now_s = self._clock.utc()
        instants = np.array([now_s, now_s + _AHEAD_S])
        inside = instants[(instants >= self._weather.start_utc_s) & (instants <= self._weather.end_utc_s)]
        if missing_by_day(self._weather, self._site, inside).size:
            raise ConnectError("cube", "the weather file has a gap here: nothing is read")


def _iso(utc_s: float) -> str:
    return datetime.fromtimestamp(utc_s, UTC).strftime("%Y-%m-%d %H:%MZ")
