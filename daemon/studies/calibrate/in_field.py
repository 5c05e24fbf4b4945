"""Evaluation of `heliocube calibrate field`: the cube where it stands."""

from dataclasses import dataclass

import numpy as np

from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.studies.calibrate.beside import MEAN_S
from daemon.studies.calibrate.readings import FaceReadings
from daemon.studies.calibrate.request import CubeSetup
from solar.calibration.in_place import FieldCalibration, UndeterminedError, calibrate_in_place
from solar.calibration.selection import block_means, night_offset
from solar.frames import Array
from solar.skies.sky import SkyModel

_LEAST_READINGS = 60


@dataclass(frozen=True, slots=True)
class FieldResult:
    """The cube in place.

    Attributes
    ----------
    fit
        Responses, attitude, albedo and their errors.
    gains_w_m2_per_mv, offsets_mv, offset_uncertainty_mv
        New ones, shape (4,) each; the uncertainty is expanded (k = 2).
    night_readings
        How many readings the offsets are from; 0 where the old ones stay.
    """

    fit: FieldCalibration
    gains_w_m2_per_mv: Array
    offsets_mv: Array
    offset_uncertainty_mv: Array
    night_readings: int


def calibrate_field(
    readings: FaceReadings, made_on: CubeSetup, *, model: SkyModel, water_cm: float, cosine_error: float
) -> FieldResult:
    """Return gains, attitude and albedo; raises `UserError` that says what the readings lack."""
    old = [getattr(made_on.cube, name) for name in FACES]
    gains, offsets = np.array([face.gain_w_m2_per_mv for face in old]), np.array([face.offset_mv for face in old])
    faces = (readings.faces - offsets) * gains if readings.in_mv else readings.faces
    whole = np.isfinite(faces).all(axis=-1)
    if np.count_nonzero(whole) < _LEAST_READINGS:
        raise UserError(
            f"{readings.source} has {np.count_nonzero(whole)} instants at which all four faces were read; "
            "calibration in place needs several clear days"
        )
    utc_s, faces = readings.utc_s[whole], faces[whole]
    zero, zero_error, nights = night_offset(utc_s, faces, made_on.site)
    if not nights:
        zero = zero_error = np.zeros(len(FACES))
    minutes, means = block_means(utc_s, faces - zero, MEAN_S)
    try:
        fit = calibrate_in_place(
            minutes, means, made_on.site, model=model, water_cm=water_cm, cosine_error=cosine_error
        )
    except UndeterminedError as error:
        raise UserError(f"{readings.source} cannot support a calibration in place; missing: {error}") from None
    return FieldResult(
        fit,
        gains_w_m2_per_mv=gains / fit.response,
        offsets_mv=offsets + zero / gains,
        offset_uncertainty_mv=2.0 * zero_error / gains,
        night_readings=nights,
    )
