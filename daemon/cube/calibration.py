"""The calibration file: gains, offsets, dates, serials and uncertainties of one cube, written once and never edited."""

import hashlib
import json
import logging
from collections.abc import Callable
from datetime import UTC, timedelta
from pathlib import Path
from typing import Any, Literal

import tomli_w
from pydantic import AwareDatetime, Field, ValidationError

from daemon.base.errors import UserError
from daemon.base.files import parse_toml, toml_text, write_new
from daemon.base.records import FACES, Event
from daemon.config.section import NotNegative, Section, describe_error
from daemon.config.sections import CubeSettings, FaceSettings
from daemon.config.settings import Settings
from drivers.settings import Positive

log = logging.getLogger("heliocube.calibration")

WARN_BEFORE = timedelta(days=30)
Validity = Literal["valid", "expires soon", "expired"]
Serial = Field("unknown", max_length=64)


class FaceCalibration(Section):
    """One sensor: irradiance = gain x (voltage - offset). Uncertainties are expanded, k = 2."""

    serial: str = Serial
    gain_w_m2_per_mv: Positive = Field(le=1000)
    gain_uncertainty_percent: NotNegative
    offset_mv: float = Field(ge=-100, le=100)
    offset_uncertainty_mv: NotNegative


class CubeOrientation(Section):
    """How the cube stands and what the ground reflects, where the cube was calibrated in place."""

    yaw_deg: float
    yaw_uncertainty_deg: NotNegative
    tilt_deg: NotNegative
    tilt_azimuth_deg: float = Field(ge=0, le=360)
    tilt_uncertainty_deg: NotNegative
    albedo: float = Field(ge=0, le=1)
    albedo_uncertainty: NotNegative


class CubeCalibration(Section):
    """A calibration of all four sensors of a cube; `simulated` where the readings came from a model or a bench."""

    identifier: str = Field(pattern=r"^[0-9]{8}-[0-9a-f]{8}$")
    method: Literal["beside a reference", "in place"]
    calibrated_utc: AwareDatetime
    expires_utc: AwareDatetime
    cube: str = Serial
    reference: str = Field("unknown", max_length=400)
    simulated: bool = False
    east: FaceCalibration
    south: FaceCalibration
    west: FaceCalibration
    zenith: FaceCalibration
    standing: CubeOrientation | None = None

    def validity(self, utc_s: float) -> Validity:
        """Tell whether the calibration still holds at `utc_s`; it expires soon in its last 30 days."""
        left_s = self.expires_utc.timestamp() - utc_s
        if not left_s > 0.0:
            return "expired"
        return "expires soon" if left_s <= WARN_BEFORE.total_seconds() else "valid"


def new_calibration(values: dict[str, Any]) -> CubeCalibration:
    """Return a calibration with an identifier made of its day and its contents."""
    blank = CubeCalibration(identifier="00000000-00000000", **values)
    return blank.model_copy(update={"identifier": _identifier(blank)})


def write_calibration(calibration: CubeCalibration, path: Path, notes: list[str]) -> None:
    """Write a calibration to a file that must not be there yet, `notes` as comments above; raises `UserError`."""
    comments = "".join(f"# {line}".rstrip() + "\n" for note in notes for line in note.split("\n"))
    contents = tomli_w.dumps(calibration.model_dump(exclude_none=True, exclude=_omitted_keys(calibration)))
    try:
        write_new(path, f"{comments}\n{contents}")
    except FileExistsError:
        raise UserError(f"{path} is there already; a calibration is not overwritten, name another file") from None
    except OSError as error:
        raise UserError(f"{path} cannot be written: {error.strerror}") from None


def read_calibration(path: Path) -> CubeCalibration:
    """Read a calibration file.

    Raises
    ------
    UserError
        There is none, it is damaged, or its contents are not those that its identifier was made of.
    """
    try:
        values = parse_toml(toml_text(path))
        calibration = CubeCalibration.model_validate(values)
    except FileNotFoundError:
        raise UserError(f"there is no calibration file at {path}; make one with 'heliocube calibrate'") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise UserError(f"calibration file {path}: {where}: {describe_error(first)}; calibrate again") from None
    except (OSError, ValueError) as error:
        raise UserError(f"calibration file {path} cannot be read: {error}") from None
    if calibration.identifier != _identifier(calibration):
        raise UserError(
            f"calibration file {path} has been edited: its contents are not those of {calibration.identifier}, which"
            " scans are recorded under; calibrate again, or set the faces' gains in the configuration"
        )
    return calibration


def calibration_in_force(cube: CubeSettings) -> CubeCalibration | None:
    """Return the calibration that the settings name, or None; raises `UserError` as `read_calibration` does."""
    return None if cube.calibration_file is None else read_calibration(cube.calibration_file)


def calibration_to_run(settings: Settings) -> CubeCalibration | None:
    """Return the calibration that a service is to run with, or None.

    Raises `UserError` as `read_calibration` does, and for real instruments with a calibration by simulated readings.
    """
    found = calibration_in_force(settings.cube)
    if found is not None and found.simulated and settings.real and not settings.instruments.bench:
        raise UserError(
            f"calibration file {settings.cube.calibration_file} is SIMULATED, made from readings of a model or a bench,"
            " and these instruments are real: calibrate the cube itself, or leave cube.calibration_file out"
        )
    return found


def calibrated_cube(cube: CubeSettings, calibration: CubeCalibration) -> CubeSettings:
    """Return the cube's settings with the gains and offsets of a calibration."""
    faces = {
        name: getattr(cube, name).model_copy(
            update={
                "gain_w_m2_per_mv": getattr(calibration, name).gain_w_m2_per_mv,
                "offset_mv": getattr(calibration, name).offset_mv,
            }
        )
        for name in FACES
    }
    return cube.model_copy(update=faces)


class ExpiryWatch:
    """Tells once that a calibration expires soon and once that it has, in the log and as events.

    Parameters
    ----------
    calibration
        The calibration in force; None never expires.
    publish
        Takes the events.
    """

    def __init__(self, calibration: CubeCalibration | None, publish: Callable[[Event], None]) -> None:
        self._calibration = calibration
        self._publish = publish
        self._reported: Validity = "valid"

    def check(self, utc_s: float, monotonic_s: float) -> None:
        """Compare the calibration with the time."""
        if self._calibration is None:
            return
        now = self._calibration.validity(utc_s)
        if now == self._reported:
            return
        self._reported = now
        if now == "valid":
            return
        day = f"{self._calibration.expires_utc.astimezone(UTC):%Y-%m-%d}"
        verb = "expired on" if now == "expired" else "expires on"
        text = f"the calibration {self._calibration.identifier} {verb} {day}; calibrate the cube again"
        log.warning(text)
        self._publish(Event(utc_s, monotonic_s, "calibration", text))


def _identifier(calibration: CubeCalibration) -> str:
    shown = calibration.model_dump(mode="json", exclude={"identifier"} | _omitted_keys(calibration))
    contents = json.dumps(shown, sort_keys=True)
    day = f"{calibration.calibrated_utc.astimezone(UTC):%Y%m%d}"
    return f"{day}-{hashlib.sha256(contents.encode()).hexdigest()[:8]}"


def _omitted_keys(calibration: CubeCalibration) -> set[str]:
    """Return the keys that a real cube's file leaves out, as do files from before there was a mark for simulation."""
    return set() if calibration.simulated else {"simulated"}


# From the end of civil twilight on, a sensor of 0.1 mV per W/m2 sees darkness.
_DARK_BELOW_DEG = -6.0
# About 25 minutes at one scan every 5 s: slow against noise, quick against the night.
_LEARNING_RATE = 1 / 300
_LARGEST_MV = 0.5


def calibrated_irradiance(voltage_mv: float, face: FaceSettings) -> float:
    """Return the irradiance [W/m2] of a face from its sensor's voltage [mV]: gain x (voltage - offset)."""
    return face.gain_w_m2_per_mv * (voltage_mv - face.offset_mv)


class DarkOffsets:
    """Each face's voltage in the dark, learnt at night and bounded to half a millivolt (5 W/m2).

    Parameters
    ----------
    sun_elevation_deg
        Returns the sun's elevation at a UTC [s]; NaN where it is not known, and then nothing is learnt.
    """

    def __init__(self, sun_elevation_deg: Callable[[float], float]) -> None:
        self._sun_elevation_deg = sun_elevation_deg
        self._offsets_mv = [0.0] * len(FACES)

    def learn(self, index: int, voltage_mv: float, utc_s: float) -> float:
        """Take in one face's voltage [mV] and return the offset [mV] to subtract from it.

        A voltage beyond the bound teaches nothing: at night it is a lamp or a fault, not an offset.
        """
        if self._sun_elevation_deg(utc_s) < _DARK_BELOW_DEG and abs(voltage_mv) <= _LARGEST_MV:
            self._offsets_mv[index] += _LEARNING_RATE * (voltage_mv - self._offsets_mv[index])
        return self._offsets_mv[index]
