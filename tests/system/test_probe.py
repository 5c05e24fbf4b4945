"""`heliocube probe` as a person with a rig uses it, on the bench."""

import re
import subprocess

import pytest

from drivers.transcript import parse

from .processes import HELIOCUBE

pytestmark = pytest.mark.system


def probe(*arguments):
    return subprocess.run(
        [str(HELIOCUBE), "probe", *map(str, arguments)], capture_output=True, text=True, timeout=90, check=False
    )


def sent(path):
    return [piece.data for piece in parse(path.read_text(encoding="utf-8").splitlines()) if piece.direction == ">"]


def test_probing_reports_records_and_changes_nothing_unless_asked(start_bench, tmp_path):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    range_v = bench.state()["voltmeter"]["range_v"]

    positioner = probe("positioner", "-c", bench.config, "--seconds", "4", "--record", tmp_path / "positioner")
    assert positioner.returncode == 0, positioner.stderr
    assert "board 36A1, firmware 1.402 (B1.100)" in positioner.stdout
    assert "modem lines: the port has none" in positioner.stdout
    assert re.search(r"angle A every 1[12]\d ms", positioner.stdout)
    assert "geometry of A fits" in positioner.stdout
    assert "70=300.0, 71=300.0, 72=90.0" in positioner.stdout
    assert sent(tmp_path / "positioner") == []
    assert bench.state()["positioner"]["received"] == {}

    voltmeter = probe("voltmeter", "-c", bench.config, "--record", tmp_path / "voltmeter")
    assert voltmeter.returncode == 0, voltmeter.stderr
    assert "MODEL 2000" in voltmeter.stdout
    questions = sent(tmp_path / "voltmeter")
    assert questions[0] == b"\x03"
    assert all(question.endswith(b"?\n") for question in questions[1:])
    assert bench.state()["voltmeter"]["range_v"] == range_v

    multiplexer = probe("multiplexer", "-c", bench.config)
    assert multiplexer.returncode == 0, multiplexer.stderr
    assert "USB-6008" in multiplexer.stdout
    assert bench.state()["multiplexer"]["writes"] == 0

    measured = probe("multiplexer", "-c", bench.config, "--write", "--record", tmp_path / "multiplexer")
    assert measured.returncode == 0, measured.stderr
    assert re.search(r"input 3 \(zenith\): \+\d+\.\d{4} mV, \d+\.\d W/m2", measured.stdout)
    assert sent(tmp_path / "multiplexer") == [b"%d" % channel for channel in range(8)]

    again = probe("voltmeter", "-c", bench.config, "--record", tmp_path / "voltmeter")
    assert (again.returncode, "is there already" in again.stderr) == (2, True)


def test_a_small_move_is_timed_and_the_axes_come_back(start_bench):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z")
    moved = probe("positioner", "-c", bench.config, "--seconds", "1", "--move-deg", "2")
    assert moved.returncode == 0, moved.stderr
    speeds = [float(text) for text in re.findall(r"([\d.]+) units/s", moved.stdout)]
    assert len(speeds) == 4
    assert all(1.5 < speed < 4.0 for speed in speeds)
    assert bench.state()["pose"] == pytest.approx({"a_deg": 0.0, "b_deg": 90.0}, abs=0.5)


def test_what_is_absent_wrong_or_hangs_is_one_sentence_and_2(start_bench, tmp_path):
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
        done = probe(*arguments)
        assert done.returncode == 2, arguments
        assert re.search(sentence, done.stderr), (arguments, done.stderr)
        assert "Traceback" not in done.stderr
    bench.ask("freeze", "positioner")
    hung = probe("positioner", "--port", positioner)
    assert (hung.returncode, "bootloader" in hung.stderr) == (2, True)
