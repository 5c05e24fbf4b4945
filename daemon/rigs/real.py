"""The drivers, built from the settings: on the ports that these name, or on a line that is given."""

from functools import partial
from typing import cast

from daemon.base import plugins
from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.config.settings import Settings
from drivers.interfaces import ElectronicLoad, Positioner
from drivers.lines.threaded import ThreadedLine
from drivers.lines.visa import VisaLine, VisaSettings
from drivers.load.agilent6063b import Agilent6063B
from drivers.load.chroma63600 import Chroma63600
from drivers.load.sweep import SweepSettings
from drivers.meters.keithley2000 import Keithley2000
from drivers.positioners.pozsol import driver as pozsol
from drivers.positioners.pozsol.driver import PozsolSettings
from drivers.positioners.pozsol.link import PositionerLine
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.scpi import ScpiLine
from drivers.settings import PositionerSurroundings, SettingsError
from drivers.switches.digital_port import DigitalPort
from drivers.switches.ni_port import NiPort
from drivers.switches.ni_usb6008 import NiMultiplexer
from drivers.transcript import Tap, no_tap

MARGIN_OF_LEAST_V = 0.9
"""The lowest voltage of a sweep may be read this much lower without ending it."""


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


def build_positioner(settings: Settings, clock: Clock) -> Positioner:
    """Return the positioner, not yet connected; `UserError` if the settings do not say how to reach it."""
    own = settings.instruments.positioner
    try:
        built = plugins.load(plugins.POSITIONERS, own.driver).build(own, positioner_surroundings(settings, clock))
    except SettingsError as error:
        raise UserError(str(error)) from None
    return cast("Positioner", built)


def build_pozsol(settings: Settings, clock: Clock, line: PositionerLine) -> PozsolPositioner:
    """Return the driver of a POZSOL unit on a line that is given, not yet connected; `UserError` for another make."""
    own = pozsol_settings(settings, "simulated is")
    return pozsol.build(own, positioner_surroundings(settings, clock), line)


def pozsol_settings(settings: Settings, who: str) -> PozsolSettings:
    """Return the settings of a POZSOL unit; `UserError`, beginning with `who`, where it is of another make."""
    own = settings.instruments.positioner
    if not isinstance(own, PozsolSettings):
        raise UserError(f'{who} a unit of the driver "pozsol", and instruments.positioner.driver is "{own.driver}"')
    return own


def positioner_surroundings(settings: Settings, clock: Clock, tap: Tap = no_tap) -> PositionerSurroundings:
    """Return what a positioner's driver is handed besides its settings."""
    return PositionerSurroundings(settings.limits.limits(), clock.monotonic, tap)


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
