"""Writes the sample days of daemon/studies/samples, minute by minute: ``python -m tests.measurements.make_samples``.

The weather is the simulator's, over the cube of a simulated rig at SIRTA; the same seeds give the same days.
"""

import csv
import io
from datetime import UTC, datetime

import numpy as np

from daemon.studies.samples import COLUMNS, DAYS, SITE, sample
from sim_drivers.scene import Scene, SensorModel
from sim_drivers.weather import GeneratedWeather
from solar.ephemeris import DAY_S

SEED = 1
# The simulator's name for each day's weather.
KINDS = {"clear": "clear", "mixed": "broken", "overcast": "overcast"}


def text(name):
    """Return the file of a day."""
    start_utc_s = datetime.fromisoformat(DAYS[name]).replace(tzinfo=UTC).timestamp()
    utc_s = start_utc_s + np.arange(0.0, DAY_S, 60.0)
    weather = GeneratedWeather(KINDS[name], SITE, SEED)
    conditions = weather.at(utc_s)
    scene, sensors = Scene(SITE, weather, seed=SEED), SensorModel()
    faces = [[scene.sensor_voltage(face, at) / sensors.volt_per_w_m2 for face in range(4)] for at in utc_s]
    light = (conditions.ghi_w_m2, conditions.dni_w_m2, conditions.dhi_w_m2)
    air = (conditions.wind_speed_m_s, conditions.temp_air_degc)
    # Adding zero turns -0.0 into 0.0.
    numbers = np.round(np.column_stack([*faces_columns(faces), *light, *air]), 1) + 0.0
    lines = io.StringIO()
    table = csv.writer(lines, lineterminator="\n")
    table.writerow(COLUMNS)
    for at, row in zip(utc_s, numbers.tolist(), strict=True):
        table.writerow([datetime.fromtimestamp(at, UTC).strftime("%Y-%m-%dT%H:%MZ"), *row, "true"])
    return lines.getvalue()


def faces_columns(faces):
    """Return the readings by face."""
    return np.array(faces).T


if __name__ == "__main__":
    for day in DAYS:
        sample(day).write_text(text(day), encoding="utf-8")
