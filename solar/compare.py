"""Two trackers compared: the bias between their measuring chains, energy, and equation (16).

Reference: Andriamahefa et al., EPJ Photovoltaics 14, 35 (2023), sections 2.1 and 4. Powers [W] are of the maximum power
point, in arrays of shape (n,); the same place in two arrays is the same instant.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array, normal_from_angles

DEGREE = 2
_GAP_S = 60.0
_LONGEST_GAP_S = 3600.0


@dataclass(frozen=True, slots=True)
class ChainBias:
    """The polynomial c0 + c1 P + c2 P^2 that turns one measuring chain's power into what the other would have measured.

    Attributes
    ----------
    constant_w, linear, quadratic_per_w
        c0, c1 and c2.
    lowest_w, highest_w
        Range of P in the fit; outside it the polynomial is an extrapolation.
    """

    constant_w: float
    linear: float
    quadratic_per_w: float
    lowest_w: float
    highest_w: float

    def corrected(self, power_w: ArrayLike) -> Array:
        """Return the corrected power, never negative; a power of 0 stays 0, whatever the constant."""
        power = np.asarray(power_w, dtype=np.float64)
        found = self.constant_w + power * (self.linear + power * self.quadratic_per_w)
        return np.where(power > 0.0, np.maximum(found, 0.0), power * 0.0)

    def is_extrapolated(self, power_w: ArrayLike) -> NDArray[np.bool_]:
        """Tell where a power lies outside the fitted range."""
        power = np.asarray(power_w, dtype=np.float64)
        return (power < self.lowest_w) | (power > self.highest_w)


def fit_chain_bias(power_w: ArrayLike, reference_w: ArrayLike) -> ChainBias:
    """Fit the second-order polynomial of section 2.1 by least squares, from powers of two trackers that lay alike.

    Parameters
    ----------
    power_w, reference_w
        Powers of the chain to correct and of the other one, finite.

    Raises
    ------
    ValueError
        Fewer than three different powers.
    """
    power, reference = _same_length_arrays(power_w, reference_w)
    if np.unique(power).size <= DEGREE:
        raise ValueError(f"a polynomial of order {DEGREE} needs {DEGREE + 1} different powers")
    # `fit` scales the powers for accuracy, `convert` undoes that.
    polynomial = np.polynomial.Polynomial.fit(power, reference, DEGREE).convert()
    constant, linear, quadratic = (float(c) for c in np.pad(polynomial.coef, (0, DEGREE + 1 - polynomial.coef.size)))
    return ChainBias(
        constant_w=constant,
        linear=linear,
        quadratic_per_w=quadratic,
        lowest_w=float(power.min()),
        highest_w=float(power.max()),
    )


def longest_gap_s(utc_s: ArrayLike) -> float:
    """Return the longest step [s] between two of these rising instants over which the power counts as known.

    It is 1.5 times their median step, so that a wattmeter that stores every five minutes has no gaps. It is at least a
    minute and at most an hour: a few readings in a day do not tell what the power was between them.
    """
    step_s = np.diff(np.asarray(utc_s, dtype=np.float64))
    return float(np.clip(1.5 * np.median(step_s), _GAP_S, _LONGEST_GAP_S)) if step_s.size else _GAP_S


def energy_wh(utc_s: ArrayLike, power_w: ArrayLike, longest_gap_s: float = _GAP_S) -> float:
    """Return the time integral of the power [Wh] by the trapezoidal rule, as equation (16) asks for.

    Parameters
    ----------
    utc_s, power_w
        Rising instants [s] and the power then.
    longest_gap_s
        A longer step does not count.
    """
    time, power = _same_length_arrays(utc_s, power_w)
    step_s = np.diff(time)
    between_w = (power[1:] + power[:-1]) / 2.0
    return float(np.sum(np.where(step_s <= longest_gap_s, step_s * between_w, 0.0))) / 3600.0


def gain_pct(energy_cube: float, energy_chrono: float) -> float:
    """Return what T-Cube gained over T-Chrono [%], equation (16); NaN without any energy of T-Chrono."""
    return 100.0 * (energy_cube - energy_chrono) / energy_chrono if energy_chrono > 0.0 else float("nan")


def lies_flat(a_deg: ArrayLike, b_deg: ArrayLike, within_deg: float = 2.0) -> NDArray[np.bool_]:
    """Tell where a tracker at A, B [deg] lies horizontal within `within_deg`; False for an unknown pose."""
    up = normal_from_angles(a_deg, b_deg)[..., 2]
    flat: NDArray[np.bool_] = up >= np.cos(np.radians(within_deg))
    return flat


def _same_length_arrays(first: ArrayLike, second: ArrayLike) -> tuple[Array, Array]:
    one, other = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if one.shape != other.shape or one.ndim != 1:
        raise ValueError(f"two rows of numbers of one length are needed, not of shapes {one.shape} and {other.shape}")
    return one, other
