"""`heliocube probe` as a person with a rig uses it, on the bench."""

import fcntl
import json
import os
import re
import signal
import time

import numpy as np
import pytest

from drivers.positioners.pozsol.wire import Field, TokenStream, parse_status
from drivers.transcript import parse
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import Setup
from sim_drivers.voltmeter.core import VoltmeterCore
from tests.daemon.store.test_full_disk import fill, small_disk
from tests.support import PATIENCE_S, forks
from tests.support.addresses import free_port
from tests.system.processes import wait_until

__all__ = ["small_disk"]
pytestmark = pytest.mark.system

READING = re.compile(rb"[+-]\d\.\d{8}E[+-]\d\d\n")


def probe(*arguments):
    return forks.run("probe", *arguments)


def pieces(path):
    return parse(path.read_text(encoding="utf-8").splitlines())


def sent(path):
    return [piece.data for piece in pieces(path) if piece.direction == ">"]


def test_probing_reports_records_and_changes_nothing_unless_asked(start_bench, tmp_path):
    file = tmp_path / "heliocube.toml"
    # A port without another service, which the self-check would report.
    file.write_text(f"[api]\nlisten = '127.0.0.1:{free_port()}'\n")
    bench = start_bench("--config", file, "--weather", "clear", "--start", "2022-06-21T12:00Z")
    range_v = bench.state()["voltmeter"]["range_v"]

    positioner = probe("positioner", "-c", bench.config, "--seconds", "4", "--record", tmp_path / "positioner")
    assert positioner.returncode == 0, positioner.stderr
    assert "board 36A1, firmware 1.402 (B1.100)" in positioner.stdout
    assert "modem lines: the port has none" in positioner.stdout
    assert re.search(r"angle A every \d+ ms", positioner.stdout)
    assert "geometry of A fits" in positioner.stdout
    assert "70=195.3, 71=300.0, 72=300.0" in positioner.stdout
    assert sent(tmp_path / "positioner") == []
    assert bench.state()["positioner"]["received"] == {}

    voltmeter = probe("voltmeter", "-c", bench.config, "--record", tmp_path / "voltmeter")
    assert voltmeter.returncode == 0, voltmeter.stderr
    assert "MODEL 2000" in voltmeter.stdout
    assert "relative: 0" in voltmeter.stdout
    assert "math: 0" in voltmeter.stdout
    questions = sent(tmp_path / "voltmeter")
    assert questions[0] == b"\x03"
    assert all(question.endswith(b"?\n") for question in questions[1:])
    assert bench.state()["voltmeter"]["range_v"] == range_v

    multiplexer = probe("multiplexer", "-c", bench.config)
    assert multiplexer.returncode == 0, multiplexer.stderr
    assert "USB-6008" in multiplexer.stdout
    assert bench.state()["multiplexer"]["writes"] == 0

    good = forks.run("config", "check", "--probe", bench.config)
    assert good.returncode == 0, good.stderr
    assert all(each in good.stdout for each in (": KEITHLEY", "NI USB-6008", " 36A1 ", ": CHROMA")), good.stdout
    checked = forks.run("self-check", "--json", "-c", bench.config)
    found = {each["subject"]: each["ok"] for each in json.loads(checked.stdout)["findings"]}
    assert all(found.get(name) for name in ("voltmeter", "multiplexer", "positioner", "load")), checked.stdout
    assert bench.state()["positioner"]["received"] == {}
    assert bench.state()["multiplexer"]["writes"] == 0
    assert bench.state()["voltmeter"]["range_v"] == range_v

    measured = probe("multiplexer", "-c", bench.config, "--write", "--record", tmp_path / "multiplexer", "--json")
    assert measured.returncode == 0, measured.stderr
    assert re.search(r"input 3 \(zenith\): \+\d+\.\d{4} mV, \d+\.\d W/m2", measured.stderr)
    assert json.loads(measured.stdout)["inputs"][3]["for"] == "zenith"
    assert sent(tmp_path / "multiplexer") == [b"%d" % channel for channel in range(8)]

    again = probe("voltmeter", "-c", bench.config, "--record", tmp_path / "voltmeter")
    assert (again.returncode, "is there already" in again.stderr) == (2, True)


def test_probe_times_a_small_move_of_each_axis_and_moves_it_back(start_bench):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    moved = probe("positioner", "-c", bench.config, "--seconds", "1", "--move-deg", "2", "--json")
    assert moved.returncode == 0, moved.stderr
    speeds = [float(text) for text in re.findall(r"([\d.]+) units/s", moved.stderr)]
    assert json.loads(moved.stdout)["geometry_fits"] == {"a": True, "b": True}
    assert len(speeds) == 4
    # The axes turn at some 2.8 units/s; a busy machine sees the beginning or the end late.
    assert all(0.7 < speed < 11.0 for speed in speeds)
    assert bench.state()["pose"] == pytest.approx({"a_deg": 0.0, "b_deg": 90.0}, abs=0.5)


def test_probe_does_not_move_a_positioner_for_which_its_service_has_noted_an_unfinished_homing(start_bench, tmp_path):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    named = tmp_path / "named.toml"
    named.write_text(f'{bench.config.read_text()}\n[[tracker]]\nname = "east"\n')
    for file, records in ((bench.config, bench.directory / "records"), (named, tmp_path / "named-records" / "east")):
        records.mkdir(parents=True)
        (records / "motion.json").write_text('{"homing": true}')
        done = probe("positioner", "-c", file, "--seconds", "1", "--move-deg", "2")
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), (done.stdout, done.stderr)
        assert f"{records / 'motion.json'} has noted: homing was not finished" in done.stderr
    assert bench.state()["positioner"]["received"] == {}


def test_sigterm_to_a_probe_stops_its_move(start_bench, tmp_path):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    begin_deg = bench.state()["pose"]["a_deg"]
    with (tmp_path / "told").open("w+") as told:
        words = ["probe", "positioner", "-c", bench.config, "--seconds", "1", "--move-deg", "20"]
        process = forks.start(words, told, told)
        wait_until(lambda: abs(bench.state()["pose"]["a_deg"] - begin_deg) > 0.5, "A to move")
        process.send_signal(signal.SIGTERM)
        code = process.wait(PATIENCE_S)
        told.seek(0)
        assert code == 130, told.read()
    pose = bench.state()["pose"]
    assert abs(pose["a_deg"] - begin_deg) < 15.0
    time.sleep(3.0)
    assert bench.state()["pose"] == pose, "it has gone on"


def test_a_recording_of_the_voltmeter_gives_the_same_replies_from_the_simulated_voltmeter(start_bench, tmp_path):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    done = probe("voltmeter", "-c", bench.config, "--write", "--record", tmp_path / "voltmeter")
    assert done.returncode == 0, done.stderr
    core = VoltmeterCore(lambda _now: 0.0, np.random.default_rng(1))
    recorded, simulated = [], []
    for piece in pieces(tmp_path / "voltmeter"):
        if piece.direction == ">":
            simulated += [reply for _, reply in core.feed(piece.data, piece.time_s)]
        else:
            recorded.append(piece.data)
    assert len(recorded) == len(simulated) > 20
    readings = 0
    for there, here in zip(recorded, simulated, strict=True):
        if READING.fullmatch(there):
            assert READING.fullmatch(here)
            readings += 1
        elif b"VDC" not in there:
            assert here == there
    assert readings >= 10


def test_a_recording_of_the_positioner_gives_the_same_fields_from_the_simulated_positioner(start_bench, tmp_path):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    record = tmp_path / "positioner"
    done = probe("positioner", "-c", bench.config, "--seconds", "4", "--move-deg", "2", "--record", record)
    assert done.returncode == 0, done.stderr
    core, stream = PositionerCore(0.0, Setup()), TokenStream()
    there, here = Shown(), Shown()
    for piece in pieces(record):
        if piece.direction == ">":
            core.feed(piece.data, piece.time_s)
        else:
            there.take(stream.feed(piece.data))
            here.take(TokenStream().feed(core.screens(piece.time_s) + b"$"))
    assert there.fields.keys() == here.fields.keys()
    for field in (Field.BOARD, Field.VERSION, Field.SERIAL, Field.SUPPLY, Field.MODE, 70, 79, 110):
        assert there.fields[field] == here.fields[field]
    # The status is on a slow screen, which may still tell of the last move.
    assert there.latched == here.latched == ((), False, False)
    # Out and back with A, out and back with B, and the same targets in the unit's own units. A stop makes the place
    # where the axes stand a target, one unit beside where they were sent.
    assert there.targets == here.targets
    for axis in zip(*there.targets, strict=True):
        assert max(axis) - min(axis) >= 5
        assert abs(axis[0] - axis[-1]) <= 1


def test_a_full_disk_ends_the_recording_of_a_probe_but_neither_its_moves_nor_its_answer(start_bench, small_disk):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    fill(small_disk / "full")
    record = small_disk / "positioner"
    done = probe("positioner", "-c", bench.config, "--seconds", "2", "--move-deg", "1", "--record", record)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"{record} cannot be written: No space left on device; " in done.stderr
    assert len(re.findall(r"^  [AB] to ", done.stdout, re.MULTILINE)) == 4
    assert not record.exists()


class Shown:
    """The newest value of each field, and the destinations one after the other."""

    def __init__(self):
        self.fields = {}
        self.targets = []

    @property
    def latched(self):
        status = parse_status(self.fields[Field.STATUS].decode())
        return status.faults, status.was_reset, status.autonomous

    def take(self, tokens):
        self.fields |= dict(tokens)
        if {Field.A_DESTINATION, Field.B_DESTINATION} <= self.fields.keys():
            # An axis that is stopped at rest takes its place, with all decimals, for its destination.
            both = tuple(int(float(self.fields[field])) for field in (Field.A_DESTINATION, Field.B_DESTINATION))
            if both not in self.targets[-1:]:
                self.targets.append(both)


def test_a_probe_of_an_absent_wrong_or_hanging_instrument_gives_a_short_reason_and_exit_code_2(start_bench, tmp_path):
    bench = start_bench()
    voltmeter, positioner = bench.directory / "voltmeter", bench.directory / "positioner"
    cases = {
        ("positioner", "--port", tmp_path / "away"): "there is no",
        ("positioner", "--port", voltmeter): "sends no telemetry",
        ("positioner", "--port", "/dev/ttyACM0"): "outlives a replug",
        ("voltmeter", "--resource", f"ASRL{positioner}::INSTR"): "answers|did not answer|does not answer",
        ("voltmeter", "--resource", "GPIB0::16::INSTR"): "prologix_port",
        ("multiplexer", "--server", "127.0.0.1:9"): "no NI gRPC Device Server answers",
        ("multiplexer",): "NI-DAQmx is not installed",
        ("positioner",): "instruments.positioner.port is missing",
    }
    for arguments, sentence in cases.items():
        refused(arguments, sentence)
    bench.ask("freeze", "positioner")
    refused(("positioner", "--port", positioner), "hangs, is in its bootloader, or is another device")
    bench.ask("thaw", "positioner")
    bench.ask("identity", "positioner", "29C3")
    refused(("positioner", "--port", positioner), "board '29C3', not 36A1: nothing is sent to it")
    bench.ask("identity", "voltmeter", "KEITHLEY INSTRUMENTS INC.,MODEL 2700,1,B01")
    model = refused(("voltmeter", "-c", bench.config), "MODEL 2700.* is not a Keithley MODEL 2000")
    assert "identity: KEITHLEY INSTRUMENTS INC.,MODEL 2700,1,B01" in model.stdout
    bench.ask("unplug", "multiplexer")
    refused(("multiplexer", "-c", bench.config), "there is no device for Dev1/port0.*is it plugged in")
    holder = rf"is held by another program \(.*, process {os.getpid()}\)"
    for port, probed in ((positioner, ("positioner",)), (voltmeter, ("voltmeter",))):
        held = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            fcntl.flock(held, fcntl.LOCK_EX)
            refused((*probed, "-c", bench.config), holder)
        finally:
            os.close(held)
    assert bench.state()["positioner"]["received"] == {}


def refused(arguments, sentence):
    """Probe, and expect one sentence and exit code 2."""
    done = probe(*arguments)
    assert done.returncode == 2, arguments
    assert re.search(sentence, done.stderr), (arguments, done.stderr)
    # For a mistake in a value a headline comes first.
    assert done.stderr.count("\n") <= 2, done.stderr
    assert "Traceback" not in done.stderr
    return done
