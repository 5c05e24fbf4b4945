"""How often a sound cube is taken for a broken one, on measured weather, and how soon a broken one is found.

Usage: python tests/measurements/face_plausibility.py FOLDER...
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daemon.base.records import FACES
from daemon.config.settings import Settings
from daemon.cube.face_watch import BAD_LOOKS, BLOCKS, face_normals
from daemon.studies.energy.benchmark import read_minute_weather
from solar.energy import SKIES, IrradianceSource, arrange_daylight, build_sky, face_irradiances
from solar.ephemeris import Site, sun_direction
from solar.faces.changes import change_misfits
from solar.faces.contradiction import misfits
from solar.faces.jumps import find_jumps
from solar.faces.plausible import Doubt, Response, doubts, responses
from solar.frames import Array

LYNGBY = Site(55.79064, 12.52505, 50.0)
NOISE_MV = 0.02
SCANS_PER_MINUTE = 12
SEEDS = 3
HALF_HOUR = 30
ALBEDOS = (0.05, 0.2, 0.8)


def cube_of(light: IrradianceSource, albedo: float, seed: int) -> tuple[Array, Array]:
    """Return faces [W/m2] and voltages [mV], shape (n, 4), of sensors with 3 % of gain error and noise."""
    random = np.random.default_rng(seed)
    faces = face_irradiances(light, albedo)
    noise = random.normal(0.0, NOISE_MV / np.sqrt(SCANS_PER_MINUTE), faces.shape)
    voltages = 0.1 * faces * (1.0 + 0.03 * random.standard_normal(4)) + noise
    return 10.0 * voltages, voltages


def five_minutes(utc_s: Array, values: Array) -> Array:
    """Return the mean of each minute and the four before it; NaN where they are not all there."""
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), values]), axis=0)
    means = np.full(values.shape, np.nan)
    means[BLOCKS - 1 :] = (sums[BLOCKS:] - sums[:-BLOCKS]) / BLOCKS
    together = np.zeros(utc_s.size, dtype=np.bool_)
    together[BLOCKS - 1 :] = utc_s[BLOCKS - 1 :] - utc_s[: 1 - BLOCKS] <= 60.0 * BLOCKS
    means[~together] = np.nan
    return means


def alarms(utc_s: Array, doubtful: NDArray[np.bool_]) -> int:
    """Return how many alarms the doubtful minutes make: `BAD_LOOKS` in a row, and 10 minutes between two alarms."""
    run = np.logical_and.reduce([np.roll(doubtful, shift) for shift in range(BAD_LOOKS)])
    run[: BAD_LOOKS - 1] = False
    return int(np.sum(np.diff(utc_s[run], prepend=-np.inf) > 600.0))


def stays(utc_s: Array, faces: Array, sun: Array) -> int:
    """Return in how many half hours, one every five minutes, a sound face is accused of not following the light."""
    named = 0
    for begin in range(0, utc_s.size - HALF_HOUR, 5):
        half_hour = slice(begin, begin + HALF_HOUR)
        if utc_s[half_hour][-1] - utc_s[begin] <= 60.0 * HALF_HOUR:
            named += int(Response.STAYS in responses(faces[half_hour], sun[half_hour], [True] * 4))
    return named


def contradictions(utc_s: Array, faces: Array, sun: Array) -> tuple[int, int, float, float]:
    """Return how many half hours, one an hour, hold sound faces that contradict each other, of how many, and misfits.

    First the greatest misfit of all four faces, then that of any three: below it, no face beside a frozen one is
    accused.
    """
    looks = []
    for begin in range(0, utc_s.size - HALF_HOUR, 2 * HALF_HOUR):
        half_hour = slice(begin, begin + HALF_HOUR)
        if utc_s[half_hour][-1] - utc_s[begin] <= 60.0 * HALF_HOUR:
            looks.append(misfits(faces[half_hour], sun[half_hour]))
    known = [look for look in looks if look is not None]
    against, three = sum(look.is_contradictory for look in known), max(look.least_without.max() for look in known)
    return against, len(known), max(look.least for look in known), float(three)


def unchanging(utc_s: Array, faces: Array, sun: Array) -> tuple[int, int, int, float]:
    """Return in how many half hours, one every five minutes, the changes of sound faces accuse one or two of them.

    Then how many half hours had enough changes, in how many of these the faces contradict each other, and the least
    remainder that assuming a fault leaves there, as a share of the remainder without one: below 0.3 a face is accused.
    """
    looks = []
    for begin in range(0, utc_s.size - HALF_HOUR, 5):
        half_hour = slice(begin, begin + HALF_HOUR)
        if utc_s[half_hour][-1] - utc_s[begin] <= 60.0 * HALF_HOUR:
            looks.append(change_misfits(faces[half_hour], sun[half_hour]))
    known = [look for look in looks if look is not None]
    against = [look for look in known if look.is_contradictory]
    shares = [min(look.single.min(), look.swapped.min()) / look.without_fault for look in against]
    return sum(bool(look.suspect_faces) for look in known), len(known), len(against), float(min(shares, default=np.inf))


def jumping(utc_s: Array, faces: Array, sun: Array) -> list[int]:
    """Return in how many half hours, one every five minutes, a sound face is accused of jumping.

    First with four sound faces, then with each of them dead in turn.
    """
    named = [0] * (1 + len(FACES))
    for begin in range(0, utc_s.size - HALF_HOUR, 5):
        half_hour = slice(begin, begin + HALF_HOUR)
        if utc_s[half_hour][-1] - utc_s[begin] <= 60.0 * HALF_HOUR:
            for place, dead in enumerate((None, *range(len(FACES)))):
                sound = np.arange(len(FACES)) != dead
                found = find_jumps(np.where(sound, faces[half_hour], 0.0))
                named[place] += int(found.repeated(sun[half_hour], sound.tolist()).any())
    return named


def main() -> None:
    """Print alarms and minutes in doubt for each sky and albedo."""
    files = sorted(path for folder in sys.argv[1:] for path in Path(folder).glob("*.csv.gz"))
    utc_s, dni, dhi, *_ = read_minute_weather(files, LYNGBY)
    sun = sun_direction(utc_s, *LYNGBY)
    # Zero irradiance in daylight is an outage of the station, not weather.
    day = (sun[:, 2] > np.sin(np.radians(5.0))) & (dni * sun[:, 2] + dhi > 0.1)
    utc_s, dni, dhi, sun = utc_s[day], dni[day], dhi[day], sun[day]
    normals = face_normals(Settings().cube, LYNGBY.latitude_deg)
    print(f"{len(files)} months, {day.sum()} minutes with the sun above 5 deg")
    weather = arrange_daylight(utc_s, dni, dhi, LYNGBY)
    for model in SKIES:
        light = build_sky(weather, model)
        for albedo in ALBEDOS:
            found = np.zeros((utc_s.size, 4), dtype=np.int64)
            raised, minutes = (
                0,
                dict.fromkeys(
                    [kind for kind in Doubt if kind in (Doubt.DEAD, Doubt.DARK, Doubt.SAME, Doubt.TOO_BRIGHT)], 0
                ),
            )
            for seed in range(SEEDS):
                faces, voltages = cube_of(light, albedo, seed)
                means = five_minutes(utc_s, faces).tolist(), five_minutes(utc_s, voltages).tolist()
                found = np.array([doubts(*each, normals) for each in zip(*means, sun, strict=True)])
                raised += alarms(utc_s, (found != Doubt.NONE).any(axis=1))
                for kind in minutes:
                    minutes[kind] += int((found == kind).any(axis=1).sum())
            frozen = stays(utc_s, faces, sun)
            told = [f"{kind.name.lower()} {count}" for kind, count in minutes.items()]
            against, known, greatest, three = contradictions(utc_s, faces, sun)
            told.append(f"{against} of {known} half hours that contradict, misfit {greatest:.3f} at the most")
            told.append(f"of three faces {three:.3f}")
            accused, changing, odd, least = unchanging(utc_s, faces, sun)
            told.append(f"{accused} of {changing} half hours with changes accuse, {odd} contradict ({least:.2f})")
            told.append(f"{frozen} half hours with a face that stays")
            alone, *beside = jumping(utc_s, faces, sun)
            each = ", ".join(f"{count} {name}" for count, name in zip(beside, FACES, strict=True))
            told.append(f"{alone} with one that jumps, beside a dead face {each}")
            print(f"{model:10} albedo {albedo:4.2f}: {raised:4d} alarms for {SEEDS} cubes; minutes: {', '.join(told)}")


if __name__ == "__main__":
    main()
