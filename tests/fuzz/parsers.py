"""Every parser of bytes from outside, each behind one call that may raise nothing.

Whatever a parser is allowed to raise is caught here; anything else that it raises is a defect. Where more is known of a
result than that there is one, it is asserted.
"""

import contextlib
import itertools
import math
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from daemon.base.errors import UserError
from daemon.base.records import Quality
from daemon.bridge import senml, signing
from daemon.bridge.receiver import BridgeReceiver
from daemon.bridge.sequence import CUBE_TIMEOUT_S
from daemon.config.file import load_settings
from daemon.config.links import BridgeSettings, SafeInput, WindInput
from daemon.cube.calibration import read_calibration
from daemon.mqtt.connection import Incoming
from daemon.mqtt.credentials import load_user
from daemon.mqtt.safety_inputs import SafeInputStow, WindReadings
from daemon.service.operator import CommandError
from daemon.service.operator_commands import COMMAND_NAMES, parse
from daemon.studies import recorded
from drivers.cube.scanning.dialects import DIALECTS
from drivers.cube.scanning.meter import ScanningMeterCube
from drivers.errors import DeadlineError, DeviceError
from drivers.load import agilent6063b, chroma63600
from drivers.load.session import LoadSession
from drivers.meters.keithley2000 import Keithley2000
from drivers.positioners.pozsol.table import FieldTable
from drivers.positioners.pozsol.unit_setup import count_step, missing_fields
from drivers.positioners.pozsol.wire import DECIMALS, Field, TokenStream, own_moves, parse_number, parse_status
from drivers.positioners.rotctld.protocol import ReplyStream, error_text, parse_state
from drivers.settings import CubeSurroundings
from tests.fuzz import registers
from tests.fuzz.waitless import drive

KEY = bytes(range(1, 33))
UTC_S = 1665742815.0

Take = Callable[[bytes], None]


@dataclass(frozen=True, slots=True)
class Parser:
    """A parser, by the name of its folder in the corpus.

    Attributes
    ----------
    build
        Returns the call that takes one input.
    words
        Words and signs of its language, for mutations.
    """

    build: Callable[[], Take]
    words: tuple[bytes, ...] = ()


class _Clock:
    """A receiver's time, which goes on by 0.1 s with each input."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def utc(self) -> float:
        return UTC_S


def _receiver(key: bytes | None) -> tuple[BridgeReceiver, list, _Clock]:
    scans: list = []
    clock = _Clock()
    return BridgeReceiver(BridgeSettings(insecure=key is None), key, clock, scans.append), scans, clock


def _datagrams() -> Take:
    """Signed datagrams from the network."""
    receiver, scans, clock = _receiver(KEY)
    peers = itertools.cycle((("127.0.0.1", 40000), ("fe80::1%eth0", 40001, 0, 2)))

    def take(data: bytes) -> None:
        clock.now_s += 0.1
        receiver.datagram_received(data, next(peers))
        for scan in scans:
            assert signing.verify(data, KEY) is not None
            assert abs(scan.time_utc_s - UTC_S) <= 30.0
        scans.clear()

    return take


def _packs() -> Take:
    """The pack itself, as a receiver without a key takes it: all rules of the format, without the signature."""
    receiver, scans, clock = _receiver(None)

    def take(data: bytes) -> None:
        # The cube that the last input named has been gone for long enough.
        clock.now_s += CUBE_TIMEOUT_S + 0.1
        receiver.datagram_received(data, ("127.0.0.1", 40000))
        for scan in scans:
            for face in scan.faces:
                assert abs(face.irradiance_w_m2) <= senml.LARGEST_W_M2 or face.quality is not Quality.OK
                assert math.isfinite(face.time_monotonic_s)
            again = senml.decode(senml.encode(senml.decode(data)))
            assert (again.source, again.session, again.sequence) == (scan.source, scan.session, scan.sequence)
        scans.clear()

    return take


def _screens() -> Take:
    """The positioner's stream, in pieces as a port gives them."""

    def take(data: bytes) -> None:
        stream, table = TokenStream(), FieldTable()
        step = data[0] % 61 + 3 if data else 1
        for place in range(0, len(data), step):
            table.take(stream.feed_tokens(data[place : place + step]), 0.01 * place)
        fields = {}
        for code, value in table.snapshot().items():
            fields[code] = value.text.decode("latin-1").strip()
            if code in DECIMALS:
                assert parse_number(code, value.text) == value.number
                assert math.isfinite(value.number)
        if status := fields.get(Field.STATUS):
            word = parse_status(status)
            assert 0 <= word.word < 1 << 32
        own_moves(fields)
        missing_fields(fields)
        step_units = count_step(fields, "a")
        assert step_units is None or 0.0 < step_units <= 1.0

    return take


class _Replies:
    """A line on which an instrument answers with the lines of the input, and then is silent."""

    def __init__(self, data: bytes) -> None:
        self._lines = iter(data.decode("latin-1").split("\n"))

    async def open(self) -> None:
        pass

    async def close(self) -> None:
        pass

    async def send(self, text: str) -> None:
        pass

    async def ask(self, text: str, within_s: float) -> str:
        return await self.receive(within_s)

    async def receive(self, within_s: float) -> str:
        line = next(self._lines, None)
        if line is None:
            raise DeadlineError("instrument", f"was silent for {within_s:g} s")
        return line.strip("\r\n")

    async def interrupt(self) -> None:
        pass

    async def drain(self, quiet_s: float) -> None:
        pass

    async def discard_unsolicited(self) -> bool:
        return False


def _rotctld() -> Take:
    """Replies of Hamlib's server, in pieces."""

    def take(data: bytes) -> None:
        stream, step = ReplyStream(), data[0] % 61 + 3 if data else 1
        for place in range(0, len(data), step):
            try:
                replies = stream.feed(data[place : place + step])
            except ValueError:
                return
            for reply in replies:
                with contextlib.suppress(ValueError):
                    assert math.isfinite(reply.number("Azimuth"))
                with contextlib.suppress(ValueError):
                    assert all(map(math.isfinite, parse_state(reply).azimuth_deg))
                assert error_text(reply.error)

    return take


def _meter() -> Take:
    async def talk(data: bytes) -> None:
        meter = Keithley2000(_Replies(data))
        with contextlib.suppress(DeviceError):
            await meter.open()
        for _ in range(3):
            with contextlib.suppress(DeviceError):
                assert abs(await meter.read_voltage()) <= 1.21

    return lambda data: drive(talk(data))


def _scanning_meters() -> Take:
    """Replies of meters with a scanner card; the first byte chooses the make."""
    makes = tuple(DIALECTS.values())

    async def talk(data: bytes) -> None:
        make = makes[data[0] % len(makes) if data else 0]
        around = CubeSurroundings(lambda: 0.0, lambda: 0.0, 1.0, lambda: None)
        cube = ScanningMeterCube(_Replies(data[1:]), make, make.channels, range_v=0.1, nplc=1.0, surroundings=around)
        with contextlib.suppress(DeviceError):
            await cube.open()
        with contextlib.suppress(DeviceError):
            reading = await cube.read()
            for face in (reading.east, reading.south, reading.west, reading.zenith):
                assert face.flaw or abs(face.value) <= 0.121

    return lambda data: drive(talk(data))


def _loads() -> Take:
    dialects = (agilent6063b.DIALECT, chroma63600.dialect(1))

    async def talk(data: bytes) -> None:
        session = LoadSession(_Replies(data[1:]), dialects[data[0] % 2 if data else 0], 1.0)
        with contextlib.suppress(DeviceError):
            await session.start()
        with contextlib.suppress(DeviceError):
            await session.prepare()
        for _ in range(3):
            with contextlib.suppress(DeviceError):
                point = (await session.measure()).point
                assert point is None or all(map(math.isfinite, point))
        await session.close()

    return lambda data: drive(talk(data))


def _file(read: Callable[[Path], object], name: str, mode: int = 0o600) -> Take:
    """A reader of files, which may fail only with one sentence for a person."""
    folder = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else Path(tempfile.gettempdir())
    path = folder / f"fuzz-{os.getpid()}-{name}"

    def take(data: bytes) -> None:
        path.write_bytes(data)
        path.chmod(mode)
        try:
            with contextlib.suppress(UserError):
                read(path)
        finally:
            path.unlink()

    return take


def _bodies() -> Take:
    """A command's body over HTTP or MQTT; the first byte chooses the command."""

    def take(data: bytes) -> None:
        name, way = (
            COMMAND_NAMES[data[0] % len(COMMAND_NAMES) if data else 0],
            ("HTTP", "MQTT")[bool(data) and data[0] > 127],
        )
        with contextlib.suppress(CommandError):
            command = parse(name, data[1:], way)
            assert command.why.isprintable()
            assert command.by.isprintable()
            assert name != "mode" or command.action in ("auto", "hold", "stow", "snow", "maintenance")

    return take


def _inputs() -> Take:
    """Wind, and the word for safe, from the broker; the first byte chooses the settings."""
    strong = []
    paths = ("", "a", "a.b", "a.0.b")
    winds, words = [], []
    for path in paths:
        wind = WindInput(topic="w", json_path=path, unit="km/h")
        winds.append(WindReadings(wind, 15.0, lambda: 1.0, lambda: strong.append(1), lambda *_: None))
        safe = SafeInput(topic="s", json_path=path, safe="safe", unsafe="1")
        words.append(SafeInputStow(safe, lambda: 1.0, lambda: strong.append(1), lambda *_: None))

    def take(data: bytes) -> None:
        choice = data[0] if data else 0
        message = Incoming("w", data[1:], retained=bool(choice & 4))
        wind, word = winds[choice & 3], words[choice & 3]
        wind.take(message)
        speed_m_s = wind.strongest_since_last_read()
        assert speed_m_s is None or 0.0 <= speed_m_s <= 150.0
        assert bool(strong) == (speed_m_s is not None and speed_m_s >= 15.0)
        strong.clear()
        word.take(message)
        word.reason(1.0)
        strong.clear()

    return take


_JSON = (b'"v":', b"1e999", b"NaN", b"null", b"true", b"-0", b"[[[[", b'{"', b"\\u0000", b'"a":', b'"b":', b"9" * 400)
_SCPI = (b"KEITHLEY INSTRUMENTS INC.,MODEL 2000,1,A06", b"HEWLETT-PACKARD,6063B,0,A", b"+9.9E37", b"0,No error", b"\n")
_MODBUS = (b"\0\x01\0\0\0\x06\x01\x03", b"\x01\x03\x06", b"\x01\x83\x02", b"\x01\x10\0\x28\0\x02\x04", b"\xff\xff")

PARSERS = {
    "bridge-datagrams": Parser(_datagrams, (b".", b"eyJ", b"[", b"=", *_JSON)),
    "bridge-packs": Parser(_packs, (b'"bn":"cube/"', b'"bt":1665742815', b'"n":"east"', b"/quality", *_JSON)),
    "positioner-screens": Parser(_screens, (b"$", b"$\x88", b"$,", b"$0", b"-.", b"\r", b"1000", b"4294967295")),
    "rotctld-replies": Parser(_rotctld, (b"get_pos:\n", b"RPRT 0\n", b"Azimuth: ", b"dump_state:\n", b" " * 100, b"=")),
    "voltmeter-replies": Parser(_meter, (*_SCPI, b"VDC", b"E+", b"1" * 400)),
    "scanner-replies": Parser(
        _scanning_meters,
        (*_SCPI, b"HEWLETT-PACKARD,34970A,0,13", b"MODEL DMM6500", b"(@1:4)", b"#15", b"101,", b"VOLT:DC", b"2000,"),
    ),
    "modbus-replies": Parser(registers.replies, _MODBUS),
    "modbus-questions": Parser(registers.questions, _MODBUS),
    "pyranometers": Parser(registers.sensors, (b"\x7f\xc0\0\0", b"\x80\0\0\0", b"\xff" * 4, b"\x02\x5a", b"\0\x01")),
    "labjack": Parser(registers.labjack, (b"\x7f\xc0\0\0", b"\x40\xe0\0\0", b"\0\x11\x22\x33", b"\x7f\x80\0\0")),
    "load-replies": Parser(_loads, (*_SCPI, b"Chroma,63640-80-80", b"CV", b"VOLT", b"1E999", b";")),
    "csv-scans": Parser(lambda: _file(recorded.read_csv, "scans.csv"), (b"time,east,south,west,zenith\n", b",", b'"')),
    "toml-settings": Parser(
        lambda: _file(load_settings, "settings.toml"),
        (b"[bridge]\n", b"[[tracker]]\n", b"= ", b"[" * 50, b"~root", b"'", b"9" * 500, b"\\u0000"),
    ),
    "toml-calibration": Parser(lambda: _file(read_calibration, "calibration.toml"), (b"[east]\n", b"= ", b"[" * 50)),
    "command-bodies": Parser(_bodies, (b'"why":', b'"id":', b'"tracker":', b'"a_deg":', b'"time":', b"auto", *_JSON)),
    "mqtt-inputs": Parser(_inputs, (b"safe", *_JSON)),
    "mqtt-credentials": Parser(lambda: _file(load_user, "credentials"), (b":", b"\n")),
}
"""All parsers, by name."""


def corpus(name: str) -> Iterator[bytes]:
    """Yield the kept inputs of a parser."""
    for path in sorted((Path(__file__).with_name("corpus") / name).iterdir()):
        yield path.read_bytes()
