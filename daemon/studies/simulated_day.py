"""What a simulation knows beyond the service's own records: where the plane faces, and what it received."""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from operator import attrgetter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from daemon.base.records import Pose, Record
from daemon.config.settings import Settings
from daemon.store.tables import COLUMNS, Column, Row
from solar.ephemeris import extraterrestrial_dni, sun_direction
from solar.frames import Array, angles_within, azimuth_from_direction, normal_from_angles
from solar.skies.sky import sky

_STEP_S = 60.0
_PLANE = [Column(name, name, "float") for name in ("surface_tilt", "surface_azimuth")]
_SIMULATED = Column("simulated", "simulated", "bool", constant_value=True)


@dataclass(frozen=True, slots=True)
class OrientedPose(Pose):
    """A pose, and where the module's plane faces [deg]: tilt from the horizontal, azimuth from North clockwise."""

    surface_tilt: float = 0.0
    surface_azimuth: float = 0.0


# All fields of a pose, in their order. An attrgetter is fast: a simulated day has 20,000 poses.
_pose_values = attrgetter(*[field.name for field in fields(Pose)])


def _columns_of_simulation(kind: type[Row], columns: list[Column]) -> list[Column]:
    marked = any(column.name == _SIMULATED.name for column in columns)
    return [*columns, *(_PLANE if kind is Pose else ()), *(() if marked else (_SIMULATED,))]


SIMULATED_COLUMNS: dict[type[Row], tuple[str, list[Column]]] = {
    OrientedPose if kind is Pose else kind: (name, _columns_of_simulation(kind, columns))
    for kind, (name, columns) in COLUMNS.items()
}
"""The tables of a simulation: the service's own, with pvlib's names for poses, each row marked as simulated."""


def with_plane_orientation(record: Record, latitude_deg: float) -> Record:
    """Return a pose with where its plane faces at a latitude, anything else as it is."""
    if not isinstance(record, Pose):
        return record
    values: tuple[Any, ...] = (*_pose_values(record), *_plane(record.a_deg, record.b_deg, latitude_deg))
    return OrientedPose(*values)


# A tracker stands at one place for most of its poses.
@lru_cache(maxsize=256)
def _plane(a_deg: float, b_deg: float, latitude_deg: float) -> tuple[float, float]:
    azimuth, elevation = azimuth_from_direction(normal_from_angles(a_deg, b_deg), latitude_deg)
    return 90.0 - float(elevation), float(azimuth)


class WeatherOfSpan(Protocol):
    """The simulated rig's weather by UTC [s]."""

    def covers(self, utc_s: Array) -> NDArray[np.bool_]:
        """Tell for each instant whether there is weather."""

    def at(self, utc_s: Array) -> Any:
        """Return the conditions, with `dni_w_m2` and `dhi_w_m2`."""


@dataclass(frozen=True, slots=True)
class PlaneInsolation:
    """What a tracker's plane received, and what an ideal chronometric tracker's would have received [kWh/m2]."""

    tracker: str
    law: str
    received_kwh_m2: float
    chronometric_kwh_m2: float

    @property
    def gain_pct(self) -> float:
        """How much more than chronometric; NaN without light."""
        return 100.0 * (self.received_kwh_m2 / self.chronometric_kwh_m2 - 1.0) if self.chronometric_kwh_m2 else np.nan


class Poses:
    """Where the trackers stood; a subscriber of the bus."""

    def __init__(self) -> None:
        # UTC [s], A and B [deg], one after the other in a compact array: a year of a hundred trackers has to fit.
        self._poses: dict[str, array[float]] = {}

    def note(self, record: Record) -> None:
        """Take in a pose, unless it is the same as the last one."""
        if isinstance(record, Pose):
            kept = self._poses.setdefault(record.tracker, array("d"))
            if kept[-2:].tolist() != [record.a_deg, record.b_deg]:
                kept.extend((record.time_utc_s, record.a_deg, record.b_deg))

    def insolation(
        self, settings: Settings, weather: WeatherOfSpan, begin_s: float, end_s: float
    ) -> Iterator[PlaneInsolation]:
        """Yield what each tracker's plane received in a span of time [s UTC], under the simulation's own sky.

        It is summed minute by minute, by equation (1) of Andriamahefa et al. (2023) and the sky model of the
        simulation. The chronometric tracker points at the sun at every instant, within the same limits. Minutes without
        weather count for neither.
        """
        utc_s = np.arange(begin_s + _STEP_S / 2.0, end_s, _STEP_S)
        sun = sun_direction(utc_s, *settings.site.place())
        lit = (sun[:, 2] > 0.0) & weather.covers(utc_s)
        utc_s, sun = utc_s[lit], sun[lit]
        conditions = weather.at(utc_s)
        light = sky(settings.simulation.sky, sun, conditions.dni_w_m2, conditions.dhi_w_m2, extraterrestrial_dni(utc_s))
        for name, own in settings.trackers:
            normals = normal_from_angles(*self._angles_at(name, utc_s))
            ideal = normal_from_angles(*angles_within(sun, own.limits.limits()))
            on_plane, on_ideal = (light.irradiance_on(each, settings.simulation.albedo) for each in (normals, ideal))
            known = np.isfinite(on_plane)
            yield PlaneInsolation(
                tracker=name,
                law=own.law.driver,
                received_kwh_m2=float(on_plane[known].sum()) * _STEP_S / 3.6e6,
                chronometric_kwh_m2=float(on_ideal[known].sum()) * _STEP_S / 3.6e6,
            )

    def _angles_at(self, tracker: str, utc_s: Array) -> tuple[Array, Array]:
        """Return A and B at each instant: those of the latest pose, NaN before the first."""
        poses = np.append([-np.inf, np.nan, np.nan], self._poses.get(tracker, ())).reshape(-1, 3)
        latest = np.searchsorted(poses[:, 0], utc_s, side="right") - 1
        return poses[latest, 1], poses[latest, 2]
