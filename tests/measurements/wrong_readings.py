"""What energy wrong and missing readings cost, by replays of measured days, against chronometric and the bound.

Usage: python tests/measurements/wrong_readings.py LAT,LON,ALT WEATHER... [--law LAW] [--every DAYS] [--from DAY]
       [--days N] [--scan SECONDS] [--sky SKY] [--seed SEED] [--case CASE ...]

A case is `healthy`, `gaps` (1 % of the readings in bursts of up to 75 s), `pause:SECONDS`, `dead:FACE`, `frozen:FACE`
or `shaded:FACE:SHARE`; FACE is east, south, west or zenith. A pause is five minutes without readings, SECONDS after the
fiftieth minute of each day: the law decides when readings come again, and at its interval from then on. The sky's light
on the faces is interpolated between the minutes of the weather, and read with a real sensor's noise (0.2 % and 0.3
W/m2).
"""

import argparse
import csv
import tempfile
from pathlib import Path

import numpy as np

from daemon.base.records import FACES
from daemon.rigs.measured import read_weather
from daemon.studies.inputs import parse_site, settings_for, site_values
from daemon.studies.recorded import RecordedScans
from daemon.studies.replay import replay
from solar.energy import arrange_daylight, best_possible, build_sky, face_irradiances
from solar.ephemeris import DAY_S, Site
from solar.frames import Limits, angles_within, normal_from_angles

LIMITS = Limits()
ALBEDO = 0.2
NOISE_SHARE, NOISE_W_M2 = 0.002, 0.3
BURST_S, MISSING_SHARE = 75.0, 0.01
PAUSE_AFTER_S, PAUSE_S = 3000.0, 300.0


def daylight_of(arguments):
    """Return the light of the chosen days, every `scan` seconds."""
    times, dni, dhi = [], [], []
    first = 0
    for path in map(Path, arguments.weather):
        weather = read_weather(path)
        begin = np.floor(weather.start_utc_s / DAY_S) * DAY_S
        for day_s in np.arange(begin, weather.end_utc_s, DAY_S):
            number, first = first, first + 1
            if number < arguments.begin or (number - arguments.begin) % arguments.every:
                continue
            if len(times) == arguments.days:
                continue
            utc_s = np.arange(day_s, day_s + DAY_S, arguments.scan)
            utc_s = utc_s[weather.covers(utc_s)]
            now = weather.at(utc_s)
            times.append(utc_s), dni.append(now.dni_w_m2), dhi.append(now.dhi_w_m2)
    site = Site(*parse_site(arguments.site))
    return arrange_daylight(np.concatenate(times), np.concatenate(dni), np.concatenate(dhi), site, arguments.scan)


def spoilt(faces, case, light, rng):
    """Return the readings as the case makes them."""
    kind, *rest = case.split(":")
    faces = faces * (1 + NOISE_SHARE * rng.standard_normal(faces.shape)) + NOISE_W_M2 * rng.standard_normal(faces.shape)
    if kind == "gaps":
        left_s = MISSING_SHARE * len(faces) * light.step_s
        while left_s > 0:
            length_s = rng.uniform(light.step_s, BURST_S)
            begin = rng.integers(len(faces))
            faces[begin : begin + max(round(length_s / light.step_s), 1)] = np.nan
            left_s -= length_s
    elif kind == "pause":
        for day in np.unique(light.day):
            begin_s = light.utc_s[light.day == day][0] + PAUSE_AFTER_S + float(rest[0])
            faces[(light.utc_s >= begin_s) & (light.utc_s < begin_s + PAUSE_S)] = np.nan
    elif kind == "dead":
        faces[:, FACES.index(rest[0])] = rng.normal(0.0, 0.3, len(faces))
    elif kind == "frozen":
        # From the middle of the first day on.
        place, column = len(faces) // (2 * np.unique(light.day).size), FACES.index(rest[0])
        faces[place:, column] = faces[place, column]
    elif kind == "shaded":
        faces[:, FACES.index(rest[0])] *= float(rest[1])
    elif kind != "healthy":
        raise SystemExit(f"there is no case {case!r}")
    return faces


def main():
    """Replay every case and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", help="LAT,LON,ALT in degrees and metres")
    parser.add_argument("weather", nargs="+", help="weather files, as `heliocube energy` takes them")
    parser.add_argument("--law", default="optimal", help="law that drives the tracker (default: %(default)s)")
    parser.add_argument("--every", type=int, default=15, help="replay only every so many-th day (default: %(default)s)")
    parser.add_argument(
        "--from",
        dest="begin",
        type=int,
        default=0,
        help="number of the first day that is replayed (default: %(default)s)",
    )
    parser.add_argument(
        "--days", type=int, default=24, help="how many days are replayed at most (default: %(default)s)"
    )
    parser.add_argument("--scan", type=float, default=10.0, help="seconds between two scans (default: %(default)g)")
    parser.add_argument("--sky", default="perez1990", help="model of the sky (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of gaps and noise (default: %(default)s)")
    parser.add_argument(
        "--case", nargs="+", default=["healthy", "gaps"], help="cases, as told above (default: healthy gaps)"
    )
    arguments = parser.parse_args()
    light = daylight_of(arguments)
    sky = build_sky(light, arguments.sky)
    faces = face_irradiances(sky, ALBEDO)
    ideal = normal_from_angles(*angles_within(light.sun, LIMITS))
    chronometric = light.by_day(sky.irradiance_on(ideal, ALBEDO))
    bound = light.by_day(best_possible(light, sky, LIMITS, ALBEDO))
    settings = settings_for(None, law=arguments.law, site=site_values(arguments.site))
    lit = bound > 0
    days = np.count_nonzero(lit)
    print(f"{days} days, {len(faces)} rows; law {arguments.law}, sky {arguments.sky}")
    print(f"{'case':18}{'share %':>9}{'worst day %':>13}{'deg/day':>9}  modes")
    for case in arguments.case:
        readings = spoilt(faces, case, light, np.random.default_rng(arguments.seed))
        rows = RecordedScans(light.utc_s, readings)
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder, "out.csv")
            replay(settings, rows, "the day", out, lambda _share: None)
            with out.open(newline="") as file:
                found = list(csv.DictReader(file))
        a_deg, b_deg = (np.array([float(row[name]) for row in found]) for name in ("a", "b"))
        energy = light.by_day(sky.irradiance_on(normal_from_angles(a_deg, b_deg), ALBEDO))
        share = (energy - chronometric).sum() / (bound - chronometric).sum()
        worst = ((energy - chronometric)[lit] / chronometric[lit]).min()
        travel = (np.abs(np.diff(a_deg)) + np.abs(np.diff(b_deg))).sum() / days
        modes = {row["mode"] for row in found}
        shares = ", ".join(f"{mode} {np.mean([row['mode'] == mode for row in found]):.1%}" for mode in sorted(modes))
        print(f"{case:18}{100 * share:9.1f}{100 * worst:13.2f}{travel:9.0f}  {shares}", flush=True)


if __name__ == "__main__":
    main()
