"""Foreign clients of SunSpec on a running service: pysunspec2 scans while the tracker moves, mbpoll reads."""

import shutil
import socket
import subprocess

import pytest
import sunspec2.modbus.client as sunspec
from sunspec2.modbus.modbus import ModbusClientError

from tests.support import PATIENCE_S
from tests.support.addresses import free_port
from tests.system.processes import wait_until

pytestmark = pytest.mark.system
CLEAR_NOON = "[simulation]\nspeed = 30.0\nweather = 'clear'\nstart_utc = 2022-06-21T11:00:00Z\nmotor_speed_mm_s = 2.0\n"


@pytest.fixture
def port():
    return free_port()


@pytest.fixture
def client(tmp_path, port, start_service):
    """Return pysunspec2's client of a service on the simulated rig that may be set to manual."""
    config = tmp_path / "heliocube.toml"
    config.write_text(
        f"{CLEAR_NOON}[api]\nlisten = '127.0.0.1:0'\n[bridge]\nlisten = '127.0.0.1:0'\n"
        f"[sunspec]\nenabled = true\nmanual = true\nlisten = '127.0.0.1:{port}'\n"
    )
    start_service(config)
    wait_until(lambda: listens(port), "the service to be there")
    found = sunspec.SunSpecModbusClientDeviceTCP(slave_id=1, ipaddr="127.0.0.1", ipport=port, timeout=10)
    found.connect()
    yield found
    found.close()


def listens(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def manual(client, elevation_deg, azimuth_deg):
    """Write the manual override; return whether it was taken."""
    client.scan()
    model = client.models[601][0]
    model.GlblElCtl.cvalue, model.GlblAzCtl.cvalue, model.GlblCtl.value = elevation_deg, azimuth_deg, 1
    try:
        model.write()
    except ModbusClientError:
        return False
    return True


def test_pysunspec2_scans_while_the_tracker_moves_and_sets_it_to_manual(client, port):
    client.scan()
    assert [name for name in client.models if isinstance(name, int)] == [1, 302, 305, 307, 601]
    assert client.common[0].Mn.value == "heliocube"
    assert "SIMULATED" in client.common[0].Md.value
    assert client.models[305][0].Lat.cvalue == pytest.approx(48.7176, abs=1e-3)
    tracker, irradiance = client.models[601][0], client.models[302][0]

    def known():
        tracker.read()
        irradiance.read()
        return tracker.tracker[0].ElPos.cvalue is not None and (irradiance.repeating[0].GHI.value or 0) > 500

    wait_until(known, "pose and irradiance")
    assert tracker.Typ.value == 5
    assert irradiance.repeating[2].OTI.value > irradiance.repeating[1].OTI.value

    # Before the first decision every goto is refused: ask until one is taken.
    wait_until(lambda: manual(client, 33.83, 217.01), "the first decision")
    seen = []

    def arrived():
        client.scan()
        position = client.models[601][0].tracker[0]
        seen.append((position.ElPos.cvalue, position.AzPos.cvalue))
        return seen[-1] == pytest.approx((33.83, 217.01), abs=1.0)

    wait_until(arrived, lambda: seen)
    assert client.models[601][0].GlblCtl.value == 1
    assert len(set(seen)) > 2, "it was scanned on its way"

    assert not manual(client, 30.0, 90.0), "the tracker does not reach the north-east"

    client.scan()
    client.models[601][0].GlblCtl.value = 0
    client.models[601][0].write()
    wait_until(lambda: client.models[601][0].read() or client.models[601][0].GlblCtl.value == 0, "automatic")

    if shutil.which("mbpoll"):
        command = ["mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-0", "-r", "40000", "-c", "4", "-t", "4", "-1"]
        done = subprocess.run([*command, "127.0.0.1"], capture_output=True, text=True, timeout=PATIENCE_S, check=True)
        assert [line.split("\t")[1] for line in done.stdout.splitlines() if line.startswith("[")] == [
            "21365",
            "28243",
            "1",
            "66",
        ]
