"""Taking commands for a running bench and carrying them out."""

import asyncio
import contextlib
import json
import logging
import re
import socket
from collections.abc import Awaitable
from pathlib import Path
from typing import Any, Self, TypeVar

from drivers.positioners.pozsol.wire import Field
from sim_drivers.bench.bench import Bench
from sim_drivers.bench.client import SOCKET_NAME, BenchError
from sim_drivers.bench.modbus_host import ModbusHost
from sim_drivers.bench.positioner_host import PositionerHost
from sim_drivers.bench.rotator_host import RotatorHost
from sim_drivers.bench.scanner_host import ScannerHost
from sim_drivers.bench.verbs import DEVICES, PYRANOMETER_ACTIONS, VERBS
from sim_drivers.load.instrument import TRIPS
from sim_drivers.pozsol.core import FAULTS
from sim_drivers.rotctld.core import ROTATOR_FAULTS

log = logging.getLogger("heliocube.bench")

Name = TypeVar("Name", bound=str)

FACES = ("east", "south", "west", "zenith")
_REENUMERATION_S = 1.0
_LONGEST_REQUEST = 65536
_WHOLE = re.compile(r"-?[0-9]{1,9}")
_LARGEST_NUMBER = 1_000_000
# The ranges of an address and of a register.
_SENSOR_VALUE_RANGES = {"address": (1, 247), "status": (0, 65535), "mode": (0, 65535)}


class BenchControl:
    """Takes commands for a bench.

    Parameters
    ----------
    bench
        The running bench; the socket is in its directory.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._server: asyncio.Server | None = None
        self._replug_tasks: dict[str, asyncio.Task[None]] = {}
        self._path = bench.directory / SOCKET_NAME

    async def __aenter__(self) -> Self:
        """Take commands.

        Raises
        ------
        BenchError
            Another bench has this directory, or no socket can be made there.
        """
        if _is_alive(self._path):
            raise BenchError(f"{self._path.parent}: a bench is running there already; stop it or take another folder")
        self._path.unlink(missing_ok=True)
        try:
            self._server = await asyncio.start_unix_server(self._serve, self._path, limit=_LONGEST_REQUEST)
        except OSError as error:
            raise BenchError(
                f"{self._path}: no socket can be made there ({error}); take a folder with a short path"
            ) from error
        return self

    async def __aexit__(self, *_: object) -> None:
        """Take no more."""
        for device in list(self._replug_tasks):
            self._forget(device)
        if self._server is not None:
            self._server.close()
        self._path.unlink(missing_ok=True)

    async def execute(self, verb: str, arguments: list[str]) -> Any:
        """Carry out one command and return what it tells; `BenchError` for a mistake in it."""
        if verb not in VERBS:
            raise BenchError(f"the bench has no command '{verb}'; it has {', '.join(VERBS)}")
        parameters = VERBS[verb].usage.split()
        least = sum(not parameter.startswith("[") for parameter in parameters)
        if not least <= len(arguments) <= len(parameters):
            raise BenchError(f"usage: {' '.join((verb, *parameters))}")
        try:
            result = getattr(self, verb.replace("-", "_"))(*arguments)
            return await result if isinstance(result, Awaitable) else result
        except ValueError as error:
            raise BenchError(f"{verb}: {error}") from error
        except OSError as error:
            raise BenchError(f"{verb}: {error.strerror or error}") from error

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                writer.write(json.dumps(await self._answer(line)).encode() + b"\n")
                await writer.drain()
        except (OSError, ValueError):
            # The user has gone, or sends something endless.
            return
        finally:
            writer.close()

    async def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            verb, arguments = str(request["verb"]), [str(argument) for argument in request.get("arguments", [])]
        except (ValueError, KeyError, TypeError, AttributeError):
            return {"ok": False, "error": 'a request is one line such as {"verb": "state", "arguments": []}'}
        try:
            return {"ok": True, "result": await self.execute(verb, arguments)}
        except BenchError as error:
            return {"ok": False, "error": str(error)}

    def state(self) -> dict[str, Any]:
        """Return the true state of everything."""
        return self._bench.state()

    async def unplug(self, device: str, seconds: str = "") -> None:
        """Pull a plug, for some seconds or until `replug`; this replaces an earlier order for the same plug."""
        name = _one_of(device, DEVICES)
        length_s = _number(seconds, 0, 86400) if seconds else None
        self._forget(name)
        bench = self._bench
        if name == "server":
            await bench.multiplexer.stop()
        elif name == "multiplexer":
            bench.multiplexer.unplug()
        elif name == "cube":
            await self._cube().unplug()
        elif name == "positioner" and isinstance(bench.positioner, RotatorHost):
            bench.positioner.unplug()
        else:
            self._host(name).port.unplug()
        if length_s is not None:
            self._replug_tasks[name] = asyncio.create_task(self._replug_after(name, length_s))

    async def replug(self, device: str) -> None:
        """Plug in again."""
        name, bench = _one_of(device, DEVICES), self._bench
        self._forget(name)
        if name == "server":
            if not bench.multiplexer.serving:
                await bench.multiplexer.start(bench.multiplexer.port)
        elif name == "multiplexer":
            bench.multiplexer.plug()
        elif name == "cube":
            await self._cube().replug()
        elif name == "positioner" and isinstance(bench.positioner, RotatorHost):
            await bench.positioner.plug()
        else:
            self._host(name).port.plug()

    def freeze(self, device: str) -> None:
        """Let a device hang."""
        self._host(device).freeze()

    def thaw(self, device: str) -> None:
        """Let it go on."""
        self._host(device).thaw()

    def delay(self, device: str, seconds: str) -> None:
        """Let every reply come later."""
        delay_s = _number(seconds, 0, 3600)
        self._host(_one_of(device, ("voltmeter", "load", "multiplexer"))).delay_s = delay_s

    def drop(self, device: str, number: str = "1") -> None:
        """Lose the next replies or screens."""
        self._talker(device).drop_next(_count(number))

    def corrupt(self, device: str, number: str = "1") -> None:
        """Garble the next replies or screens."""
        self._talker(device).corrupt_next(_count(number))

    def fail(self, code: str, number: str = "1") -> None:
        """Let the next writes to the multiplexer fail."""
        self._bench.multiplexer.core.fail_next(_whole(code, -_LARGEST_NUMBER, _LARGEST_NUMBER), _count(number))

    def overcurrent(self, axis: str) -> None:
        """Latch an overcurrent."""
        self.inject(f"{_one_of(axis, ('a', 'b'))}_overcurrent")

    def hall_loss(self, axis: str, on: str = "on") -> None:
        """Take the Hall pulses away."""
        self._condition(f"{_one_of(axis, ('a', 'b'))}_hall_loss", _one_of(on, ("on", "off")) == "on")

    def end_switch(self, axis: str, how: str) -> None:
        """Let the low end switch stick."""
        name, how = _one_of(axis, ("a", "b")), _one_of(how, ("closed", "open", "works"))
        self._condition(f"{name}_switch_{'open' if how == 'works' else how}", how != "works")

    def inject(self, fault: str) -> None:
        """Cause any of the positioner's faults."""
        self._condition(fault, present=True)

    def repair(self, fault: str) -> None:
        """End a condition of the positioner."""
        self._condition(fault, present=False)

    def mux_line(self, bit: str, level: str) -> None:
        """Let an address line of the multiplexer stick."""
        number = int(_one_of(bit, ("0", "1", "2")))
        how, core, now = _one_of(level, ("high", "low", "works")), self._bench.multiplexer.core, self._bench.clock.now()
        if how == "works":
            core.unstick(now)
        else:
            core.stick(number, how == "high", now)

    def shade(self, face: str, share: str) -> None:
        """Let only a share of the light reach a face."""
        self._bench.scene.shade(FACES.index(_one_of(face, FACES)), _number(share, 0, 1))

    def sensor(self, face: str, volt: str) -> None:
        """Let a sensor give one voltage, whatever falls on it."""
        index = FACES.index(_one_of(face, FACES))
        if volt == "works":
            self._bench.scene.repair_sensor(index)
        else:
            self._bench.scene.break_sensor(index, _number(volt, -1000, 1000))

    def pyranometer(self, face: str, what: str, value: str = "") -> None:
        """Let a sensor on Modbus do what a bad one does."""
        sensor: Any = self._sensors().sensors[FACES.index(_one_of(face, FACES))]
        name = _one_of(what, tuple(can.partition(" ")[0] for can in PYRANOMETER_ACTIONS))
        if name in ("silent", "speaks"):
            if value:
                raise ValueError(f"{name} takes no value")
            sensor.silent = name == "silent"
        elif name == "delay":
            sensor.delay_s = _number(value, 0, 3600)
        elif not hasattr(sensor, name):
            raise ValueError(f"a {sensor.state()['make']} has no {name}")
        else:
            setattr(sensor, name, _whole(value, *_SENSOR_VALUE_RANGES.get(name, (0, _LARGEST_NUMBER))))

    async def power_cycle(self, device: str, position: str = "kept") -> None:
        """Switch a device off and on; the positioner's port is gone for a second."""
        bench = self._bench
        name = _one_of(device, ("positioner", "voltmeter", "load", "multiplexer", "cube"))
        if name in ("voltmeter", "load", "cube"):
            self._host(name).power_cycle()
        elif name == "multiplexer":
            bench.multiplexer.reset()
        else:
            keep = _one_of(position, ("kept", "lost")) == "kept"
            self._unit().core.power_cycle(bench.clock.now(), keep_position=keep)
            if self._unit().port.plugged:
                await self.unplug("positioner", str(_REENUMERATION_S))

    def restart(self, seconds: str) -> None:
        """Restart the positioner while its USB stays."""
        self._unit().restart(_number(seconds, 0, 60))

    def boots_at_open(self, seconds: str) -> None:
        """Let the positioner restart whenever its port is opened."""
        self._unit().boots_at_open_s = None if seconds == "never" else _number(seconds, 0, 60)

    def identity(self, device: str, text: str) -> None:
        """Let a device say that it is something else."""
        if not (text.isascii() and text.isprintable()):
            raise ValueError(f"no device can say {text!a}; take printable characters of ASCII")
        if _one_of(device, ("positioner", "voltmeter", "load")) == "positioner":
            self._unit().core.parameters[Field.BOARD] = text
        else:
            self._host(device).core.identity = text

    def trip(self, protection: str) -> None:
        """Latch a protection of the load."""
        self._bench.load.core.trip(_one_of(protection, TRIPS))

    def rotator(self, what: str, on: str) -> None:
        """Let a rotator be unplugged from its rotctld, deaf, or without a stop."""
        fault, faults = _one_of(what, ROTATOR_FAULTS), self._rotator().core.faults
        (faults.add if _one_of(on, ("on", "off")) == "on" else faults.discard)(fault)

    def turn(self, azimuth: str, elevation: str) -> None:
        """Turn the rotator without an order of the service's."""
        core, now = self._rotator().core, self._bench.clock.now()
        core.turn(_number(azimuth, -360, 720), _number(elevation, 0, 90), now)

    def _unit(self) -> PositionerHost:
        host = self._bench.positioner
        if not isinstance(host, PositionerHost):
            raise BenchError("this bench has no POZSOL unit; start it without --positioner")
        return host

    def _rotator(self) -> RotatorHost:
        host = self._bench.positioner
        if not isinstance(host, RotatorHost):
            raise BenchError("this bench has no rotator; start it with --positioner rotctld")
        return host

    def _host(self, device: str) -> Any:
        if device == "cube":
            return self._cube()
        if device == "positioner" and self._bench.positioner is None:
            raise BenchError("this bench has no positioner of its own: --rotctld names the one in use")
        return getattr(self._bench, _one_of(device, ("positioner", "voltmeter", "load", "multiplexer")))

    def _cube(self) -> ModbusHost | ScannerHost:
        if self._bench.cube is None:
            raise BenchError("the cube of this bench is multiplexer and voltmeter; start it with --cube for another")
        return self._bench.cube

    def _sensors(self) -> ModbusHost:
        host = self._bench.cube
        if not isinstance(host, ModbusHost):
            raise BenchError("this bench has no cube on Modbus; start it with --cube modbus-pyranometers")
        return host

    def _talker(self, device: str) -> Any:
        """Return the object that loses and garbles a device's words: its host, or the core if it answers questions."""
        host = (
            self._unit() if device == "positioner" else self._host(_one_of(device, ("positioner", "voltmeter", "load")))
        )
        return host if device == "positioner" else host.core

    def _condition(self, fault: str, present: bool) -> None:
        core, now = self._unit().core, self._bench.clock.now()
        name = _one_of(fault, FAULTS)
        if present:
            core.inject(name, now)
        else:
            core.repair(name, now)

    async def _replug_after(self, device: str, seconds: float) -> None:
        await asyncio.sleep(seconds)
        self._replug_tasks.pop(device, None)
        try:
            await self.replug(device)
        except (OSError, BenchError) as error:
            log.warning("%s is not plugged in again: %s", device, getattr(error, "strerror", None) or error)

    def _forget(self, device: str) -> None:
        """Forget that a plug was to be put back by itself."""
        task = self._replug_tasks.pop(device, None)
        if task is not None:
            task.cancel()


def _is_alive(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as probe, contextlib.suppress(OSError):
        probe.connect(str(path))
        return True
    return False


def _one_of(text: str, choices: tuple[Name, ...]) -> Name:
    for choice in choices:
        if text == choice:
            return choice
    raise ValueError(f"'{text}' is not one of {', '.join(choices)}")


def _number(text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"'{text}' is not a number") from None
    if not low <= value <= high:
        raise ValueError(f"{text} is not in {low:g} to {high:g}")
    return value


def _count(text: str) -> int:
    return _whole(text, 0, _LARGEST_NUMBER)


def _whole(text: str, low: int, high: int) -> int:
    # Python refuses to make a number of thousands of digits.
    if not (_WHOLE.fullmatch(text) and low <= int(text) <= high):
        raise ValueError(f"'{text}' is not a whole number from {low} to {high}")
    return int(text)
