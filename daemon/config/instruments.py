"""The tables of the instruments: kind, connection, settings."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, SerializeAsAny

from daemon.config.plugin_sections import CUBE, POSITIONER
from daemon.config.section import Section
from drivers.settings import (
    CubeDriverSettings,
    HostAndPort,
    MeterRange,
    PortPath,
    PositionerSettings,
    Positive,
    VisaResource,
)

PortValue = Annotated[int, Field(ge=0, le=255)]


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
    server: HostAndPort | None = Field(
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
        None,
        ge=0,
        le=7,
        examples=[3],
        description="Line that enables the switch; left out if it is wired to be always on.",
    )
    enable_level: Literal["high", "low"] = Field("high", description="Level of the enable line that switches on.")
    deadline_s: Positive = Field(2.0, le=30, description="Longest wait for one write to the lines.")


class VoltmeterSettings(Section):
    """The Keithley 2000: what it measures, and how it is connected."""

    range_v: MeterRange = Field(1.0, description="Measuring range; the meter reads up to 1.2 times this.")
    nplc: float = Field(1.0, ge=0.01, le=10, description="Integration time, in periods of the mains.")
    line_frequency_hz: Literal[50, 60] = Field(50, description="Frequency of the mains.")
    resource: VisaResource | None = Field(
        None,
        examples=["ASRL/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0::INSTR"],
        description="VISA name of the meter: serial port or GPIB address.",
    )
    visa: Literal["py", "ni"] = Field("py", description="VISA library: PyVISA-py, or NI-VISA if it is installed.")
    prologix_port: PortPath | None = Field(
        None,
        examples=["/dev/serial/by-id/usb-Prologix_Prologix_GPIB-USB_Controller_PX8ABCDE-if00-port0"],
        description="Port of a Prologix GPIB-USB adapter that the GPIB address is behind; with PyVISA-py only.",
    )
    baud_rate: Literal[300, 600, 1200, 2400, 4800, 9600, 19200] = Field(
        19200, description="RS-232: speed, as chosen at the meter's front panel; it leaves the factory with 4800."
    )
    terminator: Literal["LF", "CR", "LFCR"] = Field("LF", description="RS-232: end of line, as chosen at the meter.")
    flow_control: Literal["none", "xon-xoff"] = Field("none", description="RS-232: flow control, as at the meter.")


class Instruments(Section):
    """How the instruments are reached. There is no silent fallback from one kind to another."""

    kind: Literal["simulated", "real"] = Field(
        "simulated", description="Simulated instruments in this process, or real ones at the addresses below."
    )
    bench: bool = Field(
        False, description="The addresses are a bench's: everything shown and recorded is marked as simulated."
    )
    cube: Annotated[SerializeAsAny[CubeDriverSettings], BeforeValidator(CUBE.validate)] = Field(
        default_factory=CUBE.defaults
    )
    multiplexer: MultiplexerSettings = MultiplexerSettings()
    voltmeter: VoltmeterSettings = VoltmeterSettings()
    positioner: Annotated[SerializeAsAny[PositionerSettings], BeforeValidator(POSITIONER.validate)] = Field(
        default_factory=POSITIONER.defaults
    )
