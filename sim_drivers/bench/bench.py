"""The bench: simulated instruments under one sky, on real transports, for the real drivers in another process."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field, TokenStream
from sim_drivers.bench.line_host import LineHost, VoltmeterHost
from sim_drivers.bench.modbus_host import ModbusHost
from sim_drivers.bench.ni_server import NiServer
from sim_drivers.bench.positioner_host import PositionerHost
from sim_drivers.bench.rotator_host import RotatorHost
from sim_drivers.bench.scanner_host import ScannerHost
from sim_drivers.load.core import LoadCore
from sim_drivers.modbus.line import SimulatedDevice
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pv_source import PvSource
from sim_drivers.scanner.core import ScannerCore
from sim_drivers.scene import Scene
from sim_drivers.voltmeter.core import VoltmeterCore
from sim_drivers.weather import WeatherError
from solar.frames import Angles

_DISTURBANCE_SEED = 7
# GPIB, which the load's port stands for, is limited by the instruments: some kilobytes a second.
_LOAD_BYTE_S = 2e-4


@dataclass(frozen=True, slots=True)
class BenchClock:
    """The event loop's time [s], and the scene's UTC [s]; both run at real speed."""

    now: Callable[[], float]
    utc: Callable[[], float]


class Bench:
    """Four instruments and their surroundings.

    Parameters
    ----------
    directory
        Where the ports ``positioner``, ``voltmeter`` and ``load`` appear.
    scene
        Sun, sky and cube.
    switch, meter
        The cores of multiplexer and voltmeter.
    unit
        The core of the positioner, or a rotator behind its rotctld; None for a bench without a tracker.
    load, source
        The core of the electronic load, and the module that feeds it.
    clock
        Time.
    baud_rate
        Of the voltmeter.
    sensors
        The cube at the port ``cube``: devices on Modbus or a scanning meter. Empty if meter and switch are the cube.

    Attributes
    ----------
    cube
        That cube on its line; None without it.
    """

    def __init__(
        self,
        directory: Path,
        scene: Scene,
        switch: MultiplexerCore,
        meter: VoltmeterCore,
        unit: PositionerCore | RotatorHost | None,
        load: LoadCore,
        source: PvSource,
        clock: BenchClock,
        baud_rate: int,
        sensors: Sequence[SimulatedDevice] | ScannerCore = (),
    ) -> None:
        self.directory = directory
        self.scene = scene
        self.clock = clock
        random = np.random.default_rng(_DISTURBANCE_SEED)
        self.positioner = (
            PositionerHost(unit, directory / "positioner", clock.now, random)
            if isinstance(unit, PositionerCore)
            else unit
        )
        self.voltmeter = VoltmeterHost(meter, directory / "voltmeter", clock.now, baud_rate)
        self.multiplexer = NiServer(switch, clock.now)
        self.load = LineHost(load, directory / "load", clock.now, _LOAD_BYTE_S)
        self.cube: ModbusHost | ScannerHost | None = None
        if isinstance(sensors, ScannerCore):
            self.cube = ScannerHost(sensors, directory / "cube", clock.now)
        elif sensors:
            self.cube = ModbusHost(sensors, directory / "cube", clock.now)
        self._source = source

    async def run(self, stop: asyncio.Event, ready: Callable[[], None]) -> None:
        """Plug everything in, call `ready`, and serve until `stop` is set; raises what an instrument raises.

        Raises `BenchError` before, where something else has the name of a port.
        """
        serial: list[PositionerHost | LineHost[Any]] = [self.voltmeter, self.load]
        if isinstance(self.positioner, PositionerHost):
            serial.append(self.positioner)
        lines = [*serial, *([self.cube.line] if self.cube else [])]
        for line in lines:
            line.port.check_place()
        await self.multiplexer.start()
        if self.cube is not None:
            await self.cube.start()
        if isinstance(self.positioner, RotatorHost):
            await self.positioner.plug()
        ports = [host.port for host in serial]
        for port in ports:
            port.plug()
        try:
            async with asyncio.TaskGroup() as group:
                hosts = [group.create_task(line.run()) for line in lines]
                ready()
                await stop.wait()
                for host in hosts:
                    host.cancel()
        except ExceptionGroup as group:
            # The first that failed has caused the others to be cancelled.
            raise group.exceptions[0] from group
        finally:
            for port in ports:
                port.unplug()
            if isinstance(self.positioner, RotatorHost):
                self.positioner.unplug()
            if self.cube is not None:
                await self.cube.stop()
            await self.multiplexer.stop()

    def state(self) -> dict[str, Any]:
        """Return the truth, which the instruments may tell or not, as plain data.

        Without weather the light is None, and `light_missing` says why.
        """
        now, utc_s = self.clock.now(), self.clock.utc()
        return {
            "utc": datetime.fromtimestamp(utc_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "sun": self.scene.sun_angles(utc_s)._asdict(),
            **self._light_state(now, utc_s),
            **self._tracker_state(now),
            "voltmeter": {
                "plugged": self.voltmeter.port.plugged,
                "in_use": self.voltmeter.port.in_use,
                "range_v": self.voltmeter.core.range_v,
            },
            "multiplexer": {
                "plugged": self.multiplexer.plugged,
                "serving": self.multiplexer.serving,
                "selected": self.multiplexer.core.selected(now),
                "writes": self.multiplexer.writes,
            },
            "load": self._load_state(now),
            **({"cube": self.cube.state()} if self.cube else {}),
        }

    def _load_state(self, now: float) -> dict[str, Any]:
        core, light = self.load.core, self._source.light(now)
        return {
            "plugged": self.load.port.plugged,
            "in_use": self.load.port.in_use,
            "make": core.make,
            "input_on": core.on,
            "sweeps": core.sweeps,
            "level_v": core.level_v,
            "latched": sorted(core.latched),
            "cell_temperature_c": float(light.cell_c),
            "truth": {name: float(value) for name, value in asdict(self._source.maximum(light)).items()},
        }

    def _light_state(self, now: float, utc_s: float) -> dict[str, Any]:
        """Return what falls from the sky, and on the faces; on the module too where the tracker is the bench's."""
        pose = self._pose(now)
        try:
            return {
                "sky": self.scene.sky_state(utc_s)._asdict(),
                "faces": self.scene.irradiances(utc_s)._asdict(),
                **({} if pose is None else {"plane_of_array_w_m2": self.scene.plane_of_array(*pose, utc_s)}),
            }
        except WeatherError as error:
            return {"sky": None, "faces": None, "plane_of_array_w_m2": None, "light_missing": str(error)}

    def _pose(self, now: float) -> Angles | None:
        """Return where the module points; None where the tracker is not the bench's."""
        host = self.positioner
        if host is None:
            return None
        return host.core.truth(now) if isinstance(host, PositionerHost) else host.truth(now)

    def _tracker_state(self, now: float) -> dict[str, Any]:
        host, pose = self.positioner, self._pose(now)
        if host is None or pose is None:
            return {}
        return {
            "pose": {"a_deg": pose.a_deg, "b_deg": pose.b_deg},
            "positioner": self._unit_state(host, now) if isinstance(host, PositionerHost) else host.state(now),
        }

    def _unit_state(self, host: PositionerHost, now: float) -> dict[str, Any]:
        values = dict(TokenStream().feed(host.core.live_screens(now) + bytes((wire.SEPARATOR,))))
        return {
            "plugged": host.port.plugged,
            "in_use": host.port.in_use,
            "position": [float(values[Field.A_POSITION]), float(values[Field.B_POSITION])],
            "destination": [float(values[Field.A_DESTINATION]), float(values[Field.B_DESTINATION])],
            "status": int(values[Field.STATUS]),
            "received": {str(code): number for code, number in sorted(host.received.items())},
            "stored": {str(code): text for code, text in sorted(host.core.parameters.items())},
            "lost_screens": host.lost_screens,
        }
