"""The tables of the instruments: kind, connection, settings."""

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, WithJsonSchema, field_validator

from daemon.config.section import Positive, Section, text_of, with_defaults

VOLTMETER_RANGES_V = (0.1, 1.0, 10.0)
# Linux numbers these anew at every plug: after a replug the name may belong to another instrument.
_UNSTABLE_PORT = re.compile(r"/dev/(tty(ACM|USB|AMA)|pts/)\d+")
_STABLE_PORT = re.compile(r"/\S+|COM\d+")
_VISA_RESOURCE = re.compile(r"ASRL(?P<port>/\S+|COM\d+|\d+)::INSTR|GPIB\d*::\d+(::\d+)?::INSTR", re.IGNORECASE)
_SERVER = re.compile(r"[A-Za-z0-9._-]+:\d{1,5}|\[[0-9A-Fa-f:]+\]:\d{1,5}")


def _range(value: float) -> float:
    if value not in VOLTMETER_RANGES_V:
        raise ValueError("not a range of the voltmeter")
    return value


def _port(text: str) -> str:
    if not _STABLE_PORT.fullmatch(text) or _UNSTABLE_PORT.fullmatch(text):
        raise ValueError("not a name that stays the same")
    return text


def _visa(text: str) -> str:
    found = _VISA_RESOURCE.fullmatch(text)
    if found is None or (found["port"] and _UNSTABLE_PORT.fullmatch(found["port"])):
        raise ValueError("not a resource that stays the same")
    return text


def _server(text: str) -> str:
    if not (_SERVER.fullmatch(text) and 0 < int(text.rpartition(":")[2]) <= 65535):
        raise ValueError("not a host and port")
    return text


RangeV = Annotated[float, AfterValidator(_range), WithJsonSchema({"type": "number", "enum": list(VOLTMETER_RANGES_V)})]
PortValue = Annotated[int, Field(ge=0, le=255)]
SerialPort = Annotated[str, AfterValidator(_port), text_of("port")]
VisaResource = Annotated[str, AfterValidator(_visa), text_of("visa")]
Server = Annotated[str, AfterValidator(_server), text_of("server")]
Banner = Annotated[str, Field(pattern=r"^[ -#%-~]{4,80}$"), text_of("banner")]


class MultiplexerSettings(Section):
    """The switch between the faces and the voltmeter, on digital lines of an NI device."""

    settle_s: float = Field(0.3, ge=0, le=5, description="Time from switching to the start of a conversion.")
    digital_port: str = Field(
        "Dev1/port0",
        pattern=r"^[A-Za-z0-9 ._-]+/port\d$",
        json_schema_extra={"format": "digital-port"},
        description="Device and port that the address wires are on, as NI MAX shows it. All lines from line 0 to the"
        " highest one used are driven.",
    )
    server: Server | None = Field(
        None,
        examples=["192.168.1.30:31763"],
        description="NI gRPC Device Server of the PC that the NI device is plugged into. Left out: this PC.",
    )
    addresses: tuple[PortValue, ...] = Field(
        (0, 1, 2, 3, 4, 5, 6, 7),
        strict=False,
        min_length=1,
        max_length=16,
        description="What is written to the lines to select input 0, 1, 2 and so on.",
    )
    enable_line: int | None = Field(
        None, ge=0, le=7, examples=[3], description="Line that enables the switch; left out if enable is wired fast."
    )
    enable_level: Literal["high", "low"] = Field("high", description="Level of the enable line that switches on.")
    deadline_s: Positive = Field(2.0, le=30, description="Longest wait for one write to the lines.")


class VoltmeterSettings(Section):
    """The Keithley 2000: what it measures, and how it is connected."""

    range_v: RangeV = Field(1.0, description="Measuring range; the meter reads up to 1.2 times this.")
    nplc: float = Field(1.0, ge=0.01, le=10, description="Integration time, in periods of the mains.")
    line_frequency_hz: Literal[50, 60] = Field(50, description="Frequency of the mains.")
    resource: VisaResource | None = Field(
        None,
        examples=["ASRL/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0::INSTR"],
        description="VISA name of the meter: serial port or GPIB address.",
    )
    visa: Literal["py", "ni"] = Field("py", description="VISA library: PyVISA-py, or NI-VISA if it is installed.")
    prologix_port: SerialPort | None = Field(
        None,
        examples=["/dev/serial/by-id/usb-Prologix_Prologix_GPIB-USB_Controller_PX8ABCDE-if00-port0"],
        description="Port of a Prologix GPIB-USB adapter that the GPIB address is behind; with PyVISA-py only.",
    )
    baud_rate: Literal[300, 600, 1200, 2400, 4800, 9600, 19200] = Field(
        19200, description="RS-232: speed, as chosen at the meter's front panel; it leaves the factory with 4800."
    )
    terminator: Literal["LF", "CR", "LFCR"] = Field("LF", description="RS-232: end of line, as chosen at the meter.")
    flow_control: Literal["none", "xon-xoff"] = Field("none", description="RS-232: flow control, as at the meter.")


class AxisGeometry(Section):
    """How one axis turns motor travel into an angle; what is not of the positioner's unit is not looked at."""

    low_deg: float = Field(ge=-90, le=90, description="Angle of the tracker at the low end switch, position 0.")
    arm_1_mm: Positive = Field(300.0, le=3000, description="Unit mm: one fixed side of the actuator's triangle.")
    arm_2_mm: Positive = Field(300.0, le=3000, description="Unit mm: the other fixed side.")
    apex_deg: float = Field(
        gt=-90, lt=180, description="Unit mm: angle between the fixed sides where the tracker's angle is 0."
    )
    holder_mm: float = Field(
        0.0, ge=0, le=1000, description="Unit mm: how far the actuator lies beside the third side, by its clamp."
    )
    sense: Literal["raises", "lowers"] = Field(
        "raises", description="Unit mm: whether extension raises or lowers the tracker's angle."
    )
    zero_offset: float = Field(
        0.0, ge=-1000, le=1000, description="What the unit adds to every destination (field 192 or 193), in its units."
    )
    impulses_per_deg: Positive = Field(59.5, le=100000, description="Unit impulse: motor impulses per degree.")


class PositionerSettings(Section):
    """The POZSOL positioner: how it is connected, and what the service may expect of its motion."""

    slowest_deg_per_s: Positive = Field(0.3, le=10, description="A move slower than this has failed.")
    telemetry_stale_s: Positive = Field(2.0, le=60, description="Silence after which the positioner counts as lost.")
    current_alarm_a: Positive = Field(
        1.6,
        le=20,
        description="Motor current [A] that is told when it lasts; the unit's own limit is 2 A as delivered.",
    )
    port: SerialPort | None = Field(
        None, examples=["/dev/heliocube-positioner"], description="USB serial port, by a name that outlives a replug."
    )
    dtr: bool = Field(
        True,
        description="Modem line DTR from opening on. Set it to false for a board that restarts when its port is opened."
        " Linux raises it for an instant at every open all the same.",
    )
    rts: bool = Field(True, description="Modem line RTS, likewise.")
    boot_s: float = Field(
        0.0, ge=0, le=60, description="How long the unit may take to restart when its port is opened; 0 if it does not."
    )
    boot_banner: Banner | None = Field(
        None,
        examples=["POZSOL ready"],
        description="Text that the unit prints when it has restarted. Whenever it comes, the reference is in doubt.",
    )
    boards: tuple[str, ...] = Field(
        ("36A1",), strict=False, min_length=1, description="Boards (field 37) that may be written to."
    )
    position_unit: Literal["mm", "deg", "impulse"] = Field(
        "mm", description="What the unit counts positions in: mm with linear actuators, deg with slew drives."
    )
    status_layout: Literal["unknown", "stm", "lpc"] = Field(
        "unknown", description="Where the status word has axis B's bits; what B's moves show goes before it."
    )
    a_axis: AxisGeometry = AxisGeometry(low_deg=-52.0, apex_deg=90.0)
    b_axis: AxisGeometry = AxisGeometry(low_deg=13.0, apex_deg=37.5)

    @field_validator("a_axis", "b_axis", mode="before")
    @classmethod
    def _complete(cls, value: Any, info: ValidationInfo) -> Any:
        """Give an axis of which the file names some keys that same axis' defaults for the others."""
        return with_defaults(cls, value, info)


class Load(Section):
    """The electronic load that traces the I-V curve of the module on the tracker, in open circuit otherwise."""

    driver: Literal["none", "simulated", "chroma63600", "agilent6063b"] = Field(
        "none",
        description="Whether there is one, and which; simulated goes with simulated instruments, a real one with"
        " real instruments.",
    )
    resource: VisaResource | None = Field(
        None, examples=["GPIB0::5::INSTR"], description="VISA name of a real load: GPIB address, or serial port."
    )
    visa: Literal["py", "ni"] = Field("py", description="VISA library: PyVISA-py, or NI-VISA if it is installed.")
    prologix_port: SerialPort | None = Field(
        None,
        examples=["/dev/serial/by-id/usb-Prologix_Prologix_GPIB-USB_Controller_PX8ABCDF-if00-port0"],
        description="Port of a Prologix GPIB-USB adapter that the GPIB address is behind; with PyVISA-py only.",
    )
    channel: int = Field(
        1, ge=1, le=10, description="chroma63600: channel of the mainframe; modules with one input are 1, 3, 5, 7, 9."
    )
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
        default=False, description="Keep the points of every curve in the store, and not only what they say."
    )


class Instruments(Section):
    """How the instruments are reached. There is no silent fallback from one kind to another."""

    kind: Literal["simulated", "real"] = Field(
        "simulated", description="Simulated ones in this process, or real ones at the addresses below."
    )
    multiplexer: MultiplexerSettings = MultiplexerSettings()
    voltmeter: VoltmeterSettings = VoltmeterSettings()
    positioner: PositionerSettings = PositionerSettings()
