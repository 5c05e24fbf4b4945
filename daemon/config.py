"""The settings of the service: one TOML file, every key named with its unit, every unknown key an error."""

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from solar.frames import Limits

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Azimuth = Annotated[float, Field(ge=0, lt=360, allow_inf_nan=False)]
LawName = Literal["mu-prime", "sun-vector", "chronometric", "flat"]
WeatherName = Literal["clear", "overcast", "variable"]


class Section(BaseModel):
    """A table of the file: frozen, and closed to keys it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)


class Site(Section):
    """Where the rig stands. The default is the paper's: SIRTA, Palaiseau."""

    name: str = "SIRTA"
    latitude_deg: float = Field(48.717607, ge=-90, le=90, allow_inf_nan=False)
    longitude_deg: float = Field(2.209002, ge=-180, le=180, allow_inf_nan=False)
    altitude_m: float = Field(156.0, ge=-430, le=9000, allow_inf_nan=False)


class Face(Section):
    """One sensor of the cube and the multiplexer input it is wired to.

    ``irradiance = gain * (voltage - offset)``; the RG100 gives 0.1 mV per W/m2.
    """

    channel: int = Field(ge=0, le=15)
    gain_w_m2_per_mv: Positive = 10.0
    offset_mv: Finite = 0.0
    azimuth_deg: Azimuth | None = None
    tilt_deg: float = Field(90.0, ge=0, le=180, allow_inf_nan=False)


class Cube(Section):
    """The four faces and the rhythm in which they are read."""

    name: str = Field("cube", pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,31}$")
    scan_every_s: float = Field(5.0, ge=0.5, le=60, allow_inf_nan=False)
    reading_deadline_s: Positive = 2.0
    minimum_w_m2: float = Field(-20.0, ge=-100, le=0, allow_inf_nan=False)
    maximum_w_m2: float = Field(1500.0, ge=500, le=3000, allow_inf_nan=False)
    dark_correction: bool = True
    self_test_channel: int | None = Field(None, ge=0, le=15)
    self_test_limit_mv: Positive = 0.5
    east: Face = Face(channel=0)
    south: Face = Face(channel=1)
    west: Face = Face(channel=2)
    zenith: Face = Face(channel=3, tilt_deg=0.0)


class MultiplexerSettings(Section):
    """The switch between the faces and the voltmeter."""

    settle_s: float = Field(0.3, ge=0, le=5, allow_inf_nan=False)


class VoltmeterSettings(Section):
    """The Keithley 2000."""

    range_v: Literal[0.1, 1.0, 10.0] = 1.0
    nplc: float = Field(1.0, ge=0.01, le=10, allow_inf_nan=False)
    line_frequency_hz: Literal[50, 60] = 50


class PositionerSettings(Section):
    """The POZSOL positioner: what the service may expect of its motion."""

    slowest_deg_per_s: Positive = 0.3
    telemetry_stale_s: Positive = 2.0


class Instruments(Section):
    """How the instruments are reached. There is no silent fallback from one kind to another."""

    kind: Literal["simulated"] = "simulated"
    multiplexer: MultiplexerSettings = MultiplexerSettings()
    voltmeter: VoltmeterSettings = VoltmeterSettings()
    positioner: PositionerSettings = PositionerSettings()


class Law(Section):
    """The pointing law and its parameters."""

    name: LawName = "mu-prime"
    albedo: float = Field(0.2, ge=0, le=1, allow_inf_nan=False)
    south_threshold: float = Field(0.01, ge=0, le=0.5, allow_inf_nan=False)


class Windows(Section):
    """The rhythm of control: the paper's mean over 120 s, every 300 s."""

    mean_s: Positive = 120.0
    decide_every_s: Positive = 300.0
    minimum_coverage: float = Field(0.5, gt=0, le=1, allow_inf_nan=False)


class LimitSettings(Section):
    """The permitted range of the angles; the mechanics allow no more than the defaults."""

    a_min_deg: float = Field(-50.0, ge=-50, le=50, allow_inf_nan=False)
    a_max_deg: float = Field(50.0, ge=-50, le=50, allow_inf_nan=False)
    b_min_deg: float = Field(15.0, ge=15, le=90, allow_inf_nan=False)
    b_max_deg: float = Field(90.0, ge=15, le=90, allow_inf_nan=False)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for axis in "ab":
            low, high = getattr(self, f"{axis}_min_deg"), getattr(self, f"{axis}_max_deg")
            if not low < high:
                raise ValueError(f"{axis}_min_deg ({low:g}) must be less than {axis}_max_deg ({high:g})")
        return self

    def limits(self) -> Limits:
        """The range as the science and the drivers know it."""
        return Limits(self.a_min_deg, self.a_max_deg, self.b_min_deg, self.b_max_deg)


class Motion(Section):
    """When a move is worth it, and what counts as having arrived."""

    deadband_deg: NotNegative = 0.6
    minimum_interval_s: NotNegative = 60.0
    tolerance_deg: Positive = 0.8
    attempts: int = Field(3, ge=1, le=10)
    retry_after_s: Positive = 600.0
    rehome: Literal["operator", "automatic"] = "operator"


class Safety(Section):
    """When not to track."""

    scan_stale_s: Positive = 15.0
    fallback_after_s: Positive = 60.0
    night_below_w_m2: NotNegative = 5.0
    night_above_w_m2: NotNegative = 10.0
    night_highest_sun_deg: float = Field(5.0, ge=-5, le=30, allow_inf_nan=False)
    night_a_deg: Finite = 0.0
    night_b_deg: Finite = 90.0
    stow_a_deg: Finite = 0.0
    stow_b_deg: Finite = 90.0
    stow_wind_m_s: Positive = 15.0
    release_wind_m_s: Positive = 10.0
    stow_at_least_s: Positive = 900.0
    wind_stale_s: Positive = 300.0


class Bridge(Section):
    """How scans get from the cube to the trackers."""

    listen: str = "127.0.0.1:20571"
    send_to: tuple[str, ...] = ("127.0.0.1:20571",)
    multicast_group: str | None = None
    multicast_interface: str | None = None
    multicast_ttl: int = Field(1, ge=1, le=32)
    key_file: Path | None = None
    insecure: bool = False
    accept_from: tuple[str, ...] = ()
    clock_skew_s: Positive = 30.0
    late_after_s: Positive = 10.0


class Store(Section):
    """Where records are kept; without a directory they are not."""

    directory: Path | None = None


class Simulation(Section):
    """The simulated rig: its sky, its clock and its imperfections."""

    weather: WeatherName | Path = "variable"
    sky: Literal["perez1990", "isotropic", "haydavies"] = "perez1990"
    albedo: float = Field(0.2, ge=0, le=1, allow_inf_nan=False)
    seed: int = Field(1, ge=0, lt=2**63)
    start_utc: datetime | None = None
    speed: float = Field(60.0, gt=0, le=1000, allow_inf_nan=False)
    anchor_utc: datetime | None = None
    sensor_gain_error: NotNegative = 0.005
    sensor_noise_mv: NotNegative = 0.02
    motor_speed_mm_s: Positive = 3.2


class Settings(Section):
    """The whole file."""

    site: Site = Site()
    cube: Cube = Cube()
    instruments: Instruments = Instruments()
    law: Law = Law()
    windows: Windows = Windows()
    limits: LimitSettings = LimitSettings()
    motion: Motion = Motion()
    safety: Safety = Safety()
    bridge: Bridge = Bridge()
    store: Store = Store()
    simulation: Simulation = Simulation()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        limits = self.limits.limits()
        for name in ("night", "stow"):
            a_deg, b_deg = getattr(self.safety, f"{name}_a_deg"), getattr(self.safety, f"{name}_b_deg")
            if not limits.contain(a_deg, b_deg):
                raise ValueError(
                    f"safety.{name}_a_deg and safety.{name}_b_deg ({a_deg:g}, {b_deg:g}) lie outside limits ({limits})"
                )
        if self.windows.mean_s > self.windows.decide_every_s:
            raise ValueError("windows.mean_s must not be longer than windows.decide_every_s")
        return self
