"""What a photovoltaic module gives: its I-V curve and maximum power by the single-diode model, and how warm it gets.

All functions broadcast their arguments to one shape. Irradiance is effective: broadband plane-of-array irradiance less
what reflection, soiling and the spectrum take. NaN gives NaN; no light, or less than none, gives zeros.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pvlib import pvsystem, temperature
from scipy.optimize import brentq

from solar.frames import Array

_LEAST_W_M2 = 1e-3
_SOLVED_V = 1e-10
_MOST_STEPS = 100


@dataclass(frozen=True, slots=True)
class PvModule:
    """The parameters of a module's single-diode model at 1000 W/m2 and 25 degC: De Soto et al. (2006), Dobos (2012).

    Attributes
    ----------
    name
        For reports.
    photocurrent_a, saturation_current_a
        I_L and I_o.
    series_resistance_ohm, shunt_resistance_ohm
        R_s and R_sh; the shunt's is inversely proportional to irradiance.
    ideality_v
        a = n N_s k T / q: the diode's ideality times the thermal voltage of all cells.
    isc_per_k_a
        Temperature coefficient of the short-circuit current [A/K].
    adjust_pct
        By how much the CEC's model lowers that coefficient; 0 makes it De Soto's.
    """

    name: str
    photocurrent_a: float
    saturation_current_a: float
    series_resistance_ohm: float
    shunt_resistance_ohm: float
    ideality_v: float
    isc_per_k_a: float
    adjust_pct: float = 0.0


Q_PEAK_G4_1_305 = PvModule(
    name="Q.PEAK-G4.1 305",
    photocurrent_a=9.841126,
    saturation_current_a=3.811337e-11,
    series_resistance_ohm=0.301706,
    shunt_resistance_ohm=2635.438965,
    ideality_v=1.524235,
    isc_per_k_a=0.004428,
    adjust_pct=8.127508,
)
"""The module of both trackers in Andriamahefa et al. (2023), section 2.1: 60 monocrystalline cells, 305 Wp.

From the data sheet: 305 W, Isc 9.84 A, Voc 40.05 V, Impp 9.35 A, Vmpp 32.62 V. Inferred: the seven parameters, which
the California Energy Commission's database (2019) fitted to that sheet for ``Hanwha_Q_Cells_Q_PEAK_G4_1_305``. Assumed:
that the rig's modules are like the sheet; the paper found theirs 2.4 % apart, the sheet grants 3 %.
"""


@dataclass(frozen=True, slots=True)
class MaximumPower:
    """The main points of the I-V curve, arrays of one shape."""

    pmpp_w: Array
    vmpp_v: Array
    impp_a: Array
    voc_v: Array
    isc_a: Array


def curve(
    module: PvModule, effective_irradiance_w_m2: ArrayLike, cell_temperature_c: ArrayLike, voltage_v: ArrayLike
) -> Array:
    """Return the current [A] that the module gives at `voltage_v`; beyond Voc it is negative."""
    light, dark, parameters = _parameters(module, effective_irradiance_w_m2, cell_temperature_c)
    current_a = pvsystem.i_from_v(np.asarray(voltage_v, dtype=np.float64), *parameters)
    result: Array = np.where(dark, 0.0, np.where(np.isnan(light), np.nan, current_a))
    return result


class SingleDiode(NamedTuple):
    """A module in one light: the model of `curve`, for one number at a time and 50 times as quick.

    With V_d the voltage across the diode, I = I_L - I_o (exp(V_d / a) - 1) - V_d / R_sh and V = V_d - I R_s. For a
    given V or I, V_d is found by Newton's method from above, which approaches a convex function without overshooting.
    """

    photocurrent_a: float
    saturation_a: float
    series_ohm: float
    shunt_ohm: float
    ideality_v: float
    dark: bool

    def current(self, voltage_v: float) -> float:
        """Return the current [A] at a voltage."""
        if self.dark:
            return 0.0
        most_a = max(self.photocurrent_a + voltage_v / self.series_ohm, 0.0)
        highest_v = self.ideality_v * math.log1p(most_a / self.saturation_a)
        diode_v = min(voltage_v + self.series_ohm * self.photocurrent_a, highest_v)
        for _ in range(_MOST_STEPS):
            current_a, slope = self._current_and_slope(diode_v)
            step_v = (diode_v - self.series_ohm * current_a - voltage_v) / (1.0 + self.series_ohm * slope)
            diode_v -= step_v
            if not abs(step_v) > _SOLVED_V:
                break
        return self._current_and_slope(diode_v)[0]

    def voltage(self, current_a: float) -> float:
        """Return the voltage [V] at a current, the inverse of `current`; at 0 A that of the open circuit."""
        if self.dark:
            return 0.0
        diode_v = self.ideality_v * math.log1p(max(self.photocurrent_a - current_a, 0.0) / self.saturation_a)
        for _ in range(_MOST_STEPS):
            through_a, slope = self._current_and_slope(diode_v)
            step_v = (current_a - through_a) / slope
            diode_v -= step_v
            if not abs(step_v) > _SOLVED_V:
                break
        return diode_v - current_a * self.series_ohm

    def maximum(self) -> MaximumPower:
        """Return what `maximum_power` does, a hundred times as quickly, in arrays of no dimension."""
        open_v, short_a = self.voltage(0.0), self.current(0.0)
        if self.dark or math.isnan(open_v):
            power_w = at_v = at_a = open_v
        else:
            diode_v = brentq(self._power_slope, 0.0, open_v, xtol=_SOLVED_V)
            at_a, _ = self._current_and_slope(diode_v)
            at_v = diode_v - at_a * self.series_ohm
            power_w = at_v * at_a
        return MaximumPower(*map(np.asarray, (power_w, at_v, at_a, open_v, short_a)))

    def _power_slope(self, diode_v: float) -> float:
        """Return by how much the module's power [W] grows with the voltage across the diode [V]."""
        current_a, falls = self._current_and_slope(diode_v)
        return current_a * (1.0 + falls * self.series_ohm) - (diode_v - current_a * self.series_ohm) * falls

    def _current_and_slope(self, diode_v: float) -> tuple[float, float]:
        """Return the current [A] at a voltage across the diode, and by how much it falls there [A/V]."""
        grown = self.saturation_a * math.exp(diode_v / self.ideality_v)
        current_a = self.photocurrent_a - (grown - self.saturation_a) - diode_v / self.shunt_ohm
        return current_a, grown / self.ideality_v + 1.0 / self.shunt_ohm


def single_diode(module: PvModule, effective_irradiance_w_m2: float, cell_temperature_c: float) -> SingleDiode:
    """Return the module in one light."""
    _, dark, parameters = _parameters(module, effective_irradiance_w_m2, cell_temperature_c)
    photocurrent_a, saturation_a, series_ohm, shunt_ohm, ideality_v = map(float, parameters)
    return SingleDiode(
        photocurrent_a=photocurrent_a,
        saturation_a=saturation_a,
        series_ohm=series_ohm,
        shunt_ohm=shunt_ohm,
        ideality_v=ideality_v,
        dark=bool(dark),
    )


def maximum_power(
    module: PvModule, effective_irradiance_w_m2: ArrayLike, cell_temperature_c: ArrayLike
) -> MaximumPower:
    """Return the maximum power point, the open-circuit voltage and the short-circuit current."""
    light, dark, parameters = _parameters(module, effective_irradiance_w_m2, cell_temperature_c)
    shape = np.broadcast_shapes(light.shape, np.shape(cell_temperature_c))
    flat = [np.broadcast_to(each, shape).ravel() for each in parameters]
    # pvlib's search for the maximum refuses NaN.
    usable = np.all([np.isfinite(each) for each in flat], axis=0)
    found = np.full((5, usable.size), np.nan)
    if usable.any():
        points = pvsystem.singlediode(*(each[usable] for each in flat))
        for row, name in enumerate(("p_mp", "v_mp", "i_mp", "v_oc", "i_sc")):
            found[row, usable] = np.maximum(points[name], 0.0)
    return MaximumPower(*np.where(dark, 0.0, found.reshape(5, *shape)))


def cell_temperature(
    plane_of_array_w_m2: ArrayLike, air_temperature_c: ArrayLike, wind_speed_m_s: ArrayLike = 1.0
) -> Array:
    """Return the module's temperature [degC] by Faiman (2008): air + G / (U0 + U1 wind).

    U0 = 25 and U1 = 6.84 are the published values for modules on an open rack that work at their maximum power; a
    module in open circuit turns no light into current and is some degrees warmer. Cells and module count as one.
    """
    result: Array = np.asarray(
        temperature.faiman(*map(np.asarray, (plane_of_array_w_m2, air_temperature_c, wind_speed_m_s)))
    )
    return result


def _parameters(
    module: PvModule, irradiance_w_m2: ArrayLike, cell_temperature_c: ArrayLike
) -> tuple[Array, np.ndarray, tuple[Array, ...]]:
    """Return the irradiance, where there is no light, and (I_L, I_o, R_s, R_sh, a)."""
    light = np.asarray(irradiance_w_m2, dtype=np.float64)
    dark = light <= _LEAST_W_M2
    # Without light the shunt's resistance is infinite, which the solvers do not accept.
    photocurrent_a, saturation_a, series_ohm, shunt_ohm, ideality_v = pvsystem.calcparams_cec(
        np.where(dark, _LEAST_W_M2, light),
        np.asarray(cell_temperature_c, dtype=np.float64),
        alpha_sc=module.isc_per_k_a,
        a_ref=module.ideality_v,
        I_L_ref=module.photocurrent_a,
        I_o_ref=module.saturation_current_a,
        R_sh_ref=module.shunt_resistance_ohm,
        R_s=module.series_resistance_ohm,
        Adjust=module.adjust_pct,
    )
    return light, dark, (photocurrent_a, saturation_a, series_ohm, shunt_ohm, ideality_v)
