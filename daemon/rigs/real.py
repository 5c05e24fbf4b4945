"""The drivers, built from the settings: on the ports that these name, or on a line that is given."""

from functools import partial

from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.config.instruments import AxisGeometry, PositionerSettings
from daemon.config.settings import Settings
from drivers.interfaces import ElectronicLoad
from drivers.lines.threaded import ThreadedLine
from drivers.lines.visa import VisaLine, VisaSettings
from drivers.load.agilent6063b import Agilent6063B
from drivers.load.chroma63600 import Chroma63600
from drivers.load.sweep import SweepSettings
from drivers.meters.keithley2000 import Keithley2000
from drivers.positioners.pozsol import wire as pozsol_wire
from drivers.positioners.pozsol.geometry import AxisSetup, Geometry, Proportional, Triangle
from drivers.positioners.pozsol.link import PositionerLine, SerialLine, open_port
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.scpi import ScpiLine
from drivers.switches.digital_port import DigitalPort
from drivers.switches.ni_port import NiPort
from drivers.switches.ni_usb6008 import NiMultiplexer
from drivers.transcript import Tap, no_tap

MARGIN_OF_LEAST_V = 0.9
"""The lowest voltage of a sweep may be read this much lower without ending it."""
_STEP = {"mm": 0.02, "deg": 0.02, "impulse": 1.5}
"""A Hall count and a little, where the unit does not tell how many there are to a unit."""
B_OUT_BIT = {"unknown": None, "stm": pozsol_wire.B_OUT_BIT_STM, "lpc": pozsol_wire.B_OUT_BIT_LPC}


def build_multiplexer(settings: Settings, tap: Tap = no_tap, port: DigitalPort | None = None) -> NiMultiplexer:
    """Return the multiplexer, not yet connected, at the configured digital port unless another one is given."""
    multiplexer = settings.instruments.multiplexer
    return NiMultiplexer(
        port or NiPort(multiplexer.digital_port, server=multiplexer.server, deadline_s=multiplexer.deadline_s),
        multiplexer.addresses,
        enable_line=multiplexer.enable_line,
        enable_level=multiplexer.enable_level == "high",
        tap=tap,
    )


def voltmeter_line(settings: Settings, tap: Tap = no_tap) -> ScpiLine:
    """Return the voltmeter's line, not yet open; `UserError` if the settings do not say where it is."""
    meter = settings.instruments.voltmeter
    if meter.resource is None:
        raise UserError(
            "instruments.voltmeter.resource is missing: real instruments need the meter's VISA name, such as"
            ' "ASRL/dev/serial/by-id/...::INSTR" or "GPIB0::16::INSTR"'
        )
    where = VisaSettings(
        resource=meter.resource,
        library=meter.visa,
        prologix_port=meter.prologix_port,
        baud_rate=meter.baud_rate,
        terminator=meter.terminator,
        flow_control=meter.flow_control,
    )
    return ThreadedLine("voltmeter", partial(VisaLine, where, tap))


def build_voltmeter(settings: Settings, tap: Tap = no_tap, line: ScpiLine | None = None) -> Keithley2000:
    """Return the voltmeter, not yet connected; `UserError` if no line is given and the settings do not name one."""
    meter = settings.instruments.voltmeter
    return Keithley2000(
        line or voltmeter_line(settings, tap),
        range_v=meter.range_v,
        nplc=meter.nplc,
        deadline_s=settings.cube.reading_deadline_s,
    )


def build_positioner(
    settings: Settings, clock: Clock, tap: Tap = no_tap, line: PositionerLine | None = None
) -> PozsolPositioner:
    """Return the positioner, not yet connected; `UserError` if no line is given and the settings do not name one."""
    positioner = settings.instruments.positioner
    return PozsolPositioner(
        line or positioner_line(settings, clock, tap),
        clock.monotonic,
        *axis_setups(settings),
        boards=positioner.boards,
        stale_s=positioner.telemetry_stale_s,
        b_out_bit=B_OUT_BIT[positioner.status_layout],
    )


def positioner_line(settings: Settings, clock: Clock, tap: Tap = no_tap) -> SerialLine:
    """Return the positioner's line, not yet open; `UserError` if the settings do not say where it is."""
    positioner = settings.instruments.positioner
    port = partial(open_port, positioner_port(settings), tap, dtr=positioner.dtr, rts=positioner.rts)
    return SerialLine(port, clock.monotonic, boot_s=positioner.boot_s, banner=positioner.boot_banner)


def load_line(settings: Settings, tap: Tap = no_tap) -> ScpiLine:
    """Return the electronic load's line, not yet open; `UserError` if the settings do not say where it is."""
    load = settings.load
    if load.resource is None:
        raise UserError('load.resource is missing: a real load needs its VISA name, such as "GPIB0::5::INSTR"')
    where = VisaSettings(load.resource, load.visa, load.prologix_port, device="load", section="load")
    return ThreadedLine("load", partial(VisaLine, where, tap))


def build_load(settings: Settings, tap: Tap = no_tap) -> ElectronicLoad | None:
    """Return the electronic load, not yet connected, or None if there is none; `UserError` if it cannot be found."""
    load = settings.load
    if load.driver in ("none", "simulated"):
        return None
    if load.driver == "chroma63600":
        return Chroma63600(load_line(settings, tap), load.channel, sweep_settings(settings))
    return Agilent6063B(load_line(settings, tap), sweep_settings(settings))


def sweep_settings(settings: Settings) -> SweepSettings:
    """Return how the electronic load sweeps."""
    load = settings.load
    return SweepSettings(load.settle_s, MARGIN_OF_LEAST_V * load.minimum_voltage_v, load.deadline_s)


def axis_setups(settings: Settings) -> tuple[AxisSetup, AxisSetup]:
    """Return geometry and limits of the axes A and B."""
    positioner, limits = settings.instruments.positioner, settings.limits
    a, b, step = positioner.a_axis, positioner.b_axis, _STEP[positioner.position_unit]
    return (
        AxisSetup(
            geometry=_geometry(positioner, a),
            minimum_deg=limits.a_min_deg,
            maximum_deg=limits.a_max_deg,
            zero_offset=a.zero_offset,
            step=step,
        ),
        AxisSetup(
            geometry=_geometry(positioner, b),
            minimum_deg=limits.b_min_deg,
            maximum_deg=limits.b_max_deg,
            zero_offset=b.zero_offset,
            step=step,
        ),
    )


def positioner_port(settings: Settings) -> str:
    """Return the positioner's port; `UserError` if the settings do not have it."""
    port = settings.instruments.positioner.port
    if port is None:
        raise UserError(
            "instruments.positioner.port is missing: real instruments need the positioner's port, such as"
            ' "/dev/serial/by-id/usb-..." or the link that deploy/udev makes, "/dev/heliocube-positioner"'
        )
    return port


def _geometry(positioner: PositionerSettings, axis: AxisGeometry) -> Geometry:
    if positioner.position_unit == "mm":
        return Triangle(
            arm_1_mm=axis.arm_1_mm,
            arm_2_mm=axis.arm_2_mm,
            apex_deg=axis.apex_deg,
            low_deg=axis.low_deg,
            holder_mm=axis.holder_mm,
            sense=axis.sense,
        )
    units_per_deg = axis.impulses_per_deg if positioner.position_unit == "impulse" else 1.0
    return Proportional(units_per_deg, axis.low_deg)
