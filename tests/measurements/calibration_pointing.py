"""The numbers of docs/calibration.md: what calibration in place finds on simulated cubes, and how pointing gains by it.

    python tests/measurements/calibration_pointing.py FOLDER

FOLDER holds the measured weather (2016-MM.csv.gz). The run takes up to a quarter of an hour, and always gives the same
numbers.
"""

import sys
from pathlib import Path

import numpy as np

from sim_drivers.scene import FaceGeometry, Scene, SensorModel
from sim_drivers.weather_files import MeasuredWeather, load_weather
from solar.calibration.attitude import Attitude, attitude, face_orientations, rotation, to_site
from solar.calibration.in_place import FieldCalibration, UndeterminedError, calibrate_in_place
from solar.ephemeris import DAY_S, Site, sun_direction
from solar.frames import Array, separation_deg
from solar.laws.paper import complete_poleward, sun_vector
from solar.skies.sky import SKY_MODELS, SkyModel

SITE = Site(55.79064, 12.52505, 50.0)
ERRORS = np.array([1.03, 0.97, 1.02, 0.98])
# The same shape at another level, and against the zenith face: only the clear-sky model can tell these.
OTHER_ERRORS = (np.full(4, 1.03), np.full(4, 0.97), np.array([0.97, 0.97, 0.97, 1.03]))
STANDING = attitude(2.0, 1.0, 140.0, SITE.latitude_deg)
ALBEDO = 0.35
SEASONS = {"winter (Feb)": (2, 1.0), "spring (Apr)": (4, 1.1), "summer (Jul)": (7, 2.3), "autumn (Sep)": (9, 1.9)}
LEAST_DNI_W_M2 = 400.0
WATER_CM = {3: 1.0, 4: 1.1, 5: 1.5, 6: 2.0, 7: 2.3, 8: 2.3, 9: 1.9}


def simulate(weather: MeasuredWeather, model: SkyModel, begin_utc_s: float, days: float, step_s: float) -> tuple:
    """Return instants, what the flawed cube reads (n, 4) and DNI."""
    azimuth, tilt = face_orientations(STANDING, SITE.latitude_deg)
    faces = [FaceGeometry(*face) for face in zip(azimuth, tilt, strict=True)]
    scene = Scene(SITE, weather, sky_model=model, albedo=ALBEDO, sensors=SensorModel(gain_error=0.0), faces=faces)
    utc_s = begin_utc_s + np.arange(0.0, days * DAY_S, step_s)
    utc_s = utc_s[weather.covers(utc_s)]
    utc_s = utc_s[sun_direction(utc_s, *SITE)[:, 2] > np.sin(np.radians(8.0))]
    volts = np.array([[scene.sensor_voltage(face, now) for face in range(4)] for now in utc_s.tolist()])
    return utc_s, volts * 1e4 * ERRORS, weather.at(utc_s).dni_w_m2


def begin(month: int, day: int) -> float:
    return float(np.datetime64(f"2016-{month:02d}-{day:02d}").astype("datetime64[s]").astype(np.float64))


def pointing_error(utc_s: Array, faces: Array, albedo: float, standing: Attitude) -> Array:
    """Return the angle [deg] between the sun and the cube's sun vector, corrected by the known attitude of the cube."""
    sun = sun_direction(utc_s, *SITE)
    in_cube = sun @ rotation(standing, SITE.latitude_deg)
    seen = complete_poleward(sun_vector(faces, albedo=albedo), in_cube)
    return separation_deg(to_site(seen, standing, SITE.latitude_deg), sun)


def errors_of(found: FieldCalibration, truth: Array) -> tuple[Array, Array]:
    """Return errors and their expanded uncertainties: four gains [%], yaw and tilt [deg], albedo."""
    angle = np.hypot(
        found.attitude.lean_equator_deg - STANDING.lean_equator_deg,
        found.attitude.lean_east_deg - STANDING.lean_east_deg,
    )
    gains = 100.0 * (found.response / truth - 1.0)
    said = found.errors
    told = [*(100.0 * said.response / found.response), said.yaw_deg]
    told += [np.hypot(said.lean_equator_deg, said.lean_east_deg), said.albedo]
    return np.array([*gains, found.attitude.yaw_deg - STANDING.yaw_deg, angle, found.albedo - ALBEDO]), 2 * np.array(
        told
    )


def recovery_row(found: FieldCalibration) -> str:
    (east, south, west, zenith, yaw, tilt, albedo), told = errors_of(found, ERRORS)
    return (
        f"{found.days} | {east:+.2f} | {south:+.2f} | {west:+.2f} | {zenith:+.2f} | {told[0]:.1f}, {told[3]:.1f} | "
        f"{yaw:+.3f} | {tilt:.3f} | {albedo:+.3f} | {told[6]:.3f}"
    )


def summary(pairs: list[tuple[Array, Array]]) -> str:
    errors, told = (np.array(part) for part in zip(*pairs, strict=True))
    size = np.abs(errors)
    return (
        f"{len(pairs)} answers: root mean square {np.round(np.sqrt(np.mean(errors**2, axis=0)), 3).tolist()}, "
        f"largest {np.round(size.max(axis=0), 3).tolist()}, "
        f"within the uncertainty {np.round(100 * np.mean(size <= told, axis=0)).tolist()} %; "
        f"all gains within 1 % {np.mean((size[:, :4] <= 1).all(axis=1)):.0%}, 2 % "
        f"{np.mean((size[:, :4] <= 2).all(axis=1)):.0%}; tilt within 0.3 deg {np.mean(size[:, 5] <= 0.3):.0%}, albedo "
        f"within 0.05 {np.mean(size[:, 6] <= 0.05):.0%}"
    )


def through_the_year(folder: Path, first_days: tuple[int, ...], days: int) -> None:
    pairs = []
    for month, water in WATER_CM.items():
        weather = load_weather(folder / f"2016-{month:02d}.csv.gz")
        for day in first_days:
            utc_s, faces, _ = simulate(weather, "perez1990", begin(month, day), days, 60.0)
            rows = []
            for truth in (ERRORS, *OTHER_ERRORS):
                try:
                    found = calibrate_in_place(utc_s, faces / ERRORS * truth, SITE, water_cm=water)
                except UndeterminedError as error:
                    rows.append(f"refused: {error}")
                else:
                    rows.append(recovery_row(found))
                    pairs.append(errors_of(found, truth))
            print(f"| {month:02d}-{day:02d} | {water} | {rows[0]} |", flush=True)
    print(f"\nwith all sets of gains: {summary(pairs)}")


def main(folder: Path) -> None:
    may = load_weather(folder / "2016-05.csv.gz")
    print("| true sky | assumed | days | east % | south % | west % | zenith % | yaw deg | tilt deg | albedo |")
    calibrations = {}
    for truth in SKY_MODELS:
        readings = simulate(may, truth, begin(5, 1), 10, 60.0)
        for assumed in SKY_MODELS:
            try:
                found = calibrate_in_place(readings[0], readings[1], SITE, model=assumed)
            except UndeterminedError as error:
                print(f"| {truth} | {assumed} | refused: {error} |")
                continue
            if truth == assumed:
                calibrations[truth] = found
            print(
                f"| {truth} | {assumed} | {recovery_row(found)} | horizon {found.shape.horizon:.2f}, "
                f"unexplained {100 * found.shape.residual:.3f} % |"
            )
    print(
        "\n| ten days from | water | days | east | south | west | zenith | U east, zenith | yaw | tilt | albedo | U |"
    )
    through_the_year(folder, (1, 11, 21), 10)
    print("\nthirty days:")
    through_the_year(folder, (1,), 30)
    print("\n| sky | season | instants | as built: median, 90 % | gains | gains and albedo | all |")
    for truth, found in calibrations.items():
        for season, (month, _) in SEASONS.items():
            weather = load_weather(folder / f"2016-{month:02d}.csv.gz")
            utc_s, faces, dni = simulate(weather, truth, begin(month, 1), 28, 300.0)
            sunny = dni >= LEAST_DNI_W_M2
            utc_s, faces = utc_s[sunny], faces[sunny]
            level = Attitude(0.0, 0.0, 0.0)
            steps = (
                pointing_error(utc_s, faces, 0.2, level),
                pointing_error(utc_s, faces / found.response, 0.2, level),
                pointing_error(utc_s, faces / found.response, found.albedo, level),
                pointing_error(utc_s, faces / found.response, found.albedo, found.attitude),
            )
            cells = " | ".join(f"{np.median(step):.2f}, {np.quantile(step, 0.9):.2f}" for step in steps)
            print(f"| {truth} | {season} | {utc_s.size} | {cells} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
