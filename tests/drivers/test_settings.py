"""Names of ports, and which settings of drivers are allowed."""

import pytest
from pydantic import TypeAdapter, ValidationError

from drivers.cube.scanning.driver import ScanningMeterSettings
from drivers.settings import HostAndPort, MeterRange, stable_port, stable_visa


@pytest.mark.parametrize("name", ["/dev/serial/by-id/usb-Keith-if00", "/dev/heliocube-positioner", "COM3"])
def test_a_port_by_a_name_that_stays_is_taken(name):
    assert stable_port(name) == name
    assert stable_visa(f"ASRL{name}::INSTR") == f"ASRL{name}::INSTR"


@pytest.mark.parametrize("name", ["/dev/ttyUSB0", "/dev/ttyACM12", "/dev/ttyAMA1", "/dev/pts/4"])
def test_a_name_that_another_instrument_has_after_a_replug_is_not(name):
    with pytest.raises(ValueError, match="stays the same"):
        stable_port(name)
    with pytest.raises(ValueError, match="stays the same"):
        stable_visa(f"ASRL{name}::INSTR")


@pytest.mark.parametrize("name", ["", "ttyS0", "COM", "/dev/with blank"])
def test_what_is_no_port_is_not(name):
    with pytest.raises(ValueError, match="stays the same"):
        stable_port(name)


def test_gpib_needs_an_address():
    assert stable_visa("GPIB0::16::INSTR")
    for name in ("GPIB0::INSTR", "USB0::1::INSTR", "16"):
        with pytest.raises(ValueError, match="stays the same"):
            stable_visa(name)


@pytest.mark.parametrize(("text", "right"), [
    ("127.0.0.1:4533", True), ("[::1]:1", True), ("rig-2.lan:65535", True), ("rig:0", False), ("rig:65536", False),
    ("rig", False), ("a b:1", False), (":1", False), ("10.0.0..5:4533", False), (f"{'x' * 64}.lan:1", False),
    (f"{'x' * 63}.lan.:1", True),
])  # fmt: skip
def test_a_server_is_a_host_and_a_port(text, right):
    server = TypeAdapter(HostAndPort)
    if right:
        assert server.validate_python(text) == text
    else:
        with pytest.raises(ValidationError):
            server.validate_python(text)


@pytest.mark.parametrize(("host", "right"), [("10.0.0.5", True), ("10.0.0..5", False), ("x" * 64, False)])
def test_a_meters_socket_has_a_host_that_can_be_looked_up(host, right):
    resource = f"TCPIP::{host}::5025::SOCKET"
    if right:
        assert ScanningMeterSettings(resource=resource).resource == resource
    else:
        with pytest.raises(ValidationError):
            ScanningMeterSettings(resource=resource)


def test_a_meters_range_is_one_of_its_ranges():
    ranges = TypeAdapter(MeterRange)
    assert [ranges.validate_python(value) for value in (0.1, 1.0, 10.0)] == [0.1, 1.0, 10.0]
    for value in (0.2, 2.0, 20.0):
        with pytest.raises(ValidationError):
            ranges.validate_python(value)


@pytest.mark.parametrize(("channels", "conflicts"), [
    (None, []), ([101, 102, 103, 104], []), ([101, 102, 103, 101], ["channels"]),
])  # fmt: skip
def test_a_scanner_has_a_channel_for_each_face(channels, conflicts):
    settings = ScanningMeterSettings(channels=channels)
    assert [conflict.key for conflict in settings.conflicts()] == conflicts
