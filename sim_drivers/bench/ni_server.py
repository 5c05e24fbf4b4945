# ruff: noqa: N802, D102 - the methods of the service bear the names that its protocol gives them
"""A mock NI gRPC Device Server with one USB-6008: the digital port that the multiplexer hangs on.

It knows the calls that a digital output task makes and no others. Built on the stubs that ``nidaqmx[grpc]`` ships.
"""

import asyncio
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any, NoReturn

import grpc
from nidaqmx._stubs import nidaqmx_pb2 as messages
from nidaqmx._stubs import nidaqmx_pb2_grpc as stubs

from sim_drivers.multiplexer import ALL_HIGH, DaqWriteError, MultiplexerCore

DEVICE = "Dev1"
PRODUCT = "USB-6008"

DEVICE_GONE = -88705
INVALID_DEVICE = -200220
NO_SUCH_CHANNEL = -200170
LINES_RESERVED = -200587
INVALID_TASK = -200088
TASK_RUNNING = -200479
TASK_NOT_RUNNING = -200846
TEXTS = {
    DEVICE_GONE: "The specified device is not present or is not active in the system.",
    INVALID_DEVICE: "Device identifier is invalid.",
    NO_SUCH_CHANNEL: "Physical channel specified does not exist on this device.",
    LINES_RESERVED: "Specified resource is reserved by another task.",
    TASK_RUNNING: "Specified operation cannot be performed while the task is running.",
    INVALID_TASK: "Task specified is invalid or does not exist.",
    TASK_NOT_RUNNING: "Write cannot be performed when the task is not started, or several samples are written at once.",
}

_LOOPBACK = "127.0.0.1"
_VERSION = {0x1272: 26, 0x1923: 5, 0x2F22: 0}
_TASK_NAME, _TASK_CHANNELS = 0x1276, 0x1273
_PRODUCT_TYPE = 0x0631
_DIGITAL_OUTPUT = 10153
_ONE_CHANNEL_FOR_ALL_LINES = 1
_LINES = re.compile(r"/?(\w+)/port0/line(\d+)(?::(\d+))?")
_PORT_WIDTH = 8


@dataclass(slots=True)
class _Task:
    """A digital output task: its lines in order, and its channels by name."""

    name: str
    lines: tuple[int, ...] = ()
    channels: tuple[str, ...] = ()
    valid: bool = True
    runs: bool = False


class NiServer(stubs.NiDAQmxServicer):  # type: ignore[misc]  # the shipped stubs have no types
    """The server and its device.

    Parameters
    ----------
    core
        The simulated switch on lines 0 to 3 of port 0.
    now
        The event loop's time [s].

    Attributes
    ----------
    delay_s
        Added to every write.
    writes
        How many values have reached the port.
    """

    def __init__(self, core: MultiplexerCore, now: Callable[[], float]) -> None:
        self.core = core
        self.delay_s = 0.0
        self.writes = 0
        self.port = 0
        self.plugged = True
        self._now = now
        self._tasks: dict[str, _Task] = {}
        self._names = count()
        self._levels = ALL_HIGH
        self._running = asyncio.Event()
        self._running.set()
        self._server: grpc.aio.Server | None = None

    @property
    def serving(self) -> bool:
        """Whether the server runs."""
        return self._server is not None

    async def start(self, port: int = 0) -> int:
        """Serve on a port of loopback, 0 for any, and return it; all tasks of a former run are gone.

        Raises `OSError` for a port that another program has.
        """
        # Bind the port first as the library will: on a taken port that leaves descriptors open and gives no reason.
        socket.create_server((_LOOPBACK, port), reuse_port=True).close()
        server = grpc.aio.server()
        stubs.add_NiDAQmxServicer_to_server(self, server)
        self.port = server.add_insecure_port(f"{_LOOPBACK}:{port}")
        self._tasks.clear()
        await server.start()
        self._server = server
        return self.port

    async def stop(self) -> None:
        """End the server; calls under way are broken off."""
        if self._server is not None:
            server, self._server = self._server, None
            await server.stop(None)

    def unplug(self) -> None:
        """Pull the device's USB: its lines go high and its tasks die with it."""
        self.plugged = False
        self.reset()

    def plug(self) -> None:
        """Plug the device in again."""
        self.plugged = True

    def reset(self) -> None:
        """Reset the device: lines high, tasks dead."""
        for task in self._tasks.values():
            task.valid = False
        self._levels = ALL_HIGH
        self.core.power_cycle(self._now())

    def freeze(self) -> None:
        """Answer no call."""
        self._running.clear()

    def thaw(self) -> None:
        """Answer the calls that have waited, and go on."""
        self._running.set()

    async def GetSystemInfoAttributeUInt32(self, request: Any, _context: Any) -> Any:
        await self._running.wait()
        return messages.GetSystemInfoAttributeUInt32Response(value=_VERSION.get(_enum_value(request, "attribute"), 0))

    async def GetDeviceAttributeString(self, request: Any, context: Any) -> Any:
        await self._running.wait()
        if request.device_name != DEVICE or not self.plugged:
            await _fail(context, INVALID_DEVICE)
        text = PRODUCT if _enum_value(request, "attribute") == _PRODUCT_TYPE else ""
        return messages.GetDeviceAttributeStringResponse(value=text)

    async def CreateTask(self, request: Any, _context: Any) -> Any:
        await self._running.wait()
        name = request.session_name or f"_unnamedTask<{next(self._names)}>"
        # The server hands out the session that it already has under this name.
        is_new = name not in self._tasks
        if is_new:
            self._tasks[name] = _Task(name)
        response = messages.CreateTaskResponse(new_session_initialized=is_new)
        response.task.name = name
        return response

    async def ClearTask(self, request: Any, _context: Any) -> Any:
        await self._running.wait()
        self._tasks.pop(request.task.name, None)
        return messages.ClearTaskResponse()

    async def CreateDOChan(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        match = _LINES.fullmatch(request.lines.strip())
        if match is None:
            await _fail(context, NO_SUCH_CHANNEL)
        if task.lines or task.runs:
            await _fail(context, TASK_RUNNING)
        if match[1] != DEVICE or not self.plugged:
            await _fail(context, INVALID_DEVICE)
        first = int(match[2])
        lines = tuple(range(first, int(match[3] or first) + 1))
        if not lines or lines[-1] >= _PORT_WIDTH:
            await _fail(context, NO_SUCH_CHANNEL)
        if any(set(other.lines) & set(lines) for other in self._tasks.values() if other.valid and other is not task):
            await _fail(context, LINES_RESERVED)
        task.lines = lines
        if _enum_value(request, "line_grouping") == _ONE_CHANNEL_FOR_ALL_LINES:
            # A name with a colon would be read as several channels.
            task.channels = (f"{DEVICE}/port0/line{first}" + ("..." if len(lines) > 1 else ""),)
        else:
            task.channels = tuple(f"{DEVICE}/port0/line{line}" for line in lines)
        return messages.CreateDOChanResponse()

    async def StartTask(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        task.runs = True
        return messages.StartTaskResponse()

    async def StopTask(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        task.runs = False
        return messages.StopTaskResponse()

    async def GetTaskAttributeString(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        texts = {_TASK_NAME: task.name, _TASK_CHANNELS: ", ".join(task.channels)}
        return messages.GetTaskAttributeStringResponse(value=texts.get(_enum_value(request, "attribute"), ""))

    async def GetTaskAttributeUInt32(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        return messages.GetTaskAttributeUInt32Response(value=len(task.channels))

    async def GetChanAttributeInt32(self, request: Any, context: Any) -> Any:
        await self._task(request, context)
        return messages.GetChanAttributeInt32Response(value_raw=_DIGITAL_OUTPUT)

    async def GetWriteAttributeUInt32(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        return messages.GetWriteAttributeUInt32Response(value=len(task.lines) // max(len(task.channels), 1))

    async def WriteDigitalLines(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        if len(request.write_array) != len(task.lines):
            await _fail(context, TASK_NOT_RUNNING)
        levels = zip(task.lines, request.write_array, strict=True)
        await self._write(task, sum(bool(level) << line for line, level in levels), request, context)
        return messages.WriteDigitalLinesResponse(samps_per_chan_written=1)

    async def WriteDigitalU32(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        if len(task.channels) != 1 or len(request.write_array) != 1:
            await _fail(context, TASK_NOT_RUNNING)
        await self._write(task, request.write_array[0], request, context)
        return messages.WriteDigitalU32Response(samps_per_chan_written=1)

    async def WriteDigitalScalarU32(self, request: Any, context: Any) -> Any:
        task = await self._task(request, context)
        await self._write(task, request.value, request, context)
        return messages.WriteDigitalScalarU32Response()

    async def GetErrorString(self, request: Any, _context: Any) -> Any:
        await self._running.wait()
        return messages.GetErrorStringResponse(error_string=_text(request.error_code))

    async def _task(self, request: Any, context: Any) -> _Task:
        await self._running.wait()
        task = self._tasks.get(request.task.name)
        if task is None:
            await _fail(context, INVALID_TASK)
        if not task.valid:
            await _fail(context, DEVICE_GONE)
        return task

    async def _write(self, task: _Task, bits: int, request: Any, context: Any) -> None:
        if not (task.runs or request.auto_start):
            await _fail(context, TASK_NOT_RUNNING)
        if self.delay_s:
            await asyncio.sleep(self.delay_s)
            if not task.valid:
                await _fail(context, DEVICE_GONE)
        mask = sum(1 << line for line in task.lines)
        levels = self._levels & ~mask | bits & mask
        try:
            self.core.write(levels & ALL_HIGH, self._now())
        except DaqWriteError as error:
            await _fail(context, error.code)
        self._levels = levels
        self.writes += 1


def _enum_value(request: Any, name: str) -> int:
    """Return an enumeration's value: it stands in one of two fields."""
    return int(getattr(request, request.WhichOneof(f"{name}_enum")))


async def _fail(context: Any, code: int) -> NoReturn:
    context.set_trailing_metadata((("ni-error", str(code)),))
    await context.abort(grpc.StatusCode.UNKNOWN, _text(code))
    raise AssertionError


def _text(code: int) -> str:
    return f"{TEXTS.get(code, 'The device did not take the value.')}\n\nStatus Code: {code}"
