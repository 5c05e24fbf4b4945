"""The real skies that `heliocube gain --weather` offers: a cloudless one anywhere, or a weather file at its site."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from daemon.base.errors import UserError
from daemon.studies.gain.choices import Device
from daemon.studies.gain.request import DeviceTilts
from solar.calibration.selection import clear_sky_ghi
from solar.ephemeris import Site
from solar.frames import Array
from solar.gain.ratios import Energies
from solar.gain.real_sky import (
    SkySeries,
    daylight,
    dual_irradiance,
    horizontal_irradiance,
    sky_series,
    static_irradiance,
    vertical_irradiance,
    year_instants,
)

CLEAR_STEP_S = 600.0
FILE_STEP_S = 60.0
_NEARLY_A_YEAR = 350
# A year of one latitude takes 3 MB, and a figure needs the same latitudes as the table before it.
_KEPT_LATITUDES = 20


@dataclass(frozen=True, slots=True)
class SkySource:
    """A sky for each latitude, sampled every `step_s`; `simulated` if a model made it."""

    label: str
    simulated: bool
    step_s: float
    series_at: Callable[[float], SkySeries]
    warning: str | None = None

    def energies(
        self, latitude: float, tilts: DeviceTilts, azimuths: Array, days: Array | None, against: tuple[Device, ...]
    ) -> Energies:
        """Return energies [Wh/m2] of shape (tilts, azimuths, days); without `days` (..., 1), summed over the whole sky.

        Devices that are not asked for are NaN, and so is light on the back of a static panel.
        """
        series = self.series_at(latitude)

        def energy(irradiance: Array) -> Array:
            watt_hours = irradiance * (self.step_s / 3600.0)
            if days is None:
                return np.array([watt_hours.sum()])
            return np.asarray(np.bincount(series.day, watt_hours, minlength=367)[days.astype(np.int64)])

        dual = energy(dual_irradiance(series))
        shape = (*tilts.static.shape[:2], dual.size)
        received = {device: np.full(shape, np.nan) for device in Device}
        for tilt, azimuth in np.ndindex(shape[:2]):
            at, deviation = (tilt, azimuth, 0), azimuths[azimuth]
            if Device.STATIC in against:
                received[Device.STATIC][at[:2]] = energy(static_irradiance(series, tilts.static[at], deviation))
            if Device.VERTICAL in against:
                received[Device.VERTICAL][at[:2]] = energy(vertical_irradiance(series, tilts.vertical[at]))
            if Device.HORIZONTAL in against:
                received[Device.HORIZONTAL][at[:2]] = energy(
                    horizontal_irradiance(series, tilts.horizontal[at], deviation)
                )
        return Energies(
            dual=dual,
            static=received[Device.STATIC],
            static_abs=np.full(shape, np.nan),
            vertical=received[Device.VERTICAL],
            horizontal=received[Device.HORIZONTAL],
        )


def clear_sky_source(longitude_deg: float, altitude_m: float) -> SkySource:
    """Return a cloudless sky for any latitude, over a year."""

    @lru_cache(maxsize=_KEPT_LATITUDES)
    def series_at(latitude_deg: float) -> SkySeries:
        site = Site(latitude_deg, longitude_deg, altitude_m)
        instants = daylight(site, year_instants(longitude_deg, CLEAR_STEP_S))
        _, dni, dhi = clear_sky_ghi(site, instants)
        return sky_series(site, instants, dni, dhi)

    return SkySource(label="clear sky", simulated=True, step_s=CLEAR_STEP_S, series_at=series_at)


def file_sky_source(
    path: Path, latitude_deg: float, longitude_deg: float | None, altitude_m: float | None, days: Array | None
) -> SkySource:
    """Return the sky of a weather file, at its one site.

    Raises
    ------
    UserError
        The file cannot be used, does not say its longitude and none is given, or has no daylight on the `days`.
    """
    from daemon.rigs.measured import read_weather, weather_notes  # noqa: PLC0415 - brings in the whole rig

    weather = read_weather(path)
    if longitude_deg is None and weather.site is None:
        raise UserError(f"weather file {path} does not say where it was measured; give its longitude with --lon")
    known = weather.site or Site(latitude_deg, 0.0, 0.0)
    site = Site(
        latitude_deg,
        known.longitude_deg if longitude_deg is None else longitude_deg,
        known.altitude_m if altitude_m is None else altitude_m,
    )
    steps = np.arange(weather.start_utc_s, weather.end_utc_s + 0.5 * FILE_STEP_S, FILE_STEP_S)
    lit = daylight(site, steps)
    instants = lit[weather.covers(lit)]
    conditions = weather.at(instants)
    series = sky_series(site, instants, conditions.dni_w_m2, conditions.dhi_w_m2)
    if days is not None and not np.isin(days, series.day).any():
        raise UserError(f"weather file {path} has no daylight on the days asked for with --day")
    if not instants.size:
        raise UserError(f"weather file {path} has no daylight at {latitude_deg:g} N, {site.longitude_deg:g} E")
    spans = [np.datetime_as_string(np.datetime64(int(end), "s"), unit="D") for end in (steps[0], steps[-1])]
    name = f"SIMULATED {path.name}" if weather.simulated else path.name
    label = f"{name}, {spans[0]} to {spans[1]}, {instants.size / lit.size:.0%} of its daylight"
    notes = weather_notes(weather, site)
    covered = np.unique(series.day).size
    if days is None and covered < _NEARLY_A_YEAR:
        days_told, those = ("1 day", "that day") if covered == 1 else (f"{covered} days", "those days")
        notes.append(
            f"{path.name} has {days_told}: the ratios under its sky are of {those} only, while the theory's are of a"
            " whole year"
        )
    return SkySource(
        label=label,
        simulated=weather.simulated,
        step_s=FILE_STEP_S,
        series_at=lambda _: series,
        warning="; ".join(notes) or None,
    )
