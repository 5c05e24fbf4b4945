"""The settings of what links the service to the world: bridge, store, HTTP interface, broker."""

from pathlib import Path
from typing import Literal, TypeVar

from pydantic import Field

from daemon.base.addresses import DEFAULT_DASHBOARD, DEFAULT_LISTEN, parse_address
from daemon.config.section import Duration, FilePath, Section, read_tables, validate_section
from daemon.config.text_types import (
    ArchiveUrl,
    ClockTime,
    Group,
    HostName,
    Interface,
    IpAddress,
    JsonPath,
    ListenAddress,
    SendAddress,
    Topic,
    TopicFilter,
    TopicLevel,
    TrackerAddress,
    WebAddress,
)


class BridgeSettings(Section):
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
    send_to: tuple[TrackerAddress, ...] = Field(
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
        description="File with the key that signs scans, the same on both sides, mode 0600; a second line may have"
        " another key that is accepted too. It is read again when it changes."
        " Left out: a new key at each start, which is enough for cube and tracker in one process.",
    )
    insecure: bool = Field(default=False, description="Accept and send unsigned scans. For a closed lab network only.")
    accept_from: tuple[IpAddress, ...] = Field(
        (), strict=False, description="Tracker: addresses of the cubes it listens to; empty is any."
    )
    clock_skew_s: Duration = Field(30.0, description="Largest difference between the clocks of cube and tracker.")
    late_after_s: Duration = Field(10.0, description="A scan that took longer on its way is not used.")


class StoreSettings(Section):
    """Where records are kept, in one SQLite file, and beside it what must outlive a restart."""

    directory: FilePath | None = Field(
        None,
        examples=["records"],
        description="Folder of both. If it is not set, a real rig has a folder with the name of this file in systemd's"
        " $STATE_DIRECTORY, or else one beside this file: records for heliocube.toml, NAME-records for NAME.toml. A"
        " simulated rig then keeps nothing.",
    )
    batch_s: float = Field(
        5.0, ge=0.1, le=300, description="Longest time until a record is written; a crash loses no more than this."
    )
    keep_days: int = Field(
        400,
        ge=1,
        le=36500,
        description="How many days with records are kept, at about 5 MB a day; the oldest go first.",
    )


class ApiSettings(Section):
    """The local HTTP interface, for `heliocube status`, `heliocube stow` and other programs on this machine."""

    enabled: bool = Field(default=True, description="Whether the interface is served.")
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
    hosts: tuple[HostName, ...] = Field(
        (),
        strict=False,
        description="Further names, such as that of a proxy, that requests may be for, besides localhost and this"
        " machine's addresses. Other names are refused, because a web page could read the state under its own name.",
    )


class DashboardSettings(Section):
    """The dashboard in the browser, a process of its own: `heliocube dashboard`."""

    listen: ListenAddress = Field(
        DEFAULT_DASHBOARD,
        description="Address and port to serve on. Everyone who reaches it can see everything; commands need a"
        " service's token, which travels unencrypted beyond this machine unless a proxy with TLS is in front.",
    )
    services: tuple[SendAddress, ...] = Field(
        (),
        strict=False,
        description="Local interfaces of the services that it shows. Empty: the one that [api] of this file names.",
    )
    hosts: tuple[HostName, ...] = Field(
        (),
        strict=False,
        description="Names under which browsers reach it, such as that of a proxy; localhost and numeric addresses"
        " always do.",
    )


class NotifySettings(Section):
    """Alarms to people, from a process of its own: `heliocube notify`."""

    people_file: FilePath | None = Field(
        None,
        examples=["notify.people"],
        description="File with the recipients, mode 0600 or 0640 because it holds passwords: one apprise address per"
        " line, such as ntfy://ntfy.lab/roof or mailto://user:password@lab.example.",
    )
    services: tuple[SendAddress, ...] = Field(
        (),
        strict=False,
        description="Local interfaces of the services whose alarms it sends. Empty: the one that [api] of this file"
        " names.",
    )
    dashboard: WebAddress | None = Field(
        None,
        examples=["https://tracker.lab/"],
        description="Link in each message, an address that its readers can open.",
    )
    at_least: Literal["notice", "warning", "critical"] = Field(
        "warning", description="The least severity that is sent."
    )
    quiet_from: ClockTime | None = Field(
        None, examples=["22:00"], description="From this local time on only critical alarms are sent; others wait."
    )
    quiet_until: ClockTime | None = Field(
        None, examples=["06:30"], description="At this local time the messages that waited are sent as one."
    )
    most_per_hour: int = Field(
        20,
        ge=1,
        le=1000,
        description="Most messages an hour to each address; further ones are gathered into one. Critical ones are"
        " counted apart.",
    )
    poll_every_s: float = Field(10.0, ge=1, le=120, description="How often the services are asked [s].")
    silent_after_s: Duration = Field(
        120.0, ge=10, description="When a service has not answered for this long, a critical message is sent [s]."
    )
    heartbeat: WebAddress | None = Field(
        None,
        examples=["https://hc.example/ping/1234"],
        description="Address that is requested (GET) at regular intervals while this process works; a monitoring"
        " service there alerts you when that stops.",
    )
    heartbeat_every_s: Duration = Field(300.0, ge=10, description="How often that address is requested [s].")


class ArchiveSettings(Section):
    """All records of many services in one PostgreSQL, by a process of its own: `heliocube archive`.

    The broker is that of [mqtt].
    """

    database: ArchiveUrl | None = Field(
        None,
        examples=["postgresql://archive@db.plant/heliocube"],
        description="Address of the database, without a password.",
    )
    password_file: FilePath | None = Field(
        None,
        examples=["archive.password"],
        description="File of one line, the user's password at the database, mode 0600 or 0640. Left out: the"
        " password from the file that PGPASSFILE names.",
    )
    topics: tuple[TopicFilter, ...] = Field(
        ("+/+/records",),
        strict=False,
        description="Topics that it subscribes to; + stands for one level. A prefix of two levels needs +/+/+/records.",
    )
    group: TopicLevel = Field(
        "heliocube", description="Processes with one group share the work: each page of records goes to one of them."
    )


class SunspecSettings(Section):
    """The trackers as a SunSpec device on Modbus TCP, for a control room. Modbus has no password and no encryption."""

    enabled: bool = Field(default=False, description="Whether the device is served.")
    listen: ListenAddress = Field(
        "127.0.0.1:5020",
        description="Address and port to serve on; 502 is the usual port and needs a privilege. Everyone who reaches it"
        " can read, and write if manual is true: serve other machines only in a closed network.",
    )
    unit: int = Field(1, ge=1, le=247, description="Address of the device.")
    manual: bool = Field(
        default=False,
        description="Whether clients may set model 601 to manual (a goto or hold like any operator's) and back.",
    )


class WindInput(Section):
    """A wind sensor on the broker. Thresholds and times are those of [safety]."""

    topic: Topic | None = Field(
        None, examples=["weather/roof"], description="Topic with the wind speed. Left out: there is none."
    )
    json_path: JsonPath = Field(
        "", description="Path of the speed in a JSON message; empty if the message is the number itself."
    )
    unit: Literal["m/s", "km/h", "mph", "kn", "kt"] = Field("m/s", description="Unit of the speed.")


class SafeInput(Section):
    """A source on the broker that says whether it is safe to track, such as a weather station or a switch."""

    topic: Topic | None = Field(
        None, examples=["dome/safety"], description="Topic with the safe or unsafe message. Left out: there is none."
    )
    json_path: JsonPath = Field(
        "", description="Path of the value in a JSON message; empty if the message is the value itself."
    )
    safe: str = Field(
        "safe", min_length=1, description="The value that means safe; true, false and numbers are allowed too."
    )
    unsafe: str = Field("unsafe", min_length=1, description="The value that means unsafe.")
    stale_s: Duration = Field(300.0, description="Time without a safe message that counts as unsafe.")
    stow_at_least_s: Duration = Field(900.0, description="How long it must have been safe before stow ends.")


class MqttSettings(Section):
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
        description="Name of the connection; two with one name keep disconnecting each other. Left out: made of prefix"
        " and name.",
    )
    keepalive_s: int = Field(
        5, ge=2, le=60, description="Longest silence; a broker that hangs is noticed within twice this."
    )
    prefix: Topic = Field("heliocube", description="What all topics of the installation begin with.")
    name: TopicLevel | None = Field(
        None,
        examples=["roof"],
        description="Topic level of this tracker, or of this cube, below the prefix; the store uses the name too. Left"
        " out: tracker, or cube.",
    )
    state_every_s: float = Field(10.0, ge=1, le=3600, description="Time from one message with the state to the next.")
    queue_messages: int = Field(
        1000, ge=10, le=100_000, description="How many messages wait while the broker is away; the oldest go first."
    )
    commands: bool = Field(
        default=True, description="Accept commands. Then everyone who may write to the broker can move the tracker."
    )
    dated_commands: bool = Field(
        default=False,
        description='Accept only commands with an "id" and a "time", and each only once; a stop is always accepted.',
    )
    command_age_s: Duration = Field(
        30.0, description="Largest difference between the time of a command and the service's clock."
    )
    archive: bool = Field(
        default=False,
        description="Send every record of the store to an archive on this broker (docs/archive.md), again and again"
        " until it is confirmed there.",
    )
    archive_every_s: float = Field(10.0, ge=1, le=3600, description="How often new records are sent to the archive.")
    discovery: bool = Field(default=True, description="Make the tracker appear in Home Assistant by itself.")
    discovery_prefix: Topic = Field("homeassistant", description="Where Home Assistant looks for new devices.")
    wind: WindInput = WindInput()
    safe: SafeInput = SafeInput()


ClientSettings = TypeVar("ClientSettings", DashboardSettings, NotifySettings)


def read_client_section(path: Path | None, name: str, kind: type[ClientSettings]) -> ClientSettings:
    """Return the section of a process that knows services by HTTP only; if it names none, [api] fills in its services.

    Nothing else of the file is read: a mistake elsewhere in it concerns the service only.

    Raises
    ------
    UserError
        The file cannot be read, or one of the two sections is wrong.
    """
    raw = read_tables(path)
    found = validate_section(path, raw, name, kind)
    if found.services:
        return found
    listen = DEFAULT_LISTEN if "api" not in raw else validate_section(path, raw, "api", ApiSettings).listen
    return found.model_copy(update={"services": (str(parse_address(listen).reachable_address),)})
