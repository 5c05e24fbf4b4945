"""The settings of the service: one TOML file, every key named with its unit, every unknown key an error.

The descriptions here are the only ones: the commented file, the reference and the error messages are made from them.
"""

import difflib
import ipaddress
import re
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BeforeValidator,
    Field,
    ValidationInfo,
    field_validator,
)

from daemon.base.addresses import DEFAULT_LISTEN, parse_address
from daemon.config.instruments import Instruments, Load
from daemon.config.section import Positive, Section, text_of, with_defaults
from solar.ephemeris import Site as Place
from solar.frames import Limits

NotNegative = Annotated[float, Field(ge=0)]
Azimuth = Annotated[float, Field(ge=0, lt=360)]
Channel = Annotated[int, Field(ge=0, le=15)]
Duration = Annotated[float, Field(gt=0, le=86400)]
WindSpeed = Annotated[float, Field(gt=0, le=40)]
LawName = Literal["mu-prime", "sun-vector", "optimal", "chronometric", "flat"]
WeatherName = Literal["clear", "overcast", "variable", "broken"]
_HOST_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9.:-]{0,252}")


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


def _host_name(text: str) -> str:
    if not _HOST_NAME.fullmatch(text):
        raise ValueError("not a host")
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


FilePath = Annotated[Path, Field(strict=False), BeforeValidator(_no_empty_path)]
WeatherFile = Annotated[FilePath, AfterValidator(_no_misspelt_weather)]
ListenAddress = Annotated[str, AfterValidator(_listen_address), text_of("listen")]
SendAddress = Annotated[str, AfterValidator(_send_address), text_of("address")]
Group = Annotated[str, AfterValidator(_group), text_of("group")]
Host = Annotated[str, AfterValidator(_host), text_of("ip")]
Interface = Annotated[str, AfterValidator(_interface), text_of("ipv4")]
# Whether these three can be used is found by daemon.mqtt.unusable: a wrong one must not keep the tracker from tracking.
Topic = Annotated[str, text_of("topic")]
TopicLevel = Annotated[str, text_of("level")]
JsonPath = Annotated[str, text_of("json-path")]
HostName = Annotated[str, AfterValidator(_host_name), text_of("host")]


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

    def place(self) -> Place:
        """Return the site as the science knows it."""
        return Place(self.latitude_deg, self.longitude_deg, self.altitude_m)


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
    second_self_test_channel: Channel | None = Field(
        None,
        examples=[4],
        description="Another such input, with all address lines the other way: only two together see every stuck line.",
    )
    self_test_limit_mv: Positive = Field(
        0.5, le=100, description="Largest voltage of a short-circuited input that passes the self-test."
    )
    east: Face = Face(channel=0)
    south: Face = Face(channel=1)
    west: Face = Face(channel=2)
    zenith: Face = Face(channel=3, tilt_deg=0.0)

    @field_validator("east", "south", "west", "zenith", mode="before")
    @classmethod
    def _complete(cls, value: Any, info: ValidationInfo) -> Any:
        """Give a face of which the file names some keys that same face's defaults for the others."""
        return with_defaults(cls, value, info)


class Law(Section):
    """The pointing law and its parameters."""

    name: LawName = Field(
        "mu-prime",
        description="mu-prime: towards sun and bright sky, the paper's (12). sun-vector: towards the sun as the cube"
        " sees it. optimal: where the expected light is collected best, for little travel."
        " chronometric: towards the sun by ephemeris. flat: up.",
    )
    albedo: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Share of the irradiance that the ground reflects; optimal begins with it and learns its own.",
    )
    uniform_threshold: float = Field(
        0.01,
        ge=0,
        le=0.5,
        description="Differences between faces below this share of the zenith are noise of a uniform sky, not sun.",
    )
    gain_uncertainty: float = Field(
        0.03,
        ge=0,
        le=0.2,
        description="sun-vector: standard error of a face's gain, as a share; a beam that such errors explain is not"
        " pointed at.",
    )
    thrift: float = Field(
        1.0, ge=0.1, le=100, description="optimal: weight of wear against harvest; 2 travels less for a little energy."
    )
    travel_per_day_deg: Positive = Field(
        1300.0, le=100000, description="optimal: degrees of travel in a day, A and B added, that are never exceeded."
    )
    moves_per_day: int = Field(250, ge=1, le=1440, description="optimal: moves in a day that are never exceeded.")


class Windows(Section):
    """The rhythm of control: the paper's mean over 120 s, every 300 s."""

    mean_s: Duration = Field(120.0, description="Span of the newest readings that a decision averages.")
    decide_every_s: Duration = Field(
        300.0, description="Time from one decision to the next; optimal looks every minute, whatever stands here."
    )
    minimum_coverage: float = Field(
        0.25,
        gt=0,
        le=1,
        description="Share of the span that good readings must cover for a decision. With a quarter, a cube that was"
        " away for 70 s steers again with its first scan.",
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
    travel_per_day_deg: Positive = Field(
        2000.0,
        le=100000,
        description="Degrees of travel in a solar day, A and B added, beyond which no law moves the tracker.",
    )
    moves_per_day: int = Field(
        300, ge=1, le=10000, description="Moves in a solar day beyond which no law moves the tracker."
    )
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
    snow_a_deg: float = Field(0.0, ge=-50, le=50, description="Angle A of the snow position.")
    snow_b_deg: float = Field(
        15.0,
        ge=15,
        le=90,
        description="Angle B of the snow position: steep sheds snow and hail. The default goes as far as limits allow.",
    )
    stow_wind_m_s: WindSpeed = Field(15.0, description="Wind speed from which the tracker is stowed.")
    release_wind_m_s: WindSpeed = Field(10.0, description="Wind speed below which stow may end.")
    stow_at_least_s: Duration = Field(900.0, description="Time that the wind must have been calm before stow ends.")
    wind_stale_s: Duration = Field(300.0, description="Silence of the wind sensor that counts as strong wind.")
    without_wind_source: Literal["alarm", "accepted"] = Field(
        "alarm",
        description="What to do on real instruments when nothing tells of the wind: alarm, or accepted where somebody"
        " else sees to storms.",
    )


class Bridge(Section):
    """How scans get from the cube to the trackers: over UDP or a broker, signed with a key that both sides have."""

    transport: Literal["udp", "mqtt"] = Field(
        "udp",
        description="udp: within one network. mqtt: over the broker of [mqtt] to trackers in other networks; cube and"
        " tracker in one process still use UDP between themselves.",
    )
    topic: Topic = Field(
        "heliocube/bridge", description="Topic of the scans over a broker: one per cube, the same on both sides."
    )
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
        description="How many days with records are kept, at about 5 MB a day; the oldest go first.",
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


class WindInput(Section):
    """A wind sensor on the broker. Thresholds and times are those of [safety]."""

    topic: Topic | None = Field(
        None, examples=["weather/roof"], description="Topic that bears the wind speed. Left out: there is none."
    )
    json_path: JsonPath = Field(
        "", description="Where the speed is in a JSON message; empty where the message is the number."
    )
    unit: Literal["m/s", "km/h", "mph", "kn"] = Field("m/s", description="Unit of the speed.")


class SafeInput(Section):
    """Somebody on the broker who says whether it is safe to track, such as a weather station or a switch."""

    topic: Topic | None = Field(
        None, examples=["dome/safety"], description="Topic that bears the word. Left out: there is none."
    )
    json_path: JsonPath = Field(
        "", description="Where the word is in a JSON message; empty where the message is the word."
    )
    safe: str = Field("safe", min_length=1, description="The word for safe; true, false and numbers are words too.")
    unsafe: str = Field("unsafe", min_length=1, description="The word for unsafe.")
    stale_s: Duration = Field(300.0, description="Time without the word for safe that counts as unsafe.")
    stow_at_least_s: Duration = Field(900.0, description="Time that it must have been safe before stow ends.")


class Mqtt(Section):
    """Telemetry and commands over an MQTT broker, described in docs/mqtt.md."""

    enabled: bool = Field(default=False, description="Whether a broker is used at all.")
    host: HostName = Field("127.0.0.1", description="Name or address of the broker.")
    port: int = Field(1883, ge=1, le=65535, description="Port of the broker; with TLS usually 8883.")
    tls: bool = Field(default=False, description="Encrypt, and check the broker's certificate.")
    ca_file: FilePath | None = Field(
        None,
        examples=["broker-ca.pem"],
        description="Certificates that the broker's own is checked against. Left out: those of the system.",
    )
    certificate_file: FilePath | None = Field(
        None, examples=["client.pem"], description="This client's certificate, where the broker asks for one."
    )
    certificate_key_file: FilePath | None = Field(
        None, examples=["client.key"], description="The key of that certificate."
    )
    credentials_file: FilePath | None = Field(
        None, examples=["mqtt.credentials"], description="File of one line, user:password, mode 0600 or 0640."
    )
    client_id: str | None = Field(
        None,
        min_length=1,
        max_length=128,
        examples=["roof-tracker"],
        description="Name of the connection; two with one name throw each other out. Left out: of prefix and name.",
    )
    keepalive_s: int = Field(5, ge=2, le=60, description="Longest silence; a hung broker is noticed within twice this.")
    prefix: Topic = Field("heliocube", description="What all topics of the installation begin with.")
    name: TopicLevel | None = Field(
        None,
        examples=["roof"],
        description="Level of this tracker below the prefix, or of this cube; the store bears the name too. Left out:"
        " tracker, or cube.",
    )
    state_every_s: float = Field(10.0, ge=1, le=3600, description="Time from one message with the state to the next.")
    queue_messages: int = Field(
        1000, ge=10, le=100_000, description="How many messages wait while the broker is away; the oldest go first."
    )
    commands: bool = Field(
        default=True, description="Take commands. Whoever may write to the broker can move the tracker then."
    )
    discovery: bool = Field(default=True, description="Make the tracker appear in Home Assistant by itself.")
    discovery_prefix: Topic = Field("homeassistant", description="Where Home Assistant looks for new devices.")
    wind: WindInput = WindInput()
    safe: SafeInput = SafeInput()


class Simulation(Section):
    """The simulated rig: its sky, its clock and its imperfections.

    Real instruments do not look here, with one exception: start_utc and anchor_utc together give a bench its own time.
    """

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


class Sections(Section):
    """Everything that a file may set, section by section."""

    site: Site = Site()
    cube: Cube = Cube()
    instruments: Instruments = Instruments()
    load: Load = Load()
    law: Law = Law()
    windows: Windows = Windows()
    limits: LimitSettings = LimitSettings()
    motion: Motion = Motion()
    safety: Safety = Safety()
    bridge: Bridge = Bridge()
    store: Store = Store()
    api: Api = Api()
    mqtt: Mqtt = Mqtt()
    simulation: Simulation = Simulation()
