"""The simulated module on the tracker, as what feeds the electronic load."""

from collections.abc import Callable
from typing import NamedTuple

from numpy.typing import ArrayLike

from sim_drivers.scene import Scene
from solar.frames import Angles, Array
from solar.pv_module import MaximumPower, PvModule, cell_temperature, curve, maximum_power, voltage

_CALM_M_S = 1.0
_MILD_C = 15.0


class SourceLight(NamedTuple):
    """What falls on the module [W/m2], and how warm its cells are [degC]."""

    irradiance_w_m2: float | Array
    cell_c: float | Array


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

    def light(self, now: float) -> SourceLight:
        """Return the light at a time [s]."""
        utc_s, pose = self._utc_s(now), self._pose(now)
        irradiance = self._scene.plane_of_array(pose.a_deg, pose.b_deg, utc_s)
        air, wind = self._scene.air_temperature(utc_s), self._scene.wind_speed(utc_s)
        warm = cell_temperature(irradiance, _MILD_C if air is None else air, _CALM_M_S if wind is None else wind)
        return SourceLight(irradiance, float(warm))

    def current(self, light: SourceLight, voltage_v: ArrayLike) -> Array:
        """Return the current [A] at a voltage."""
        return curve(self._module, *light, voltage_v)

    def voltage(self, light: SourceLight, current_a: ArrayLike) -> Array:
        """Return the voltage [V] at a current; that of the open circuit for none."""
        return voltage(self._module, *light, current_a)

    def maximum(self, light: SourceLight) -> MaximumPower:
        """Return the true maximum power point."""
        return maximum_power(self._module, *light)
