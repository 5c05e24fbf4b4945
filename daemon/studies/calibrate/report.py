"""The report of `heliocube calibrate`, and the calibration that it writes."""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from pydantic import ValidationError

from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.cube.calibration import CubeCalibration, new_calibration
from daemon.studies.calibrate.in_field import FieldResult
from daemon.studies.calibrate.readings import span_text
from daemon.studies.calibrate.reference_comparison import Comparison
from daemon.studies.calibrate.request import CubeSetup
from solar.frames import azimuth_from_direction

# Largest share left unexplained: under a simulated sky the right model leaves 0.1 % at most, a wrong one 0.3 %.
_DOUBTFUL = 0.002
DOUBT_PREFIX = "Doubtful: "
"""Begins the line of a result that nobody should use before it has been checked."""
# The order of the paper's Table 1.
_TABLE_ORDER = ("zenith", "west", "south", "east")
_ROWS = (
    ("MBE (W/m2)", "mbe"),
    ("rMBE (%)", "rmbe_percent"),
    ("MAE (W/m2)", "mae"),
    ("rMAE (%)", "rmae_percent"),
)


def with_simulation_mark(lines: list[str], *, simulated: bool) -> list[str]:
    """Return the lines, below a mark if they are `simulated`: the calibration file has them as well."""
    mark = "SIMULATED: these readings come from a model or a bench, not from a cube."
    return [mark, *lines] if simulated else lines


def comparison_lines(found: Comparison) -> list[str]:
    """Return gains, offsets and the paper's Table 1 before and after, as lines of text."""
    lines = [
        (
            f"{found.utc_s.size} minutes of clear and stable sky of {found.minutes} common by daylight, "
            f"{span_text(found.utc_s)}."
        ),
        f"The sensors' clock is {found.lag_s:+z.1f} s ahead."
        if found.lag_known
        else "The readings do not show the lag between the clocks; it is taken as 0 (--lag sets it).",
        f"Night offset of the reference {found.reference_offset_w_m2:+z.1f} W/m2; those of the sensors from "
        + (f"{found.night_readings} readings at night." if found.night_readings else "a line through the readings."),
        "",
    ]
    rows = [("", "gain W/m2/mV", "95 % scatter", "U (k=2)", "offset mV", "95 %", "series", "dropped")]
    for name, face in found.faces.items():
        gain, series = face.series.gain_w_m2_per_mv, face.series
        rows.append(
            (
                name,
                f"{gain.value:.4f}",
                f"{gain.half_width:.4f}",
                f"{face.gain_uncertainty_percent:.1f} %",
                f"{face.offset_mv.value:+z.4f}",
                f"{face.offset_mv.half_width:.4f}",
                f"{series.kept.size}",
                f"{np.count_nonzero(~series.kept)}",
            )
        )
    lines += _aligned(rows)
    for title, moment in (("Before", "before"), ("After", "after")):
        table = [(title, *(f"RG-{name[0].upper()}" for name in _TABLE_ORDER))]
        table += [
            (label, *(f"{getattr(getattr(found.faces[name], moment), field):z.1f}" for name in _TABLE_ORDER))
            for label, field in _ROWS
        ]
        lines += ["", *_aligned(table)]
    if strayed := _sensors_in_doubt(found):
        told = (
            f"{DOUBT_PREFIX}most of the series of {', '.join(strayed)} were dropped, and the rest may agree by chance; "
            "check that all times are UTC, the lag of the clocks (--lag), and that all lie level."
        )
        lines += ["", told]
    return lines


def _sensors_in_doubt(found: Comparison) -> list[str]:
    """Return the sensors with a gain that most of their series disagree with."""
    return [name for name, face in found.faces.items() if face.series.kept.mean() < 0.5]


def comparison_dict(found: Comparison) -> dict[str, Any]:
    """Return, for scripts, what the calibration file lacks: agreement before and after, and the data behind it."""
    return {
        "clear_minutes": int(found.utc_s.size),
        "common_minutes": found.minutes,
        "lag_s": found.lag_s,
        "lag_known": found.lag_known,
        "doubtful": bool(_sensors_in_doubt(found)),
        "agreement": {
            name: {"before": face.before._asdict(), "after": face.after._asdict()} for name, face in found.faces.items()
        },
    }


def field_dict(found: FieldResult, made_on: CubeSetup) -> dict[str, Any]:
    """Return, for scripts, what the calibration file lacks: how the cube stands, and how well the sky explains it."""
    return {
        "days": found.fit.days,
        "standing": _standing(found, made_on.site.latitude_deg),
        "level_by": found.level.names,
        "contradictions": found.contradictions,
        "unexplained_share": found.fit.shape.residual,
        "doubtful": not found.fit.shape.residual <= _DOUBTFUL,
    }


def field_lines(found: FieldResult, made_on: CubeSetup, sky: str) -> list[str]:
    """Return gains, attitude and albedo as lines of text."""
    fit, latitude = found.fit, made_on.site.latitude_deg
    rows = [("", "gain W/m2/mV", "U (k=2)", "change", "offset mV")]
    for place, name in enumerate(FACES):
        rows.append(
            (
                name,
                f"{found.gains_w_m2_per_mv[place]:.4f}",
                f"{200.0 * fit.errors.response[place] / fit.response[place]:.1f} %",
                f"{100.0 * (1.0 / fit.response[place] - 1.0):+z.1f} %",
                f"{found.offsets_mv[place]:+z.4f}",
            )
        )
    standing = _standing(found, latitude)
    lines = [
        (
            f"{fit.shape.utc_s.size} quarters of an hour of clear and stable sky on {fit.days} days, "
            f"{span_text(fit.shape.utc_s)}; sky {sky}."
        ),
        "",
        *_aligned(rows),
        "",
        f"yaw     {fit.attitude.yaw_deg:+z.2f} +- {standing['yaw_uncertainty_deg']:.2f} deg, clockwise from above",
        (
            f"tilt    {fit.attitude.tilt_deg:.2f} +- {standing['tilt_uncertainty_deg']:.2f} deg, towards azimuth "
            f"{standing['tilt_azimuth_deg']:.0f} deg"
        ),
        f"albedo  {fit.albedo:.3f} +- {standing['albedo_uncertainty']:.3f} (law.albedo)",
        f"left unexplained: {100.0 * fit.shape.residual:.2f} % of the zenith face",
        f"Uncertainties (U, +-) are expanded, k = 2. {_level_line(found)}",
    ]
    lines += [
        f"{DOUBT_PREFIX}{clause}; check each certificate, its serial number and its gain in the configuration, or "
        "leave one out."
        for clause in found.contradictions
    ]
    if not fit.shape.residual <= _DOUBTFUL:
        lines.append(
            f"{DOUBT_PREFIX}with the right sky, less than {_DOUBTFUL:.1%} is left unexplained; try another --sky, and "
            "look for shade on a face."
        )
    if sky == "perez1990" and not 0.5 <= fit.shape.horizon <= 1.5:
        lines.append(
            f"{DOUBT_PREFIX}the readings fit best with {fit.shape.horizon:z.1f} of the Perez model's horizon band,"
            " where 1 is right; try --sky haydavies, and trust vertical gains and albedo only if both agree."
        )
    return lines


def _level_line(found: FieldResult) -> str:
    known = found.level
    if not known.names:
        return (
            "Those of the gains and of the albedo come mostly from the clear-sky model, which sets the level of all "
            "gains; to know the gains to 1 %, give the uncertainty of a face whose gain comes from a reference "
            "(--referenced), or the GHI of a pyranometer nearby (--ghi)."
        )
    told = f"The level of the gains is held by {' and '.join(known.names)}, and by the clear-sky model."
    vertical = [face for face in known.referenced if face != "zenith"]
    zenith = "zenith" in known.referenced or known.ghi is not None
    if vertical and zenith:
        return told
    rest = "gain of the zenith face follows" if vertical else "gains of the vertical faces follow"
    return f"{told} The {rest} from that level by the model alone."


def comparison_calibration(
    found: Comparison, cube: str, serials: dict[str, str], valid_days: float, *, simulated: bool
) -> CubeCalibration:
    """Return the calibration for the file; its day is that of the last reading."""
    faces = {
        name: {
            "serial": serials.get(name, "unknown"),
            "gain_w_m2_per_mv": face.series.gain_w_m2_per_mv.value,
            "gain_uncertainty_percent": face.gain_uncertainty_percent,
            "offset_mv": face.offset_mv.value,
            "offset_uncertainty_mv": face.offset_mv.half_width,
        }
        for name, face in found.faces.items()
    }
    return _make_calibration(
        _dates(float(found.utc_s[-1]), valid_days)
        | {
            "method": "beside a reference",
            "cube": cube,
            "reference": serials.get("reference", "unknown"),
            "simulated": simulated,
        }
        | faces
    )


def field_calibration(
    found: FieldResult,
    made_on: CubeSetup,
    sky: str,
    serials: dict[str, str],
    valid_days: float,
    *,
    simulated: bool,
) -> CubeCalibration:
    """Return the calibration for the file; its day is that of the last clear sky."""
    fit = found.fit
    faces = {
        name: {
            "serial": serials.get(name, "unknown"),
            "gain_w_m2_per_mv": float(found.gains_w_m2_per_mv[place]),
            "gain_uncertainty_percent": float(200.0 * fit.errors.response[place] / fit.response[place]),
            "offset_mv": float(found.offsets_mv[place]),
            "offset_uncertainty_mv": float(found.offset_uncertainty_mv[place]),
        }
        for place, name in enumerate(FACES)
    }
    return _make_calibration(
        _dates(float(fit.shape.utc_s[-1]), valid_days)
        | {
            "method": "in place",
            "cube": made_on.cube.name,
            "reference": ", ".join([f"clear sky, {sky}", *found.level.names]),
            "simulated": simulated,
        }
        | faces
        | {"standing": _standing(found, made_on.site.latitude_deg)}
    )


def _make_calibration(values: dict[str, Any]) -> CubeCalibration:
    """Return the calibration; `UserError` for a number that no sensor has."""
    try:
        return new_calibration(values)
    except ValidationError as error:
        first = error.errors()[0]
        where, value = " ".join(map(str, first["loc"])), first["input"]
        if "gain_w_m2_per_mv" in first["loc"]:
            raise UserError(
                f"the {first['loc'][0]} sensor's gain would be {value:.4g} W/m2/mV: are the voltages in mV?"
            ) from None
        raise UserError(f"no calibration can be made of these readings: {where} would be {value}") from None


def _standing(found: FieldResult, latitude_deg: float) -> dict[str, Any]:
    attitude, errors = found.fit.attitude, found.fit.errors
    lean = np.array([attitude.lean_equator_deg, attitude.lean_east_deg, 0.0])
    azimuth, _ = azimuth_from_direction(lean, latitude_deg)
    return {
        "yaw_deg": attitude.yaw_deg,
        "yaw_uncertainty_deg": 2.0 * errors.yaw_deg,
        "tilt_deg": attitude.tilt_deg,
        "tilt_azimuth_deg": float(azimuth),
        "tilt_uncertainty_deg": float(2.0 * np.hypot(errors.lean_equator_deg, errors.lean_east_deg)),
        "albedo": found.fit.albedo,
        "albedo_uncertainty": 2.0 * errors.albedo,
    }


def _dates(last_utc_s: float, valid_days: float) -> dict[str, Any]:
    made = datetime.fromtimestamp(int(last_utc_s), UTC)
    return {"calibrated_utc": made, "expires_utc": made + timedelta(days=round(valid_days))}


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        ).rstrip()
        for row in rows
    ]
