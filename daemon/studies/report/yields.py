"""What the tracker's plane received by the light of the cube, against chronometric tracking and the best pose."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from daemon.base.clock import iso_utc
from daemon.base.records import FACES
from daemon.studies.report.material import Material
from daemon.studies.report.span import ReportSpan
from solar.compare import longest_gap_s
from solar.ephemeris import DAY_S, solar_days, sun_direction
from solar.frames import Array
from solar.received import ReceivedIrradiance, insolation, received_irradiance
from solar.skies.sky_periods import LOWEST_SUN_DEG, Period, diffuse_fraction_of_faces, sky_periods

USUAL_ALBEDO = 0.2
DAYLIGHT_EVERY_S = 60.0
# The service records the pose of a tracker at rest more often than this.
_POSE_HOLDS_S = 900.0
_CHUNK = 20_000
_ROUNDING_S = 1.0


@dataclass(frozen=True, slots=True)
class RecordedLight:
    """The cube's readings in a span, and what follows from them.

    Attributes
    ----------
    utc_s, faces, sun
        Instants, shape (n,), the good readings [W/m2], shape (n, 4), and unit vectors to the sun, shape (n, 3).
    a_deg, b_deg
        Where the tracker stood then, NaN where that is not known.
    diffuse_fraction
        DHI/GHI by the paper's approximation, NaN without light.
    albedo, albedo_estimated
        Albedo of the ground, and whether it is the law's own mean estimate; otherwise it is the usual one.
    received
        What the three planes received.
    """

    utc_s: Array
    faces: Array
    sun: Array
    a_deg: Array
    b_deg: Array
    diffuse_fraction: Array
    albedo: float
    albedo_estimated: bool
    received: ReceivedIrradiance

    def part(self, start_utc_s: float, end_utc_s: float) -> slice:
        """Return where the instants of a stretch of time are."""
        first, last = np.searchsorted(self.utc_s, [start_utc_s, end_utc_s])
        return slice(int(first), int(last))

    def periods(self) -> list[Period]:
        """Return the clear, overcast and variable periods, while the sun is high enough to tell them."""
        told = self.sun[:, 2] >= np.sin(np.radians(LOWEST_SUN_DEG))
        return sky_periods(self.utc_s[told], self.diffuse_fraction[told])


@dataclass(frozen=True, slots=True)
class Yield:
    """Insolations [kWh/m2] of a stretch of time, over the time for which all three are known.

    Attributes
    ----------
    actual_kwh_m2, chronometric_kwh_m2, best_kwh_m2
        Insolation of the tracker's plane, of a chronometric tracker's, and of the bound.
    known_s, daylight_s
        The time for which they are known, and the time of daylight.
    faces_kwh_m2
        Measured by the faces east, south, west, zenith, each over its own good readings in daylight.
    """

    actual_kwh_m2: float
    chronometric_kwh_m2: float
    best_kwh_m2: float
    known_s: float
    daylight_s: float
    faces_kwh_m2: tuple[float, ...]

    @property
    def gain_pct(self) -> float:
        """Gain of the tracker over chronometric tracking [%]; NaN without light."""
        return _percent_over(self.actual_kwh_m2, self.chronometric_kwh_m2)

    @property
    def bound_pct(self) -> float:
        """Gain of the best pointing over chronometric tracking [%]; NaN without light."""
        return _percent_over(self.best_kwh_m2, self.chronometric_kwh_m2)

    @property
    def of_bound_pct(self) -> float:
        """What the tracker received, of what the best pointing would have received [%]; NaN without light."""
        return 100.0 * self.actual_kwh_m2 / self.best_kwh_m2 if self.best_kwh_m2 > 0.0 else np.nan

    @property
    def known_pct(self) -> float:
        """Share of daylight that is known [%]; NaN without daylight."""
        return 100.0 * min(self.known_s / self.daylight_s, 1.0) if self.daylight_s > 0.0 else np.nan


def light_of(material: Material) -> RecordedLight:
    """Return the light of a span and what the planes received in it."""
    utc_s, first = np.unique(material.times_of("scans"), return_index=True)
    faces = material.faces()[first]
    sun = _suns(utc_s, material)
    a_deg, b_deg = (latest_column_values(material, "poses", name, utc_s, _POSE_HOLDS_S) for name in ("a_deg", "b_deg"))
    albedo, estimated = _albedo(material, utc_s)
    return RecordedLight(
        utc_s=utc_s,
        faces=faces,
        sun=sun,
        a_deg=a_deg,
        b_deg=b_deg,
        diffuse_fraction=diffuse_fraction_of_faces(faces, USUAL_ALBEDO),
        albedo=float(np.mean(albedo)) if utc_s.size else USUAL_ALBEDO,
        albedo_estimated=estimated,
        received=received_irradiance(faces, sun, a_deg, b_deg, material.limits, albedo),
    )


def yield_of(material: Material, light: RecordedLight, start_utc_s: float, end_utc_s: float) -> Yield:
    """Return the insolations of a stretch of time."""
    part = light.part(start_utc_s, end_utc_s)
    utc_s = light.utc_s[part]
    (actual, known_s), (chronometric, _), (best, _) = (insolation(utc_s, plane[part]) for plane in light.received)
    lit = np.where(light.sun[part][:, 2:] > 0.0, light.faces[part], np.nan)
    return Yield(
        actual_kwh_m2=actual,
        chronometric_kwh_m2=chronometric,
        best_kwh_m2=best,
        known_s=known_s,
        daylight_s=daylight_s(material, start_utc_s, end_utc_s),
        faces_kwh_m2=tuple(insolation(utc_s, lit[:, face])[0] for face in range(len(FACES))),
    )


def module_kwh(material: Material, start_utc_s: float, end_utc_s: float) -> tuple[float, float]:
    """Return the module's maximum energy [kWh] by its I-V curves, and the time [s] that good curves stand for."""
    curves = material.tables["curves"]
    if not len(curves):
        return 0.0, 0.0
    utc_s = material.times_of("curves")
    inside = (utc_s >= start_utc_s) & (utc_s < end_utc_s)
    power = np.where(curves["quality"] == "ok", material.column("curves", "pmpp_w"), np.nan)
    return insolation(utc_s[inside], power[inside], longest_gap_s(utc_s[inside]))


def daylight_s(material: Material, start_utc_s: float, end_utc_s: float, lowest_deg: float = 0.0) -> float:
    """Return how long the sun is higher than `lowest_deg` between two instants [s]."""
    middles = np.arange(start_utc_s + DAYLIGHT_EVERY_S / 2.0, end_utc_s, DAYLIGHT_EVERY_S)
    higher = _suns(middles, material)[:, 2] > np.sin(np.radians(lowest_deg))
    return float(np.count_nonzero(higher)) * DAYLIGHT_EVERY_S


def days_of(material: Material) -> list[ReportSpan]:
    """Return the days of the site in a span, each with its date as its name; a span of up to a day is one.

    Days begin at solar midnight. A part at either end without daylight belongs to the day beside it.
    """
    span, longitude_deg = material.span, material.site.longitude_deg
    # The ends may be midnights themselves, apart from rounding.
    first, last = (
        int(solar_days(at, longitude_deg)) for at in (span.start_utc_s + _ROUNDING_S, span.end_utc_s - _ROUNDING_S)
    )
    if span.duration_s <= DAY_S:
        first = last = int(solar_days((span.start_utc_s + span.end_utc_s) / 2.0, longitude_deg))
    midnights = [day * DAY_S - longitude_deg * 240.0 for day in range(first + 1, last + 1)]
    edges = [span.start_utc_s, *midnights, span.end_utc_s]
    found = [
        ReportSpan(begins_s, ends_s, iso_utc(day * DAY_S)[:10])
        for day, (begins_s, ends_s) in zip(range(first, last + 1), pairwise(edges), strict=True)
    ]
    if _dark_part(material, found[-1]) and len(found) > 1:
        found[-2:] = [replace(found[-2], end_utc_s=span.end_utc_s)]
    if _dark_part(material, found[0]) and len(found) > 1:
        found[:2] = [replace(found[1], start_utc_s=span.start_utc_s)]
    return found


def _dark_part(material: Material, day: ReportSpan) -> bool:
    part = day.duration_s < DAY_S - 2.0 * _ROUNDING_S
    return part and not daylight_s(material, day.start_utc_s, day.end_utc_s)


def sun_up(material: Material, utc_s: Array) -> Array:
    """Return 1.0 where the sun is up at instants [s], 0.0 elsewhere."""
    return (_suns(utc_s, material)[:, 2] > 0.0).astype(np.float64)


def latest_column_values(material: Material, kind: str, name: str, utc_s: Array, holds_s: float) -> Array:
    """Return a column's newest value at each instant [s]; NaN before the first and once it is older than `holds_s`."""
    return latest_values(material.times_of(kind), material.column(kind, name), utc_s, holds_s)


def latest_values(times: Array, values: Array, utc_s: Array, holds_s: float) -> Array:
    """Return, at each instant, the newest of `values` at rising `times` [s], as :func:`latest_column_values` does."""
    if not times.size:
        return np.full(utc_s.shape, np.nan)
    place = np.searchsorted(times, utc_s, side="right") - 1
    fresh = (place >= 0) & (utc_s - times[place] <= holds_s)
    return np.where(fresh, values[place], np.nan)


def _suns(utc_s: Array, material: Material) -> Array:
    parts = [sun_direction(utc_s[first : first + _CHUNK], *material.site) for first in range(0, utc_s.size, _CHUNK)]
    return np.concatenate([np.empty((0, 3)), *parts])


def _albedo(material: Material, utc_s: Array) -> tuple[Array, bool]:
    """Return the law's estimate at each instant, or the usual albedo where no law estimates it."""
    known = np.isfinite(material.column("decisions", "albedo_est"))
    if not known.any():
        return np.full(utc_s.shape, USUAL_ALBEDO), False
    return np.interp(
        utc_s, material.times_of("decisions")[known], material.column("decisions", "albedo_est")[known]
    ), True


def _percent_over(value: float, reference: float) -> float:
    return 100.0 * (value / reference - 1.0) if reference > 0.0 else np.nan
