"""The simulated scanning meter, built as the configuration describes the real one."""

from collections.abc import Callable
from typing import cast

import numpy as np

from daemon.base.clock import Clock
from daemon.config.settings import Settings
from daemon.rigs.real import cube_surroundings
from drivers.cube.scanning.dialects import slot_of
from drivers.cube.scanning.driver import ScanningMeterSettings, build, channels_of
from drivers.cube.scanning.meter import DEVICE, ScanningMeterCube
from sim_drivers.scanner.core import ScannerCore
from sim_drivers.transports import InMemoryLine

_SEED = 4


def build_scanner(settings: Settings, sensor_v: Callable[[int, float], float], now_s: float) -> ScannerCore:
    """Return the meter with the faces' sensors at its channels; `sensor_v` gives the voltage of a face at a time."""
    own = cast("ScanningMeterSettings", settings.instruments.cube)
    channels = channels_of(own)

    def at_channel(channel: int, now_s: float) -> float | None:
        return sensor_v(channels.index(channel), now_s) if channel in channels else None

    random = np.random.default_rng([settings.simulation.seed, _SEED])
    return ScannerCore(own.meter, at_channel, random, slots={slot_of(channel) for channel in channels}, now=now_s)


def simulated_scanner(settings: Settings, clock: Clock, sensor_v: Callable[[int, float], float]) -> ScanningMeterCube:
    """Return the cube on a simulated meter, not yet connected."""
    own = cast("ScanningMeterSettings", settings.instruments.cube)
    core = build_scanner(settings, sensor_v, clock.monotonic())
    return build(own, cube_surroundings(settings, clock), InMemoryLine(DEVICE, core, clock.monotonic))
