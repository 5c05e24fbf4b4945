"""The calibration of a cube where it stands: what :mod:`.shape` and :mod:`.anchor` tell together, and how surely."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solar.calibration.anchor import ClearSkyResponse, fit_clear_sky_response
from solar.calibration.attitude import Attitude
from solar.calibration.level import LevelReference, known_responses
from solar.calibration.selection import CLEAR_WATER_CM, StabilityCriteria, block_means, clear_and_stable
from solar.calibration.shape import COSINE_ERROR, HIGHEST_DIFFUSE, RelativeCalibration, fit_relative_calibration
from solar.ephemeris import Site, solar_days, sun_direction
from solar.frames import FACE_NORMALS, Array
from solar.skies.sky import SkyModel

_BLOCK_S = 900.0
_ROUNDS = 6
_SETTLED = 2e-4
_LEAST_DAYS = 3
_LEAST_LIT = 8
_LIT_COSINE = 0.26
_LEAST_AIR_MASS_SPAN = 0.7
_LARGEST_RESIDUAL = 0.01
# Standard errors beyond which a result is refused: gains (relative), angles [deg], albedo.
_LARGEST_ERRORS = (0.03, 0.5, 0.1)
_LEAST_WITHOUT_HAZE = 15
# With a larger standard error (one sigma) the level is known no better than by the maker's own tolerance.
_LEVEL_SIGMA = 0.025
# What leaving out days cannot show: the sensors' cosine response, the same on all of them [deg].
_ANGLE_SIGMA = 0.03
_FACES = ("east", "south", "west")
_DAYTIME_OF_FACE = {"east": "mornings", "south": "around noon", "west": "afternoons"}


class UndeterminedError(ValueError):
    """The readings cannot support a calibration.

    Parameters
    ----------
    missing
        What is missing, one clause each.
    """

    def __init__(self, missing: list[str]) -> None:
        super().__init__("; ".join(missing))
        self.missing = tuple(missing)


class FieldErrors(NamedTuple):
    """Standard errors (one sigma) of responses, angles [deg] and albedo.

    From leaving out one day after the other, with what no day shows added: the level of the clear-sky model, by its own
    fit, in responses and albedo, and the sensors' cosine response in angles.
    """

    response: Array
    yaw_deg: float
    lean_equator_deg: float
    lean_east_deg: float
    albedo: float


@dataclass(frozen=True, slots=True)
class FieldCalibration:
    """A cube as its own readings show it.

    Attributes
    ----------
    response
        What each face reads over what falls on it, shape (4,): divide readings by it.
    attitude, albedo
        Of the cube and the ground.
    errors
        Of all of them.
    shape
        The fit behind it.
    days
        Solar days with clear sky in it.
    """

    response: Array
    attitude: Attitude
    albedo: float
    errors: FieldErrors
    shape: RelativeCalibration
    days: int


def calibrate_in_place(
    utc_s: Array,
    faces_w_m2: Array,
    site: Site,
    *,
    model: SkyModel = "perez1990",
    water_cm: float = CLEAR_WATER_CM,
    cosine_error: float = COSINE_ERROR,
    stability: StabilityCriteria | None = None,
    level: LevelReference | None = None,
) -> FieldCalibration:
    """Return gains, attitude and albedo from a cube's readings over several days.

    The equations are those of :mod:`.shape` and :mod:`.anchor`, solved in turn.

    Parameters
    ----------
    utc_s, faces_w_m2
        Increasing instants [s], shape (n,), about a minute apart or less, and readings with their offsets taken off,
        shape (n, 4); NaN is no reading.
    model, water_cm, cosine_error
        As :func:`.shape.fit_relative_calibration` and :func:`.anchor.fit_clear_sky_response` say.
    level
        What is known of the level of the gains from elsewhere; None where only the clear-sky model tells it.

    Raises
    ------
    UndeterminedError
        Naming everything that is missing.
    """
    known = LevelReference() if level is None else level
    ghi = np.full(utc_s.shape, np.nan) if known.ghi_w_m2 is None else known.ghi_w_m2
    whole = np.isfinite(faces_w_m2).all(axis=-1)
    utc_s, faces_w_m2, ghi = utc_s[whole], faces_w_m2[whole], ghi[whole]
    clear = clear_and_stable(utc_s, faces_w_m2[:, 3], site, stability)
    utc_s, faces_w_m2, ghi = utc_s[clear], faces_w_m2[clear], ghi[clear]
    # Average the ratio, not the GHI itself: in a quarter of an hour the GHI may have other minutes than the faces.
    blocks_s, means = block_means(utc_s, np.column_stack([faces_w_m2, ghi / faces_w_m2[:, 3]]), _BLOCK_S)
    missing = _missing_clauses(blocks_s, site)
    if missing:
        raise UndeterminedError(missing)
    told = _Givens(site=site, model=model, water_cm=water_cm, cosine_error=cosine_error, level=known)

    def estimate(
        kept: NDArray[np.bool_], vertical: float, rounds: int
    ) -> tuple[Array, RelativeCalibration, ClearSkyResponse]:
        return _estimate(blocks_s[kept], means[kept], told, vertical, rounds)

    everything = np.ones(blocks_s.size, dtype=np.bool_)
    try:
        values, shape, anchor = estimate(everything, 1.0, _ROUNDS)
        vertical = float(np.exp(np.mean(np.log(values[:3] / values[3]))))
        day = solar_days(blocks_s, site.longitude_deg)
        each = np.array([estimate(day != one, vertical, 2)[0] for one in np.unique(day)])
    except ValueError as error:
        raise UndeterminedError([str(error)]) from None
    spread = jackknife_error(each)
    unsure = _unsure(spread, shape.residual, max(anchor.zenith_error, anchor.vertical_error))
    if unsure:
        raise UndeterminedError(unsure)
    of_level = np.array([*[anchor.vertical_error] * 3, anchor.zenith_error])
    response_error = np.hypot(spread[:4], values[:4] * of_level)
    yaw, equator, east = np.hypot(spread[4:7], _ANGLE_SIGMA).tolist()
    albedo = float(np.hypot(spread[7], (1.0 + shape.albedo) * anchor.ratio_error))
    return FieldCalibration(
        response=values[:4],
        attitude=shape.attitude,
        albedo=shape.albedo,
        errors=FieldErrors(
            response=response_error, yaw_deg=yaw, lean_equator_deg=equator, lean_east_deg=east, albedo=albedo
        ),
        shape=shape,
        days=int(np.unique(day).size),
    )


def jackknife_error(each: Array) -> Array:
    """Return standard errors from estimates with one of g groups left out, shape (g, m).

    sqrt((g - 1)/g sum (theta_i - mean)^2), Efron & Tibshirani (1993), equation (11.5). The groups are days: readings
    minutes apart share their errors, days do not.
    """
    groups = each.shape[0]
    return np.asarray(np.sqrt((groups - 1) / groups * np.sum((each - each.mean(axis=0)) ** 2, axis=0)), np.float64)


class _Givens(NamedTuple):
    """What the user has given beside the readings."""

    site: Site
    model: SkyModel
    water_cm: float
    cosine_error: float
    level: LevelReference


def _estimate(
    utc_s: Array, means: Array, told: _Givens, vertical: float, rounds: int
) -> tuple[Array, RelativeCalibration, ClearSkyResponse]:
    """Shape and anchor in turn until the vertical faces' gain over the zenith face's settles.

    `means` are those of the four faces, and of the GHI nearby over the zenith face's reading, shape (n, 5).
    """
    faces_w_m2, ghi_w_m2 = means[:, :4], means[:, 3] * means[:, 4]
    for _ in range(rounds):
        shape = fit_relative_calibration(
            utc_s, faces_w_m2, told.site, vertical=vertical, model=told.model, cosine_error=told.cosine_error
        )
        count = shape.utc_s.size
        if count < _LEAST_WITHOUT_HAZE:
            raise ValueError(
                f"clear sky without haze, its diffuse light below {HIGHEST_DIFFUSE:.0%} of the whole: "
                f"{count * _BLOCK_S / 60:.0f} min, where {_LEAST_WITHOUT_HAZE * _BLOCK_S / 60:.0f} min are needed, "
                "also without any one of the days"
            )
        horizontal = shape.beam_w_m2 * sun_direction(shape.utc_s, *told.site)[:, 2] + shape.uniform_w_m2
        nearby = horizontal / ghi_w_m2[np.searchsorted(utc_s, shape.utc_s)]
        of_zenith, of_vertical = known_responses(told.level, shape, vertical, nearby)
        anchor = fit_clear_sky_response(
            shape.utc_s,
            horizontal,
            vertical * shape.beam_w_m2,
            told.site,
            model=told.model,
            water_cm=told.water_cm,
            zenith=of_zenith,
            vertical=of_vertical,
        )
        before, vertical = vertical, anchor.vertical / anchor.zenith
        if abs(vertical - before) < _SETTLED:
            break
    return np.array([*(shape.response * anchor.zenith), *shape.attitude, shape.albedo]), shape, anchor


def _missing_clauses(utc_s: Array, site: Site) -> list[str]:
    days = np.unique(solar_days(utc_s, site.longitude_deg)).size
    if days < _LEAST_DAYS:
        return [f"clear and stable sky on {days} day{'s' * (days != 1)}, where at least {_LEAST_DAYS} are needed"]
    sun = sun_direction(utc_s, *site)
    lit = np.count_nonzero(sun @ FACE_NORMALS[:3].T > _LIT_COSINE, axis=0)
    missing = [
        f"clear sky with the sun on the {name} face ({_DAYTIME_OF_FACE[name]}): {count * _BLOCK_S / 60:.0f} min, "
        f"where {_LEAST_LIT * _BLOCK_S / 60:.0f} min are needed"
        for name, count in zip(_FACES, lit, strict=True)
        if count < _LEAST_LIT
    ]
    air_mass = 1.0 / sun[:, 2]
    if np.ptp(air_mass) < _LEAST_AIR_MASS_SPAN:
        missing.append(
            f"clear sky with the sun both high and low: air mass {air_mass.min():.2f} to {air_mass.max():.2f}, "
            f"where a span of {_LEAST_AIR_MASS_SPAN:g} is needed"
        )
    return missing


def _unsure(spread: Array, residual: float, level: float) -> list[str]:
    if not residual <= _LARGEST_RESIDUAL:
        return [
            (
                f"readings that fit a clear sky: {residual:.1%} is left unexplained, where 1 % is allowed (is there "
                "shade on a face, a wrong site or clock, or are faces exchanged?)"
            )
        ]
    if not level <= _LEVEL_SIGMA:
        return [
            (
                f"clear sky that determines the level of the gains: it is known to {200.0 * level:.1f} % (k = 2) only, "
                "but the sensors' maker promises 5 % (take more clear days, with the sun high and low, or a known "
                "level: of a face from its certificate, or of the site from a pyranometer nearby)"
            )
        ]
    names = ("the gains", "yaw and tilt", "the albedo")
    worst = (float(spread[:4].max()), float(spread[4:7].max()), float(spread[7]))
    units = ("", " deg", "")
    return [
        f"days that agree on {name}: leaving out one day at a time gives a standard error of {error:.3g}{unit}, "
        f"where {limit:g}{unit} is allowed"
        for name, error, limit, unit in zip(names, worst, _LARGEST_ERRORS, units, strict=True)
        if not error <= limit
    ]
