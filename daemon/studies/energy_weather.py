"""Weather files as the energy benchmark wants them: whole, by the minute."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from daemon.rigs.simulated import measured_weather, weather_misfit
from solar.ephemeris import Site
from solar.frames import Array


def measured_minutes(files: Sequence[Path], site: Site) -> tuple[Array, Array, Array, list[str]]:
    """Read weather files: UTC [s] of whole minutes, DNI and DHI [W/m2], each of shape (n,), and warnings.

    Between records up to an hour apart the weather is linear. Where files overlap, the first counts.

    Raises
    ------
    UserError
        A file cannot be read.
    """
    parts: list[tuple[Array, Array, Array]] = []
    warnings: list[str] = []
    for path in files:
        weather = measured_weather(path)
        minutes = np.arange(np.ceil(weather.start_utc_s / 60.0), weather.end_utc_s / 60.0 + 1e-6) * 60.0
        minutes = minutes[weather.covers(minutes)]
        conditions = weather.at(minutes)
        parts.append((minutes, conditions.dni_w_m2, conditions.dhi_w_m2))
        warning = weather_misfit(weather, site)
        warnings += [warning] if warning else []
    utc_s, dni, dhi = (np.concatenate(column) for column in zip(*parts, strict=True))
    utc_s, first = np.unique(utc_s, return_index=True)
    return utc_s, dni[first], dhi[first], warnings
