"""What a faulty face costs: weeks of measured weather with each fault, energy against chronometric and the bound.

Usage: python tests/measurements/face_weeks.py FOLDER [--law LAW ...] [--month M ...] [--kind KIND ...] [--scan SECONDS]
[--day DAY] [--still HOUR] [--soiled SHARE] [--sky SKY ...] [--site LAT,LON,ALT] [--quick]

FOLDER holds the months of a year at Lyngby, or at --site. In its place, `clear`, `overcast`, `variable` or `broken`
asks for weather that the simulator makes for 2023. Seven days of each month, from the 8th on or from --day, are
replayed through the service's own code under Perez' sky, or the skies of --sky, with a real sensor's noise. A fault is
there from the first midnight, but `frozen` and `held` begin at noon (UTC) of the first day, or at the hour of --still.
A `held` face keeps its reading but for its noise, and a `stuck` one reads 300 W/m2 with its noise. A `shaded` face has
no beam while the sun is within 30 deg of the face's direction. A `soiled` face keeps 80 % of its light, or the share of
--soiled. A `loose` face reads 0 or 1350 W/m2 in a tenth of the minutes, at random, as with a loose contact. --kind
without a kind runs only the healthy week.

--quick runs the watch alone and drives `optimal` as `heliocube energy` does. It takes a third of the time, and its
shares differ by some three points at most. By default June and December are run with `optimal`; --month 4 6 10 12 --law
optimal mu-prime runs everything, in 20 minutes.
"""

import argparse
import csv
import itertools
import logging
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import cast, get_args

import numpy as np

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import LoopClock
from daemon.base.records import FACES, Quality
from daemon.config.sections import CubeSettings, SiteSettings
from daemon.cube.face_watch import FaceWatch
from daemon.cube.repeats import Repeats
from daemon.rigs.measured import read_weather
from daemon.studies.inputs import parse_site, settings_for
from daemon.studies.recorded import RecordedScans
from daemon.studies.replay import replay
from sim_drivers.weather import GeneratedWeather, Weather, WeatherKind
from solar.energy import SKIES, Drive, arrange_daylight, best_possible, build_sky, face_irradiances, harvest
from solar.ephemeris import DAY_S, Site, sun_direction
from solar.frames import Limits, angles_within, normal_from_angles
from solar.laws import optimal_live
from solar.laws.light import FACES_NEEDED

LYNGBY = Site(55.79064, 12.52505, 50.0)
LIMITS = Limits()
ALBEDO = 0.2
NOISE_SHARE, NOISE_W_M2 = 0.002, 0.3
NIGHT_SCAN_S = 60.0
DAYS = 7
SEED, MADE_UP_YEAR = 1, 2023
STUCK_W_M2, SOILED, SHADE_DEG = 300.0, 0.8, 30.0
LOOSE_SHARE, LOOSE_W_M2 = 0.1, (0.0, 1350.0)
KINDS = ("dead", "frozen", "held", "stuck", "shaded", "soiled", "loose")
PAIRS = ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))


def weather_of(folder: Path, month: int, site: Site) -> tuple[Weather, int]:
    """Return a month's weather, or one that the simulator makes, and its year."""
    if _is_made_up(folder):
        return GeneratedWeather(cast("WeatherKind", str(folder)), site, SEED), MADE_UP_YEAR
    (path,) = _files_of(folder, month)
    weather = read_weather(path)
    return weather, datetime.fromtimestamp(weather.start_utc_s + DAY_S, UTC).year


def _is_made_up(folder: Path) -> bool:
    return str(folder) in get_args(WeatherKind)


def _files_of(folder: Path, month: int) -> list[Path]:
    return list(folder.glob(f"*-{month:02d}.csv*"))


class Week:
    """A week's light, what the faces read in it, and what chronometric and the bound collect a day [Wh/m2]."""

    def __init__(
        self,
        folder: Path,
        month: int,
        first_day: int,
        scan_s: float,
        still_hour: float,
        soiled: float = SOILED,
        sky: str = "perez1990",
        site: Site = LYNGBY,
    ) -> None:
        self.site = site
        weather, year = weather_of(folder, month, site)
        begin = datetime(year, month, first_day, tzinfo=UTC).timestamp()
        utc_s = np.arange(begin, begin + DAYS * DAY_S, scan_s)
        utc_s = utc_s[weather.covers(utc_s)]
        now = weather.at(utc_s)
        self.light = arrange_daylight(utc_s, now.dni_w_m2, now.dhi_w_m2, site, scan_s)
        # A cube reads through the night: otherwise it would look like one that sleeps.
        resting = ~np.isin(utc_s, self.light.utc_s) & (
            np.arange(len(utc_s)) % max(round(NIGHT_SCAN_S / scan_s), 1) == 0
        )
        self.utc_s = np.concatenate([self.light.utc_s, utc_s[resting]])
        self.order = np.argsort(self.utc_s)
        self.utc_s = self.utc_s[self.order]
        self.sky = build_sky(self.light, sky)
        dull = build_sky(arrange_daylight(utc_s, 0.0 * now.dni_w_m2, now.dhi_w_m2, site, scan_s), sky)
        self.still_s, self.soiled = begin + 3600.0 * still_hour, soiled
        ideal = normal_from_angles(*angles_within(self.light.sun, LIMITS))
        self.chronometric = self.light.by_day(self.sky.irradiance_on(ideal, ALBEDO))
        self.bound = self.light.by_day(best_possible(self.light, self.sky, LIMITS, ALBEDO))
        random = np.random.default_rng(month)
        self.noise = random.standard_normal((2, len(self.utc_s), 4))
        self.faces, self.dull = (self.read(face_irradiances(light, ALBEDO)) for light in (self.sky, dull))
        self.sun = sun_direction(self.utc_s, *site)

    def read(self, faces):
        """Return the faces [W/m2] as sensors read them by day and by night."""
        lit = np.concatenate([faces, np.zeros((len(self.utc_s) - len(faces), 4))])[self.order]
        return lit * (1.0 + NOISE_SHARE * self.noise[0]) + NOISE_W_M2 * self.noise[1]

    def spoilt(self, kind, face):
        """Return the readings with one face as the fault makes it; a pair of faces is swapped."""
        faces = self.faces.copy()
        if kind == "swapped":
            faces[:, list(face)] = faces[:, list(face[::-1])]
            return faces
        noise = NOISE_W_M2 * self.noise[1, :, face]
        later = self.utc_s >= self.still_s
        last = faces[np.argmax(later), face]
        if kind == "dead":
            faces[:, face] = noise
        elif kind == "frozen":
            faces[later, face] = last
        elif kind == "held":
            faces[later, face] = last + noise[later]
        elif kind == "stuck":
            faces[:, face] = STUCK_W_M2 + noise
        elif kind == "soiled":
            faces[:, face] *= self.soiled
        elif kind == "loose":
            minute = ((self.utc_s - self.utc_s[0]) // 60.0).astype(int)
            random = np.random.default_rng(face)
            jumps, reads = random.random(minute[-1] + 1) < LOOSE_SHARE, random.choice(LOOSE_W_M2, minute[-1] + 1)
            faces[:, face] = np.where(jumps[minute], reads[minute], faces[:, face])
        elif kind == "shaded":
            azimuth_deg = np.degrees(np.arctan2(self.sun[:, 1], -self.sun[:, 0])) % 360.0
            # Azimuths count from north; the frame's first axis points to the equator, its second to the east.
            towards = (90.0, 180.0, 270.0, 180.0)[face]
            behind = np.abs((azimuth_deg - towards + 180.0) % 360.0 - 180.0) < SHADE_DEG
            faces[behind, face] = self.dull[behind, face]
        return faces

    def driven(self, law, readings):
        """Return what `judged` returns, driven by the service itself."""
        rows = RecordedScans(self.utc_s, readings)
        site = dict(zip(("latitude_deg", "longitude_deg", "altitude_m"), self.site, strict=True))
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder, "out.csv")
            done = replay(settings_for(None, law=law, site=site), rows, "the week", out, lambda _share: None)
            with out.open(newline="") as file:
                found = list(csv.DictReader(file))
        day = np.isin(self.utc_s, self.light.utc_s)
        a_deg, b_deg = (np.array([float(row[name]) for row in found])[day] for name in ("a", "b"))
        energy = self.light.by_day(self.sky.irradiance_on(normal_from_angles(a_deg, b_deg), ALBEDO))
        travel = (np.abs(np.diff(a_deg)) + np.abs(np.diff(b_deg))).sum() / DAYS
        tracking = np.mean(np.array([row["mode"] == "tracking" for row in found])[day])
        return self.judged(energy, travel, tracking, done.qualities[day] != tuple(Quality).index(Quality.OK))

    def quickly_driven(self, readings):
        """Return what `judged` returns, driven by the watch alone and `optimal` as `heliocube energy` drives it."""
        now_s = [float(self.utc_s[0]) - 60.0]
        clock = LoopClock(lambda: now_s[0], now_s[0])
        site = SiteSettings(
            latitude_deg=self.site.latitude_deg,
            longitude_deg=self.site.longitude_deg,
            altitude_m=self.site.altitude_m,
        )
        scan_s = float(np.median(np.diff(self.utc_s)))
        watch = FaceWatch(site, CubeSettings(), clock, Alarms(clock, lambda _record: None))
        repeats = Repeats(scan_s)
        unused = np.zeros(readings.shape, dtype=np.bool_)
        for number, (utc_s, row) in enumerate(zip(self.utc_s.tolist(), readings.tolist(), strict=True)):
            now_s[0] = utc_s
            watch.note(row, [np.nan] * len(row))
            for face, w_m2 in enumerate(row):
                repeats.note(face, w_m2)
                unused[number, face] = watch.implausible(face) or repeats.frozen(face, w_m2, rounded=True)
        day = np.isin(self.utc_s, self.light.utc_s)
        faces = np.where(unused, np.nan, readings)[day]
        steer = optimal_live.steer(optimal_live.SETTINGS(), self.light, faces, LIMITS)
        done = harvest(self.light, self.sky, ALBEDO, Drive(), steer)
        tracking = np.mean((~unused[day]).sum(axis=1) >= FACES_NEEDED)
        return self.judged(done.energy_kwh_m2, done.travel_deg.sum() / DAYS, tracking, unused[day])

    def judged(self, energy, travel, tracking, unused):
        """Return the share of the headroom [%], each day's gain over chronometric [%], and details.

        The details are travel [deg/day], the share of the daylight with enough faces [%], and for how long each face
        was not used [h].
        """
        gain = energy - self.chronometric
        share = 100.0 * gain.sum() / (self.bound - self.chronometric).sum()
        hours = unused.sum(axis=0) * self.light.step_s / 3600.0
        return share, 100.0 * gain / self.chronometric, (travel, 100.0 * tracking, *hours)


def cases(kinds) -> Iterator[tuple[str, str, int | tuple[int, int]]]:
    """Yield name, kind and face of every fault."""
    for kind in kinds:
        if kind == "swapped":
            for one, other in PAIRS:
                yield f"{FACES[one]} and {FACES[other]} swapped", kind, (one, other)
        else:
            for face, name in enumerate(FACES):
                yield f"{kind}: {name}", kind, face


def say(name, share, of_healthy, worst, lost, how):
    """Print a row."""
    travel, tracking, *hours = how
    print(f"{name:24}{share:8.1f}{of_healthy:8.0f}{worst:8.2f}{lost:8.2f}{travel:7.0f}{tracking:5.0f}", end="")
    print("".join(f"{each:6.1f}" for each in hours), flush=True)


def main() -> None:
    """Print a row for each fault, one table for each month and law."""
    logging.disable()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "folder", type=Path, help="folder with the months of a year, or clear, overcast, variable or broken"
    )
    parser.add_argument("--law", nargs="+", default=["optimal"], help="laws that drive the tracker (default: optimal)")
    parser.add_argument("--month", nargs="+", type=int, default=[6, 12], help="months by number (default: 6 12)")
    parser.add_argument(
        "--kind",
        nargs="*",
        choices=(*KINDS, "swapped"),
        default=[*KINDS, "swapped"],
        help="faults of a face (default: all); none runs only the healthy week",
    )
    parser.add_argument("--scan", type=float, default=30.0, help="seconds between two scans (default: %(default)g)")
    parser.add_argument(
        "--day", type=int, default=8, help="first of the seven days in each month (default: %(default)s)"
    )
    parser.add_argument(
        "--still",
        type=float,
        default=12.0,
        help="hour (UTC) of the first day at which `frozen` and `held` begin (default: %(default)g)",
    )
    parser.add_argument(
        "--soiled",
        type=float,
        default=SOILED,
        help="share of the light that a soiled face keeps (default: %(default)g)",
    )
    parser.add_argument(
        "--sky", nargs="+", choices=SKIES, default=["perez1990"], help="models of the sky (default: perez1990)"
    )
    parser.add_argument(
        "--site", default=",".join(map(str, LYNGBY)), help="LAT,LON,ALT of the weather (default: %(default)s)"
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="the watch alone, with `optimal`: a third of the time, some three points off",
    )
    arguments = parser.parse_args()
    for month in arguments.month:
        if not _is_made_up(arguments.folder) and len(_files_of(arguments.folder, month)) != 1:
            parser.error(f"{arguments.folder} needs one file for month {month}, such as 2016-{month:02d}.csv.gz")
    site = Site(*parse_site(arguments.site))
    for month, sky in itertools.product(arguments.month, arguments.sky):
        terms = (month, arguments.day, arguments.scan, arguments.still, arguments.soiled, sky, site)
        week = Week(arguments.folder, *terms)
        for law in ["optimal"] if arguments.quick else arguments.law:
            driven = week.quickly_driven if arguments.quick else partial(week.driven, law)
            share, days, how = driven(week.faces)
            print(f"\nmonth {month} from day {arguments.day}, {sky}, {law}: share of the bound [%], of the healthy")
            print("week's [%], worst day over chronometric [%], most that a day lost against the healthy one [%],")
            print("deg/day, tracking [%], hours of daylight without the east, south, west and zenith face\n")
            say("healthy", share, 100.0, days.min(), 0.0, how)
            for name, kind, face in cases(arguments.kind):
                found, gains, how = driven(week.spoilt(kind, face))
                say(name, found, 100.0 * found / share, gains.min(), (gains - days).min(), how)


if __name__ == "__main__":
    main()
