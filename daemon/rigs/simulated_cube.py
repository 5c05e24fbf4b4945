"""The simulated cube, built as the configuration describes the real one."""

import math
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np

from daemon.base import plugins
from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.config.plugin_sections import LABJACK, MULTIPLEXED, PYRANOMETERS, SCANNING_METER
from daemon.config.settings import Settings
from daemon.rigs.real import build_multiplexed_cube, build_voltmeter, cube_surroundings
from drivers.interfaces import Cube
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.modbus.line import SimulatedDevice
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.scanner.core import ScannerCore
from sim_drivers.scene import Scene
from sim_drivers.transports import InMemoryLine, InMemoryPort
from sim_drivers.voltmeter.core import VoltmeterCore
from sim_drivers.weather import WeatherError
from sim_drivers.weather_files import MeasuredWeather


def build_simulated_cube(settings: Settings, clock: Clock, scene: Scene) -> Cube:
    """Return the cube on simulated sensors, not yet connected.

    A driver of another package simulates its own instrument; `UserError` for one that cannot.
    """
    own = settings.instruments.cube
    if own.driver == MULTIPLEXED:
        switch, meter = build_cube_cores(settings, clock, scene)
        return build_multiplexed_cube(
            settings,
            clock,
            # The simulated switch is wired one to one, whatever is configured for a real one.
            NiMultiplexer(InMemoryPort(switch, clock.monotonic)),
            build_voltmeter(settings, line=InMemoryLine("voltmeter", meter, clock.monotonic)),
        )
    if own.driver == PYRANOMETERS:
        from daemon.rigs.simulated_modbus import simulated_pyranometers  # noqa: PLC0415 - loads the driver

        return simulated_pyranometers(settings, clock, _sensors(clock, scene))
    if own.driver == LABJACK:
        from daemon.rigs.simulated_modbus import simulated_labjack  # noqa: PLC0415 - loads the driver

        return simulated_labjack(settings, clock, _sensors(clock, scene))
    if own.driver == SCANNING_METER:
        from daemon.rigs.simulated_scanner import simulated_scanner  # noqa: PLC0415 - loads the driver

        return simulated_scanner(settings, clock, _sensors(clock, scene))
    simulate = getattr(plugins.load(plugins.CUBES, own.driver), "simulate", None)
    if simulate is None:
        raise UserError(
            f'instruments.cube.driver = "{own.driver}" cannot be simulated and instruments.kind is "simulated":'
            f' set instruments.cube.driver to "{MULTIPLEXED}"'
        )
    return cast("Cube", simulate(own, cube_surroundings(settings, clock), _sensors(clock, scene)))


def build_bench_sensors(settings: Settings, clock: Clock, scene: Scene) -> Sequence[SimulatedDevice] | ScannerCore:
    """Return, for the bench, the sensors of a cube on Modbus or its scanning meter; none for the multiplexed cube.

    `UserError` for a cube that the bench cannot simulate.
    """
    own = settings.instruments.cube
    if own.driver == MULTIPLEXED:
        return ()
    if own.driver == PYRANOMETERS:
        from daemon.rigs.simulated_modbus import build_pyranometers  # noqa: PLC0415 - loads the driver

        return build_pyranometers(own, _sensors(clock, scene))
    if own.driver == LABJACK:
        from daemon.rigs.simulated_modbus import build_labjack  # noqa: PLC0415 - loads the driver

        return [build_labjack(own, _sensors(clock, scene))] * len(FACES)
    if own.driver == SCANNING_METER:
        from daemon.rigs.simulated_scanner import build_scanner  # noqa: PLC0415 - loads the driver

        return build_scanner(settings, _sensors(clock, scene), clock.monotonic())
    raise UserError(
        f'instruments.cube.driver = "{own.driver}" has no simulator for the bench, which has'
        f' "{MULTIPLEXED}", "{PYRANOMETERS}", "{LABJACK}" and "{SCANNING_METER}"; choose with --cube NAME'
    )


def build_cube_cores(
    settings: Settings, clock: Clock, scene: Scene, gaps: MeasuredWeather | None = None
) -> tuple[MultiplexerCore, VoltmeterCore]:
    """Return simulated multiplexer and voltmeter, wired to the scene as configured; `gaps` as for `_sensors`."""
    face_of_channel = {getattr(settings.cube, name).channel: index for index, name in enumerate(FACES)}
    shorted = (settings.cube.self_test_channel, settings.cube.second_self_test_channel)
    sensor_v = _sensors(clock, scene, gaps)

    def on_input(channel: int, now_s: float) -> float | None:
        if channel in shorted:
            return 0.0
        face = face_of_channel.get(channel)
        return None if face is None else sensor_v(face, now_s)

    meter = settings.instruments.voltmeter
    switch = MultiplexerCore(inputs=on_input, latency_s=0.0)
    core = VoltmeterCore(
        input_voltage=switch.output_voltage,
        random=np.random.default_rng([settings.simulation.seed, 1]),
        line_frequency_hz=meter.line_frequency_hz,
        terminator=meter.terminator,
    )
    return switch, core


def _sensors(clock: Clock, scene: Scene, gaps: MeasuredWeather | None = None) -> Callable[[int, float], float]:
    """Return a function for the voltage [V] of a face's sensor at a monotonic time.

    Without weather it raises `UserError`; within the span of the file `gaps` it returns NaN instead, which a voltmeter
    shows as an overflow.
    """

    def sensor_v(face: int, now_s: float) -> float:
        utc_s = clock.utc() + now_s - clock.monotonic()
        try:
            return scene.sensor_voltage(face, utc_s)
        except WeatherError as error:
            if gaps is not None and gaps.start_utc_s <= utc_s <= gaps.end_utc_s:
                return math.nan
            raise UserError(str(error)) from error

    return sensor_v
