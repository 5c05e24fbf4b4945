"""Simulated instruments on Modbus, with the makes, addresses and inputs that are configured for real ones."""

from collections.abc import Callable
from functools import partial
from typing import cast

from daemon.base.clock import Clock
from daemon.config.settings import Settings
from daemon.rigs.real import cube_surroundings
from drivers.cube import labjack
from drivers.cube.labjack import T7, T8, LabjackCube, LabjackSettings
from drivers.cube.pyranometers.driver import DEVICE, PyranometerCube, build
from drivers.cube.pyranometers.settings import FACE_NAMES, PyranometersSettings
from drivers.settings import CubeDriverSettings
from sim_drivers.modbus.labjack import BEST_INDEX, SimulatedLabjack
from sim_drivers.modbus.line import DeviceLineCore
from sim_drivers.modbus.pyranometers import SimulatedMapped, SimulatedPyranometer, simulated_pyranometer
from sim_drivers.transports import InMemoryModbus

# Output of a simulated sensor.
_VOLT_PER_W_M2 = 1e-4
_FIRST_SERIAL = 24101

SensorVoltage = Callable[[int, float], float]


def simulated_pyranometers(settings: Settings, clock: Clock, sensor_v: SensorVoltage) -> PyranometerCube:
    """Return the cube on simulated sensors, not yet connected; each line of the configuration is one in memory.

    Parameters
    ----------
    sensor_v
        Voltage [V] of the scene's sensor on face 0 to 3 at a monotonic time.
    """
    own = cast("PyranometersSettings", settings.instruments.cube)
    sensors = build_pyranometers(own, sensor_v)

    def path(line: str) -> InMemoryModbus:
        there = [sensor for name, sensor in zip(FACE_NAMES, sensors, strict=True) if (own.line_of(name) or "") == line]
        return InMemoryModbus(DEVICE, DeviceLineCore(there), clock.monotonic)

    return build(own, cube_surroundings(settings, clock), path)


def build_pyranometers(section: CubeDriverSettings, sensor_v: SensorVoltage) -> list[SimulatedPyranometer]:
    """Return the sensors of east, south, west and zenith, with the serial numbers that are configured, if any."""
    own = cast("PyranometersSettings", section)

    def irradiance(face: int, now_s: float) -> float:
        return sensor_v(face, now_s) / _VOLT_PER_W_M2

    found: list[SimulatedPyranometer] = []
    for face, name in enumerate(FACE_NAMES):
        used, light = own.map_of(name), partial(irradiance, face)
        twins = [
            sensor
            for other, sensor in zip(FACE_NAMES, found, strict=False)
            if own.line_of(other) == own.line_of(name) and own.face(other).address == own.face(name).address
        ]
        if twins and isinstance(twins[0], SimulatedMapped):
            twins[0].add(used, light)
            found.append(twins[0])
            continue
        serial = own.face(name).serial or _FIRST_SERIAL + face
        found.append(simulated_pyranometer(own.make_of(name), own.face(name).address, serial, light, used))
    return found


def simulated_labjack(settings: Settings, clock: Clock, sensor_v: SensorVoltage) -> LabjackCube:
    """Return the cube on a simulated LabJack, not yet connected."""
    own = cast("LabjackSettings", settings.instruments.cube)
    core = DeviceLineCore([build_labjack(own, sensor_v)])
    return labjack.build(
        own, cube_surroundings(settings, clock), lambda _line: InMemoryModbus(DEVICE, core, clock.monotonic)
    )


def build_labjack(section: CubeDriverSettings, sensor_v: SensorVoltage) -> SimulatedLabjack:
    """Return a LabJack with the sensors of the four faces at their inputs: a T7, or a T8 if the settings need one."""
    own = cast("LabjackSettings", section)
    face_of_input = {each: face for face, each in enumerate(own.inputs)}
    only_t8 = any(each % 2 for each in own.inputs) or own.resolution_index > BEST_INDEX[T7]

    def input_v(each: int, now_s: float) -> float:
        face = face_of_input.get(each)
        return 0.0 if face is None else sensor_v(face, now_s)

    return SimulatedLabjack(input_v, T8 if only_t8 else T7)
