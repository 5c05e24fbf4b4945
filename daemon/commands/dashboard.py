"""`heliocube dashboard`, and the dashboard that `heliocube run --dashboard` starts beside it."""

import asyncio
import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from daemon.api.client import CONFIG_VARIABLE
from daemon.commands.answers import say
from daemon.commands.options import SERVICE

app = typer.Typer()

_ENDS_WITHIN_S = 5.0


@app.command(rich_help_panel=SERVICE)
def dashboard(
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            "-c",
            metavar="FILE",
            envvar=CONFIG_VARIABLE,
            help="Configuration file; its sections dashboard and api are used.",
        ),
    ] = None,
    api: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS:PORT", help="Address of a service, instead of the configuration's. May be repeated."
        ),
    ] = None,
    listen: Annotated[
        str | None, typer.Option(metavar="ADDRESS:PORT", help="Where to serve the page, instead of dashboard.listen.")
    ] = None,
    with_parent: Annotated[bool, typer.Option("--with-parent", help="End when standard input ends.")] = False,
) -> None:
    """Serve the dashboard for browsers until Ctrl-C, SIGTERM or SIGHUP; services may start before or after it."""
    import logging
    import os

    from daemon.base import process
    from daemon.base.clock import SystemClock
    from daemon.dashboard.serve import addresses, bind, serve, settings_of_file, url_of

    settings = settings_of_file(config)
    services = addresses(api or settings.services)
    # Beside a service, the service's own lines on the terminal say enough.
    level = logging.ERROR if with_parent else logging.INFO
    process.configure_logging(sys.stderr, journal="JOURNAL_STREAM" in os.environ, level=level)
    # httpx would log a line for each request, which is one a second.
    logging.getLogger("httpx").setLevel(logging.WARNING)
    bound = bind(listen or settings.listen)
    say(f"dashboard at {url_of(bound)}, of {', '.join(str(service) for service in services)}")
    notifier = process.SystemdNotifier(os.environ, os.getpid())
    parent = sys.stdin.fileno() if with_parent else None
    asyncio.run(serve(bound, services, settings.hosts, SystemClock(), notifier, parent))


@contextlib.contextmanager
def dashboard_beside(api: str, listen: str) -> Iterator[None]:
    """Serve the dashboard of this service in a process of its own, which ends with the block or with this process.

    Its address is printed before anything else. If it cannot start it says why itself; the service goes on without it.
    """
    command = [sys.executable, "-m", "daemon.commands.main", "dashboard", "--with-parent"]
    # Its standard input is a pipe that closes when this process ends, however it ends.
    with subprocess.Popen(  # noqa: S603 - our own program
        [*command, "--api", api, "--listen", listen], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdin is not None  # noqa: S101 - narrowing; both are pipes
        assert child.stdout is not None  # noqa: S101 - as above
        # The service goes on even if nobody reads its output.
        with contextlib.suppress(OSError):
            typer.echo(child.stdout.readline(), nl=False)
        try:
            yield
        finally:
            child.stdin.close()
            try:
                child.wait(_ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                child.kill()
