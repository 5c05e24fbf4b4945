"""How well calibration in place finds the level of the gains in 30 days: docs/calibration.md, "A tie for the level".

    python -m tests.measurements.calibration_level FOLDER [PROCESSES]

FOLDER holds the measured weather of a year (2016-03.csv.gz to 2016-09.csv.gz, or another year's). A cube of known flaws
stands under a sky: the one that calibration assumes (perez1990), or a foreign one, which is the radiance of the
all-weather model (perez1993) or CIE skies with drifting clouds (cie). Each reference is off by half of its own
uncertainty, upwards and downwards in turn. The run takes a quarter of an hour on two cores, and always gives the same
numbers.
"""

import multiprocessing
import sys
from pathlib import Path

import numpy as np

from sim_drivers.scene import SensorModel
from sim_drivers.weather_files import load_weather
from solar.calibration.attitude import face_normals
from solar.calibration.in_place import UndeterminedError, calibrate_in_place
from solar.calibration.level import KnownResponse, LevelReference
from solar.ephemeris import DAY_S, extraterrestrial_dni, sun_direction
from solar.frames import Array
from solar.skies.allweather import all_weather_sky
from solar.skies.cie import cie_sky
from solar.skies.sky import sky
from tests.measurements.calibration_pointing import ALBEDO, ERRORS, OTHER_ERRORS, SITE, STANDING, WATER_CM

DAYS = 30
# Expanded (k = 2) uncertainty of every reference [%].
UNCERTAINTY_PERCENT = 1.0
SKIES = ("perez1990", "perez1993", "cie")
TIES = ("nothing", "zenith", "south", "zenith and south", "GHI")
FOREIGN_TIES = ("nothing", "GHI")


def readings(file: Path, kind: str) -> tuple[Array, Array, Array]:
    """Return instants, the irradiance on the four sensors as they sense it (n, 4), and GHI [W/m2]."""
    weather = load_weather(file)
    first_s = np.datetime64(f"{file.name[:7]}-01").astype("datetime64[s]").astype(np.float64)
    utc_s = first_s + np.arange(0.0, DAYS * DAY_S, 60.0)
    utc_s = utc_s[weather.covers(utc_s)]
    sun = sun_direction(utc_s, *SITE)
    high = sun[:, 2] > np.sin(np.radians(8.0))
    utc_s, sun = utc_s[high], sun[high]
    dni, dhi, extra = weather.at(utc_s).dni_w_m2, weather.at(utc_s).dhi_w_m2, extraterrestrial_dni(utc_s)
    if kind == "perez1990":
        overhead = sky(kind, sun, dni, dhi, extra)
        beam = overhead.dni_w_m2 + overhead.circumsolar_w_m2
    else:
        overhead = all_weather_sky(sun, dni, dhi, extra) if kind == "perez1993" else cie_sky(sun, dni, dhi, utc_s)
        beam = overhead.dni_w_m2
    normals = face_normals(STANDING, SITE.latitude_deg)
    falls = np.stack([overhead.irradiance_on(normal[None, :], ALBEDO) for normal in normals], axis=-1)
    cosine = np.clip(sun @ normals.T, 0.0, 1.0)
    missed = beam[:, None] * cosine * (1.0 - SensorModel().response(cosine))
    return utc_s, falls - missed, overhead.ghi_w_m2


def level_of(tied_to: str, truth: Array, ghi: Array, off: float) -> LevelReference:
    """Return the known level: references whose values are `off` times the truth."""
    error = UNCERTAINTY_PERCENT / 200.0
    if tied_to == "GHI":
        return LevelReference(ghi_w_m2=ghi * off, ghi_error=error)
    names = ("east", "south", "west", "zenith")
    east, south, west, zenith = (
        KnownResponse(float(response / off), error) if name in tied_to else None
        for name, response in zip(names, truth, strict=True)
    )
    return LevelReference((east, south, west, zenith))


def answer(case: tuple[Path, str, str, int]) -> tuple[str, str, Array | None, Array | None]:
    """Return the errors of the four gains and their expanded uncertainties [%]; None where calibration refuses."""
    file, kind, tied_to, turn = case
    truth = (ERRORS, *OTHER_ERRORS)[turn % 4]
    utc_s, sensed, ghi = readings(file, kind)
    level = level_of(tied_to, truth, ghi, 1.0 + (-1) ** turn * UNCERTAINTY_PERCENT / 200.0)
    try:
        found = calibrate_in_place(utc_s, sensed * truth, SITE, water_cm=WATER_CM[int(file.name[5:7])], level=level)
    except UndeterminedError:
        return kind, tied_to, None, None
    return kind, tied_to, 100.0 * (found.response / truth - 1.0), 200.0 * found.errors.response / found.response


def row(kind: str, tied_to: str, answers: list[tuple[str, str, Array | None, Array | None]]) -> str:
    here = [(error, told) for sky_name, tie, error, told in answers if (sky_name, tie) == (kind, tied_to)]
    errors = np.array([error for error, _ in here if error is not None])
    told = np.array([told for _, told in here if told is not None])
    vertical, zenith = (np.sqrt(np.mean(part**2)) for part in (errors[:, :3], errors[:, 3]))
    relative = errors[:, :3] - errors[:, :3].mean(axis=1, keepdims=True)
    size = np.abs(errors)
    return (
        f"| {kind} | {tied_to} | {len(errors)} of {len(here)} | {vertical:.2f} | {zenith:.2f} | {size.max():.1f} | "
        f"{100 * np.mean((size <= 1.0).all(axis=1)):.0f} | {100 * np.mean((size <= 2.0).all(axis=1)):.0f} | "
        f"{100 * np.mean(size <= told):.0f} | {np.abs(relative).max():.2f} | {told[:, :3].mean():.1f}, "
        f"{told[:, 3].mean():.1f} |"
    )


def main(folder: Path, processes: int) -> None:
    files = [next(folder.glob(f"*-{month:02d}.csv.gz")) for month in WATER_CM]
    pairs = [(SKIES[0], tie) for tie in TIES] + [(kind, tie) for kind in SKIES[1:] for tie in FOREIGN_TIES]
    cases = [(file, *pair, turn) for pair in pairs for turn, file in enumerate(files)]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        answers = pool.map(answer, cases, chunksize=1)
    print("| sky | known | answers | vertical % | zenith % | worst % | in 1 % | in 2 % | in U | relative % | U % |")
    for pair in pairs:
        print(row(*pair, answers))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 2)
