"""Looks at each instrument before it is trusted; nothing here moves an axis."""

import asyncio
import os
from collections.abc import Callable
from pathlib import Path

from daemon.base.clock import Clock, iso_utc, local_time
from daemon.base.errors import UserError
from daemon.base.kernel_clock import synchronised
from daemon.base.records import FACES
from daemon.config.settings import Settings
from daemon.cube.calibration import calibrated_irradiance
from daemon.rigs.probe_load import probe_load
from daemon.rigs.probe_positioner import probe_positioner
from daemon.rigs.real import build_cube, build_positioner
from drivers.positioners.pozsol.driver import PozsolSettings
from drivers.transcript import no_tap
from solar.ephemeris import sun_position

Say = Callable[[str], object]

_LISTEN_S = 3.0
_STABLE_NAMES = ("heliocube-*", "serial/by-id/*")
_DIRECTIONS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def rig_utc_s(settings: Settings, now_s: float) -> float:
    """Return the time of the rig's clock [s since 1970]; a bench has a clock of its own."""
    if settings.bench_clock is None:
        return now_s
    start, anchor = settings.bench_clock
    return start.timestamp() + now_s - anchor.timestamp()


def sun_sentence(settings: Settings, now_s: float) -> str:
    """Return where the sun stands at the site now, and what time the rig's clock shows."""
    site, utc_s = settings.site, rig_utc_s(settings, now_s)
    sun = sun_position(utc_s, site.latitude_deg, site.longitude_deg, site.altitude_m)
    where = _DIRECTIONS[round(sun.azimuth_deg / 45.0) % 8]
    height = (
        f"{sun.elevation_deg:.0f} deg high" if sun.elevation_deg > 0 else f"down, {-sun.elevation_deg:.0f} deg below"
    )
    place = f"in the {where} (azimuth {sun.azimuth_deg:.0f} deg), {height}"
    return f"{_clock_sentence(settings, utc_s)}, and the sun is {place}."


def _clock_sentence(settings: Settings, utc_s: float) -> str:
    now = f"it is {iso_utc(utc_s)[:16]} UTC"
    if settings.instruments.bench:
        return f"By the bench's clock {now}"
    known = {True: "synchronised", False: "NOT synchronised", None: "not known to be synchronised"}[synchronised()]
    return f"By this machine's clock {now}, {local_time(utc_s):%H:%M} local ({known})"


def serial_ports() -> list[str]:
    """Return the serial ports of this machine, by names that stay the same after a replug if it has such names."""
    named = [str(path) for pattern in _STABLE_NAMES for path in sorted(Path("/dev").glob(pattern))]
    if named or os.name == "posix":
        return named
    from serial.tools import list_ports

    return sorted(port.device for port in list_ports.comports())


async def check_cube(settings: Settings, clock: Clock, say: Say) -> None:
    """Open the cube and read its faces once; raises `DeviceError` or `UserError`."""
    cube = build_cube(settings, clock)
    try:
        say(f"found: {await cube.open()}")
        reading = await cube.read()
    finally:
        await cube.close()
    for name, sample in zip(FACES, reading.faces, strict=True):
        face = getattr(settings.cube, name)
        if sample.flaw is not None:
            say(f"  {name:<7} {sample.flaw}")
        elif reading.unit == "V":
            voltage_mv = sample.value * 1e3
            say(f"  {name:<7} {voltage_mv:+z9.3f} mV  {calibrated_irradiance(voltage_mv, face):z8.1f} W/m2")
        else:
            say(f"  {name:<7} {sample.value:z8.1f} W/m2")
    for note in (*reading.notes, *(() if reading.proven else ("the self-test of switch and meter has FAILED",))):
        say(f"  {note}")


async def check_positioner(settings: Settings, clock: Clock, say: Say) -> None:
    """Listen to the positioner and report; raises `DeviceError` or `UserError`."""
    if isinstance(settings.instruments.positioner, PozsolSettings):
        await probe_positioner(settings, clock, _LISTEN_S, None, no_tap, say)
        return
    positioner = build_positioner(settings, clock)
    try:
        identity = await positioner.open()
        say(f"found: {identity.board} {identity.firmware} {identity.serial}".rstrip())
        await asyncio.sleep(_LISTEN_S)
        seen = await positioner.read_telemetry()
        say(f"  it stands at A {seen.a_deg:z.1f} deg, B {seen.b_deg:z.1f} deg")
        for sentence in (*identity.setup_conflicts, *seen.faults, *filter(None, [seen.reference_doubt])):
            say(f"  {sentence}")
    finally:
        await positioner.close()


async def check_load(settings: Settings, clock: Clock, say: Say) -> None:
    """Ask the electronic load for its identity; raises `DeviceError` or `UserError`."""
    await probe_load(settings, clock.monotonic, no_tap, say, write=False)


def require_movable(settings: Settings) -> None:
    """Raise `UserError` for a mount on which a few degrees of A or B can be a large move."""
    if not settings.instruments.positioner.axes_are_angles:
        raise UserError(
            "this mount turns in azimuth and elevation, where two degrees near flat can be half a turn: make its first"
            " move by hand, with docs/install.md section 7, and say 'skip' here"
        )
