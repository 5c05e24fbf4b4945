"""The settings of the simulated rig."""

import difflib
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, AwareDatetime, Field

from daemon.config.section import FilePath, NotNegative, Section
from drivers.settings import Positive

LARGEST_SEED = 2**63 - 1
"""A TOML file has no larger whole number."""
# A day of the paper's measuring campaign, minutes before its first cloud gap: what a visitor sees first.
DEFAULT_START = datetime(2022, 10, 12, 9, 25, tzinfo=UTC)

WeatherName = Literal["clear", "overcast", "variable", "broken"]


def _no_misspelt_weather(path: Path) -> Path:
    names = get_args(WeatherName)
    if path.name == str(path) and not path.suffix and difflib.get_close_matches(str(path).lower(), names):
        raise ValueError("a misspelt name and not a file")
    return path


WeatherFile = Annotated[FilePath, AfterValidator(_no_misspelt_weather)]


class SimulationSettings(Section):
    """The simulated rig: its sky, its clock and its imperfections.

    Real instruments ignore this section, except that start_utc and anchor_utc set their time with instruments.bench.
    """

    weather: WeatherName | WeatherFile = Field("variable", description="Sky by name, or a file of measured weather.")
    sky: Literal["perez1990", "isotropic", "haydavies"] = Field(
        "haydavies", description="Model of how diffuse light spreads over the sky."
    )
    albedo: float = Field(0.2, ge=0, le=1, description="True albedo of the simulated ground.")
    seed: int = Field(1, ge=0, le=LARGEST_SEED, description="The same seed gives the same clouds and noise.")
    start_utc: AwareDatetime | None = Field(
        None,
        examples=["2022-10-14T06:00:00Z"],
        description="Start of the simulated clock. Left out: now at speed 1, else a bright October morning of 2022.",
    )
    speed: Positive = Field(
        60.0,
        le=1000,
        description="How many times faster than real time it runs; a machine too slow for it takes longer.",
    )
    anchor_utc: AwareDatetime | None = Field(
        None,
        examples=["2026-01-01T12:00:00Z"],
        description="Real time at which the simulated clock shows start_utc. Set it alike for cube and tracker to"
        " give two processes one sky. Left out: when the process starts.",
    )
    sensor_gain_error: NotNegative = Field(0.005, le=0.5, description="Spread of the sensors' gains, as a share.")
    sensor_noise_mv: NotNegative = Field(0.02, le=100, description="Noise of a sensor's voltage, one sigma.")
    # Faster actuators would turn an axis by more than 10 deg/s, which is taken for a jump of its count.
    motor_speed_mm_s: Positive = Field(3.2, le=15, description="Speed of the positioner's actuators.")
