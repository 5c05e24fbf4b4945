"""`heliocube energy`: what the laws harvest on measured weather."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from daemon.commands.answers import JsonOption, print_json


def energy(
    weather: Annotated[list[Path], typer.Argument(help="Measured weather (CSV, BSRN, SURFRAD, MIDC, TMY3).")],
    site: Annotated[str, typer.Option(metavar="LAT,LON[,ALT]", help="Site: degrees north, east, metres.")],
    out: Annotated[
        Path, typer.Option(help="Folder for energy.txt, energy.csv and energy.png; made if it is not there.")
    ],
    laws: Annotated[
        str | None,
        typer.Option(
            help="Laws, by commas, or all of them; fixed:DEG is a tilt, bound what nothing can beat, NAME:VALUE a law"
            " that has one parameter to try, such as its thrift."
        ),
    ] = None,
    sky: Annotated[
        str, typer.Option(help="Skies, by commas: isotropic, haydavies, perez1990, perez1993 (all-weather radiance).")
    ] = "perez1990",
    albedo: Annotated[float, typer.Option(min=0, max=1, help="Of the ground.")] = 0.2,
    speed: Annotated[float, typer.Option(min=0.01, max=90, help="Speed of each axis, deg/s.")] = 0.9,
    ideal: Annotated[bool, typer.Option("--ideal", help="Instant moves, no deadband.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Compare pointing laws on measured weather: energy, travel and moves, by type of day."""
    from daemon.base.errors import UserError
    from daemon.commands.studies.simulate import progress_bar
    from daemon.studies.energy import (
        IDEAL,
        Terms,
        as_page,
        as_text,
        check_names,
        default_names,
        measured_minutes,
        run_benchmark,
        write_csv,
    )
    from daemon.studies.energy_plot import plot
    from daemon.studies.inputs import parse_site
    from solar.energy import Drive, lay_out
    from solar.ephemeris import Site
    from solar.frames import Limits

    skies, names = _words(sky), list(default_names()) if laws is None else _words(laws)
    check_names(skies, names)
    place = Site(*parse_site(site))
    console = Console(stderr=True)
    utc_s, dni, dhi, warnings = measured_minutes(weather, place)
    for warning in warnings:
        console.print(f"warning: {warning}", markup=False, highlight=False)
    try:
        days = lay_out(utc_s, dni, dhi, place)
    except ValueError as error:
        raise UserError(f"the weather cannot be used: {error}") from error
    terms = Terms(albedo, Limits(), IDEAL if ideal else Drive(speed))
    with progress_bar(console, "comparing") as progress:
        rows = run_benchmark(days, skies, names, terms, progress)
    text = as_text(rows, days, terms)
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "energy.txt").write_text(text, encoding="utf-8")
        write_csv(rows, out / "energy.csv")
        plot(rows, out / "energy.png")
    except OSError as error:
        raise UserError(f"--out: {out} cannot be written to: {error}") from error
    if as_json:
        print_json(as_page(rows, days, terms) | {"tables": out, "warnings": warnings})
        return
    Console().print(text, markup=False, highlight=False, soft_wrap=True, end="")


def _words(text: str) -> list[str]:
    return list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
