"""The settings of the service: one TOML file, every key named with its unit, every unknown key an error.

The descriptions here are the only ones: the commented file, the reference and the error messages are made from them.
"""

import difflib
import ipaddress
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from daemon import config_rules
from daemon.api.address import DEFAULT_LISTEN
from daemon.bridge.addresses import parse_address
from solar.frames import Limits

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Azimuth = Annotated[float, Field(ge=0, lt=360)]
Channel = Annotated[int, Field(ge=0, le=15)]
Duration = Annotated[float, Field(gt=0, le=86400)]
WindSpeed = Annotated[float, Field(gt=0, le=40)]
LawName = Literal["mu-prime", "sun-vector", "chronometric", "flat"]
WeatherName = Literal["clear", "overcast", "variable"]
VOLTMETER_RANGES_V = (0.1, 1.0, 10.0)


def _text(form: str) -> WithJsonSchema:
    return WithJsonSchema({"type": "string", "format": form})


def _range(value: float) -> float:
    if value not in VOLTMETER_RANGES_V:
        raise ValueError("not a range of the voltmeter")
    return value


def _listen_address(text: str) -> str:
    parse_address(text)
    return text


def _send_address(text: str) -> str:
    if parse_address(text).port == 0:
        raise ValueError("port 0 is nobody's")
    return text


def _group(text: str) -> str:
    group = parse_address(text)
    if not (group.ip.version == 4 and group.ip.is_multicast and group.port):
        raise ValueError("not an IPv4 multicast group")
    return text


def _host(text: str) -> str:
    ipaddress.ip_address(text)
    return text


def _interface(text: str) -> str:
    ipaddress.IPv4Address(text)
    return text


def _no_empty_path(value: object) -> object:
    if value == "":
        raise ValueError("empty")
    return value


def _no_misspelt_weather(path: Path) -> Path:
    names = get_args(WeatherName)
    if path.name == str(path) and not path.suffix and difflib.get_close_matches(str(path).lower(), names):
        raise ValueError("a misspelt name and not a file")
    return path


RangeV = Annotated[float, AfterValidator(_range), WithJsonSchema({"type": "number", "enum": list(VOLTMETER_RANGES_V)})]
FilePath = Annotated[Path, Field(strict=False), BeforeValidator(_no_empty_path)]
WeatherFile = Annotated[FilePath, AfterValidator(_no_misspelt_weather)]
ListenAddress = Annotated[str, AfterValidator(_listen_address), _text("listen")]
SendAddress = Annotated[str, AfterValidator(_send_address), _text("address")]
Group = Annotated[str, AfterValidator(_group), _text("group")]
Host = Annotated[str, AfterValidator(_host), _text("ip")]
Interface = Annotated[str, AfterValidator(_interface), _text("ipv4")]


class Section(BaseModel):
    """A table of the file: frozen, closed to keys it does not know, and with no guessing of types."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)


class Site(Section):
    """Where the rig stands. The default is the paper's: SIRTA, Palaiseau."""

    name: str = Field("SIRTA", description="Name of the place, for people.")
    latitude_deg: float = Field(
        48.717607,
        ge=-90,
        le=90,
        description="Latitude, north positive; in the south the cube's south face looks north.",
    )
    longitude_deg: float = Field(2.209002, ge=-180, le=180, description="Longitude, east positive.")
    altitude_m: float = Field(156.0, ge=-430, le=9000, description="Height above sea level.")


class Face(Section):
    """One sensor of the cube: irradiance = gain x (voltage - offset)."""

    channel: Channel = Field(description="Multiplexer input that the sensor is wired to.")
    gain_w_m2_per_mv: Positive = Field(
        10.0, le=1000, description="Gain. A sensor of 0.1 mV per W/m2, such as the RG100, has a gain of 10."
    )
    offset_mv: float = Field(0.0, ge=-100, le=100, description="Voltage that the sensor gives in the dark.")
    azimuth_deg: Azimuth | None = Field(
        None,
        examples=[92.5],
        description="Where the face truly looks, from north clockwise: 92.5 for an east face turned by 2.5."
        " Left out: exactly where its name says.",
    )
    tilt_deg: float = Field(90.0, ge=0, le=180, description="Tilt of the face: 0 looks up, 90 at the horizon.")


class Cube(Section):
    """The cube and the rhythm in which its four faces are read."""

    name: str = Field(
        "cube",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,31}$",
        json_schema_extra={"format": "name"},
        description="Name that every scan bears on its way to the trackers.",
    )
    scan_every_s: float = Field(5.0, ge=0.5, le=60, description="Time from the start of one scan to the next.")
    reading_deadline_s: Positive = Field(
        2.0, le=60, description="Longest wait for one reading after the multiplexer has settled."
    )
    minimum_w_m2: float = Field(-20.0, ge=-100, le=0, description="Readings below are implausible and not used.")
    maximum_w_m2: float = Field(1500.0, ge=500, le=3000, description="Readings above are implausible and not used.")
    dark_correction: bool = Field(
        default=True, description="Learn each sensor's voltage in the dark at night and subtract it."
    )
    calibration_file: FilePath | None = Field(
        None,
        examples=["calibration.toml"],
        description="File of 'heliocube calibrate'; its gains and offsets replace those of the faces below.",
    )
    self_test_channel: Channel | None = Field(
        None,
        examples=[7],
        description="Multiplexer input that is short-circuited: read before each scan to prove switch and meter.",
    )
    self_test_limit_mv: Positive = Field(
        0.5, le=100, description="Largest voltage of the short-circuited input that passes the self-test."
    )
    east: Face = Face(channel=0)
    south: Face = Face(channel=1)
    west: Face = Face(channel=2)
    zenith: Face = Face(channel=3, tilt_deg=0.0)

    @field_validator("east", "south", "west", "zenith", mode="before")
    @classmethod
    def _complete(cls, value: Any, info: ValidationInfo) -> Any:
        """Give a face of which the file names some keys that same face's defaults for the others."""
        if not isinstance(value, dict) or info.field_name is None:
            return value
        return {**cls.model_fields[info.field_name].default.model_dump(), **value}


class MultiplexerSettings(Section):
    """The switch between the faces and the voltmeter."""

    settle_s: float = Field(0.3, ge=0, le=5, description="Time from switching to the start of a conversion.")


class VoltmeterSettings(Section):
    """The Keithley 2000."""

    range_v: RangeV = Field(1.0, description="Measuring range; the meter reads up to 1.2 times this.")
    nplc: float = Field(1.0, ge=0.01, le=10, description="Integration time, in periods of the mains.")
    line_frequency_hz: Literal[50, 60] = Field(50, description="Frequency of the mains.")


class PositionerSettings(Section):
    """The POZSOL positioner: what the service may expect of its motion."""

    slowest_deg_per_s: Positive = Field(0.3, le=10, description="A move slower than this has failed.")
    telemetry_stale_s: Positive = Field(2.0, le=60, description="Silence after which the positioner counts as lost.")


class Instruments(Section):
    """How the instruments are reached. There is no silent fallback from one kind to another."""

    kind: Literal["simulated"] = Field("simulated", description="Kind of the instruments.")
    multiplexer: MultiplexerSettings = MultiplexerSettings()
    voltmeter: VoltmeterSettings = VoltmeterSettings()
    positioner: PositionerSettings = PositionerSettings()


class Law(Section):
    """The pointing law and its parameters."""

    name: LawName = Field(
        "mu-prime",
        description="mu-prime: towards sun and bright sky, the paper's (12). sun-vector: towards the sun as the cube"
        " sees it. chronometric: towards the sun by ephemeris. flat: up.",
    )
    albedo: float = Field(0.2, ge=0, le=1, description="Share of the irradiance that the ground reflects.")
    uniform_threshold: float = Field(
        0.01,
        ge=0,
        le=0.5,
        description="Differences between faces below this share of the zenith are noise of a uniform sky, not sun.",
    )


class Windows(Section):
    """The rhythm of control: the paper's mean over 120 s, every 300 s."""

    mean_s: Duration = Field(120.0, description="Span of the newest readings that a decision averages.")
    decide_every_s: Duration = Field(300.0, description="Time from one decision to the next.")
    minimum_coverage: float = Field(
        0.5, gt=0, le=1, description="Share of the span that good readings must cover for a decision."
    )


class LimitSettings(Section):
    """The permitted range of the angles: A -50 East to +50 West, B 90 flat. The mechanics allow no more than this."""

    a_min_deg: float = Field(-50.0, ge=-50, le=50, description="Lowest angle A, towards the east.")
    a_max_deg: float = Field(50.0, ge=-50, le=50, description="Highest angle A, towards the west.")
    b_min_deg: float = Field(15.0, ge=15, le=90, description="Lowest angle B, the steepest.")
    b_max_deg: float = Field(90.0, ge=15, le=90, description="Highest angle B; 90 is flat.")

    def limits(self) -> Limits:
        """Return the range as the science and the drivers know it."""
        return Limits(self.a_min_deg, self.a_max_deg, self.b_min_deg, self.b_max_deg)


class Motion(Section):
    """When a move is worth it, and what counts as having arrived."""

    deadband_deg: NotNegative = Field(0.6, le=30, description="A smaller change of direction is not worth a move.")
    minimum_interval_s: NotNegative = Field(60.0, le=86400, description="Least time between two tracking moves.")
    tolerance_deg: Positive = Field(0.8, le=10, description="Distance from the target that counts as arrived.")
    attempts: int = Field(3, ge=1, le=10, description="Tries before a move is given up and a fault declared.")
    retry_after_s: Duration = Field(600.0, description="Time after a fault until moves are tried again.")
    rehome: Literal["operator", "automatic"] = Field(
        "operator", description="Who orders the reference run after the positioner has lost its reference."
    )


class Safety(Section):
    """When not to track."""

    scan_stale_s: Duration = Field(15.0, description="Age from which the newest scan is not used any more.")
    fallback_after_s: Duration = Field(
        60.0, description="Time without good readings after which the sun is followed by ephemeris."
    )
    night_below_w_m2: NotNegative = Field(5.0, le=200, description="Zenith irradiance below which night begins.")
    night_above_w_m2: NotNegative = Field(10.0, le=200, description="Zenith irradiance above which night ends.")
    night_highest_sun_deg: float = Field(
        5.0, ge=-5, le=30, description="With the sun higher than this it is never night, however dark."
    )
    night_a_deg: float = Field(0.0, ge=-50, le=50, description="Angle A at night.")
    night_b_deg: float = Field(90.0, ge=15, le=90, description="Angle B at night.")
    stow_a_deg: float = Field(0.0, ge=-50, le=50, description="Angle A of the stow position.")
    stow_b_deg: float = Field(90.0, ge=15, le=90, description="Angle B of the stow position.")
    stow_wind_m_s: WindSpeed = Field(15.0, description="Wind speed from which the tracker is stowed.")
    release_wind_m_s: WindSpeed = Field(10.0, description="Wind speed below which stow may end.")
    stow_at_least_s: Duration = Field(900.0, description="Time that the wind must have been calm before stow ends.")
    wind_stale_s: Duration = Field(300.0, description="Silence of the wind sensor that counts as strong wind.")


class Bridge(Section):
    """How scans get from the cube to the trackers: UDP, signed with a key that both sides have."""

    listen: ListenAddress = Field(
        "127.0.0.1:20571", description="Tracker: address and port to receive on; 0.0.0.0 is every network."
    )
    send_to: tuple[SendAddress, ...] = Field(
        ("127.0.0.1:20571",), strict=False, description="Cube: addresses and ports of the trackers."
    )
    multicast_group: Group | None = Field(
        None, examples=["239.255.20.71:20571"], description="Group and port that the cube sends to and trackers join."
    )
    multicast_interface: Interface | None = Field(
        None, examples=["192.168.1.20"], description="This machine's own address in the network of the group."
    )
    multicast_ttl: int = Field(1, ge=1, le=32, description="How many networks multicast may cross; 1 is this one only.")
    key_file: FilePath | None = Field(
        None,
        examples=["bridge.key"],
        description="File with the key that signs scans, the same on both sides, mode 0600."
        " Left out: a new key at each start, which is enough for cube and tracker in one process.",
    )
    insecure: bool = Field(default=False, description="Take and send unsigned scans. For a closed lab network only.")
    accept_from: tuple[Host, ...] = Field(
        (), strict=False, description="Tracker: addresses of the cubes it listens to; empty is any."
    )
    clock_skew_s: Duration = Field(30.0, description="Largest difference between the clocks of cube and tracker.")
    late_after_s: Duration = Field(10.0, description="A scan that took longer on its way is not used.")


class Store(Section):
    """Where records are kept, in one SQLite file; without a directory they are not."""

    directory: FilePath | None = Field(None, examples=["records"], description="Folder of the records.")
    batch_s: float = Field(
        5.0, ge=0.1, le=300, description="Longest time until a record is written; a crash loses no more than this."
    )
    keep_days: int = Field(
        400,
        ge=1,
        le=36500,
        description="How many days with records are kept, at about 7 MB a day; the oldest go first.",
    )


class Api(Section):
    """The local HTTP interface, for `heliocube status`, `heliocube stow` and other programs on this machine."""

    enabled: bool = Field(default=True, description="Whether there is one.")
    listen: ListenAddress = Field(
        DEFAULT_LISTEN,
        description="Address and port to serve on. Everyone who reaches it can read the state; beyond this machine"
        " the token would travel unencrypted, so put a proxy with TLS in front.",
    )
    token_file: FilePath | None = Field(
        None,
        examples=["api.token"],
        description="File with the token that commands need, mode 0600 or 0640."
        " Left out: a new token at each start, shown on the terminal.",
    )


class Simulation(Section):
    """The simulated rig: its sky, its clock and its imperfections. Real instruments do not look here."""

    weather: WeatherName | WeatherFile = Field("variable", description="Sky by name, or a file of measured weather.")
    sky: Literal["perez1990", "isotropic", "haydavies"] = Field(
        "haydavies", description="Model of how diffuse light spreads over the sky."
    )
    albedo: float = Field(0.2, ge=0, le=1, description="True albedo of the simulated ground.")
    seed: int = Field(1, ge=0, le=2**63 - 1, description="The same seed gives the same clouds and noise.")
    start_utc: AwareDatetime | None = Field(
        None,
        examples=["2022-10-14T06:00:00Z"],
        description="Start of the simulated clock. Left out: now at speed 1, else a bright October morning of 2022.",
    )
    speed: Positive = Field(60.0, le=1000, description="How many times faster than real time.")
    anchor_utc: AwareDatetime | None = Field(
        None,
        examples=["2026-01-01T12:00:00Z"],
        description="Real time at which the simulated clock shows start_utc. Set it alike for cube and tracker to"
        " give two processes one sky. Left out: when the process starts.",
    )
    sensor_gain_error: NotNegative = Field(0.005, le=0.5, description="Spread of the sensors' gains, as a share.")
    sensor_noise_mv: NotNegative = Field(0.02, le=100, description="Noise of a sensor's voltage, one sigma.")
    motor_speed_mm_s: Positive = Field(3.2, le=100, description="Speed of the positioner's actuators.")


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
    api: Api = Api()
    simulation: Simulation = Simulation()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        found = [f"{conflict.key} {conflict.reason}" for conflict in config_rules.conflicts(self)]
        if found:
            raise ValueError("; ".join(found))
        return self
