"""Runs the bench: simulated instruments in one process, for the real drivers in another."""

import asyncio
import contextlib
import logging
import sys
from datetime import UTC, datetime
from operator import attrgetter
from pathlib import Path
from typing import Any

from daemon.base import process
from daemon.base.clock import LoopClock, SystemClock
from daemon.base.errors import UserError
from daemon.base.files import replace_file
from daemon.base.process import on_signals
from daemon.base.records import FACES
from daemon.config.file import override
from daemon.config.keys import Drivers
from daemon.config.keys import keys as every_key
from daemon.config.plugin_sections import CUBE, LABJACK, MULTIPLEXED, POSITIONER, SCANNING_METER
from daemon.config.settings import Settings
from daemon.config.simulation import DEFAULT_START
from daemon.config.template import FILE_NAME, render_config
from daemon.rigs.simulated import BenchPorts, build_weather, run_bench
from drivers.cube.pyranometers.settings import PyranometersSettings
from drivers.positioners.rotctld.driver import RotctldSettings
from solar.ephemeris import DAY_S

log = logging.getLogger("heliocube.bench")

DIGITAL_PORT = "Dev1/port0"
_MARK = "# Written by heliocube bench, anew at each start."


def serve_bench(settings: Settings, directory: Path) -> None:
    """Run the bench in a directory until SIGINT, SIGTERM or SIGHUP; print ``ready`` when everything is there.

    Parameters
    ----------
    settings
        Site, cube and simulation of the bench, and everything else for the file that it writes.
    directory
        Where the ports, the control socket and the configuration file appear; made if missing.

    Raises
    ------
    UserError
        A weather file or the directory cannot be used, the disk is full, or the settings name trackers.
    """
    if settings.tracker:
        names = ", ".join(table.name for table in settings.tracker)
        raise UserError(f"the bench has one tracker and the configuration names {names}: leave its [[tracker]] out")
    settings = _with_distinct_addresses(settings)
    directory = directory.absolute()
    file = _claim(directory)
    process.configure_logging(sys.stderr, journal=False, level=logging.INFO)
    with asyncio.Runner() as runner:
        loop = runner.get_loop()
        anchor = datetime.fromtimestamp(SystemClock().utc(), UTC)
        start = settings.simulation.start_utc or DEFAULT_START
        clock = LoopClock(loop.time, start.timestamp())
        # A voltmeter can show "no value". Each kind of sensor of the other cubes would need its own sign for that.
        with_gaps = settings.instruments.cube.driver == MULTIPLEXED
        weather, warning = build_weather(settings, clock.utc(), clock.utc() + DAY_S, with_gaps=with_gaps)
        if warning:
            log.warning(warning)

        def ready(ports: BenchPorts) -> None:
            served = _service_settings(settings, directory, ports, start, anchor)
            chosen = (
                (CUBE.path, served.instruments.cube.driver),
                (POSITIONER.path, served.instruments.positioner.driver),
            )
            try:
                replace_file(file, f"{_MARK}\n{render_config('both', _values(served, chosen), chosen)}")
            except OSError as error:
                raise UserError(f"{file} cannot be written: {error.strerror}") from None
            sys.stdout.write("ready\n")
            sys.stdout.flush()

        stop = asyncio.Event()
        with on_signals(lambda: loop.call_soon_threadsafe(stop.set)):
            runner.run(run_bench(settings, directory, clock, weather, stop, ready))


def _with_distinct_addresses(settings: Settings) -> Settings:
    """Return the settings with distinct addresses for Modbus sensors, which on lines of their own may share one."""
    own = settings.instruments.cube
    if not isinstance(own, PyranometersSettings):
        return settings
    # A device with several faces has all of them at one line and address.
    places = [(own.line_of(face), own.face(face).address) for face in FACES]
    devices = list(dict.fromkeys(places))
    if len({address for _, address in devices}) == len(devices):
        return settings
    values: dict[str, Any] = CUBE.table_with_changes(own, {})
    for face, place in zip(FACES, places, strict=True):
        values[face] = {**values.get(face, {}), "address": devices.index(place) + 1}
    return override(settings, {"instruments": settings.instruments.model_dump() | {"cube": values}})


def _claim(directory: Path) -> Path:
    """Make the directory and return the file to write; `UserError` if there is one that no bench has written."""
    file = directory / FILE_NAME
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if file.exists() and not file.read_text(encoding="utf-8", errors="replace").startswith(_MARK):
            raise UserError(f"{file} was not written by a bench and is not overwritten; name another folder")
    except OSError as error:
        raise UserError(f"{directory} cannot be used: {error.strerror}") from None
    return file


def _service_settings(
    settings: Settings, directory: Path, ports: BenchPorts, start: datetime, anchor: datetime
) -> Settings:
    """Return the settings with which a service drives this bench under the same sun."""
    instruments = settings.instruments.model_dump() | {
        "kind": "real",
        "bench": True,
        "cube": _cube(settings, directory, ports),
    }
    instruments["multiplexer"] |= {"server": f"127.0.0.1:{ports.ni_server}", "digital_port": DIGITAL_PORT}
    instruments["voltmeter"] |= {"resource": f"ASRL{directory / 'voltmeter'}::INSTR", "visa": "py"}
    instruments["positioner"] = _positioner(settings, directory, ports)
    load = settings.load.model_dump() | {"resource": f"ASRL{directory / 'load'}::INSTR", "visa": "py"}
    if load["driver"] != "agilent6063b":
        load["driver"] = "chroma63600"
    clock = {"start_utc": start, "anchor_utc": anchor, "speed": 1.0}
    return override(settings, {"instruments": instruments, "load": load, "simulation": clock})


def _positioner(settings: Settings, directory: Path, ports: BenchPorts) -> dict[str, Any]:
    """Return the section of the positioner; a rotctld that `settings` name stays."""
    own = settings.instruments.positioner
    if not isinstance(own, RotctldSettings):
        return POSITIONER.table_with_changes(own, {"port": str(directory / "positioner")})
    return POSITIONER.table_with_changes(own, {"server": own.server or f"127.0.0.1:{ports.rotctld}"})


def _cube(settings: Settings, directory: Path, ports: BenchPorts) -> dict[str, Any]:
    """Return the section of the cube; Modbus sensors are on one line, over TCP if they are in `settings`."""
    own = settings.instruments.cube
    if own.driver == MULTIPLEXED:
        return {"driver": MULTIPLEXED}
    if own.driver == LABJACK:
        return CUBE.table_with_changes(own, {"line": f"tcp:127.0.0.1:{ports.modbus}"})
    if own.driver == SCANNING_METER:
        return CUBE.table_with_changes(own, {"resource": f"ASRL{directory / 'cube'}::INSTR", "visa": "py"})
    # Linux pseudo-terminals have no parity.
    values: dict[str, Any] = CUBE.table_with_changes(own, {"line": str(directory / "cube"), "serial_form": "8N1"})
    if str(getattr(own, "line", "")).startswith("tcp:"):
        values["line"] = f"tcp:127.0.0.1:{ports.modbus}"
    for face in FACES:
        if isinstance(values.get(face), dict):
            values[face].pop("line", None)
    return values


def _values(settings: Settings, chosen: Drivers) -> dict[str, Any]:
    """Return every value by its key's path; keys of drivers and laws that are not chosen have no value."""
    values = {}
    for path in every_key(chosen):
        with contextlib.suppress(AttributeError):
            values[path] = attrgetter(path)(settings)
    return values
