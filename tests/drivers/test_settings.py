"""Names of ports, and which settings of drivers are allowed."""

import pytest
from pydantic import TypeAdapter, ValidationError

from drivers.cube.scanning.driver import ScanningMeterSettings
from drivers.settings import HostAndPort, MeterRange, stable_port, stable_visa


@pytest.mark.parametrize("name", ["/dev/serial/by-id/usb-Keith-if00", "/dev/heliocube-positioner", "COM3"])
def test_a_serial_port_with_a_stable_name_is_accepted(name):
    assert stable_port(name) == name
    assert stable_visa(f"ASRL{name}::INSTR") == f"ASRL{name}::INSTR"


@pytest.mark.parametrize("name", ["/dev/ttyUSB0", "/dev/ttyACM12", "/dev/ttyAMA1", "/dev/pts/4"])
def test_a_serial_port_name_that_may_change_after_a_replug_is_refused(name):
    with pytest.raises(ValueError, match="stays the same"):
        stable_port(name)
    with pytest.raises(ValueError, match="stays the same"):
        stable_visa(f"ASRL{name}::INSTR")


@pytest.mark.parametrize("name", ["", "ttyS0", "COM", "/dev/with blank"])
def test_text_that_is_not_a_serial_port_name_is_refused(name):
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
def test_a_server_setting_needs_a_valid_host_and_port(text, right):
    server = TypeAdapter(HostAndPort)
    if right:
        assert server.validate_python(text) == text
    else:
        with pytest.raises(ValidationError):
            server.validate_python(text)


@pytest.mark.parametrize(("host", "right"), [("10.0.0.5", True), ("10.0.0..5", False), ("x" * 64, False)])
def test_the_socket_resource_of_a_scanning_meter_needs_a_valid_host(host, right):
    resource = f"TCPIP::{host}::5025::SOCKET"
    if right:
        assert ScanningMeterSettings(resource=resource).resource == resource
    else:
        with pytest.raises(ValidationError):
            ScanningMeterSettings(resource=resource)


def test_a_meter_range_setting_other_than_100_mv_1_v_or_10_v_is_refused():
    ranges = TypeAdapter(MeterRange)
    assert [ranges.validate_python(value) for value in (0.1, 1.0, 10.0)] == [0.1, 1.0, 10.0]
    for value in (0.2, 2.0, 20.0):
        with pytest.raises(ValidationError):
            ranges.validate_python(value)


@pytest.mark.parametrize(("channels", "conflicts"), [
    (None, []), ([101, 102, 103, 104], []), ([101, 102, 103, 101], ["channels"]),
])  # fmt: skip
def test_a_scanning_meter_needs_a_channel_of_its_own_for_each_face(channels, conflicts):
    settings = ScanningMeterSettings(channels=channels)
    assert [conflict.key for conflict in settings.conflicts()] == conflicts
