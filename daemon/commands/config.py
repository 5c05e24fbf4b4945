"""`heliocube config`: check a configuration file, write a commented one, update an older one to today's form."""

import contextlib
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console
from rich.text import Text

from daemon.api.client import CONFIG_VARIABLE
from daemon.base.records import FACES
from daemon.commands.answers import JsonOption, print_json, say
from daemon.commands.file_check import absent_addresses, check_file, missing_requirements_by_role
from daemon.commands.options import CubeOption, PositionerOption, RoleChoice
from daemon.commands.wrapping import wrapped

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from daemon.config.links import MqttSettings, SunspecSettings
    from daemon.config.sections import RowsSettings
    from daemon.config.settings import Settings


app = typer.Typer(
    help="Check a configuration file, write a commented one, or update an older one.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


@app.command()
def check(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="FILE", envvar=CONFIG_VARIABLE, help="The TOML file.", show_default=False),
    ] = None,
    role: Annotated[
        RoleChoice | None,
        typer.Option(
            help="What the process will do. If left out: the role of the unit that starts this file, or else any role"
            " that the file allows."
        ),
    ] = None,
    probe: Annotated[
        bool, typer.Option("--probe", help="Also open the real instruments, without changing anything.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check FILE and print what it sets up, or everything that is wrong with it."""
    from daemon.base.errors import UserError
    from daemon.config.file import ConfigError
    from daemon.config.stuck_lines import self_test_gaps

    if file is None:
        raise UserError(f"config check needs the service's configuration: name it as FILE or in {CONFIG_VARIABLE}")
    answers: dict[str, str] = {}
    try:
        settings = check_file(file, role, partial(_probe, role, answers) if probe else None)
    except ConfigError as error:
        if as_json:
            print_json({"file": file, "good": False, "problems": error.problems})
        raise
    summary = _summary(settings)
    warnings = absent_addresses(settings)
    if settings.real:
        warnings += self_test_gaps(settings)
        summary["runs as"] = ", ".join(
            each for each, sentences in missing_requirements_by_role(settings).items() if not sentences
        )
    summary |= answers
    if as_json:
        print_json({"file": file, "good": True, "problems": (), "sets_up": summary, "warnings": warnings})
        return
    console = Console(highlight=False, soft_wrap=True)
    console.print(Text.assemble((str(file), "bold"), " is ", ("good", "bold green"), "."))
    for subject, text in summary.items():
        console.print(_line(subject, "dim", text))
    for sentence in warnings:
        console.print(_line("warning", "bold yellow", sentence))


def _line(subject: str, style: str, text: str) -> Text:
    head = f"  {subject:<12} "
    whole = wrapped(head + text, sys.stdout, hang=len(head) - 2)
    # If the first word does not fit beside the heading it goes to the next line, and the heading loses its blanks.
    ends = len(head if whole.startswith(head) else head.rstrip())
    return Text.assemble((whole[:ends], style), whole[ends:])


@app.command()
def init(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder; created if it is missing.", show_default=False)
    ],
    role: Annotated[RoleChoice, typer.Option(help="What the machine will do.")] = RoleChoice.both,
    cube: CubeOption = None,
    positioner: PositionerOption = None,
) -> None:
    """Write heliocube.toml, with every key explained, and a new bridge.key and api.token into DIR."""
    *first, last = write_example(directory, role.value, cube, positioner)
    console = Console(highlight=False, soft_wrap=True)
    names = Text(", ").join(Text(str(path), "bold") for path in first)
    console.print(Text.assemble("written: ", names, " and ", (str(last), "bold")))
    console.print(_NEXT[role], markup=False)


@app.command()
def migrate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The TOML file.", show_default=False)],
    keys_only: Annotated[
        bool, typer.Option("--keys-only", help="Give no name to a tracker that has none; an upgrade does the same.")
    ] = False,
) -> None:
    """Update FILE to the keys of this release; the old file is kept beside it."""
    from daemon.config.migrate import migrate as bring_up_to_date

    say(bring_up_to_date(file, keys_only=keys_only))


def _probe(role: RoleChoice | None, answers: dict[str, str], settings: "Settings") -> list[str]:
    """Open the instruments of a role, note those that answer, and return a sentence for each that does not."""
    import asyncio

    from daemon.base.errors import UserError
    from daemon.commands.upgrade.instruments import check_instruments
    from daemon.service.rig import Role

    if not settings.real:
        raise UserError("--probe: these instruments are simulated (instruments.kind), and there is nothing to open")
    lacking = missing_requirements_by_role(settings)
    able = next((each for each in (RoleChoice.both, *lacking) if not lacking[each]), RoleChoice.both)
    found = asyncio.run(check_instruments(settings, Role((role or able).value)))
    answers |= {each.subject: each.text for each in found if each.ok}
    return [f"{each.subject}: {each.text}; {each.remedy}" for each in found if not each.ok]


def write_example(
    directory: Path, role: Literal["both", "cube", "tracker"], cube: str | None = None, positioner: str | None = None
) -> tuple[Path, Path, Path]:
    """Write a commented file, a new bridge key and a new token into a directory, made if missing; return their paths.

    Parameters
    ----------
    directory, role
        The folder, and what the machine will do.
    cube, positioner
        Names of the drivers that read the faces and turn the tracker, if they are not the usual ones.

    Raises
    ------
    UserError
        There is no such driver, the directory has the name of a file, or one of the files is there already or cannot be
        written. In all these cases nothing has been written.
    """
    from daemon.api.token import generate_token, write_token
    from daemon.base.errors import UserError
    from daemon.base.files import write_new
    from daemon.bridge.signing import generate_key, write_key
    from daemon.config.plugin_sections import CUBE, DRIVER, POSITIONER
    from daemon.config.template import FILE_NAME, KEY_FILE_NAME, TOKEN_FILE_NAME, render_config
    from daemon.store.records_folder import RECORDS_NAME

    file, key, token = directory / FILE_NAME, directory / KEY_FILE_NAME, directory / TOKEN_FILE_NAME
    values: dict[str, Any] = {
        "bridge.key_file": KEY_FILE_NAME,
        "api.token_file": TOKEN_FILE_NAME,
        "store.directory": RECORDS_NAME,
    }
    if role == "tracker":
        values["bridge.listen"] = "0.0.0.0:20571"
    chosen = []
    for plugged, given in ((CUBE, cube), (POSITIONER, positioner)):
        if given is not None:
            name = plugged.complete(given)
            plugged.settings_class(name)
            chosen.append((plugged.path, name))
            values[f"{plugged.path}.{DRIVER}"] = name
    if directory.is_file() or (directory.suffix == file.suffix and not directory.is_dir()):
        raise UserError(f"{directory} is the name of a file: name the folder that {file.name} is to be in")
    written: list[Path] = []
    made: list[Path] = []
    try:
        _refuse_taken(file, key, token)
        made = [folder for folder in (directory, *directory.parents) if not folder.exists()]
        directory.mkdir(parents=True, exist_ok=True)
        write_new(file, render_config(role, values, tuple(chosen)))
        written.append(file)
        write_key(key, generate_key())
        written.append(key)
        write_token(token, generate_token())
    except (OSError, UserError) as error:
        for path in written:
            path.unlink(missing_ok=True)
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()
        if isinstance(error, UserError):
            raise
        raise UserError(f"{directory} cannot take the files: {error.strerror}") from None
    return file, key, token


def _refuse_taken(*paths: Path) -> None:
    from daemon.base.errors import UserError

    for path in paths:
        if path.exists():
            raise UserError(f"{path} is there already and is not overwritten; name another folder or move it away")


_NEXT = {
    RoleChoice.both: "Next: set [site] and [cube] to your rig.",
    RoleChoice.cube: "Next: set [cube] to your rig and bridge.send_to to the address of the tracker's machine;"
    " bridge.key must be the same file on both machines.",
    RoleChoice.tracker: "Next: set [site] to your rig; bridge.key must be the same file as on the cube's machine.",
}


def _summary(settings: "Settings") -> dict[str, str]:
    from daemon.config.plugin_sections import MULTIPLEXED

    site, cube, bridge, safety = settings.site, settings.cube, settings.bridge, settings.safety
    channels = "inputs " + ", ".join(f"{name} {getattr(cube, name).channel}" for name in FACES)
    driver = settings.instruments.cube.driver
    targets = [*bridge.send_to, *([bridge.multicast_group] if bridge.multicast_group else [])]
    if bridge.insecure:
        signed = "NOT SIGNED"
    elif bridge.key_file is None:
        signed = "signed with a new key at each start (one process only)"
    else:
        signed = f"signed with {bridge.key_file}"
    file = settings.api.token_file
    token = "with a new token at each start" if file is None else f"with the token in {file}"
    return {
        "site": f"{site.name}: {site.latitude_deg:g} N, {site.longitude_deg:g} E, {site.altitude_m:g} m",
        "cube": f"{cube.name}: a scan every {cube.scan_every_s:g} s;"
        f" {channels if driver == MULTIPLEXED else f'read by {driver}'}",
        "instruments": settings.instruments.kind.upper(),
        "law": f"{settings.law.driver}: mean of {settings.windows.mean_s:g} s, decided every"
        f" {settings.windows.decide_every_s:g} s",
        "limits": str(settings.limits.limits()),
        **({"rows": _rows_text(settings.rows)} if settings.rows.east_m else {}),
        "safety": f"wind from {safety.stow_wind_m_s:g} m/s stows at A {safety.stow_a_deg:g} deg,"
        f" B {safety.stow_b_deg:g} deg; fallback after {safety.fallback_after_s:g} s without readings",
        "bridge": f"listens on {bridge.listen}, sends to {', '.join(targets) or 'nobody'}; {signed}",
        "interface": f"on {settings.api.listen}, " + token if settings.api.enabled else "off",
        **({"sunspec": _sunspec(settings.sunspec)} if settings.sunspec.enabled else {}),
        "mqtt": _broker(settings.mqtt) if settings.mqtt.enabled else "off",
        **({"trackers": ", ".join(table.name for table in settings.tracker)} if settings.tracker else {}),
        "store": "none, the rig is simulated" if settings.store.directory is None else str(settings.store.directory),
    }


def _rows_text(rows: "RowsSettings") -> str:
    size = f"{rows.module_width_m:g} by {rows.module_height_m:g} m"
    return f"{len(rows.east_m)} trackers with modules of {size} turn back together from each other's shade"


def _sunspec(sunspec: "SunspecSettings") -> str:
    return f"on {sunspec.listen}, {'model 601 may be set to manual' if sunspec.manual else 'read-only'}"


def _broker(mqtt: "MqttSettings") -> str:
    known = f"as the user in {mqtt.credentials_file}" if mqtt.credentials_file else "without a user"
    inputs = ", ".join(part.topic for part in (mqtt.wind, mqtt.safe) if part.topic) or "none"
    return (
        f"{mqtt.host}:{mqtt.port}{' with TLS' if mqtt.tls else ''}, {known}; topics {mqtt.prefix}/...;"
        f" commands {'on' if mqtt.commands else 'off'}; safety inputs {inputs}"
    )
