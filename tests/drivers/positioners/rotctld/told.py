"""A line to a rotctld that gives the answers of a test, and the driver of rotators on it, in virtual time."""

import asyncio

from daemon.base.timeloop import VirtualTimeLoop
from drivers.positioners.rotctld.driver import RotctldSettings, build
from drivers.positioners.rotctld.protocol import ReplyStream
from drivers.settings import PositionerSurroundings
from drivers.transcript import no_tap
from sim_drivers.rotctld.core import RotatorCore
from sim_drivers.transports import InMemoryRotctld
from solar.frames import Limits

INFO = b"get_info:\nInfo: SPID\nRPRT 0\n"
STATE = (
    b"dump_state:\nrotctld Protocol Ver: 1\nRotor Model: 603\nMinimum Azimuth: 0.000000\nMaximum Azimuth: 360.000000\n"
    b"Minimum Elevation: 0.000000\nMaximum Elevation: 90.000000\nSouth Zero: 0\nrot_type=AzEl\ndone\nRPRT 0\n"
)


def at(azimuth, elevation):
    return f"get_pos:\nAzimuth: {azimuth}\nElevation: {elevation}\nRPRT 0\n".encode()


def ends_with(name, error):
    return f"{name}:\nRPRT {error}\n".encode()


class Told:
    """A line to a rotctld that answers each command by name with the reply of a test."""

    simulated = False

    def __init__(self, **says):
        fine = {name: ends_with(name, 0) for name in ("set_pos", "stop")}
        self.says = {"get_info": INFO, "dump_state": STATE, "get_pos": at(180, 45)} | fine | says
        self.sent = []
        self.is_open = False

    async def open(self):
        assert not self.is_open
        self.is_open = True

    async def close(self):
        self.is_open = False

    async def ask(self, command, within_s):
        self.sent.append(command.decode().strip("+\\\n"))
        (reply,) = ReplyStream().feed(self.says[self.sent[-1].partition(" ")[0]])
        return reply


def driver_on(line, now, stow=(0.0, 90.0), **settings):
    around = PositionerSurroundings(limits=Limits(), monotonic=now, tap=no_tap, stow=stow, equator_azimuth_deg=180.0)
    return build(RotctldSettings(driver="rotctld", **settings), around, line)


def run(scenario):
    """Run `scenario`, which is given the function that returns the time, in virtual time."""

    async def scene():
        return await scenario(asyncio.get_running_loop().time)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(scene())


def told(act, stow=(0.0, 90.0), settings=None, **says):
    """Run `act` with an open driver, and return its result and the line."""
    line = Told(**says)

    async def scenario(now):
        driver = driver_on(line, now, stow, **(settings or {}))
        await driver.open()
        line.sent.clear()
        return await act(driver, line)

    return run(scenario), line


def opened(**says):
    line = Told(**says)

    async def scenario(now):
        return await driver_on(line, now).open()

    return run(scenario), line


def on_rotator(scenario, **settings):
    """Run a scenario with an open driver, its rotator at south, 45 deg, and a function that returns the time."""

    async def scene(now):
        rotator = RotatorCore(now(), start=(180.0, 45.0))
        driver = driver_on(InMemoryRotctld(rotator, now), now, **settings)
        await driver.open()
        await scenario(driver, rotator, now)

    run(scene)
