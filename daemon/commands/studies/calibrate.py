"""`heliocube calibrate`: gains of the cube, beside a reference or in place."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from daemon.base.process import signals_as_ctrl_c
from daemon.commands.answers import JsonOption, print_json, say, warn
from daemon.studies.inputs import check_data_files, instant

app = typer.Typer(help="Calibrate the cube: beside a reference pyranometer, or where it stands.", no_args_is_help=True)


class SkyChoice(StrEnum):
    """Sky models as the command line names them."""

    perez1990 = "perez1990"
    haydavies = "haydavies"
    isotropic = "isotropic"


SiteOption = Annotated[
    str | None, typer.Option(metavar="LAT,LON[,ALT]", help="Site: degrees north, degrees east, metres.")
]
ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", "-c", metavar="FILE", help="Configuration under which the readings were made: site and old gains."
    ),
]
StoreOption = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Take the readings from the store in this folder.")
]
FromOption = Annotated[str | None, typer.Option("--from", metavar="UTC", help="First instant to take from the store.")]
ToOption = Annotated[str | None, typer.Option("--to", metavar="UTC", help="End; this instant itself is not included.")]
OutOption = Annotated[Path, typer.Option(metavar="FILE", help="Calibration file to write; never overwritten.")]
SerialOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=NUMBER", help="Serial number of east, south, west, zenith or reference. May be repeated."
    ),
]


@app.command()
@signals_as_ctrl_c()
def cube(
    reference: Annotated[
        Path, typer.Argument(metavar="REFERENCE", help="CSV of the reference: time, ghi [W/m2].", show_default=False)
    ],
    sensors: Annotated[
        Path | None,
        typer.Argument(
            metavar="SENSORS", help="CSV of the cube: time, east_mv .. zenith_mv, or east_w_m2 .. zenith_w_m2."
        ),
    ] = None,
    store: StoreOption = None,
    start: FromOption = None,
    end: ToOption = None,
    site: SiteOption = None,
    config: ConfigOption = None,
    lag: Annotated[
        float | None,
        typer.Option(
            min=-3600,
            max=3600,
            metavar="S",
            help="Seconds by which the sensors' clock is ahead; found from the data if left out.",
        ),
    ] = None,
    reference_uncertainty: Annotated[
        float,
        typer.Option(min=0, max=20, metavar="PERCENT", help="Uncertainty of the reference's own calibration, k = 2."),
    ] = 1.5,
    serial: SerialOption = None,
    valid_days: Annotated[
        float, typer.Option(min=1, max=3660, metavar="N", help="Days until the calibration expires.")
    ] = 730,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also draw scatter and residuals: .png, .svg or .pdf.")
    ] = None,
    out: OutOption = Path("calibration.toml"),
    force: Annotated[bool, typer.Option("--force", help="Overwrite the figure; never the calibration.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Calibrate the four sensors, laid horizontally beside a reference pyranometer, in the manner of ISO 9847."""
    check_data_files([reference, *filter(None, [sensors])], "readings")
    from daemon.cube.calibration import write_calibration
    from daemon.studies.calibrate import report, request
    from daemon.studies.calibrate.readings import read_reference
    from daemon.studies.calibrate.reference_comparison import compare

    request.check_output_paths(out, plot, force=force)
    serials = request.serials(serial or [])
    made_on = request.load_cube_setup(config, site)
    first = None if start is None else instant(start, "--from")
    last = None if end is None else instant(end, "--to")
    readings = request.readings(sensors, store, first, last, made_on)
    beside = read_reference(reference)
    _warn(beside.note, readings.note)
    found = compare(
        beside,
        readings,
        made_on.site,
        made_on.cube,
        lag=lag,
        reference_uncertainty_percent=reference_uncertainty,
    )
    simulated = readings.simulated or beside.simulated
    lines = report.with_simulation_mark(report.comparison_lines(found), simulated=simulated)
    calibration = report.comparison_calibration(found, made_on.cube.name, serials, valid_days, simulated=simulated)
    if plot is not None:
        from daemon.studies.calibrate.plots import draw_comparison

        draw_comparison(found, plot, simulated=simulated)
    write_calibration(calibration, out, lines)
    if as_json:
        page = {"simulated": simulated} | report.comparison_dict(found)
        print_json(page | {"calibration": calibration, "written": out, "figure": plot})
        return
    _print(lines if plot is None else [*lines, "", f"figure in {plot}"], calibration.identifier, out)


@app.command()
@signals_as_ctrl_c()
def field(
    sensors: Annotated[
        Path | None,
        typer.Argument(
            metavar="SENSORS", help="CSV of the cube: time, east_mv .. zenith_mv, or east_w_m2 .. zenith_w_m2."
        ),
    ] = None,
    store: StoreOption = None,
    start: FromOption = None,
    end: ToOption = None,
    site: SiteOption = None,
    config: ConfigOption = None,
    sky: Annotated[
        SkyChoice,
        typer.Option(metavar="MODEL", help="Model of diffuse light: perez1990, haydavies or isotropic."),
    ] = SkyChoice.perez1990,
    water: Annotated[
        float,
        typer.Option(
            min=0.1, max=8, metavar="CM", help="Precipitable water of those days; 1 cm more lowers GHI by 2 %."
        ),
    ] = 1.5,
    cosine_error: Annotated[
        float,
        typer.Option(
            min=0, max=0.2, metavar="SHARE", help="Share of the beam that the sensors miss at 80 deg of incidence."
        ),
    ] = 0.008,
    referenced: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FACE=PERCENT",
            help="Face whose configured gain comes from a reference, and its uncertainty, k = 2. May be repeated.",
        ),
    ] = None,
    ghi: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="CSV of a calibrated, level pyranometer nearby: time, ghi [W/m2]."),
    ] = None,
    ghi_uncertainty: Annotated[
        float,
        typer.Option(min=0.1, max=20, metavar="PERCENT", help="Uncertainty of that pyranometer's calibration, k = 2."),
    ] = 1.5,
    serial: SerialOption = None,
    valid_days: Annotated[
        float, typer.Option(min=1, max=3660, metavar="N", help="Days until the calibration expires.")
    ] = 365,
    out: OutOption = Path("calibration.toml"),
    as_json: JsonOption = False,
) -> None:
    """Find gains, misalignment and albedo of the cube where it stands, from its readings under clear sky."""
    check_data_files([*filter(None, [sensors, ghi])], "readings")
    from daemon.cube.calibration import write_calibration
    from daemon.studies.calibrate import report, request
    from daemon.studies.calibrate.in_field import LevelSources, calibrate_field
    from daemon.studies.calibrate.readings import read_reference

    request.check_output_paths(out, None, force=False)
    serials = request.serials(serial or [])
    known_faces = request.referenced(referenced or [])
    made_on = request.load_cube_setup(config, site)
    first = None if start is None else instant(start, "--from")
    last = None if end is None else instant(end, "--to")
    readings = request.readings(sensors, store, first, last, made_on)
    nearby = None if ghi is None else read_reference(ghi)
    _warn("" if nearby is None else nearby.note, readings.note)
    level = LevelSources(known_faces, nearby, ghi_uncertainty)
    found = calibrate_field(readings, made_on, level, model=sky.value, water_cm=water, cosine_error=cosine_error)
    simulated = readings.simulated or (nearby is not None and nearby.simulated)
    lines = report.with_simulation_mark(report.field_lines(found, made_on, sky.value), simulated=simulated)
    calibration = report.field_calibration(found, made_on, sky.value, serials, valid_days, simulated=simulated)
    write_calibration(calibration, out, lines)
    if as_json:
        page = {"simulated": simulated} | report.field_dict(found, made_on)
        print_json(page | {"calibration": calibration, "written": out})
        return
    _print(lines, calibration.identifier, out)


def _warn(*notes: str) -> None:
    for note in filter(None, notes):
        warn(note)


def _print(lines: list[str], identifier: str, out: Path) -> None:
    for line in lines:
        say(line)
    from daemon.studies.calibrate.report import DOUBT_PREFIX

    doubtful = any(line.startswith(DOUBT_PREFIX) for line in lines)
    then = "do not use it until the doubts are resolved" if doubtful else "set cube.calibration_file to use it"
    say(f"\ncalibration {identifier} written to {out}; {then}")
