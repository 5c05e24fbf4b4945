"""`heliocube replay`: recorded cube data through the code that runs live."""

from pathlib import Path
from typing import Annotated, Any

import typer


def replay(
    out: Annotated[Path, typer.Option(help="CSV file for the positions, one line per reading.")],
    faces: Annotated[
        Path | None,
        typer.Argument(metavar="FACES.csv", help="Readings: time,east,south,west,zenith; or .gz."),
    ] = None,
    site: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON[,ALT]", help="Site: degrees north, east, metres. Or in --config."),
    ] = None,
    law: Annotated[
        str | None, typer.Option(metavar="LAW", help="mu-prime, sun-vector, optimal, chronometric or flat.")
    ] = None,
    store: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of a store, instead of FACES.csv.")] = None,
    config: Annotated[Path | None, typer.Option("--config", "-c", help="Configuration file.")] = None,
) -> None:
    """Let recorded cube data drive a simulated tracker, through the code that runs live."""
    from rich.console import Console

    from daemon.base.errors import UserError
    from daemon.commands.options import parse_site
    from daemon.commands.simulate import progress_bar
    from daemon.config.file import load_settings, override
    from daemon.config.sections import Settings
    from daemon.studies.replay import replay as run_replay
    from daemon.studies.replay import rows_of_store
    from daemon.studies.send_csv import read_csv

    if (faces is None) is (store is None):
        raise UserError("replay needs either FACES.csv or --store DIR")
    if site is None and config is None:
        raise UserError("replay needs --site LAT,LON[,ALT], or --config FILE with a site")
    changes: dict[str, dict[str, Any]] = {}
    if site is not None:
        latitude, longitude, altitude = parse_site(site)
        changes["site"] = {
            "name": site,
            "latitude_deg": latitude,
            "longitude_deg": longitude,
            "altitude_m": altitude,
        }
    if law is not None:
        changes["law"] = {"name": law}
    settings = override(Settings() if config is None else load_settings(config), changes)
    if faces is not None and out.exists() and faces.exists() and out.samefile(faces):
        raise UserError(f"--out: {out} is the file with the readings; name another")
    if faces is not None:
        rows = read_csv(faces)
    else:
        assert store is not None  # noqa: S101 - narrowing; one of the two is there
        rows = rows_of_store(store)
    with progress_bar(Console(stderr=True), "replaying") as progress:
        run_replay(settings, rows, out, progress)
    typer.echo(f"{len(rows)} rows by {settings.law.name}: {out}")
