"""The simulated module on the tracker, as what feeds the electronic load."""

import math
from collections.abc import Callable
from typing import NamedTuple

from sim_drivers.scene import Scene
from solar.frames import Angles
from solar.pv_module import MaximumPower, PvModule, SingleDiode, cell_temperature, single_diode

_CALM_M_S = 1.0
_MILD_C = 15.0
_STEADY_S = 0.2
"""How long the light counts as the same: at full speed the axes turn by a tenth of a degree in that time."""


class SourceLight(NamedTuple):
    """What falls on the module [W/m2], and how warm its cells are [degC]."""

    irradiance_w_m2: float
    cell_c: float


class PvSource:
    """A module that looks where the tracker truly points.

    Effective irradiance is the plane's: neither reflection nor spectrum takes anything. The module is as warm as
    Faiman's model has it, at once, in the weather's air and wind, or at 15 degC and 1 m/s where it does not tell them.

    Parameters
    ----------
    scene
        Sun, sky and ground.
    pose
        Where the axes truly stand, of time [s].
    utc_s
        UTC [s], of time [s].
    module
        What it is.
    """

    def __init__(
        self,
        scene: Scene,
        pose: Callable[[float], Angles],
        utc_s: Callable[[float], float],
        module: PvModule,
    ) -> None:
        self._scene = scene
        self._pose = pose
        self._utc_s = utc_s
        self._module = module
        self._light, self._lit_s = SourceLight(0.0, _MILD_C), math.nan
        self._diode: tuple[SourceLight, SingleDiode] | None = None
        self._open_v = self._last_current_a = 0.0
        self._last_voltage_v = math.nan

    def light(self, now: float) -> SourceLight:
        """Return the light at a time [s]."""
        if not abs(now - self._lit_s) < _STEADY_S:
            self._light, self._lit_s = self.light_now(now), now
        return self._light

    def current(self, light: SourceLight, voltage_v: float) -> float:
        """Return the current [A] at a voltage."""
        diode = self._diode_in(light)
        # While a load holds a voltage, each question to it asks for the current at that voltage again.
        if voltage_v != self._last_voltage_v:
            self._last_voltage_v, self._last_current_a = voltage_v, diode.current(voltage_v)
        return self._last_current_a

    def voltage(self, light: SourceLight, current_a: float) -> float:
        """Return the voltage [V] at a current; at 0 A that of the open circuit."""
        diode = self._diode_in(light)
        return self._open_v if current_a == 0.0 else diode.voltage(current_a)

    def maximum(self, light: SourceLight) -> MaximumPower:
        """Return the true maximum power point."""
        return self._diode_in(light).maximum()

    def light_now(self, now: float) -> SourceLight:
        """Work out the light at a time [s] anew."""
        utc_s, pose = self._utc_s(now), self._pose(now)
        irradiance = self._scene.plane_of_array(pose.a_deg, pose.b_deg, utc_s)
        air, wind = self._scene.air_temperature(utc_s), self._scene.wind_speed(utc_s)
        warm = cell_temperature(irradiance, _MILD_C if air is None else air, _CALM_M_S if wind is None else wind)
        return SourceLight(irradiance, float(warm))

    def _diode_in(self, light: SourceLight) -> SingleDiode:
        if self._diode is None or self._diode[0] is not light:
            self._diode = light, single_diode(self._module, *light)
            self._open_v, self._last_voltage_v = self._diode[1].voltage(0.0), math.nan
        return self._diode[1]
