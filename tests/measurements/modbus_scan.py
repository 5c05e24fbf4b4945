"""How long a scan of four pyranometers on one line of 19200 baud takes, and what a dead one costs.

    python -m tests.measurements.modbus_scan [SCANS]

The simulated sensors are on a pseudo-terminal that gives every byte its time (11 bits at 19200 baud), and answer 5 ms
after a question; the driver is the service's, in real time. Real sensors may think longer.
"""

import asyncio
import platform
import statistics
import sys
import tempfile
from pathlib import Path

from daemon.base.clock import SystemClock
from drivers.cube.pyranometers.driver import build
from drivers.cube.pyranometers.settings import PyranometersSettings
from drivers.settings import CubeSurroundings
from sim_drivers.bench.modbus_host import ModbusHost
from sim_drivers.modbus.pyranometers import simulated_pyranometer


async def measure(make, folder, scans):
    """Return durations of scans [s]: with all four, of the scan in which one falls silent, and of those after it."""
    clock = SystemClock()
    keys = {"make": make, "line": str(folder / "cube"), "serial_form": "8N1"}
    if make in ("smp", "hukseflux"):
        keys |= {name: {"serial": 101 + face} for face, name in enumerate(("east", "south", "west", "zenith"))}
    settings = PyranometersSettings.model_validate(keys)
    sensors = [simulated_pyranometer(make, 1 + face, 101 + face, lambda _now: 500.0, settings.map) for face in range(4)]
    host = ModbusHost(sensors, folder / "cube", asyncio.get_running_loop().time)
    await host.start()
    line = asyncio.create_task(host.line.run())
    cube = build(settings, CubeSurroundings(clock.utc, clock.monotonic, 2.0, lambda: None))

    async def scan():
        await asyncio.sleep(0.1)
        begun_s = clock.monotonic()
        await cube.read()
        return clock.monotonic() - begun_s

    try:
        await cube.open()
        well = [await scan() for _ in range(scans)]
        first = []
        for _ in range(max(scans // 10, 3)):
            sensors[1].silent = True
            first.append(await scan())
            sensors[1].silent = False
            await scan()
            await scan()
        sensors[1].silent = True
        for _ in range(3):
            await scan()
        after = [await scan() for _ in range(20)]
    finally:
        await cube.close()
        line.cancel()
        await host.stop()
    return well, first, after


def report(name, durations):
    """Print median, spread and worst [s]."""
    print(
        f"  {name:<32} median {statistics.median(durations):.3f} s, standard deviation"
        f" {statistics.pstdev(durations):.3f} s, worst {max(durations):.3f} s ({len(durations)} scans)"
    )


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    print(f"{platform.machine()}, Python {platform.python_version()}, gap 50 ms, time-out 0.3 s")
    for each in ("smp", "hukseflux", "apogee"):
        with tempfile.TemporaryDirectory() as directory:
            found = asyncio.run(measure(each, Path(directory), count))
        print(f"{each}:")
        for title, values in zip(
            ("all four answer", "one falls silent", "one has long been silent"), found, strict=True
        ):
            report(title, values)
