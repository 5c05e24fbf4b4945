"""Which faults of a face the cube's watch finds within a day, by kind and season, on measured weather.

Usage: python tests/measurements/face_faults.py FOLDER [DAY OF THE MONTH...]

FOLDER holds the months of a year at Lyngby. The days of the month are taken from January, April, July and October; by
default they are 5, 12, 19 and 26. A fault is there from dawn. The service's own watch judges, minute by minute.
"""

import logging
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.records import FACES
from daemon.config.sections import CubeSettings, SiteSettings
from daemon.config.settings import Settings
from daemon.cube.face_watch import FaceWatch, face_normals
from daemon.studies.energy.benchmark import read_minute_weather
from solar.ephemeris import Site, extraterrestrial_dni, sun_direction
from solar.frames import Array
from solar.skies.sky import sky

LYNGBY = Site(55.79064, 12.52505, 50.0)
SEASONS = {1: "January", 4: "April", 7: "July", 10: "October"}
DAYS = (5, 12, 19, 26)
NOISE_MV, GAIN_ERROR = 0.006, 0.02
"""The noise of a minute's mean, and the gain error of a sensor."""
DIRTY, GREY = 0.5, 0.8
PAIRS = ((0, 1), (0, 2), (1, 2), (1, 3))

Fault = Callable[[Array, Array], Array]
"""Turns the faces' readings, with and without beam [W/m2], both (n, 4), into the readings under the fault."""


def faults() -> Iterator[tuple[str, tuple[int, ...], Fault]]:
    """Yield kind, faces concerned, and fault; the first case has no fault."""
    yield "none", (), lambda faces, _: faces
    for face in range(4):
        yield "dead", (face,), lambda faces, _, f=face: changed(faces, f, 0.0 * faces[:, f])
        yield (
            "frozen",
            (face,),
            lambda faces, _, f=face: changed(faces, f, 0.0 * faces[:, f] + faces[len(faces) // 3, f]),
        )
        yield "shaded from the sun", (face,), lambda faces, dull, f=face: changed(faces, f, GREY * dull[:, f])
        yield f"soiled, {DIRTY:.0%} left", (face,), lambda faces, _, f=face: changed(faces, f, DIRTY * faces[:, f])
        yield f"soiled, {GREY:.0%} left", (face,), lambda faces, _, f=face: changed(faces, f, GREY * faces[:, f])
    for one, other in PAIRS:
        names = f"{FACES[one]} and {FACES[other]} swapped"
        order = [{one: other, other: one}.get(face, face) for face in range(4)]
        yield names, (one, other), lambda faces, _, o=tuple(order): faces[:, list(o)]


def changed(faces: Array, face: int, values: Array) -> Array:
    """Return the faces with other values in one."""
    result = faces.copy()
    result[:, face] = values
    return result


class HandClock(Clock):
    """A clock that stands where it is set."""

    def __init__(self) -> None:
        self.utc_s = 0.0

    def monotonic(self) -> float:
        """Return the time that is set."""
        return self.utc_s

    def utc(self) -> float:
        """Return the time that is set."""
        return self.utc_s

    def asleep_s(self) -> float:
        """Return 0: it never sleeps."""
        return 0.0


def found(utc_s: Array, faces: Array, concerned: tuple[int, ...]) -> tuple[float, bool]:
    """Return after how many minutes the watch doubts a face, infinite for never, and whether only sound faces."""
    clock = HandClock()
    clock.utc_s = float(utc_s[0]) - 60.0
    site = SiteSettings(latitude_deg=LYNGBY.latitude_deg, longitude_deg=LYNGBY.longitude_deg, altitude_m=50.0)
    watch = FaceWatch(site, CubeSettings(), clock, Alarms(clock, lambda _: None))
    first, wrong = np.inf, False
    for minute, row in zip(utc_s, faces, strict=True):
        clock.utc_s = float(minute)
        watch.note(row.tolist(), (0.1 * row).tolist())
        doubted = [face for face in range(4) if watch.implausible(face)]
        if doubted and np.isinf(first):
            first = (minute - utc_s[0]) / 60.0
            wrong = not set(doubted) & set(concerned)
    return first, wrong


def readings(utc_s: Array, dni: Array, dhi: Array, seed: int) -> Array:
    """Return faces [W/m2] under Perez' sky, of sensors with gain errors and noise."""
    random = np.random.default_rng(seed)
    light = sky("perez1990", sun_direction(utc_s, *LYNGBY), dni, dhi, extraterrestrial_dni(utc_s))
    normals = face_normals(Settings().cube, LYNGBY.latitude_deg)
    faces = np.stack([light.irradiance_on(normal, 0.2) for normal in normals], axis=-1)
    return faces * (1.0 + GAIN_ERROR * random.standard_normal(4)) + 10.0 * NOISE_MV * random.standard_normal(
        faces.shape
    )


def days(folder: Path, numbers: tuple[int, ...]) -> Iterator[tuple[str, Array, Array, Array]]:
    """Yield season, minutes with the sun above 5 deg, and irradiance with and without beam."""
    utc_s, dni, dhi, *_ = read_minute_weather(sorted(folder.glob("*.csv*")), LYNGBY)
    for month, season in SEASONS.items():
        for number in numbers:
            begin = datetime(
                datetime.fromtimestamp(utc_s[len(utc_s) // 2], UTC).year, month, number, tzinfo=UTC
            ).timestamp()
            day = (utc_s >= begin) & (utc_s < begin + 86400.0)
            day &= sun_direction(utc_s, *LYNGBY)[:, 2] > np.sin(np.radians(5.0))
            if day.sum() > 120:
                arguments = utc_s[day], dni[day], dhi[day]
                yield (
                    season,
                    utc_s[day],
                    readings(*arguments, number),
                    readings(utc_s[day], 0.0 * dni[day], dhi[day], number),
                )


def main() -> None:
    """Print, by fault, on how many days of each season it was found, and after how long."""
    logging.disable()
    numbers = tuple(int(text) for text in sys.argv[2:]) or DAYS
    told: dict[str, dict[str, list[tuple[float, bool]]]] = {}
    for season, utc_s, faces, dull in days(Path(sys.argv[1]), numbers):
        for kind, concerned, fault in faults():
            told.setdefault(kind, {}).setdefault(season, []).append(found(utc_s, fault(faces, dull), concerned))
    print("| fault | " + " | ".join(SEASONS.values()) + " |\n|" + "---|" * (len(SEASONS) + 1))
    for kind, by_season in told.items():
        cells = []
        for season in SEASONS.values():
            results = by_season.get(season, [])
            minutes = [first for first, _ in results if np.isfinite(first)]
            after = f" after {np.median(minutes):.0f} min" if minutes else ""
            wrong = sum(each for _, each in results)
            cells.append(f"{len(minutes)} of {len(results)}{after}{f', {wrong} by another name' if wrong else ''}")
        print(f"| {kind} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
