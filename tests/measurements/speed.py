"""Time of replay, of a simulated day, of a campaign's day and of a year of energies, each as a user would run it.

Usage: python tests/measurements/speed.py [repetitions [LAT,LON,ALT WEATHER...]]

The replay reads 48 days of made-up readings every 5 s at SIRTA, half of the minutes with sun and half without; the
energy benchmark runs if a year of one-minute weather is given. Processor time is printed beside wall time: they are
equal on a machine with nothing else to do.
"""

import csv
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from daemon.base.clock import iso_utc
from solar.ephemeris import sun_direction
from solar.skies.sky import sky

SIRTA = (48.7176, 2.2090, 156.0)
FIRST_DAY_UTC_S = 1656633600.0
DAYS, EVERY_S = 48, 5.0
LOWEST_SUN = 0.12
ROWS_A_MINUTE = 12
FACES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])


def write_faces(path: Path) -> int:
    """Write the readings of the replay and return how many rows there are."""
    hours = np.arange(4 * 3600.0, 20 * 3600.0, EVERY_S)
    utc_s = np.concatenate([FIRST_DAY_UTC_S + 86400.0 * day + hours for day in range(DAYS)])
    sun = sun_direction(utc_s, *SIRTA)
    up = sun[:, 2] > LOWEST_SUN
    utc_s, sun = utc_s[up], sun[up]
    minutes = len(utc_s) // ROWS_A_MINUTE + 1
    clear = np.repeat(np.random.default_rng(1).random(minutes) < 0.5, ROWS_A_MINUTE)[: len(utc_s)]
    light = sky("isotropic", sun, np.where(clear, 800.0, 20.0), 60.0 + 120.0 * sun[:, 2], 1360.0)
    readings = np.stack([light.irradiance_on(normal) for normal in FACES], axis=-1)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time", "east", "south", "west", "zenith"])
        for at_s, row in zip(utc_s.tolist(), readings.tolist(), strict=True):
            writer.writerow([iso_utc(at_s), *(f"{value:.2f}" for value in row)])
    return len(utc_s)


def main() -> None:
    """Run each command some times and print the median and the spread of its times."""
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    heliocube = str(Path(sys.executable).with_name("heliocube"))
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
          f"load {os.getloadavg()[0]:.1f} before, {repetitions} repetitions")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        faces, number = Path(folder, "faces.csv"), 0
        print(f"{write_faces(faces)} rows of {EVERY_S:g} s, {DAYS} days")
        replay = [heliocube, "replay", str(faces), "--site", ",".join(map(str, SIRTA))]
        day = [heliocube, "simulate", "--start", "2022-10-14", "--weather", "variable"]
        commands = {
            "replay, mu-prime": [*replay, "--law", "mu-prime"],
            "replay, optimal": [*replay, "--law", "optimal"],
            "a simulated day, mu-prime": [*day, "--law", "mu-prime"],
            "a simulated day, optimal": [*day, "--law", "optimal"],
            "a campaign's day": [heliocube, "campaign", "--seeds", "1", "--hours", "24"],
        }
        if len(sys.argv) > 3:
            year = [heliocube, "energy", *sys.argv[3:], "--site", sys.argv[2]]
            commands["a year of weather, all laws"] = year
        for name, command in commands.items():
            walls, busy = [], []
            for _ in range(repetitions):
                number += 1
                into = "--keep" if "campaign" in command else "--out"
                place = f"{folder}/{number}.csv" if "replay" in command else f"{folder}/{number}"
                started, before = time.perf_counter(), os.times()
                subprocess.run([*command, into, place], check=True, capture_output=True)
                after = os.times()
                walls.append(time.perf_counter() - started)
                busy.append(after.children_user + after.children_system - before.children_user - before.children_system)
            print(f"{name}: median {statistics.median(walls):.1f} s, {min(walls):.1f}..{max(walls):.1f} s;"
                  f" busy {statistics.median(busy):.1f} s, {min(busy):.1f}..{max(busy):.1f} s")  # fmt: skip


if __name__ == "__main__":
    main()
