"""The service, its real drivers and the bench: three kinds of transport, one sun."""

import os
import socket
import time

import pytest
import serial

from daemon.bridge import senml
from daemon.records import FACES, Quality

from .processes import (
    brisk,
    distance_from_law,
    law_says,
    moves,
    points_as_the_law_says,
    wait_until,
)

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

SETTLES_WITHIN_S = 60.0
BACK_WITHIN_S = 15.0
ROLES = {"positioner": "the positioner", "voltmeter": "the cube's instruments", "multiplexer": "the cube's instruments"}
SKIES = (0.25, 1.0)


class Rig:
    """A bench with a service on it."""

    def __init__(self, bench, service):
        self.bench = bench
        self.service = service
        self._turn = 0

    def settle(self):
        wait_until(
            lambda: points_as_the_law_says(self.bench),
            SETTLES_WITHIN_S,
            lambda: (
                f"the tracker where the law says, but {distance_from_law(self.bench):.2f} deg off; "
                + self.service.log()
            ),
        )

    def new_sky(self):
        """Change the light so much that the law says something else."""
        before = law_says(self.bench)
        self.bench.ask("shade", "east", SKIES[self._turn % len(SKIES)])
        self._turn += 1
        after = law_says(self.bench)
        assert max(abs(old - new) for old, new in zip(before, after, strict=True)) > 10

    def lines(self, text):
        return self.service.log().count(text)

    def outages(self, sentence):
        return sum(" is down: " in line and sentence in line for line in self.service.log().splitlines())

    def last_mode(self):
        changes = [line.split(" -> ")[1].split(":")[0] for line in self.service.log().splitlines() if " -> " in line]
        return changes[-1] if changes else "starting"


@pytest.fixture
def start_rig(tmp_path, start_bench, start_service):
    def start(*options):
        bench = start_bench("--config", brisk(tmp_path), "--weather", "clear", *options)
        return Rig(bench, start_service(bench.config))

    return start


def test_under_a_measured_sky_each_cycle_ends_where_the_law_says(tmp_path, start_bench, start_service, measured):
    file = measured / "dtu_lyngby_2016" / "2016-06.csv.gz"
    options = ("--weather", file, "--start", "2016-06-05T08:00Z", "--site", "55.79,12.52,50")
    bench = start_bench("--config", brisk(tmp_path), *options)
    rig = Rig(bench, start_service(bench.config))
    rig.settle()
    for _ in range(3):
        rig.new_sky()
        rig.settle()
    assert bench.state()["sky"]["ghi_w_m2"] > 100
    assert "SIMULATED" not in rig.service.log()


@pytest.mark.parametrize("device", ROLES)
def test_a_pulled_plug_is_survived_while_the_service_runs(start_rig, device):
    rig = start_rig()
    rig.settle()
    pid = rig.service.pid
    for phase in (idle, mid_exchange, mid_move):
        down, back = rig.lines(f"{ROLES[device]} is down"), rig.lines(f"{ROLES[device]} is back")
        phase(rig, device)
        rig.bench.ask("unplug", device)
        time.sleep(1.0)
        rig.bench.ask("replug", device)
        tidy(rig, device)
        wait_until(
            lambda back=back: rig.lines(f"{ROLES[device]} is back") > back and rig.last_mode() == "tracking",
            BACK_WITHIN_S,
            lambda phase=phase: f"tracking again after {device} {phase.__name__}: {rig.service.log()}",
        )
        rig.new_sky()
        rig.settle()
        assert rig.lines(f"{ROLES[device]} is down") == down + 1, rig.service.log()
        assert rig.lines(f"{ROLES[device]} is back") == back + 1, rig.service.log()
    assert rig.service.exit_code is None
    assert rig.service.pid == pid


@pytest.mark.parametrize("device", ROLES)
def test_a_plug_that_is_out_before_and_pulled_at_the_start_is_survived(tmp_path, start_bench, start_service, device):
    bench = start_bench("--config", brisk(tmp_path), "--weather", "clear")
    bench.ask("unplug", device)
    rig = Rig(bench, start_service(bench.config))
    wait_until(lambda: rig.lines(f"{ROLES[device]} is down") == 1, SETTLES_WITHIN_S, rig.service.log)
    start_s, used_s = time.monotonic(), rig.service.cpu_s()
    time.sleep(3.0)
    assert (rig.service.cpu_s() - used_s) / (time.monotonic() - start_s) < 0.2
    bench.ask("replug", device)
    wait_until(
        lambda: rig.last_mode() == "tracking" and rig.lines(f"{ROLES[device]} is back") == 1,
        BACK_WITHIN_S,
        lambda: f"tracking: {rig.service.log()}",
    )
    assert rig.lines(f"{ROLES[device]} is down") == 1
    assert rig.service.stop() == 0
    again = Rig(bench, start_service(bench.config))
    wait_until(lambda: "real instruments" in again.service.log(), SETTLES_WITHIN_S, again.service.log)
    bench.ask("unplug", device, 1)
    again.settle()


def test_a_late_reply_is_never_credited_to_another_face(tmp_path, start_bench, start_service):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(30)
        config = brisk(tmp_path, send_to=f"127.0.0.1:{listener.getsockname()[1]}")
        bench = start_bench("--config", config, "--weather", "clear")
        for index, face in enumerate(FACES):
            bench.ask("sensor", face, 0.01 * (index + 1))
        start_service(bench.config)
        seen = []

        def next_scan():
            seen.append(senml.decode(listener.recv(2048)))
            return seen[-1]

        while not next_scan().ok:
            pass
        for delay_s in (0.7, 0.55, 1.3):
            bench.ask("delay", "voltmeter", delay_s)
            while next_scan().ok:
                pass
            bench.ask("delay", "voltmeter", 0)
            while not next_scan().ok:
                pass
        bench.ask("drop", "voltmeter", 3)
        bench.ask("corrupt", "voltmeter", 3)
        for _ in range(8):
            next_scan()
        while not next_scan().ok:
            pass
    readings = [(index, face) for scan in seen for index, face in enumerate(scan.faces)]
    assert any(face.quality is not Quality.OK for _, face in readings)
    for index, face in readings:
        if face.quality is Quality.OK:
            assert face.irradiance_w_m2 == pytest.approx(100 * (index + 1), abs=1.0)


def test_wrong_and_silent_instruments_are_told_in_one_sentence_and_waited_for(tmp_path, start_bench, start_service):
    bench = start_bench("--config", brisk(tmp_path), "--weather", "clear")
    bench.ask("identity", "voltmeter", "KEITHLEY INSTRUMENTS INC.,MODEL 2700,1,B01")
    bench.ask("freeze", "positioner")
    rig = Rig(bench, start_service(bench.config))
    for sentence in ("MODEL 2700", "in its bootloader"):
        wait_until(lambda sentence=sentence: rig.outages(sentence) == 1, SETTLES_WITHIN_S, rig.service.log)
    bench.ask("identity", "voltmeter", "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02")
    bench.ask("thaw", "positioner")
    rig.settle()
    assert rig.lines("is down") == rig.lines("is back") == 2


def test_a_port_held_by_another_program_and_a_missing_ni_driver_are_told_and_waited_for(
    tmp_path, start_bench, start_service
):
    bench = start_bench("--config", brisk(tmp_path), "--weather", "clear")
    config = tmp_path / "here.toml"
    lines = bench.config.read_text().splitlines()
    config.write_text("\n".join(line for line in lines if not line.startswith("server = ")))
    holder = bench.directory / "positioner"
    with serial.Serial(str(holder), exclusive=True):
        rig = Rig(bench, start_service(config))
        for sentence in (f"is held by another program (python, process {os.getpid()})", "NI-DAQmx"):
            wait_until(lambda sentence=sentence: rig.outages(sentence) == 1, SETTLES_WITHIN_S, rig.service.log)
    wait_until(lambda: rig.lines("the positioner is back") == 1, SETTLES_WITHIN_S, rig.service.log)
    assert rig.service.exit_code is None


def idle(rig, _device):
    rig.settle()


def mid_exchange(rig, device):
    """Let a question be open when the plug is pulled."""
    if device == "positioner":
        rig.bench.ask("inject", "deaf")
        rig.new_sky()
        wait_until(lambda: rig.lines("moving ") and rig.last_mode() == "tracking", SETTLES_WITHIN_S, rig.service.log)
        time.sleep(3.0)
    else:
        rig.bench.ask("delay", device, 0.3)
        time.sleep(1.0)


def mid_move(rig, _device):
    rig.new_sky()
    wait_until(lambda: moves(rig.bench), SETTLES_WITHIN_S, rig.service.log)


def tidy(rig, device):
    if device == "positioner":
        rig.bench.ask("repair", "deaf")
    else:
        rig.bench.ask("delay", device, 0)
