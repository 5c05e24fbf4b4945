"""Modbus from outside: frames of both kinds at both ends, and what sensors and converters reply in correct frames."""

import contextlib
import math
from collections.abc import Callable
from typing import get_args

from drivers.cube.labjack import LabjackCube, LabjackSettings
from drivers.cube.pyranometers.makes import make_of
from drivers.cube.pyranometers.sensor import BusSensor
from drivers.cube.pyranometers.settings import MakeName, RegisterMapSettings
from drivers.errors import DeviceError
from drivers.modbus import pdu
from drivers.modbus.client import ModbusBus
from drivers.modbus.framing import BrokenStreamError, RtuClient, RtuServer, TcpClient, TcpServer
from drivers.modbus.server import answer
from drivers.settings import CubeSurroundings
from tests.fuzz.waitless import drive

Take = Callable[[bytes], None]

_QUESTIONS = (
    pdu.read_registers(1, pdu.READ_HOLDING, 2, 3),
    pdu.read_registers(1, pdu.READ_INPUT_REGISTERS, 0, 7),
    pdu.write_registers(1, 40, (1, 2)),
    pdu.write_coil(1, 3, on=True),
)


def pieces(data: bytes) -> list[bytes]:
    """Return an input in pieces, as from a line: the first byte sets the size of the pieces."""
    step = data[0] % 61 + 1 if data else 1
    return [data[place : place + step] for place in range(1, len(data), step)]


def replies() -> Take:
    """What comes back to a question, over RTU and TCP; the first byte also chooses the question."""

    def take(data: bytes) -> None:
        choice = data[0] if data else 0
        client, asked = (RtuClient, TcpClient)[choice & 1](), _QUESTIONS[choice >> 1 & 3]
        client.begin(asked)
        for piece in pieces(data):
            try:
                reply = client.feed(piece)
            except BrokenStreamError:
                return
            if reply is not None:
                assert pdu.reply_matches(asked.pdu, reply)
                assert pdu.exception_text(reply) or len(reply) == pdu.reply_length(asked.pdu)

    return take


class _Table:
    """Sixty registers and as many coils, which hold what is written."""

    def __init__(self) -> None:
        self.words, self.bits = [0] * 60, [False] * 60

    def read(self, function: int, register: int, count: int) -> tuple[int, ...]:
        return tuple((self.words * 4)[register % 60 :][:count])

    def write(self, function: int, register: int, values: tuple[int, ...]) -> None:
        assert all(0 <= value <= 0xFFFF for value in values)
        for index, value in enumerate(values):
            self.words[(register + index) % 60] = value

    def read_bits(self, function: int, first: int, count: int) -> tuple[bool, ...]:
        return tuple((self.bits * 40)[first % 60 :][:count])

    def write_bits(self, function: int, first: int, values: tuple[bool, ...]) -> None:
        for index, value in enumerate(values):
            self.bits[(first + index) % 60] = value


def questions() -> Take:
    """A client's questions to our server, over RTU and TCP; each question that is understood gets one correct reply."""
    table = _Table()

    def take(data: bytes) -> None:
        server = (RtuServer, TcpServer)[data[0] & 1 if data else 0]()
        for piece in pieces(data):
            try:
                found = server.feed(piece, 0.0)
            except BrokenStreamError:
                return
            for asked in found:
                reply = answer(table, asked.request.pdu)
                assert reply is not None
                assert pdu.reply_matches(asked.request.pdu, reply), (asked, reply)
                assert len(server.reply(asked, reply)) <= 260

    return take


class _Path:
    """A line whose replies are correct frames around the words of an input, until there are no more."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    async def open(self, within_s: float) -> None:
        pass

    async def close(self) -> None:
        pass

    async def exchange(self, request: pdu.ModbusRequest, within_s: float) -> bytes:
        if request.pdu[0] > pdu.READ_INPUT_REGISTERS:
            return request.pdu[:5]
        length = pdu.reply_length(request.pdu) - 2
        words, self._data = self._data[:length], self._data[length:]
        if len(words) < length:
            return bytes((request.pdu[0] | pdu.EXCEPTION_FLAG, len(words) + 1))
        return bytes((request.pdu[0], length)) + words


def _bus(data: bytes) -> ModbusBus:
    return ModbusBus(_Path(data), "cube", 0.0, lambda: 0.0, writes=True)


def sensors() -> Take:
    """The replies of pyranometers of each make; the first byte chooses the make."""
    maps = [make_of(name, RegisterMapSettings()) for name in get_args(MakeName)]
    maps.append(make_of("map", RegisterMapSettings(number_type="float32", status_register=9)))

    async def talk(data: bytes) -> None:
        make = maps[data[0] % len(maps) if data else 0]
        sensor = BusSensor("east", 1, make, None, _bus(data[1:]), 1.0, lambda: 0.0, lambda: 0.0)
        for _ in range(3):
            sample = await sensor.read(check=True)
            assert math.isfinite(sample.value) == (sample.flaw is None)
            assert sensor.note.isprintable()
            assert sensor.identity.isprintable()

    return lambda data: drive(talk(data))


def labjack() -> Take:
    """The replies of a LabJack."""

    def no_meter():
        raise AssertionError("a LabJack switches nothing")

    async def talk(data: bytes) -> None:
        around = CubeSurroundings(lambda: 0.0, lambda: 0.0, 1.0, no_meter)
        cube = LabjackCube(_bus(data), LabjackSettings(line="tcp:127.0.0.1:502"), around)
        with contextlib.suppress(DeviceError):
            assert (await cube.open()).isprintable()
        with contextlib.suppress(DeviceError):
            reading = await cube.read()
            for face in (reading.east, reading.south, reading.west, reading.zenith):
                assert math.isfinite(face.value) == (face.flaw is None)

    return lambda data: drive(talk(data))
