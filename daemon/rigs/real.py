"""Builds the drivers from the settings, on the ports that these name or on a line that is given."""

from collections.abc import Callable
from functools import partial
from typing import cast

from daemon.base import plugins
from daemon.base.clock import Clock, SystemClock
from daemon.base.errors import UserError
from daemon.base.kernel_clock import synchronised
from daemon.config.plugin_sections import LOAD, MULTIPLEXED
from daemon.config.rules import SELF_TESTS
from daemon.config.settings import Settings
from daemon.service.rig import Rig, Role, TrackerInstruments
from drivers.interfaces import Cube, ElectronicLoad, Multiplexer, Positioner, Voltmeter
from drivers.lines.threaded import ThreadedLine
from drivers.lines.visa import VisaLine, VisaSettings
from drivers.meters.keithley2000 import Keithley2000
from drivers.positioners.pozsol import driver as pozsol
from drivers.positioners.pozsol.driver import PozsolSettings
from drivers.positioners.pozsol.link import PositionerLine
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.scpi import ScpiLine
from drivers.settings import CubeSurroundings, CubeWiring, PositionerSurroundings, SettingsError, SwitchedMeter
from drivers.switches.digital_port import DigitalPort
from drivers.switches.ni_port import NiPort
from drivers.switches.ni_usb6008 import NiMultiplexer
from drivers.transcript import Tap, no_tap
from solar.frames import equator_azimuth_deg


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


def build_multiplexed_cube(settings: Settings, clock: Clock, multiplexer: Multiplexer, voltmeter: Voltmeter) -> Cube:
    """Return the cube of the given multiplexer and voltmeter, wired as configured, not yet connected."""
    driver = plugins.load(plugins.CUBES, MULTIPLEXED)
    own = driver.SETTINGS(driver=MULTIPLEXED)
    around = cube_surroundings(settings, clock, lambda: SwitchedMeter(multiplexer, voltmeter, _wiring(settings)))
    return cast("Cube", driver.build(own, around))


def build_cube(settings: Settings, clock: Clock) -> Cube:
    """Return the cube, not yet connected; `UserError` if the settings do not say how to reach it."""
    own = settings.instruments.cube
    try:
        return cast("Cube", plugins.load(plugins.CUBES, own.driver).build(own, cube_surroundings(settings, clock)))
    except SettingsError as error:
        raise UserError(str(error)) from None


def build_cube_for_role(settings: Settings, role: Role, clock: Clock) -> Cube:
    """Return the cube of a process with this role; `UserError` also names the role that may have been meant."""
    try:
        return build_cube(settings, clock)
    except UserError as error:
        if role is Role.BOTH and settings.tracker:
            raise UserError(f"{error}; if another process reads the cube, give --role tracker") from None
        raise


def cube_surroundings(
    settings: Settings, clock: Clock, switched_meter: Callable[[], SwitchedMeter] | None = None
) -> CubeSurroundings:
    """Return what a cube's driver gets besides its settings; the switched meter is the configured one unless given."""

    def configured() -> SwitchedMeter:
        return SwitchedMeter(build_multiplexer(settings), build_voltmeter(settings), _wiring(settings))

    return CubeSurroundings(
        utc_s=clock.utc,
        monotonic_s=clock.monotonic,
        deadline_s=settings.cube.reading_deadline_s,
        switched_meter=switched_meter or configured,
    )


def _wiring(settings: Settings) -> CubeWiring:
    cube = settings.cube
    tests = [getattr(cube, name) for name in SELF_TESTS]
    return CubeWiring(
        channels=(cube.east.channel, cube.south.channel, cube.west.channel, cube.zenith.channel),
        settle_s=settings.instruments.multiplexer.settle_s,
        self_test_channels=tuple(channel for channel in tests if channel is not None),
        self_test_limit_mv=cube.self_test_limit_mv,
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
    """Return the driver of a POZSOL unit on the given line, not yet connected; `UserError` for another make."""
    own = pozsol_settings(settings, "simulated is")
    return pozsol.build(own, positioner_surroundings(settings, clock), line)


def pozsol_settings(settings: Settings, who: str) -> PozsolSettings:
    """Return the settings of a POZSOL unit; for another make, a `UserError` that begins with `who`."""
    own = settings.instruments.positioner
    if not isinstance(own, PozsolSettings):
        raise UserError(f'{who} a unit of the driver "pozsol", and instruments.positioner.driver is "{own.driver}"')
    return own


def positioner_surroundings(settings: Settings, clock: Clock, tap: Tap = no_tap) -> PositionerSurroundings:
    """Return what a positioner's driver gets besides its settings."""
    return PositionerSurroundings(
        limits=settings.limits.limits(),
        monotonic=clock.monotonic,
        tap=tap,
        stow=(settings.safety.stow_a_deg, settings.safety.stow_b_deg),
        equator_azimuth_deg=equator_azimuth_deg(settings.site.latitude_deg),
    )


def build_load(settings: Settings, tap: Tap = no_tap) -> ElectronicLoad | None:
    """Return the electronic load, not yet connected, or None if there is none; `UserError` if it cannot be found."""
    if settings.load.driver in LOAD.built_in:
        return None
    try:
        return cast("ElectronicLoad", plugins.load(plugins.LOADS, settings.load.driver).build(settings.load, tap))
    except SettingsError as error:
        raise UserError(str(error)) from None


def build_real_rig(settings: Settings, role: Role, clock: Clock) -> Rig:
    """Build the real instruments that a role needs; nothing is connected yet.

    Raises
    ------
    UserError
        The settings do not say where one of them is.
    """
    trackers = () if role is Role.CUBE else settings.trackers
    return Rig(
        cube=None if role is Role.TRACKER else build_cube_for_role(settings, role, clock),
        trackers=tuple(
            TrackerInstruments(
                build_positioner(own, clock), build_load(own), has_fixed_start_pose=settings.instruments.bench
            )
            for _, own in trackers
        ),
        wind_speed_m_s=None,
        simulated=settings.instruments.bench,
        clock_synchronised=synchronised if isinstance(clock, SystemClock) else lambda: None,
        has_persistent_clock=isinstance(clock, SystemClock),
    )
