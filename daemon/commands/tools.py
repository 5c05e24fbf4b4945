"""`heliocube bridge`: tools for people who write or test a sender. Also the commands of the bench."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from daemon.base.words import pluralise
from daemon.commands.answers import JsonOption, print_json, say

if TYPE_CHECKING:
    # The command line imports this module to show its help, which must not wait for scientific libraries.
    from daemon.config.settings import Settings

_VERB_WIDTH = 36

app = typer.Typer(help="Tools for the UDP bridge between cube and trackers.", no_args_is_help=True)


@app.command("send-csv")
def send_csv(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="CSV with time,east,south,west,zenith (UTC, W/m2), plain or .gz.")
    ],
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            "-c",
            metavar="FILE",
            help="Configuration file; the targets and the key of its section bridge are used.",
        ),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HOST:PORT", help="Where to send, instead of the configuration's targets. May be repeated."
        ),
    ] = None,
    key: Annotated[Path | None, typer.Option(metavar="FILE", help="Key file, instead of the configuration's.")] = None,
    insecure: Annotated[bool, typer.Option("--insecure", help="Send without a signature.")] = False,
    speed: Annotated[
        float, typer.Option(min=0.001, metavar="FACTOR", help="How many times faster than the file's own times.")
    ] = 1.0,
    keep_times: Annotated[
        bool, typer.Option("--keep-times", help="Send the file's times instead of the present time.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Send recorded irradiances as a cube would: the reference sender of docs/bridge.md."""
    import asyncio
    from random import SystemRandom

    from daemon.base.clock import SystemClock
    from daemon.base.errors import UserError
    from daemon.bridge.signing import load_key
    from daemon.commands.progress import progress_bar
    from daemon.config.file import load_settings, override
    from daemon.config.settings import Settings
    from daemon.studies.send_csv import send_csv as send

    settings = load_settings(config) if config is not None else Settings()
    changes: dict[str, object] = {}
    if to:
        changes["send_to"] = tuple(to)
    if key is not None or insecure:
        changes.update(key_file=key, insecure=insecure)
    bridge = override(settings, {"bridge": changes}).bridge
    if bridge.key_file is None and not bridge.insecure:
        raise UserError(
            "bridge send-csv signs its datagrams: name the key with --key FILE or --config FILE, or, in a closed lab"
            " only, send them unsigned with --insecure"
        )
    secret = load_key(bridge.key_file) if bridge.key_file is not None else None
    with progress_bar(Console(stderr=True), "sending") as progress:
        sent = asyncio.run(
            send(
                file,
                bridge,
                secret,
                SystemClock(),
                SystemRandom(),
                settings.site.place(),
                speed=speed,
                keep_times=keep_times,
                on_progress=lambda done, total: progress(done / total),
                warn=lambda note: say(note, err=True),
            )
        )
    if as_json:
        print_json({"scans": sent, "sent_to": bridge.send_to})
        return
    Console().print(f"{pluralise(sent, 'scan')} sent to {', '.join(bridge.send_to)}", markup=False, highlight=False)


def run_bench_server(settings: "Settings", directory: Path) -> None:
    """Run the bench; raises `UserError` on a machine that cannot have one."""
    from daemon.store.outputs import check_folder

    _require_terminals()
    check_folder(directory, "--dir")
    # Only now: a mistake is reported before the simulators are loaded.
    from daemon.rigs.bench import serve_bench

    serve_bench(settings, directory)


def _require_terminals() -> None:
    from daemon.base.errors import UserError

    try:
        import termios  # noqa: F401 - asked for, not used
    except ImportError:
        raise UserError(
            "a bench serves pseudo-terminals, which this system does not have: run it on Linux, or try the"
            " simulated rig of 'heliocube run'"
        ) from None


def control(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of the bench, as in bench --dir.", show_default=False)
    ],
    verb: Annotated[str, typer.Argument(help="The command; 'help' lists them.", show_default=False)],
    arguments: Annotated[list[str] | None, typer.Argument(help="Arguments of the command.", show_default=False)] = None,
) -> None:
    """Change or query the bench that runs in DIR."""
    from daemon.rigs.bench_client import ask_bench, bench_verbs

    _require_terminals()
    if verb == "help":
        for name, (usage, meaning) in bench_verbs().items():
            say(f"{f'{name} {usage}'.rstrip():<{_VERB_WIDTH}}  {meaning}", hang=_VERB_WIDTH + 2)
        return
    result = ask_bench(directory.absolute(), verb, arguments or [])
    if result is not None:
        print_json(result)
