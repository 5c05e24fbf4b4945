"""How much of the bound's gain `optimal` keeps if faces, noise, gains, the ground or a budget are against it.

The last lines are the paper's laws with one face missing or dead.

Usage: python tests/measurements/optimal_burdens.py LAT,LON,ALT WEATHER... [--sky SKY] [--scan SECONDS]

The weather has a value a minute, and the tracker turns at 0.9 deg/s, as in `heliocube energy`; --scan 10 interpolates
the weather for readings every 10 s. The worst day is told against ideal chronometric. A year takes three minutes.
"""

import argparse
from pathlib import Path

import numpy as np

from daemon.studies.energy.benchmark import Assumptions, read_minute_weather, under_sky
from daemon.studies.inputs import parse_site
from solar.energy import Drive, arrange_daylight
from solar.ephemeris import Site
from solar.frames import Limits
from solar.laws import mu_prime, optimal_live, sun_vector

LIMITS = Limits()
FACES = ("east", "south", "west", "zenith")
GAINS = (1.03, 0.97, 1.02, 0.97)
BUDGETS = ({"travel_per_day_deg": 900.0}, {"travel_per_day_deg": 650.0}, {"moves_per_day": 60})


def interpolated(minutes, scan_s):
    """Return instants so far apart [s], DNI and DHI [W/m2], interpolated where both neighbouring minutes are known."""
    utc_s = np.arange(minutes.utc_s[0], minutes.utc_s[-1] + 1.0, scan_s)
    known = [np.isin(60.0 * whole(utc_s / 60.0), minutes.utc_s) for whole in (np.floor, np.ceil)]
    utc_s = utc_s[np.logical_and(*known)]
    return utc_s, *(np.interp(utc_s, minutes.utc_s, values) for values in (minutes.dni_w_m2, minutes.dhi_w_m2))


def without(days, *missing):
    """Return the faces with some of them missing."""
    faces = days.faces.copy()
    faces[:, missing] = np.nan
    return faces


def dead(days, face, rng):
    """Return the faces with one that reads its noise of 0.3 W/m2 and nothing else."""
    faces = days.faces.copy()
    faces[:, face] = 0.3 * rng.standard_normal(len(faces))
    return faces


def noisy(days, rng):
    """Return the faces with noise of 1 % and of 1 W/m2."""
    one, other = rng.standard_normal((2, *days.faces.shape))
    return days.faces * (1.0 + 0.01 * one) + other


def say(name, days, faces, law=optimal_live, **settings):
    """Drive a law by these faces and print how much of the gain it keeps, and how far it travels."""
    lit = days.weather.day_types() >= 0
    done = days.run(law.steer(law.SETTINGS(**settings), days.weather, faces, LIMITS), Drive())
    room = (days.bound_kwh_m2 - days.chronometric_kwh_m2)[lit].sum()
    share = 100.0 * (done.energy_kwh_m2 - days.chronometric_kwh_m2)[lit].sum() / room
    each = done.travel_deg[lit].sum() / days.weather.whole_days(), done.moves[lit].sum() / days.weather.whole_days()
    worst = 100.0 * (done.energy_kwh_m2[lit] / days.chronometric_kwh_m2[lit] - 1.0).min()
    print(f"{name:34} {share:6.1f} % {each[0]:6.0f} deg/day {each[1]:5.0f} moves, worst day {worst:+.2f} %", flush=True)


def main():
    """Print a line for each burden."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", help="LAT,LON,ALT in degrees and metres")
    parser.add_argument("weather", nargs="+", type=Path, help="weather files, as `heliocube energy` takes them")
    parser.add_argument("--sky", default="perez1990", help="model of the sky (default: %(default)s)")
    parser.add_argument("--scan", type=float, default=60.0, help="seconds between two readings (default: %(default)g)")
    asked = parser.parse_args()
    site = Site(*parse_site(asked.site))
    light = interpolated(read_minute_weather(asked.weather, site), asked.scan)
    weather = arrange_daylight(*light, site, asked.scan)
    days, snowy = (under_sky(weather, asked.sky, Assumptions(albedo, LIMITS, Drive())) for albedo in (0.2, 0.6))
    say("nothing", days, days.faces)
    for number, face in enumerate(FACES):
        say(f"no {face} face", days, without(days, number))
    for number, face in enumerate(FACES):
        say(f"a dead {face} face", days, dead(days, number, np.random.default_rng(2)))
    say("neither east nor zenith face", days, without(days, 0, 3))
    say("noise of 1 % and 1 W/m2", days, noisy(days, np.random.default_rng(1)))
    say("gains off by +3, -3, +2, -3 %", days, days.faces * np.array(GAINS))
    say("albedo 0.6", snowy, snowy.faces)
    for budget in BUDGETS:
        say(", ".join(f"{key} {value:g}" for key, value in budget.items()), days, days.faces, **budget)
    for name, law in (("mu-prime", mu_prime), ("sun-vector", sun_vector)):
        say(name, days, days.faces, law)
        for number, face in enumerate(FACES):
            say(f"{name}, no {face} face", days, without(days, number), law)
        for number, face in enumerate(FACES):
            say(f"{name}, a dead {face} face", days, dead(days, number, np.random.default_rng(2)), law)


if __name__ == "__main__":
    main()
