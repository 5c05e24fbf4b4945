"""`heliocube gain`: what a tracker can gain, by latitude, tilt and day."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from daemon.base.errors import UserError
from daemon.base.process import signals_as_ctrl_c
from daemon.commands.answers import JsonOption, print_json, say, warn
from daemon.commands.options import ForceOption
from daemon.commands.progress import progress_bar
from daemon.store.outputs import check_outputs
from daemon.studies.gain.choices import AnswerFormat, Device, PlotKind, check_plot
from daemon.studies.inputs import check_weather_file

if TYPE_CHECKING:
    from daemon.studies.gain.request import Request
    from daemon.studies.gain.weather import SkySource


_VALUES = "A number, a list A,B,C or a range FROM:TO:STEP"


@signals_as_ctrl_c()
def gain(
    lat: Annotated[float | None, typer.Option(help="Latitude in degrees, north positive.")] = None,
    lat_range: Annotated[str | None, typer.Option(metavar="FROM:TO:STEP", help="Several latitudes in degrees.")] = None,
    tilt: Annotated[
        str | None,
        typer.Option(
            metavar="DEG",
            help="Tilt of every device; positive tilts south, negative north; the vertical axis has no sign. "
            f"{_VALUES}. Without it each device has its own best tilt for the year.",
        ),
    ] = None,
    azimuth: Annotated[str, typer.Option(metavar="DEG", help=f"Deviation from south towards east. {_VALUES}.")] = "0",
    day: Annotated[str | None, typer.Option(metavar="N", help=f"Day of the year, 1..365. {_VALUES}.")] = None,
    year: Annotated[bool, typer.Option("--year", help="Ratios of yearly sums, as without --day.")] = False,
    against: Annotated[str, typer.Option(metavar="DEVICES", help="What the dual axis is compared with.")] = ",".join(
        Device
    ),
    weather: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|clear",
            help="The same ratios under a real sky: a weather file (CSV, BSRN, SURFRAD, MIDC, TMY3) or a clear sky.",
        ),
    ] = None,
    lon: Annotated[float | None, typer.Option(min=-180, max=180, help="Longitude of the weather.")] = None,
    altitude: Annotated[
        float | None,
        typer.Option(min=-430, max=9000, help="Altitude of the weather, m."),
    ] = None,
    printed: Annotated[
        bool, typer.Option("--printed", help="Add the results of the paper's own formulas and scripts.")
    ] = False,
    points: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="CSV with phi_deg, beta_deg, n, lambda_deg: compute row by row instead."),
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Also draw a figure: .png, .svg or .pdf.")] = None,
    plot_kind: Annotated[
        PlotKind | None,
        typer.Option(help="Kind of figure."),
    ] = None,
    table_format: Annotated[
        AnswerFormat | None, typer.Option("--format", help="If left out: a table, but CSV for --points.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File for CSV or Parquet instead of standard output.")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compute how much more a dual-axis tracker receives than a static panel and single axes.

    K is the ratio of energies in a day or a year, exact for a constant beam without an atmosphere.
    With --weather, K under a real sky stands beside it.
    """
    if out is not None:
        check_outputs([out], "--out", force=force)
    if plot is not None:
        check_plot(plot)
        check_outputs([plot], "--plot", force=force)
    elif plot_kind is not None:
        raise UserError("--plot-kind needs a file to draw in; add --plot FILE")
    if weather not in (None, "clear") and lat_range is None:
        check_weather_file(Path(weather), built_in=("clear",))
    from daemon.studies.gain import request

    console = Console()
    if as_json and (table_format is not None or out is not None):
        raise UserError("--json goes to standard output; leave out --format and --out, or --json")
    if points is not None:
        given = {
            "--lat": lat, "--lat-range": lat_range, "--tilt": tilt, "--day": day, "--weather": weather, "--plot": plot,
        }  # fmt: skip
        clash = next((name for name, value in given.items() if value is not None), None)
        if clash is not None:
            raise UserError(f"--points takes its cases from the file; leave out {clash}")
        cases = request.read_points(points)
        # Only now: the code that computes takes longer to load than the file to read.
        from daemon.studies.gain import output
        from daemon.studies.gain.evaluate import evaluate_points

        rows = evaluate_points(cases, with_printed=printed)
        if as_json:
            print_json(output.as_dict(rows, None))
        else:
            output.write(rows, table_format or AnswerFormat.CSV, out, console, None)
        return

    if day is not None and year:
        raise UserError("--day and --year exclude each other; give one of them")
    asked = request.Request(
        latitudes_deg=request.latitudes(lat, lat_range),
        tilts_deg=None if tilt is None else request.numbers(tilt, "--tilt", -90.0, 90.0),
        azimuths_deg=request.numbers(azimuth, "--azimuth", -180.0, 180.0),
        days=None if day is None else request.days(day),
        against=request.devices(against),
        printed=printed,
    )
    from daemon.studies.gain import output
    from daemon.studies.gain.evaluate import evaluate

    sky = _sky(weather, asked, lon, altitude)
    if sky is not None and sky.warning:
        warn(sky.warning)
    with progress_bar(Console(stderr=True), "computing") as progress:
        columns = evaluate(asked, sky, progress)
    if plot is not None:
        from daemon.studies.gain import plots

        kind = plot_kind or _fitting_plot_kind(asked)
        plots.draw(kind, asked, columns, sky, plot)
        say(f"figure in {plot}", err=True)
    label = sky.label if sky else None
    if as_json:
        print_json(output.as_dict(columns, label) | {"figure": plot})
    else:
        most_rows = output.MOST_ROWS if plot is None else output.MOST_ROWS_BESIDE_A_FIGURE
        output.write(columns, table_format or AnswerFormat.TABLE, out, console, label, most_rows=most_rows)


def _sky(weather: str | None, asked: "Request", lon: float | None, altitude: float | None) -> "SkySource | None":
    if weather is None:
        if lon is not None or altitude is not None:
            raise UserError("--lon and --altitude say where the weather was measured; add --weather")
        return None
    from daemon.studies.gain.weather import clear_sky_source, file_sky_source

    if weather == "clear":
        return clear_sky_source(lon or 0.0, altitude or 0.0)
    if asked.latitudes_deg.size > 1:
        raise UserError("a weather file belongs to one site; give its latitude with --lat, or --weather clear")
    return file_sky_source(Path(weather), float(asked.latitudes_deg[0]), lon, altitude, asked.days)


def _fitting_plot_kind(asked: "Request") -> PlotKind:
    """Return the kind of figure that shows most of a request."""
    if asked.printed:
        return PlotKind.PRINTED
    if asked.latitudes_deg.size == 1:
        return PlotKind.DAILY
    return PlotKind.BEST_TILT if asked.tilts_deg is None else PlotKind.MAP
