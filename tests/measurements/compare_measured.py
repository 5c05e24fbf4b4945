"""Equation (16) on changeable afternoons of measured weather.

Usage: python tests/measurements/compare_measured.py LAT,LON,ALT FILE...

Takes the afternoons of the files (from noon on, for 4.3 h) in which the beam exceeds 120 W/m2 for 10 to 90 % of the
time and crosses that mark ten times or more, and prints how much more irradiation T-Cube gets than T-Chrono.
"""

import sys
from pathlib import Path

import numpy as np

from daemon.base.clock import iso_utc
from daemon.config.file import override
from daemon.config.settings import Settings
from daemon.rigs.measured import read_weather
from daemon.rigs.simulated import build_simulated_pair
from daemon.studies.compare.pairs import frame_of, pair
from daemon.studies.compare.side_by_side import MODULES, T_CHRONO, T_CUBE, run_side_by_side, two_trackers
from daemon.studies.inputs import parse_site, site_values
from solar.compare import energy_wh, gain_pct
from solar.ephemeris import DAY_S, sun_day

BEAM_W_M2, AFTERNOON_S, BEFORE_S = 120.0, 4.3 * 3600.0, 1200.0


def main(site, *files):
    settings = override(Settings(), {"site": site_values(site)})
    place = parse_site(site)
    energies = []
    for weather in map(read_weather, map(Path, files)):
        for day in np.arange(weather.start_utc_s // DAY_S, weather.end_utc_s // DAY_S + 1):
            noon_s = sun_day(day * DAY_S + DAY_S / 2, *place).noon_utc_s
            minutes = noon_s + np.arange(-BEFORE_S, AFTERNOON_S + 600.0, 60.0)
            if not weather.covers(minutes).all():
                continue
            shines = weather.at(minutes[minutes >= noon_s]).dni_w_m2 > BEAM_W_M2
            changes = int(np.sum(shines[1:] != shines[:-1]))
            if not (0.1 < shines.mean() < 0.9 and changes >= 10):
                continue
            measured = run_side_by_side(
                settings,
                two_trackers(),
                lambda clock, weather=weather: build_simulated_pair(settings, clock, weather, MODULES),
                noon_s - BEFORE_S,
                (AFTERNOON_S + BEFORE_S) / DAY_S,
                lambda _name, _record: None,
                lambda _share: None,
            )
            both = pair(frame_of(measured), (T_CUBE, T_CHRONO))
            both = both.select(both.utc_s >= noon_s)
            cube, chrono = (energy_wh(both.utc_s, side.irradiance_w_m2) for side in (both.cube, both.chrono))
            energies.append((cube, chrono))
            print(
                f"{iso_utc(noon_s)[:10]}  sun {shines.mean():4.0%}  {changes:3} changes  {chrono:5.0f} Wh/m2"
                f"  {gain_pct(cube, chrono):+6.2f} %",
                flush=True,
            )
    gains = [gain_pct(*each) for each in energies]
    low, middle, high = np.percentile(gains, [25, 50, 75])
    cube, chrono = np.sum(energies, axis=0)
    print(f"{len(gains)} afternoons: median {middle:+.2f} %, quartiles {low:+.2f}..{high:+.2f} %,"
          f" all together {gain_pct(cube, chrono):+.2f} %")  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
