"""A store with days of known records: a uniform sky, a tracker that lies flat till noon and then tilts."""

import math

import numpy as np

from daemon.base.clock import SystemClock
from daemon.base.records import (
    NO_ESTIMATE,
    Decision,
    Event,
    FaceReading,
    Irradiances,
    Mode,
    ModeChange,
    Move,
    MoveOutcome,
    Pose,
    Quality,
    Scan,
    Target,
)
from daemon.store.store import Origin, Store
from solar.energy import arrange_daylight, build_sky, face_irradiances
from solar.ephemeris import Site

DAY_S = 86400.0
T0 = 1665705600.0
"""2022-10-14T00:00Z, a Friday."""
SITE = Site(48.7, 0.0, 156.0)
"""On the prime meridian: its solar midnight is UTC's."""
EVERY_S = 60.0
DNI, DHI = 500.0, 100.0
GAP = (T0 + 15 * 3600, T0 + 15 * 3600 + 1800.0)
FLAGGED = (T0 + 11 * 3600, T0 + 11 * 3600 + 600.0)
HOSTILE_NAME = "<script>alert('x')</script>"


def instants(days):
    return T0 + np.arange(0.0, days * DAY_S, EVERY_S)


def faces_of(utc_s):
    """Return what the faces read [W/m2], shape (n, 4): a uniform sky while the sun is up, nothing at night."""
    weather = arrange_daylight(utc_s, np.full(utc_s.size, DNI), np.full(utc_s.size, DHI), SITE, EVERY_S)
    found = np.zeros((utc_s.size, 4))
    found[np.isin(utc_s, weather.utc_s)] = face_irradiances(build_sky(weather, "isotropic"), 0.2)
    return found


def scans(days, simulated):
    utc_s = instants(days)
    for number, (at, values) in enumerate(zip(utc_s.tolist(), faces_of(utc_s).tolist(), strict=True)):
        if GAP[0] <= at < GAP[1]:
            continue
        qualities = [Quality.OK] * 4
        if FLAGGED[0] <= at < FLAGGED[1]:
            qualities[0] = Quality.STALE
        east, south, west, zenith = (
            FaceReading(value, quality, at, at) for value, quality in zip(values, qualities, strict=True)
        )
        yield Scan(
            source="cube", session="s", sequence=number, time_utc_s=at, time_monotonic_s=at,
            east=east, south=south, west=west, zenith=zenith, simulated=simulated,
        )  # fmt: skip


def tracker_records(days, tracker):
    """Yield a tracker's poses, one move at noon of each day, its modes and decisions."""
    yield ModeChange(T0 + 1.0, 0.0, Mode.STARTING, Mode.NIGHT, "the sun is down", tracker)
    for day in range(days):
        start = T0 + day * DAY_S
        for minute in range(1440):
            at = start + 60.0 * minute
            wind_m_s = math.nan if minute % 2 else 4.0 + minute % 480 / 60.0
            yield Pose(at, at, 0.0, 90.0 if minute < 720 else 40.0, False, tracker, wind_m_s)
        yield ModeChange(start + 6.5 * 3600, 0.0, Mode.NIGHT, Mode.TRACKING, "the cube's readings are good", tracker)
        noon = start + DAY_S / 2.0
        yield Move(
            time_utc_s=noon - 30.0, time_monotonic_s=0.0, duration_s=25.0, from_a_deg=0.0, from_b_deg=90.0,
            target_a_deg=0.0, target_b_deg=40.0, end_a_deg=0.0, end_b_deg=40.0,
            outcome=MoveOutcome.ARRIVED, why="the sun", tracker=tracker,
        )  # fmt: skip
        yield decision(noon - 30.0, tracker)
        yield ModeChange(start + 13 * 3600, 0.0, Mode.TRACKING, Mode.STOW, "wind 17.2 m/s", tracker)
        yield ModeChange(start + 14 * 3600, 0.0, Mode.STOW, Mode.TRACKING, "calm again", tracker)
        yield ModeChange(start + 17 * 3600, 0.0, Mode.TRACKING, Mode.NIGHT, "dark", tracker)


def decision(at, tracker):
    return Decision(
        time_utc_s=at, time_monotonic_s=0.0, mode=Mode.TRACKING, law="mu-prime",
        irradiances=Irradiances(1.0, 2.0, 3.0, 4.0, 1.0), direction_azimuth_deg=180.0, direction_elevation_deg=40.0,
        sun_azimuth_deg=180.0, sun_elevation_deg=32.0, target=Target(0.0, 40.0, "the sun"), moved=True,
        estimate=NO_ESTIMATE, tracker=tracker,
    )  # fmt: skip


def alarm_events(tracker):
    def event(hour, subject, text):
        return Event(T0 + hour * 3600.0, 0.0, subject, text, tracker)

    yield event(9.0, "alarm", "raised cube-lost: the cube is silent: look at its PC")
    yield event(9.5, "alarm", f"acknowledged cube-lost by {HOSTILE_NAME}")
    yield event(10.0, "alarm", "cleared cube-lost: the cube is silent: look at its PC")
    yield event(12.5, "operator", f"hold by {HOSTILE_NAME}")
    yield event(16.0, "alarm", "raised day-budget: the day's moves are used up")


def open_store(directory, simulated=True, name="roof"):
    """Open a store for one run."""
    origin = Origin(
        started_utc_s=T0, role="both", version="0.1.0", simulated=simulated, site="Greenwich & Sons",
        latitude_deg=SITE.latitude_deg, longitude_deg=SITE.longitude_deg, altitude_m=SITE.altitude_m, tracker=name,
    )  # fmt: skip
    return Store(directory, 3600.0, 400, origin, SystemClock(), lambda _event: None)


def stored_days(directory, days=1, trackers=("roof",), simulated=True):
    """Write the store and return its folder."""
    store = open_store(directory, simulated, trackers[0] if len(trackers) == 1 else "")
    for record in scans(days, simulated):
        store.keep(record)
    for tracker in trackers:
        for record in (*tracker_records(days, tracker), *alarm_events(tracker)):
            store.keep(record)
    store.close()
    return directory
