"""Evaluation of `heliocube calibrate field`: the cube where it stands."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.base.words import pluralise
from daemon.studies.calibrate.readings import FaceReadings, ReferenceReadings, span_text
from daemon.studies.calibrate.reference_comparison import MEAN_S, values_at, zero_of
from daemon.studies.calibrate.request import CubeSetup
from solar.calibration.in_place import FieldCalibration, UndeterminedError, calibrate_in_place
from solar.calibration.level import KnownResponse, LevelReference
from solar.calibration.selection import block_means, night_offset
from solar.ephemeris import Site
from solar.frames import Array
from solar.skies.sky import SkyModel

_LEAST_READINGS = 60
_LONGEST_NAME = 100


@dataclass(frozen=True, slots=True)
class LevelSources:
    """What sets the level of all gains, besides the clear-sky model.

    Attributes
    ----------
    referenced
        Faces whose gains in the settings are from a reference, each with its expanded uncertainty (k = 2) [%].
    ghi
        Readings of a pyranometer nearby, or None.
    ghi_uncertainty_percent
        Expanded uncertainty (k = 2) of its calibration.
    """

    referenced: dict[str, float]
    ghi: ReferenceReadings | None
    ghi_uncertainty_percent: float

    @property
    def names(self) -> list[str]:
        """The sources, for people."""
        faces = [f"the gain of {face} (U {percent:g} %)" for face, percent in self.referenced.items()]
        if self.ghi is None:
            return faces
        return [
            *faces,
            f"the GHI of {Path(self.ghi.source).name[:_LONGEST_NAME]} (U {self.ghi_uncertainty_percent:g} %)",
        ]


@dataclass(frozen=True, slots=True)
class FieldResult:
    """The cube in place.

    Attributes
    ----------
    fit
        Responses, attitude, albedo and their errors.
    gains_w_m2_per_mv, offsets_mv, offset_uncertainty_mv
        New gains and offsets, shape (4,) each; the uncertainty is expanded (k = 2).
    night_readings
        How many readings at night the offsets are from; 0 if the old offsets stay.
    level
        What set the level of the gains, besides the clear-sky model.
    """

    fit: FieldCalibration
    gains_w_m2_per_mv: Array
    offsets_mv: Array
    offset_uncertainty_mv: Array
    night_readings: int
    level: LevelSources

    @property
    def contradictions(self) -> list[str]:
        """A clause for each two sources of the level that contradict each other (k = 2)."""
        known, change_percent = self.level.referenced, 100.0 * np.log(self.fit.response)
        vertical = [face for face in known if face != "zenith"]
        found = []
        for one, other in combinations(vertical, 2):
            apart = abs(float(change_percent[FACES.index(one)] - change_percent[FACES.index(other)]))
            found.append((f"the known gains of {one} and {other}", apart, float(np.hypot(known[one], known[other]))))
        if "zenith" in known and self.level.ghi is not None:
            # The fit lies between the two, at distances in proportion to their variances.
            both = float(np.hypot(known["zenith"], self.level.ghi_uncertainty_percent))
            apart = abs(float(change_percent[FACES.index("zenith")])) * (both / known["zenith"]) ** 2
            found.append(("the known gain of zenith and the GHI", apart, both))
        return [
            f"these readings put {who} {apart:.1f} % apart, where their uncertainties explain {most:.1f} %"
            for who, apart, most in found
            if apart > most
        ]


def calibrate_field(
    readings: FaceReadings,
    made_on: CubeSetup,
    level: LevelSources,
    *,
    model: SkyModel,
    water_cm: float,
    cosine_error: float,
) -> FieldResult:
    """Return gains, attitude and albedo; raises `UserError` that says what the readings lack."""
    old = [getattr(made_on.cube, name) for name in FACES]
    gains, offsets = np.array([face.gain_w_m2_per_mv for face in old]), np.array([face.offset_mv for face in old])
    faces = (readings.faces - offsets) * gains if readings.in_mv else readings.faces
    whole = np.isfinite(faces).all(axis=-1)
    if whole.sum() < _LEAST_READINGS:
        raise UserError(
            f"{readings.source} has {pluralise(int(whole.sum()), 'instant')} at which all four faces were read;"
            " calibration in place needs several clear days"
        )
    utc_s, faces = readings.utc_s[whole], faces[whole]
    zero, zero_error, nights = night_offset(utc_s, faces, made_on.site)
    if not nights:
        zero = zero_error = np.zeros(len(FACES))
    minutes, means = block_means(utc_s, faces - zero, MEAN_S)
    try:
        fit = calibrate_in_place(
            minutes,
            means,
            made_on.site,
            model=model,
            water_cm=water_cm,
            cosine_error=cosine_error,
            level=_level(level, minutes, made_on.site),
        )
    except UndeterminedError as error:
        raise UserError(f"{readings.source} cannot support a calibration in place; missing: {error}") from None
    return FieldResult(
        fit,
        gains_w_m2_per_mv=gains / fit.response,
        offsets_mv=offsets + zero / gains,
        offset_uncertainty_mv=2.0 * zero_error / gains,
        night_readings=nights,
        level=level,
    )


def _level(sources: LevelSources, utc_s: Array, site: Site) -> LevelReference:
    """Return the level for readings at these instants; raises `UserError` if the GHI covers none of them."""
    east, south, west, zenith = (
        KnownResponse(1.0, sources.referenced[face] / 200.0) if face in sources.referenced else None for face in FACES
    )
    ghi, step_s = None, MEAN_S
    if sources.ghi is not None:
        times, values = block_means(sources.ghi.utc_s, sources.ghi.ghi_w_m2 - zero_of(sources.ghi, site), MEAN_S)
        ghi = values_at(utc_s, times, values[:, None])[:, 0]
        if not np.isfinite(ghi).any():
            raise UserError(
                f"--ghi: {sources.ghi.source} has {span_text(sources.ghi.utc_s)}, and the cube's readings "
                f"{span_text(utc_s)}; check the file and that its times are UTC"
            )
        step_s = float(np.median(np.diff(sources.ghi.utc_s)))
    return LevelReference((east, south, west, zenith), ghi, sources.ghi_uncertainty_percent / 200.0, step_s)
