"""`heliocube probe`: look at one real instrument, without changing anything unless asked to."""

import asyncio
import os
from collections.abc import Coroutine
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.api.client import CONFIG_VARIABLE
from daemon.base.errors import UserError
from daemon.commands.answers import JsonOption, message_printer, print_json
from daemon.commands.options import CubeOption, TrackerOption
from daemon.commands.recording import record_transcript

if TYPE_CHECKING:
    from daemon.config.settings import Settings

app = typer.Typer(
    help="Query one real instrument and report; nothing is changed unless you ask for it.",
    no_args_is_help=True,
)

ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE",
        envvar=CONFIG_VARIABLE,
        help="Configuration file that says where the instrument is.",
    ),
]
RecordOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write all bytes sent and received to this file.")
]
WriteOption = Annotated[bool, typer.Option("--write", help="Also do what changes the instrument's state.")]


@app.command()
def positioner(
    port: Annotated[str | None, typer.Option(help="Port of the positioner, instead of the configuration's.")] = None,
    config: ConfigOption = None,
    tracker: TrackerOption = None,
    seconds: Annotated[float, typer.Option(min=1, max=3600, help="How long to listen.")] = 10.0,
    move_deg: Annotated[
        float | None, typer.Option(min=1, max=20, help="MOVES both axes, one by one, by this much and back.")
    ] = None,
    record: RecordOption = None,
    as_json: JsonOption = False,
) -> None:
    """Identify the positioner by listening, and report its stream, settings and geometry."""
    from daemon.base.clock import SystemClock
    from daemon.rigs.probe_positioner import probe_positioner

    settings = _settings(config, "positioner", {"port": port}, tracker, kept=move_deg is not None)
    say = message_printer(as_json=as_json)
    with record_transcript(record) as tap:
        _run(probe_positioner(settings, SystemClock(), seconds, move_deg, tap, say), as_json=as_json, tracker=tracker)


@app.command()
def voltmeter(
    resource: Annotated[
        str | None, typer.Option(help="VISA name of the instrument, instead of the configuration's.")
    ] = None,
    config: ConfigOption = None,
    write: WriteOption = False,
    record: RecordOption = None,
    as_json: JsonOption = False,
) -> None:
    """Read the voltmeter's identity and settings; with --write, configure it and take ten readings."""
    from daemon.base.clock import SystemClock
    from daemon.rigs.probe_cube import probe_voltmeter

    settings = _settings(config, "voltmeter", {"resource": resource})
    say = message_printer(as_json=as_json)
    with record_transcript(record) as tap:
        _run(
            probe_voltmeter(settings, SystemClock().monotonic, tap, say, write=write),
            as_json=as_json,
        )


@app.command()
def multiplexer(
    server: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="NI gRPC Device Server.")] = None,
    config: ConfigOption = None,
    write: WriteOption = False,
    record: RecordOption = None,
    as_json: JsonOption = False,
) -> None:
    """Reserve the multiplexer's lines; with --write, select each input and measure it."""
    from daemon.rigs.probe_cube import probe_multiplexer

    settings = _settings(config, "multiplexer", {"server": server})
    say = message_printer(as_json=as_json)
    with record_transcript(record) as tap:
        _run(probe_multiplexer(settings, tap, say, write=write), as_json=as_json)


@app.command()
def cube(
    line: Annotated[
        str | None, typer.Option(metavar="LINE", help="Serial port, tcp:HOST:PORT or rtu-over-tcp:HOST:PORT.")
    ] = None,
    config: ConfigOption = None,
    name: CubeOption = None,
    addresses: Annotated[
        str, typer.Option(metavar="FIRST-LAST", help="Modbus addresses to query, within 1-247.")
    ] = "1-32",
    clear: Annotated[bool, typer.Option("--clear", help="Also clear the old error that an SMP keeps.")] = False,
    set_address: Annotated[
        bool, typer.Option("--set-address", help="Give new sensors their addresses in a dialogue, one at a time.")
    ] = False,
    record: RecordOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the pyranometers that answer on a Modbus line, with make, serial number and value."""
    from daemon.base.clock import SystemClock
    from daemon.rigs.probe_modbus import ModbusProbe, unit_range
    from daemon.studies.inputs import settings_for

    if as_json and set_address:
        raise UserError("--set-address is for people: leave out --json")
    # The file of HELIOCUBE_CONFIG may be for the usual cube, which has no such line.
    chosen = name or ("modbus-pyranometers" if config is None or line is not None else None)
    settings, units = settings_for(config, cube=chosen), unit_range(addresses)
    say = message_printer(as_json=as_json)
    with record_transcript(record) as tap:
        probe = ModbusProbe(settings, line, SystemClock(), say, tap)
        _run(probe.set_addresses(_ask, units) if set_address else probe.report(units, clear=clear), as_json=as_json)


def _ask(question: str) -> str:
    try:
        return input(f"{question}: ").strip()
    except EOFError:
        raise UserError("--set-address asks, and there is nobody to answer: run it in a terminal") from None


class LoadChoice(StrEnum):
    """Makes of electronic loads."""

    chroma63600 = "chroma63600"
    agilent6063b = "agilent6063b"


@app.command()
def load(
    resource: Annotated[
        str | None, typer.Option(help="VISA name of the instrument, instead of the configuration's.")
    ] = None,
    driver: Annotated[
        LoadChoice | None, typer.Option(help="Driver of the load, instead of the configuration's.")
    ] = None,
    config: ConfigOption = None,
    tracker: TrackerOption = None,
    write: Annotated[
        bool, typer.Option("--write", help="Also trace one curve; the module is in open circuit afterwards.")
    ] = False,
    record: RecordOption = None,
    as_json: JsonOption = False,
) -> None:
    """Read the electronic load's identity and settings; with --write, trace one curve."""
    from daemon.base.clock import SystemClock
    from daemon.config.file import load_settings, override
    from daemon.config.settings import Settings, settings_of_tracker
    from daemon.rigs.probe_load import probe_load

    settings = settings_of_tracker(load_settings(config) if config is not None else Settings(), tracker)
    given = {"resource": resource, "driver": None if driver is None else driver.value}
    settings = override(settings, {"load": {name: value for name, value in given.items() if value is not None}})
    say = message_printer(as_json=as_json)
    with record_transcript(record) as tap:
        _run(probe_load(settings, SystemClock().monotonic, tap, say, write=write), as_json=as_json)


def _settings(
    config: Path | None,
    instrument: str,
    given: dict[str, str | None],
    tracker: str | None = None,
    *,
    kept: bool = False,
) -> "Settings":
    """Return the settings for one instrument; with `kept`, also the folder in which its service keeps its state."""
    from daemon.commands.records_folder import with_records_folder
    from daemon.config.file import load_settings, override
    from daemon.config.settings import Settings, settings_of_tracker

    settings = load_settings(config) if config is not None else Settings()
    if kept and config is not None:
        settings = with_records_folder(settings, config, os.environ)
    if instrument == "positioner":
        settings = settings_of_tracker(settings, tracker)
    changes = settings.instruments.model_dump()
    changes[instrument] |= {name: value for name, value in given.items() if value is not None}
    return override(settings, {"instruments": changes})


def _run(work: Coroutine[Any, Any, dict[str, Any]], *, as_json: bool, tracker: str | None = None) -> None:
    """Run the probe; an error of the instrument gives one sentence and exit code 2."""
    from daemon.base.alarms.kinds import with_tracker_option
    from daemon.base.process import signals_as_ctrl_c
    from drivers.errors import DeviceError

    try:
        # An axis that moves must be stopped, whatever ends the program.
        with signals_as_ctrl_c():
            found = asyncio.run(work)
    except DeviceError as error:
        raise UserError(with_tracker_option(str(error), tracker)) from error
    if as_json:
        print_json(found)
