"""The service, its real drivers and the bench: three kinds of transport, one sun."""

import os
import socket
import time

import psutil
import pytest
import serial

from daemon.base.records import FACES, Quality
from daemon.bridge import senml
from tests.support import PATIENCE_S
from tests.system.processes import wait_until
from tests.system.rig import HIGH_SUN, PHASES, ROLES, Rig, brisk

# Destinations, tracking off, stop and homing, clearing of faults.
ALLOWED = {44, 46, 48, 50, 56, 57, 136}
pytestmark = pytest.mark.system


def test_under_a_measured_sky_the_tracker_settles_where_the_law_says(tmp_path, start_bench, start_service, measured):
    file = measured / "dtu_lyngby_2016" / "2016-06.csv.gz"
    options = ("--weather", file, "--start", "2016-06-05T11:10Z", "--site", "55.79,12.52,50")
    bench = start_bench("--config", brisk(tmp_path), *options)
    rig = Rig(bench, start_service(bench.config))
    rig.settle()
    rig.new_sky()
    rig.settle()
    assert bench.state()["sky"]["ghi_w_m2"] > 100
    assert "SIMULATED instruments" not in rig.service.log()


@pytest.mark.parametrize(
    "geometry",
    [
        """
a_axis = { arm_1_mm = 410.0, arm_2_mm = 280.0, low_deg = -55.0, apex_deg = 85.0, holder_mm = 20.0 }
b_axis = { sense = "lowers", low_deg = 90.0, apex_deg = 140.0 }
""",
        """
position_unit = "deg"
a_axis = { low_deg = -60.0 }
""",
    ],
    ids=["other arms", "slew drives"],
)
def test_the_bench_and_the_service_use_the_configured_geometry_of_the_positioner(
    tmp_path, start_bench, start_service, geometry
):
    config = brisk(tmp_path, positioner=geometry)
    rig = Rig(bench := start_bench("--config", config, *HIGH_SUN), start_service(bench.config))
    rig.settle()
    rig.new_sky()
    rig.settle()


@pytest.mark.parametrize("devices", [("positioner",), ("voltmeter", "multiplexer")], ids="-".join)
@pytest.mark.long
def test_the_running_service_survives_a_pulled_plug_in_each_phase_and_reports_each_outage_once(start_rig, devices):
    rig = start_rig()
    stored = rig.bench.state()["positioner"]["stored"]
    rig.settle()
    for device in devices:
        for phase in PHASES:
            phase(rig, device)
            rig.survive(device, 1.0, phase.__name__)
    rig.new_sky()
    rig.settle()
    assert rig.service.exit_code is None
    # Each replug brought the port back with echo: still only the driver's own commands have come through it.
    positioner = rig.bench.state()["positioner"]
    assert {int(code) for code in positioner["received"]} <= ALLOWED
    assert positioner["stored"] == stored


def test_the_service_waits_with_little_processor_load_for_plugs_that_are_out_before_its_start(
    tmp_path, start_bench, start_service
):
    bench = start_bench("--config", brisk(tmp_path), *HIGH_SUN)
    for device in ROLES:
        bench.ask("unplug", device)
    rig = Rig(bench, start_service(bench.config))

    # Nobody has pulled the load's plug, and a busy machine may let it answer late.
    def count(what):
        return sum(rig.lines(f"the {one} is {what}") for one in ("cube", "positioner"))

    wait_until(lambda: count("down: ") == 2, rig.service.log)
    assert rig.load(3.0) < 0.2
    for device in ("multiplexer", "positioner", "voltmeter"):
        bench.ask("replug", device)
        time.sleep(1.0)
    # The return of the positioner is logged a moment after the mode that it makes possible.
    wait_until(
        lambda: rig.last_mode() == "tracking" and count("back") == 2,
        lambda: f"both back and tracking, but it is {rig.service.log()}",
    )
    assert count("down: ") == 2, rig.service.log()


@pytest.mark.long
def test_a_positioner_board_that_restarts_at_open_or_in_mid_run_is_waited_for_homed_and_used(
    tmp_path, start_bench, start_service
):
    config = brisk(
        tmp_path,
        positioner='dtr = false\nboot_s = 5.0\nboot_banner = "POZSOL36A1 ready"\n'
        # The end switches are within some seconds of the axes: they are sought twice.
        "a_axis = { low_deg = -10.0 }\nb_axis = { low_deg = 68.0 }\n[limits]\na_min_deg = -8.0\nb_min_deg = 70.0\n",
    )
    config.write_text(config.read_text().replace("[motion]", '[motion]\nrehome = "automatic"'))
    bench = start_bench("--config", config, *HIGH_SUN)
    bench.ask("boots-at-open", 3)
    rig = Rig(bench, start_service(bench.config))
    wait_until(lambda: rig.lines("homing finished") == 1 and rig.last_mode() == "tracking", rig.service.log)
    assert rig.outages("it prints its banner") == 0, rig.service.log()
    bench.ask("boots-at-open", "never")
    bench.ask("restart", 0.5)
    wait_until(lambda: rig.outages("it prints its banner") == 1, rig.service.log)
    wait_until(lambda: rig.lines("homing finished") == 2 and rig.last_mode() == "tracking", rig.service.log)
    rig.settle()
    # A busy machine may let the line fall silent for a moment besides.
    wait_until(lambda: rig.lines(" is down: ") == rig.lines(" is back"), rig.service.log)
    assert rig.outages("it prints its banner") == 1


def test_the_service_survives_plugs_that_are_pulled_while_it_starts(start_rig):
    rig = start_rig()
    wait_until(lambda: "real instruments" in rig.service.log(), rig.service.log)
    for device in ROLES:
        rig.bench.ask("unplug", device, 1)
    rig.settle()
    wait_until(lambda: rig.last_mode() == "tracking", rig.service.log)


def test_a_late_reply_is_never_credited_to_another_face(tmp_path, start_bench, start_service):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(PATIENCE_S)
        config = brisk(tmp_path, send_to=f"127.0.0.1:{listener.getsockname()[1]}")
        config.write_text(config.read_text().replace("reading_deadline_s = 1.5", "reading_deadline_s = 0.5"))
        bench = start_bench("--config", config, "--weather", "clear")
        for index, face in enumerate(FACES):
            bench.ask("sensor", face, 0.01 * (index + 1))
        service = start_service(bench.config)
        seen = []

        def next_scan():
            seen.append(senml.decode(listener.recv(2048)))
            return seen[-1]

        while not next_scan().ok:
            pass
        for turn in range(4):
            # The delay is longer than any deadline and lasts about a scan: replies come when nobody waits for them.
            bench.ask("delay", "voltmeter", 1.0 + 0.1 * turn)
            time.sleep(0.1 + 0.15 * turn)
            bench.ask("delay", "voltmeter", 0)
            for _ in range(4):
                next_scan()
        bench.ask("drop", "voltmeter", 3)
        bench.ask("corrupt", "voltmeter", 3)
        for _ in range(8):
            next_scan()
        while not next_scan().ok:
            pass
    qualities = {face.quality for scan in seen for face in scan.faces}
    assert Quality.LATE in qualities or "is down" in service.log()
    readings = [(index, face) for scan in seen for index, face in enumerate(scan.faces)]
    for index, face in readings:
        if face.quality is Quality.OK:
            assert face.irradiance_w_m2 == pytest.approx(100 * (index + 1), abs=1.0)


def test_wrong_and_silent_instruments_are_reported_once_and_waited_for(tmp_path, start_bench, start_service):
    bench = start_bench("--config", brisk(tmp_path), *HIGH_SUN)
    bench.ask("identity", "voltmeter", "KEITHLEY INSTRUMENTS INC.,MODEL 2700,1,B01")
    bench.ask("freeze", "positioner")
    rig = Rig(bench, start_service(bench.config))
    for sentence in ("MODEL 2700", "in its bootloader"):
        wait_until(lambda sentence=sentence: rig.outages(sentence) == 1, rig.service.log)
    bench.ask("identity", "voltmeter", "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02")
    bench.ask("thaw", "positioner")
    rig.settle()
    for role in ("the positioner", "the cube"):
        assert rig.lines(f"{role} is down") == rig.lines(f"{role} is back") == 1, rig.service.log()


HANGS = """
import os, time
from nidaqmx.stream_writers import DigitalSingleChannelWriter
from nidaqmx.task import Task

def hanging(function):
    def call(*arguments, **options):
        while os.path.exists({mark!r}):
            time.sleep(0.05)
        return function(*arguments, **options)
    return call

DigitalSingleChannelWriter.write_one_sample_port_uint32 = hanging(
    DigitalSingleChannelWriter.write_one_sample_port_uint32
)
Task.__init__ = hanging(Task.__init__)
"""


@pytest.mark.long
def test_a_library_that_hangs_is_reported_and_waited_for_and_does_not_keep_the_service_from_ending(
    tmp_path, start_bench, start_service, monkeypatch
):
    mark = tmp_path / "hang"
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(HANGS.format(mark=str(mark)))
    bench = start_bench("--config", brisk(tmp_path), *HIGH_SUN)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    rig = Rig(bench, start_service(bench.config))
    rig.settle()
    mark.touch()
    told = "the cube is down: multiplexer: a call of its driver did not return within"
    wait_until(lambda: rig.lines(told) == 1, rig.service.log)
    # The driver hangs again while it is being opened.
    assert rig.load(12.0) < 0.2
    assert rig.lines("the cube is back") == 0
    mark.unlink()
    wait_until(lambda: rig.lines("the cube is back") == 1, rig.service.log)
    wait_until(lambda: rig.last_mode() == "tracking", rig.service.log)
    mark.touch()
    wait_until(lambda: rig.lines(told) == 2, rig.service.log)
    rig.service.ask_to_stop()
    assert rig.service.wait() == 0


def test_a_port_held_by_another_program_and_a_missing_ni_driver_are_reported_and_waited_for(
    tmp_path, start_bench, start_service
):
    bench = start_bench("--config", brisk(tmp_path), *HIGH_SUN)
    config = tmp_path / "here.toml"
    lines = bench.config.read_text().splitlines()
    config.write_text("\n".join(line for line in lines if not line.startswith("server = ")))
    holder = bench.directory / "positioner"
    with serial.Serial(str(holder), exclusive=True):
        rig = Rig(bench, start_service(config))
        for sentence in (f"is held by another program ({psutil.Process().name()}, process {os.getpid()})", "NI-DAQmx"):
            # The lines in between give every reason. The line of the outage comes once, and may give another reason.
            wait_until(lambda sentence=sentence: sentence in rig.service.log(), rig.service.log)
        assert rig.lines("the positioner is down") == 1
    wait_until(lambda: rig.lines("the positioner is back") == 1, rig.service.log)
    assert rig.service.exit_code is None
