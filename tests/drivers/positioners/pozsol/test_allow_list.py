"""What may be sent to a positioner by any public way of its driver: 44, 46, 48, 50, 56 N, 57 s/5/6 and 136."""

import asyncio
import inspect
import re
import time
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceError
from drivers.lines import serial_port
from drivers.lines.serial_port import SerialPort
from drivers.positioners.pozsol import link as positioner_line
from drivers.positioners.pozsol import positioner
from drivers.positioners.pozsol import stream as telemetry
from drivers.positioners.pozsol import wire as pozsol_wire
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.link import SerialLine, open_port
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.positioners.pozsol.wire import Field, encode_command

ALLOWED = re.compile(rb"\$([,0]-?\d+\.\d{4}|[.2]\d+|8N|9[s56]|\x880)\r", re.ASCII)
A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -52.0, 52.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 13.0, 92.0)


class ShapeShifter(float):
    """A number within the limits that prints itself as a second command."""

    def __format__(self, _spec):
        return "1.0\r$7bootloader"

    __str__ = __repr__ = lambda self: format(self)


class Chameleon(str):
    """A text that claims to be equal to any other."""

    __slots__ = ()
    __hash__ = str.__hash__

    def __eq__(self, _other):
        return True


ODD = [
    float("nan"), float("inf"), -float("inf"), -0.0, 5e-324, 1e300, -1e300, 99_999.5, 10**400, True, False, None,
    "1", "1\r$7", "N\r$7", "s\r$F1", "S", "n", "Y", "y", "1", "2", "3", "4", "7", "", "\0", "$", "\r", "\n", "٣",
    b"1", b"N", b"$7", [1], (1.0,), {"a": 1}, 1j, Fraction(1, 3), np.float64(1.5), np.float32("nan"), np.int64(-3),
    ShapeShifter(1.0), Chameleon("1\r$7x"), object(),
]  # fmt: skip
VALUES = st.sampled_from(ODD) | st.floats() | st.integers() | st.text() | st.binary() | st.booleans()
CODES = st.integers(0, 255) | st.integers() | st.sampled_from([44.0, 56.0, "44", b",", True, None, float("nan")])


def public(scope, kind):
    """Return the public names of a class or a module that are its own."""
    home = scope.__name__
    return {
        name
        for name, thing in inspect.getmembers(scope, kind)
        if not name.startswith("_") and (inspect.isclass(scope) or thing.__module__ == home)
    }


def test_the_pozsol_driver_has_exactly_the_public_names_that_the_allow_list_tests_cover():
    assert public(PozsolPositioner, inspect.isroutine) == {
        "open", "close", "read_telemetry", "fields", "has_modem_lines", "disable_autonomy", "move_to", "stop", "halt",
        "home", "clear_faults", "repeated_s", "standing", "recall",
    }  # fmt: skip
    assert public(SerialPort, inspect.isroutine) == {"read", "write", "discard", "has_echo", "has_modem_lines", "close"}
    assert public(telemetry.TelemetryReader, inspect.isroutine) == {"read_promptly", "stop", "close"}
    assert public(positioner_line.SerialLine, inspect.isroutine) == {
        "open",
        "close",
        "send",
        "state",
        "has_modem_lines",
    }
    assert public(positioner_line, inspect.isroutine) == {"open_port"}
    assert public(positioner, inspect.isroutine) == set()
    assert public(positioner, inspect.isclass) == {"PozsolPositioner"}
    assert public(serial_port, inspect.isclass) == {"SerialPort"}
    assert public(pozsol_wire, inspect.isroutine) == {
        "encode_command", "require_allowed", "parse_number", "parse_status", "own_moves",
    }  # fmt: skip


@given(CODES, VALUES)
def test_encode_command_returns_one_allowed_command_or_raises_for_random_codes_and_values(code, value):
    try:
        packet = encode_command(code, value)
    except (ValueError, TypeError, OverflowError):
        return
    assert ALLOWED.fullmatch(packet)
    assert len(packet) <= pozsol_wire.MAXIMUM_PACKET
    assert packet[1] == code


def test_encode_command_returns_one_allowed_command_or_raises_for_every_code_with_odd_values():
    made = set()
    for code in range(256):
        for value in (*ODD, 1, 1.0, "s", "5", "6", "N", "0"):
            try:
                packet = encode_command(code, value)
            except (ValueError, TypeError, OverflowError):
                continue
            assert ALLOWED.fullmatch(packet), (code, value)
            made.add(packet[1])
    assert made == {44, 46, 48, 50, 56, 57, 136}


@given(st.binary(max_size=70))
def test_require_allowed_refuses_all_bytes_that_are_not_an_allowed_command(data):
    for packet in (data, b"$" + data, b"$" + data + b"\r", b"$,1.0000\r" + data):
        if not ALLOWED.fullmatch(packet):
            with pytest.raises(ValueError, match="is not a command"):
                pozsol_wire.require_allowed(packet)


def test_no_public_call_of_driver_or_port_sends_anything_but_allowed_commands(positioner_host):
    async def scene():
        arrived = []
        async with positioner_host() as host:
            take = host.port._on_bytes
            host.port._on_bytes = lambda data: (arrived.append(bytes(data)), take(data))
            line = SerialLine(lambda: open_port(str(host.port.link)), time.monotonic, write_s=10.0)
            driver = PozsolPositioner(line, time.monotonic, A, B, stale_s=10.0)
            await driver.open()
            for value in ODD:
                for call in (
                    lambda value=value: driver.move_to(value, 45.0),
                    lambda value=value: driver.move_to(0.0, value),
                    lambda value=value: driver.home(value),
                ):
                    sending = asyncio.create_task(call())
                    await asyncio.wait({sending}, timeout=0.15)
                    if not sending.done():
                        # The command is under way: a stop ends the wait for its effect.
                        await driver.stop()
                    await asyncio.gather(sending, return_exceptions=True)
            for call in (driver.disable_autonomy, driver.clear_faults, driver.stop, driver.halt, driver.close):
                await call()
            port = open_port(str(host.port.link))
            for code in range(256):
                for text in (b"1", b"y", b"1\r", b"N\r", b"s\r", b"1\r$7x\r", b"\r", b""):
                    packet = bytes((0x24, code)) + text
                    if not ALLOWED.fullmatch(packet):
                        with pytest.raises(ValueError, match="is not a command"):
                            port.write(packet)
            port.close()
            assert {Field.A_DESTINATION, Field.B_DESTINATION, Field.ACTION, Field.STATUS} == set(host.received)
        # A command that goes out at once, right after another, may be read together with it.
        assert re.fullmatch(b"(?:" + ALLOWED.pattern + b")+", b"".join(arrived)), arrived

    with pytest.raises(DeviceError, match="opened first"):
        asyncio.run(PozsolPositioner(SerialLine(lambda: None, time.monotonic), time.monotonic, A, B).stop())
    asyncio.run(scene())
