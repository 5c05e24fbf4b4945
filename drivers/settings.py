"""What the settings of all drivers have in common, and what a driver is handed besides its settings.

A driver is a module with two names, found through the entry points of its kind, such as `heliocube.positioner`:

`SETTINGS`
    Its keys in the configuration, a child of :class:`PositionerSettings`, :class:`LoadSettings` or
    :class:`CubeDriverSettings`. Descriptions, units in names and ranges make the commented file, the reference and the
    error messages.
`build(settings, surroundings)`
    Returns the instrument, not yet connected; for a positioner a :class:`drivers.interfaces.Positioner`. Raises
    :class:`SettingsError` where the settings do not say enough to reach it. An electronic load is handed only the
    `drivers.transcript.Tap` besides its settings, and is a :class:`drivers.interfaces.ElectronicLoad`. A cube is a
    :class:`drivers.interfaces.Cube`.

A positioner's module may have a third, `simulate(settings, surroundings)`, for simulated rigs: it returns a function
that tells where the axes truly stand at a monotonic time, and the instrument. A cube's is `simulate(settings,
surroundings, sensor_v)` and returns the cube; `sensor_v(face, time_monotonic_s)` is the voltage [V] of the simulated
sensor on face 0 east, 1 south, 2 west or 3 zenith, of about 0.1 mV per W/m2.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, WithJsonSchema

from drivers.interfaces import Multiplexer, Voltmeter
from drivers.transcript import Tap, no_tap

# Linux numbers these anew at every plug: after a replug the name may belong to another instrument.
_UNSTABLE_PORT = re.compile(r"/dev/(tty(ACM|USB|AMA)|pts/)\d+")
_STABLE_PORT = re.compile(r"/\S+|COM\d+")
_SERVER = re.compile(r"[A-Za-z0-9._-]+:\d{1,5}|\[[0-9A-Fa-f:]+\]:\d{1,5}")
_VISA_RESOURCE = re.compile(
    r"ASRL(?P<port>/\S+|COM\d+|\d+)::INSTR|GPIB\d*::\d+(::\d+)?::INSTR",
    re.IGNORECASE,
)


class SettingsError(Exception):
    """The settings lack what the driver needs to reach its instrument: one sentence with the key and the remedy."""


def text_schema(form: str) -> WithJsonSchema:
    """Return the schema of a text of one of the forms that `daemon.config.keys` has words for."""
    return WithJsonSchema({"type": "string", "format": form})


def with_defaults(section: type[BaseModel], value: Any, info: ValidationInfo) -> Any:
    """Complete an inner table, of which the file names only some keys, by the outer table's defaults."""
    if not isinstance(value, dict) or info.field_name is None:
        return value
    return {**section.model_fields[info.field_name].default.model_dump(), **value}


def stable_port(text: str) -> str:
    """Return the name of a port; `ValueError` for one that another instrument may have after a replug."""
    if not _STABLE_PORT.fullmatch(text) or _UNSTABLE_PORT.fullmatch(text):
        raise ValueError("not a name that stays the same")
    return text


def stable_visa(text: str) -> str:
    """Return a VISA name; `ValueError` for one that another instrument may have after a replug."""
    found = _VISA_RESOURCE.fullmatch(text)
    if found is None or (found["port"] and _UNSTABLE_PORT.fullmatch(found["port"])):
        raise ValueError("not a resource that stays the same")
    return text


def exclusive_resource(resource: str | None, prologix_port: str | None) -> dict[str, str | None]:
    """Return what an instrument behind VISA holds: the port of its adapter, or its VISA name if it has no adapter."""
    return {"resource": resource} if prologix_port is None else {"prologix_port": prologix_port}


def canonical_address(name: str) -> str:
    """Return where a port, a server or a VISA name leads: for VISA's name of a serial line, its port."""
    found = _VISA_RESOURCE.fullmatch(name)
    if found is None:
        return name
    way = found["port"] or name
    return way if way.startswith("/") else way.upper()


def check_host(name: str) -> None:
    """Raise a `ValueError` for the name of a host that has an empty part, or one that is too long."""
    # The resolver would raise this UnicodeError, which nobody expects of it.
    try:
        name.encode("idna")
    except UnicodeError:
        raise ValueError("a part of the host's name is empty or longer than 63 letters") from None


def _checked_server(text: str) -> str:
    host, _, port = text.rpartition(":")
    if not (_SERVER.fullmatch(text) and 0 < int(port) <= 65535):
        raise ValueError("not a host and port")
    check_host(host)
    return text


def _range(value: float) -> float:
    if value not in METER_RANGES_V:
        raise ValueError("not a range of the meter")
    return value


Positive = Annotated[float, Field(gt=0)]
METER_RANGES_V = (0.1, 1.0, 10.0)
"""The ranges of every meter here for the DC voltages of sensors."""
MeterRange = Annotated[float, AfterValidator(_range), WithJsonSchema({"type": "number", "enum": list(METER_RANGES_V)})]
PortPath = Annotated[str, AfterValidator(stable_port), text_schema("port")]
HostAndPort = Annotated[str, AfterValidator(_checked_server), text_schema("server")]
VisaResource = Annotated[str, AfterValidator(stable_visa), text_schema("visa")]


class DriverSettings(BaseModel):
    """Frozen, closed to keys it does not know, and with no guessing of types."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)


class AngleRange(Protocol):
    """The permitted range of each angle [deg], ends included."""

    @property
    def a_min_deg(self) -> float:
        """Lowest angle A."""

    @property
    def a_max_deg(self) -> float:
        """Highest angle A."""

    @property
    def b_min_deg(self) -> float:
        """Lowest angle B."""

    @property
    def b_max_deg(self) -> float:
        """Highest angle B."""


class SettingsConflict(NamedTuple):
    """A key that conflicts with others: its name and theirs, relative to the driver's section, and what is wrong.

    Keys of other sections begin with a slash: ``/limits.a_min_deg``.
    """

    key: str
    reason: str
    others: tuple[str, ...] = ()


class PositionerSettings(DriverSettings):
    """How a positioner is connected, and what the service may expect of its motion.

    Attributes
    ----------
    axes_are_angles
        Whether each motor turns one of the angles A and B. Where not, as with azimuth and elevation, the way of a move
        is judged by positions, which then are in deg, and its end by the angles.
    axis_names
        What the two motors turn, as people are told.
    has_reference_run
        Whether `home` does anything; without it a doubt about the count waits for a person.
    """

    axes_are_angles: ClassVar[bool] = True
    axis_names: ClassVar[tuple[str, str]] = ("A", "B")
    has_reference_run: ClassVar[bool] = True

    driver: str = Field("", description="Name of the driver.")
    slowest_deg_per_s: Positive = Field(0.3, le=10, description="A move slower than this has failed.")
    telemetry_stale_s: float = Field(
        2.0,
        ge=0.5,
        le=60,
        description="Silence after which the positioner counts as lost; also the longest wait when it is opened.",
    )
    current_alarm_a: Positive = Field(
        1.6,
        le=20,
        description="Motor current [A] that raises an alarm when it lasts; the unit's own limit is 2 A as delivered.",
    )

    position_unit: Literal["mm", "deg", "impulse"] = Field("deg", description="What the unit counts positions in.")

    def exclusive(self) -> Mapping[str, str | None]:
        """Return the values that no two positioners can have in common, such as a port, by their keys."""
        return {}

    def conflicts(self, limits: AngleRange) -> Iterator[SettingsConflict]:  # noqa: ARG002
        """Yield the keys that cannot be as they are with these limits of the angles."""
        yield from ()

    def unreachable(self, a_deg: float, b_deg: float, equator_azimuth_deg: float) -> str | None:  # noqa: ARG002
        """Return why a position inside the limits cannot be reached with these settings, or None.

        `equator_azimuth_deg` is that of `PositionerSurroundings`.
        """
        return None

    def rests_within(self, limits: AngleRange) -> tuple[float, float]:  # noqa: ARG002
        """Return how far A and B come to rest at the most [deg] from an angle inside the limits that they are sent to.

        NaN for an axis that cannot be sent anywhere inside them.
        """
        return 0.0, 0.0

    def resolution(self) -> float:
        """Return what positions are rounded to, in their unit, where that is coarser than the drive's own count."""
        return 0.0


class LoadSettings(DriverSettings):
    """When and how an electronic load traces curves, whatever make it is."""

    driver: str = Field("", description="Name of the driver.")
    period_s: float = Field(5.0, ge=1, le=3600, description="Time from the start of one curve to the next.")
    points: int = Field(30, ge=8, le=200, description="Points of a curve, half of them around its knee.")
    settle_s: float = Field(0.03, ge=0.002, le=1, description="Time from a new voltage to its measurement.")
    minimum_voltage_v: Positive = Field(
        3.0, le=100, description="Lowest voltage of a curve; the load must be able to hold it."
    )
    abort_change: float = Field(
        0.1, gt=0, le=10, description="A curve ends where the zenith irradiance has changed by more than this share."
    )
    deadline_s: Positive = Field(1.0, le=30, description="Longest wait for one answer of the load.")
    keep_curves: bool = Field(
        default=False, description="Keep the points of every curve in the store, and not only their results."
    )

    def exclusive(self) -> Mapping[str, str | None]:
        """Return the values that no two loads can have in common, such as a port, by their keys."""
        return {}


class CubeDriverSettings(DriverSettings):
    """How what reads the cube's faces is connected; their gains and the rhythm are those of every cube, in [cube]."""

    driver: str = Field("", description="Name of the driver.")

    def conflicts(self) -> Iterator[SettingsConflict]:
        """Yield the keys that cannot be as they are."""
        yield from ()


@dataclass(frozen=True, slots=True)
class CubeWiring:
    """How the sensors are wired to the multiplexer.

    Attributes
    ----------
    channels
        Inputs of east, south, west and zenith.
    settle_s
        Time between switching the multiplexer and the start of a conversion.
    self_test_channels
        Short-circuited inputs, read before the faces; none of them: nothing is tested.
    self_test_limit_mv
        Largest voltage of such an input that proves switch and meter.
    """

    channels: tuple[int, int, int, int]
    settle_s: float
    self_test_channels: tuple[int, ...] = ()
    self_test_limit_mv: float = 0.5


class SwitchedMeter(NamedTuple):
    """One voltmeter for several sensors, and what leads to each of them."""

    multiplexer: Multiplexer
    voltmeter: Voltmeter
    wiring: CubeWiring


@dataclass(frozen=True, slots=True)
class CubeSurroundings:
    """What a cube's driver is handed besides its settings.

    Attributes
    ----------
    utc_s, monotonic_s
        Return the service's time.
    deadline_s
        Longest wait for one reading.
    switched_meter
        Builds multiplexer and voltmeter of the sections of these names, with the inputs of `[cube]`; raises where these
        do not say how to reach them.
    tap
        To be told what goes over the line.
    """

    utc_s: Callable[[], float]
    monotonic_s: Callable[[], float]
    deadline_s: float
    switched_meter: Callable[[], SwitchedMeter]
    tap: Tap = no_tap


@dataclass(frozen=True, slots=True)
class PositionerSurroundings:
    """What a positioner's driver is handed besides its settings.

    Attributes
    ----------
    limits
        Limits that the driver keeps its moves within, whatever it is asked for.
    monotonic
        The service's monotonic time [s].
    tap
        To be told what goes over the line.
    stow
        The angles A and B [deg] of the stow position, which it has to be able to reach.
    equator_azimuth_deg
        Compass direction that B 0 points to: 180 south, 0 north, by the site's hemisphere.
    """

    limits: AngleRange
    monotonic: Callable[[], float]
    tap: Tap = no_tap
    stow: tuple[float, float] = (0.0, 90.0)
    equator_azimuth_deg: float = 180.0
