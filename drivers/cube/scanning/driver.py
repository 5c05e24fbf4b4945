"""Scanning meters as a plug-in: the settings, and how the cube is built of them."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from drivers.cube.scanning.dialects import DIALECTS, Make
from drivers.cube.scanning.meter import DEVICE, ScanningMeterCube
from drivers.lines.socket_line import SOCKET_RESOURCE, SocketLine
from drivers.lines.threaded import ThreadedLine
from drivers.lines.visa import VisaLine, VisaSettings
from drivers.scpi import ScpiLine
from drivers.settings import (
    CubeDriverSettings,
    CubeSurroundings,
    MeterRange,
    SettingsConflict,
    SettingsError,
    check_host,
    stable_visa,
    text_schema,
)

_SECTION = "instruments.cube"


def _resource(text: str) -> str:
    found = SOCKET_RESOURCE.fullmatch(text)
    if found is None:
        return stable_visa(text)
    check_host(found["host"])
    return text


VisaOrSocket = Annotated[str, AfterValidator(_resource), text_schema("visa-or-socket")]
Channel = Annotated[int, Field(ge=1, le=399)]


class ScanningMeterSettings(CubeDriverSettings):
    """scanning-meter: a meter with a scanner card, four channels in one reply."""

    meter: Make = Field(
        "keithley2000-scan",
        description="Model: a Keithley 2000 with 2000-SCAN (or a DMM6500 set to SCPI2000), a DMM6500, a DAQ6510, or an"
        " Agilent 34970A, 34972A or DAQ970A.",
    )
    resource: VisaOrSocket | None = Field(
        None, examples=["TCPIP::192.168.1.60::5025::SOCKET"], description="VISA name of the meter."
    )
    channels: tuple[Channel, ...] | None = Field(
        None,
        strict=False,
        min_length=4,
        max_length=4,
        examples=[[101, 102, 103, 104]],
        description="Channels of east, south, west and zenith. Left out: 1 to 4, or 101 to 104, as the meter counts.",
    )
    meter_range_v: MeterRange = Field(1.0, description="Measuring range; the meter reads up to 1.2 times this.")
    nplc: float = Field(1.0, ge=0.02, le=10, description="Integration time, in periods of the mains.")
    visa: Literal["py", "ni"] = Field("py", description="VISA library: PyVISA-py, or NI-VISA if it is installed.")
    baud_rate: Literal[300, 600, 1200, 2400, 4800, 9600, 19200, 57600, 115200] = Field(
        9600, description="RS-232: speed, as chosen at the meter."
    )

    def conflicts(self) -> Iterator[SettingsConflict]:
        """Yield `channels` if two faces have the same channel."""
        if self.channels is not None and len(set(self.channels)) != len(self.channels):
            yield SettingsConflict("channels", "has one channel for two faces")


SETTINGS = ScanningMeterSettings


def build(
    settings: ScanningMeterSettings, surroundings: CubeSurroundings, line: ScpiLine | None = None
) -> ScanningMeterCube:
    """Return the cube, not yet connected; `SettingsError` if no line is given and none is named."""
    if line is None:
        line = _build_line(settings, surroundings)
    return ScanningMeterCube(
        line,
        DIALECTS[settings.meter],
        channels_of(settings),
        range_v=settings.meter_range_v,
        nplc=settings.nplc,
        surroundings=surroundings,
    )


def channels_of(settings: ScanningMeterSettings) -> tuple[int, int, int, int]:
    """Return the channels of east, south, west and zenith."""
    east, south, west, zenith = settings.channels or DIALECTS[settings.meter].channels
    return east, south, west, zenith


def _build_line(settings: ScanningMeterSettings, surroundings: CubeSurroundings) -> ScpiLine:
    if settings.resource is None:
        raise SettingsError(
            f"{_SECTION}.resource is missing: name the meter's VISA resource, such as"
            ' "TCPIP::192.168.1.60::5025::SOCKET" or "GPIB0::9::INSTR"'
        )
    if (found := SOCKET_RESOURCE.fullmatch(settings.resource)) is not None:
        return SocketLine(DEVICE, found["host"], int(found["port"]), surroundings.tap)
    where = VisaSettings(
        resource=settings.resource,
        library=settings.visa,
        baud_rate=settings.baud_rate,
        takes_adapter=False,
        device=DEVICE,
        section=_SECTION,
    )
    return ThreadedLine(DEVICE, lambda: VisaLine(where, surroundings.tap))
