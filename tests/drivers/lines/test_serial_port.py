"""A serial port on a pseudo-terminal: how the kernel is set, and what goes through."""

import contextlib
import itertools
import os
import select
import subprocess
import sys
import termios
import threading
import time

import pytest
import serial

from drivers.errors import ConnectError, LinkLostError
from drivers.lines import serial_port
from drivers.lines.serial_port import SerialPort, port_open_error
from tests.support import PATIENCE_S

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")


@pytest.fixture
def ends():
    """Both ends: the instrument's descriptor, and the name of the port."""
    instrument, port = os.openpty()
    path = os.ttyname(port)
    yield instrument, path
    for descriptor in (instrument, port):
        with contextlib.suppress(OSError):
            os.close(descriptor)


@contextlib.contextmanager
def opened(path, allowed=lambda _data: None, **options):
    port = SerialPort("positioner", path, allowed, read_s=0.01, **options)
    try:
        yield port
    finally:
        port.close()


def send(instrument, path, data):
    """Write at the instrument's end, and return when the bytes wait at the other."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(instrument, data)
        assert select.select([descriptor], [], [], PATIENCE_S)[0]
    finally:
        os.close(descriptor)


def modes(path):
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        return termios.tcgetattr(descriptor)
    finally:
        os.close(descriptor)


def test_bytes_from_before_the_opening_are_neither_read_nor_echoed_and_later_ones_are_read(ends):
    instrument, path = ends
    send(instrument, path, b"old telemetry\n")
    assert os.read(instrument, 100) == b"old telemetry\r\n", "the kernel's echo, before anybody has opened the port"
    tapped = []
    with opened(path, tap=lambda way, data: tapped.append((way, data))) as port:
        assert port.read() == b""
        assert tapped == []
        send(instrument, path, b"\x24new")
        assert port.read() == b"\x24new"
        port.write(b"$9s\r")
        assert os.read(instrument, 100) == b"$9s\r", "and nothing that came back by itself"
        assert tapped == [("<", b"\x24new"), (">", b"$9s\r")]
        send(instrument, path, b"late")
        port.discard()
        assert port.read() == b""


def test_the_echo_is_off_before_the_port_is_set_up(ends, monkeypatch):
    _, path = ends
    before, really_open = [], serial.Serial.open

    def seen_open(port):
        before.append(modes(path)[3])
        really_open(port)

    monkeypatch.setattr(serial.Serial, "open", seen_open)
    with opened(path):
        pass
    assert [local & (termios.ECHO | termios.ICANON) for local in before] == [0]


def test_a_command_that_is_not_allowed_is_not_sent(ends):
    instrument, path = ends

    def allowed(data):
        if data != b"$9s\r":
            raise ValueError("not a command")

    with opened(path, allowed) as port:
        with pytest.raises(ValueError, match="not a command"):
            port.write(b"$9x\r")
        port.write(b"$9s\r")
    assert os.read(instrument, 100) == b"$9s\r"


def test_a_write_is_sent_even_if_the_process_gets_no_processor_time_for_seconds(ends, monkeypatch):
    instrument, path = ends
    looks = itertools.count(step=2.0)
    # Two seconds pass between any two readings of the clock, pyserial's clock too.
    for clock in ((time, "monotonic"), (serial.serialutil.Timeout, "TIME")):
        monkeypatch.setattr(*clock, lambda: next(looks))
    with opened(path) as port:
        port.write(b"M#(600)")
        assert os.read(instrument, 100) == b"M#(600)"


@pytest.mark.parametrize(("form", "flags"), [
    ("8N1", 0),
    ("8E1", 0),
    ("8O1", termios.PARODD),
    ("8N2", termios.CSTOPB),
])  # fmt: skip
def test_the_port_is_set_to_the_requested_speed_parity_and_stop_bits(ends, form, flags):
    _, path = ends
    with opened(path, baud_rate=19200, form=form):
        _, _, control, local, _, speed, _ = modes(path)
    assert speed == termios.B19200
    # A pseudo-terminal does not keep PARENB.
    assert control & (termios.PARODD | termios.CSTOPB) == flags
    assert control & termios.CSIZE == termios.CS8
    assert not local & (termios.ECHO | termios.ICANON)


@pytest.mark.parametrize("flag", [termios.ECHO, termios.ICANON])
def test_an_echo_that_another_program_switches_on_is_detected(ends, flag):
    _, path = ends
    with opened(path) as port:
        assert not port.has_echo()
        assert not port.has_modem_lines(), "a pseudo-terminal has none"
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
        settings = termios.tcgetattr(descriptor)
        settings[3] |= flag
        termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        os.close(descriptor)
        assert port.has_echo()


def test_a_port_that_is_gone_is_a_lost_link(ends):
    instrument, path = ends
    with opened(path) as port:
        os.close(instrument)
        for call in (port.read, lambda: port.write(b"x"), port.has_echo):
            with pytest.raises(LinkLostError):
                call()
        assert not port.has_modem_lines()


def test_a_write_that_waits_for_room_ends_when_the_port_is_closed(ends, monkeypatch):
    _, path = ends
    monkeypatch.setattr(serial_port, "_WRITE_S", 10.0 * PATIENCE_S)
    waits, errors = threading.Event(), []

    def select_and_tell(*what):
        waits.set()
        return wait_for(*what)

    wait_for = select.select
    monkeypatch.setattr(select, "select", select_and_tell)
    with opened(path) as port:

        def fill():
            try:
                while True:
                    port.write(bytes(256))
            except LinkLostError as error:
                errors.append(error)

        writer = threading.Thread(target=fill, daemon=True)
        writer.start()
        assert waits.wait(PATIENCE_S)
    writer.join(PATIENCE_S)
    assert len(errors) == 1


def test_a_port_held_by_another_program_is_refused_naming_that_program(ends):
    _, path = ends
    code = f"import fcntl, os; f = os.open({path!r}, os.O_RDWR | os.O_NOCTTY); fcntl.flock(f, fcntl.LOCK_EX)"
    holder = subprocess.Popen(
        [sys.executable, "-c", f"{code}; print('held', flush=True); input()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    try:
        holder.stdout.readline()
        with pytest.raises(ConnectError, match=rf"is held by another program \(\S+, process {holder.pid}\)"):
            SerialPort("positioner", path, lambda _data: None)
    finally:
        holder.communicate(b"\n")
    with opened(path):
        pass


def test_a_plain_file_or_a_missing_port_is_refused_with_the_reason(tmp_path):
    plain = tmp_path / "plain"
    plain.touch()
    with pytest.raises(ConnectError, match="is not a serial port"):
        SerialPort("positioner", str(plain), lambda _data: None)
    with pytest.raises(ConnectError, match="is it plugged in and powered"):
        SerialPort("positioner", str(tmp_path / "none"), lambda _data: None)


@pytest.mark.parametrize(("error", "words"), [
    (FileNotFoundError(2, "x"), "is it plugged in"),
    (OSError(19, "x"), "is it plugged in"),
    (OSError(6, "x"), "is it plugged in"),
    (ValueError("FileNotFoundError(2)"), "is it plugged in"),
    (PermissionError(13, "x"), "add this user to the group"),
    (ValueError("PermissionError(13)"), "add this user to the group"),
    (OSError(11, "x"), "held by another program"),
    (OSError(16, "x"), "held by another program"),
    (OSError(5, "broken"), "cannot be opened: .*broken"),
])  # fmt: skip
def test_each_error_on_opening_a_port_is_reported_with_its_cause_or_remedy(error, words):
    with pytest.raises(ConnectError, match=words):
        raise port_open_error("positioner", "/dev/ttyS99", error)
