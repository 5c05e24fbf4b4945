"""What a person asks of `heliocube calibrate`, read and checked."""

from dataclasses import dataclass
from datetime import datetime
from math import nan
from pathlib import Path

from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.config.file import load_settings, override
from daemon.config.sections import CubeSettings
from daemon.config.settings import Settings
from daemon.cube.calibration import CubeCalibration, calibrated_cube, calibration_in_force
from daemon.store.outputs import check_outputs
from daemon.studies.calibrate.readings import FaceReadings, read_csv, read_store
from daemon.studies.inputs import site_values
from drivers.numbers import read_number
from solar.ephemeris import Site

PLOT_SUFFIXES = (".png", ".svg", ".pdf")
_REFERENCE = "reference"
# Uncertainty of a gain by a reference [%]: no laboratory reaches less, and makers promise less than the most.
_LEAST_PERCENT, _MOST_PERCENT = 0.1, 20.0


@dataclass(frozen=True, slots=True)
class CubeSetup:
    """Where the readings were made, and with what gains.

    Attributes
    ----------
    cube
        Its settings, with the gains of the calibration in force.
    """

    site: Site
    cube: CubeSettings
    calibration: CubeCalibration | None


def load_cube_setup(config: Path | None, site: str | None) -> CubeSetup:
    """Return site and gains: those of a configuration, of --site, or the built-in ones; raises `UserError`."""
    settings = Settings() if config is None else load_settings(config)
    if site is not None:
        settings = override(settings, {"site": site_values(site)})
    elif config is None:
        raise UserError("give the site of the readings: --site LAT,LON[,ALT], or the service's --config")
    place = settings.site
    calibration = calibration_in_force(settings.cube)
    cube = settings.cube if calibration is None else calibrated_cube(settings.cube, calibration)
    return CubeSetup(Site(place.latitude_deg, place.longitude_deg, place.altitude_m), cube, calibration)


def readings(
    sensors: Path | None, store: Path | None, start: datetime | None, end: datetime | None, made_on: CubeSetup
) -> FaceReadings:
    """Return the readings of `sensors`, a file, or of `store`, whichever is given.

    Raises
    ------
    UserError
        Neither or both are given, they cannot be read, or were not made with the calibration of `made_on`.
    """
    if (sensors is None) == (store is None):
        raise UserError("give the readings of the cube once: a CSV file, or --store DIR")
    if sensors is not None and (start is not None or end is not None):
        raise UserError("--from and --to choose from a store; a CSV file is taken whole")
    if start is not None and end is not None and start >= end:
        raise UserError("--from is not before --to: exchange them; --to itself is not included")
    if sensors is not None:
        found = read_csv(sensors)
    else:
        assert store is not None  # noqa: S101 - narrowing; one of the two is there
        found = read_store(store, start, end)
    if found.in_mv:
        return found
    if len(found.calibrations) > 1:
        names = ", ".join(sorted(name or "none" for name in found.calibrations))
        raise UserError(f"{found.source} was recorded under several calibrations ({names}); choose a span with one")
    was = next(iter(found.calibrations))
    now = "" if made_on.calibration is None else made_on.calibration.identifier
    if was != now:
        raise UserError(
            f"{found.source} was recorded under {f'the calibration {was}' if was else 'no calibration file'}, and the "
            f"settings have {now or 'none'}; name the configuration of that time with --config"
        )
    return found


def serials(given: list[str]) -> dict[str, str]:
    """Read serial numbers given as NAME=NUMBER, of faces or of 'reference'; raises `UserError`."""
    known = (*FACES, _REFERENCE)
    found = {}
    for text in given:
        name, equals, number = text.partition("=")
        if not equals or name not in known or not 0 < len(number) <= 64:
            raise UserError(f"--serial: '{text}' is not NAME=NUMBER, with one of {', '.join(known)} as the name")
        found[name] = number
    return found


def referenced(given: list[str]) -> dict[str, float]:
    """Read FACE=PERCENT of faces with a reference; raises `UserError`."""
    found = {}
    for text in given:
        name, _, percent = text.partition("=")
        try:
            value = read_number(percent)
        except ValueError:
            value = nan
        if name not in FACES or not _LEAST_PERCENT <= value <= _MOST_PERCENT:
            raise UserError(
                f"--referenced: '{text}' is not FACE=PERCENT, with one of {', '.join(FACES)} as the face and an "
                f"uncertainty (k = 2) of {_LEAST_PERCENT:g} to {_MOST_PERCENT:g} %"
            )
        found[name] = value
    return found


def check_output_paths(out: Path, plot: Path | None, *, force: bool) -> None:
    """Refuse, before a long evaluation, files that could not be written after it; raises `UserError`.

    No option overwrites a calibration: records made with it refer to it by name.
    """
    if out.exists():
        raise UserError(f"{out} is there already; a calibration is not overwritten, name another file with --out")
    check_outputs([out], "--out", force=False)
    if not out.parent.is_dir():
        raise UserError(f"--out: there is no folder {out.parent}")
    if plot is not None:
        check_outputs([plot], "--plot", force=force)
    if plot is not None and plot.suffix.lower() not in PLOT_SUFFIXES:
        raise UserError(f"--plot: {plot} must end in {', '.join(PLOT_SUFFIXES[:-1])} or {PLOT_SUFFIXES[-1]}")
