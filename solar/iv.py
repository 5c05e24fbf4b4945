"""The maximum power of a measured I-V curve, by a local fit around its knee.

Near its maximum the power P = V I of a curve is smooth in V, so a polynomial through the points around the highest one
tells the maximum better than that point alone, and how well it is known. Nothing is assumed about the module.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array

LEAST_POINTS = 5
LEAST_SWEEP_POINTS = 8
_NEAR_TOP_SHARE = 0.92
_SPARSE_NEAR_TOP_SHARE = 0.7
_ENOUGH_POINTS = 7
_DEGREE = 4
# Between these shares of Voc the knee of crystalline silicon lies in any light and warmth.
_KNEE = (0.70, 0.92)
_OUTLIER = 5.0
_WILD = 0.02
_MAD_TO_SIGMA = 1.4826
# Rounding alone must not make a point an outlier, and noise in the dark must not make a maximum.
_EXACT = 1e-6
_LARGEST_POSSIBLE = 1e6
_LEAST_SIGNIFICANCE = 3.0


@dataclass(frozen=True, slots=True)
class MeasuredMaximum:
    """What a measured curve says.

    Attributes
    ----------
    pmpp_w, vmpp_v, impp_a
        The maximum power point; NaN if there is none.
    pmpp_sigma_w
        Standard uncertainty of `pmpp_w` by the scatter of the points around the fit; NaN with no more points than
        unknowns. What all points have in common (calibration, the light's drift) is not in it.
    voc_v, isc_a
        Where the curve meets the axes, by the straight line through its last points; NaN if it does not come near.
    points
        How many points the fit used.
    why_not
        Why there is no maximum power point; empty if there is one.
    """

    pmpp_w: float
    vmpp_v: float
    impp_a: float
    pmpp_sigma_w: float
    voc_v: float
    isc_a: float
    points: int
    why_not: str = ""


def sweep_voltages(voc_v: float, least_v: float, points: int) -> Array:
    """Return the voltages of a sweep from near `voc_v` down to `least_v`, shape (points,), half of them at the knee.

    Raises `ValueError` for fewer than `LEAST_SWEEP_POINTS` points, and where `least_v` is not between 0 and the knee.
    """
    high_v, low_v = _KNEE[1] * voc_v, _KNEE[0] * voc_v
    if points < LEAST_SWEEP_POINTS:
        raise ValueError(f"a sweep of {points} points is too short; take {LEAST_SWEEP_POINTS} or more")
    if not 0.0 <= least_v < low_v < np.inf:
        raise ValueError(f"there is no sweep from {voc_v:g} V down to {least_v:g} V")
    at_knee, above = (points + 1) // 2, max(points // 8, 1)
    return np.concatenate(
        [
            np.linspace(0.99 * voc_v, high_v, above, endpoint=False),
            np.linspace(high_v, low_v, at_knee, endpoint=False),
            np.linspace(low_v, least_v, points - at_knee - above),
        ]
    )


def measured_maximum(voltage_v: ArrayLike, current_a: ArrayLike) -> MeasuredMaximum:
    """Return the maximum power point of the points of one curve, shape (n,) each, in any order.

    Points that are no possible number are left out, and so is a point far from what its neighbours say. A voltage that
    was read in open circuit is a point of 0 A. There is no maximum where fewer than `LEAST_POINTS` remain, where the
    highest power is at either end of them (the knee is not in the curve), where it is more than points of one curve can
    give, or where it is no more than noise. Equal voltages are allowed. Never raises for a curve of odd values.
    """
    voltage, current = np.asarray(voltage_v, dtype=np.float64), np.asarray(current_a, dtype=np.float64)
    # Written so that NaN fails; the bound keeps powers finite.
    usable = (np.abs(voltage) < _LARGEST_POSSIBLE) & (np.abs(current) < _LARGEST_POSSIBLE)
    voltage, current = voltage[usable], current[usable]
    order = np.argsort(voltage)
    voltage, current = _without_wild_points(voltage[order], current[order])
    if voltage.size < LEAST_POINTS:
        return _no_maximum(f"{voltage.size} usable points, {LEAST_POINTS} are needed")
    power = voltage * current
    top = int(np.argmax(power))
    if not power[top] > 0.0:
        return _no_maximum("no power")
    first, last = _window(power, top)
    voc_v = _voc(voltage, current)
    if voltage[top] in (voltage[first], voltage[last]):
        return _no_maximum("the highest power is at an end of the curve: the knee is not in it", voc_v)
    fit = _fit(voltage[first : last + 1], power[first : last + 1], float(voltage[top]))
    if fit is None:
        return _no_maximum("the points around the highest power have no maximum", voc_v)
    vmpp_v, pmpp_w, sigma_w, points = fit
    # The current falls as the voltage rises, so the curve cannot give more than this; a polynomial of odd points may.
    if pmpp_w > voltage[last] * current[first : last + 1].max():
        return _no_maximum("the points around the highest power are not of one curve", voc_v)
    if not pmpp_w > 0.0 or pmpp_w < _LEAST_SIGNIFICANCE * sigma_w:
        return _no_maximum("the highest power is no more than noise", voc_v)
    return MeasuredMaximum(
        pmpp_w=pmpp_w,
        vmpp_v=vmpp_v,
        impp_a=pmpp_w / vmpp_v,
        pmpp_sigma_w=sigma_w,
        voc_v=voc_v,
        isc_a=_isc(voltage, current, vmpp_v),
        points=points,
    )


def _no_maximum(why: str, voc_v: float = np.nan) -> MeasuredMaximum:
    return MeasuredMaximum(
        pmpp_w=np.nan,
        vmpp_v=np.nan,
        impp_a=np.nan,
        pmpp_sigma_w=np.nan,
        voc_v=voc_v,
        isc_a=np.nan,
        points=0,
        why_not=why,
    )


def _without_wild_points(voltage: Array, current: Array) -> tuple[Array, Array]:
    """Leave out the points that are far from the median of themselves and their two neighbours.

    The current of a curve falls throughout, so without noise every point is that median. The points at the ends are
    given a neighbour beyond them, infinitely high or low, so that this holds for them too.
    """
    if voltage.size < LEAST_POINTS:
        return voltage, current
    before, after = np.append(np.inf, current[:-1]), np.append(current[1:], -np.inf)
    off = np.abs(current - np.median(np.stack([before, current, after]), axis=0))
    noise = _MAD_TO_SIGMA * float(np.median(off))
    tame = off <= max(_OUTLIER * noise, _WILD * float(np.median(np.abs(current))))
    return voltage[tame], current[tame]


def _window(power: Array, top: int) -> tuple[int, int]:
    """Return the first and last point of the stretch around the top that is near it; wider where points are sparse."""
    first = last = top
    while True:
        enough = last - first + 1 >= _ENOUGH_POINTS
        least = power[top] * (_NEAR_TOP_SHARE if enough else _SPARSE_NEAR_TOP_SHARE)
        grown_first = first - (first > 0 and (power[first - 1] >= least or top - first < 2))
        grown_last = last + (last < power.size - 1 and (power[last + 1] >= least or last - top < 2))
        if (grown_first, grown_last) == (first, last):
            return first, last
        first, last = int(grown_first), int(grown_last)


def _fit(voltage: Array, power: Array, middle_v: float) -> tuple[float, float, float, int] | None:
    """Return (Vmpp, Pmpp, its uncertainty, points used), or None where the polynomial has no maximum among them."""
    half_v = max(float(voltage[-1]) - middle_v, middle_v - float(voltage[0]))
    place = (voltage - middle_v) / half_v
    used = np.ones(place.size, dtype=np.bool_)
    for attempt in range(2):
        # One point more than unknowns, so that the scatter shows.
        degree = max(2, min(_DEGREE, int(used.sum()) - 2))
        powers = np.vander(place, degree + 1)
        coefficients = np.linalg.lstsq(powers[used], power[used])[0]
        off = np.abs(power - powers @ coefficients)
        scatter = max(_MAD_TO_SIGMA * float(np.median(off[used])), _EXACT * float(np.abs(power).max()))
        kept = off <= _OUTLIER * scatter
        if attempt or kept.all() or kept.sum() < LEAST_POINTS:
            break
        used = kept
    slopes = np.roots(np.polyder(coefficients))
    places = slopes[np.isreal(slopes)].real
    places = places[(places >= place[used].min()) & (places <= place[used].max())]
    if places.size == 0:
        return None
    at = float(places[np.argmax(np.polyval(coefficients, places))])
    freedom = int(used.sum()) - degree - 1
    sigma_w = np.nan
    if freedom > 0:
        variance = float(off[used] @ off[used]) / freedom
        weights = np.linalg.pinv(powers[used].T @ powers[used])
        here = np.vander([at], degree + 1)[0]
        sigma_w = float(np.sqrt(variance * max(float(here @ weights @ here), 0.0)))
    return middle_v + half_v * at, float(np.polyval(coefficients, at)), sigma_w, int(used.sum())


def _voc(voltage: Array, current: Array) -> float:
    """Return where the line through the two points nearest to 0 A reaches 0 A; NaN if over a step beyond them."""
    nearest = np.sort(np.argsort(np.abs(current))[:2])
    (low, high), (at_low, at_high) = voltage[nearest], current[nearest]
    if not at_low > at_high or not high > low:
        return np.nan
    crossing = float(low + at_low * (high - low) / (at_low - at_high))
    return crossing if crossing <= high + (high - low) else np.nan


def _isc(voltage: Array, current: Array, vmpp_v: float) -> float:
    """Return the current at 0 V by the line through the points below half of Vmpp."""
    flat = voltage < 0.5 * vmpp_v
    if np.unique(voltage[flat]).size < 2:
        return np.nan
    return float(np.polyval(np.polyfit(voltage[flat], current[flat], 1), 0.0))
