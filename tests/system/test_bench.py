"""The bench as independent programs see it: its files, its ports, its commands."""

import asyncio
import contextlib
import os
import re
import subprocess
import sys
import termios
import textwrap
import time

import pytest
import serial

from daemon.base.clock import SystemClock
from daemon.base.records import FACES
from daemon.commands.file_check import check_file
from daemon.rigs.real import build_cube
from drivers.errors import DeviceError
from drivers.positioners.pozsol.wire import TokenStream
from sim_drivers.bench.client import BenchError
from tests.support import PATIENCE_S, forks
from tests.system.processes import wait_until

pytestmark = pytest.mark.system


def heliocube(*arguments):
    return forks.run(*arguments)


def test_a_bench_writes_all_that_a_service_needs_and_removes_its_ports_when_it_ends(start_bench):
    bench = start_bench("--weather", "clear", "--start", "2022-06-21T12:00Z", "--site", "55.79,12.52", "--seed", "5")
    settings = check_file(bench.config)
    assert settings.instruments.kind == "real"
    assert settings.instruments.positioner.port == str(bench.directory / "positioner")
    assert (settings.site.latitude_deg, settings.simulation.seed, settings.simulation.speed) == (55.79, 5, 1.0)
    state = bench.state()
    assert state["utc"].startswith("2022-06-21T12:0")
    assert 45 < state["sun"]["elevation_deg"] < 60
    assert state["pose"] == pytest.approx({"a_deg": 0.0, "b_deg": 90.0})
    assert bench.stop() == 0
    assert sorted(path.name for path in bench.directory.iterdir()) == ["bench.log", "heliocube.toml"]


def test_a_bench_is_refused_in_a_folder_with_another_bench_or_a_foreign_configuration(start_bench, tmp_path):
    bench = start_bench()
    before = bench.config.read_bytes()
    second = heliocube("bench", "--dir", bench.directory)
    assert (second.returncode, "running there already" in second.stderr) == (2, True)
    assert bench.config.read_bytes() == before
    (tmp_path / "heliocube.toml").write_text("[site]\nname = 'mine'\n")
    third = heliocube("bench", "--dir", tmp_path)
    assert (third.returncode, "was not written by a bench" in third.stderr) == (2, True)
    assert "Traceback" not in second.stderr + third.stderr


@pytest.mark.parametrize(
    ("name", "options"), [("load", ()), ("positioner", ()), ("cube", ("--cube", "scanning-meter"))]
)
def test_a_bench_refuses_to_replace_a_file_that_has_the_name_of_one_of_its_ports(tmp_path, name, options):
    (tmp_path / name).write_text("somebody's own\n")
    done = heliocube("bench", "--dir", tmp_path, *options)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"{tmp_path / name} exists and is not a port of a bench" in done.stderr
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "somebody's own\n"}


def test_a_bench_on_a_full_disk_reports_it_and_leaves_no_partial_configuration(tmp_path):
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", tmp_path], capture_output=True)
    if made.returncode:
        pytest.skip("mounting a small file system needs root")
    try:
        with contextlib.suppress(OSError), (tmp_path / "filler").open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))
        done = heliocube("bench", "--dir", tmp_path)
        assert (done.returncode, "Traceback" in done.stderr) == (2, False)
        last = done.stderr.splitlines()[-1]
        assert last == f"heliocube: {tmp_path / 'heliocube.toml'} cannot be written: No space left on device"
        assert [path.name for path in tmp_path.iterdir()] == ["filler"]
    finally:
        subprocess.run(["umount", "--lazy", tmp_path], check=True)


def test_a_mistaken_command_to_a_bench_is_refused_with_a_sentence(start_bench, tmp_path):
    bench = start_bench()
    mistakes = {
        ("explode",): "no command 'explode'",
        ("unplug",): "usage: unplug DEVICE [SECONDS]",
        ("unplug", "toaster"): "'toaster' is not one of positioner, voltmeter, multiplexer, server",
        ("unplug", "voltmeter", "soon"): "'soon' is not a number",
        ("shade", "east", "2"): "2 is not in 0 to 1",
        ("mux-line", "3", "high"): "'3' is not one of 0, 1, 2",
        ("inject", "meteor"): "'meteor' is not one of",
        ("repair", "re_reference"): "there is nothing to end",
        ("drop", "voltmeter", "-1"): "'-1' is not a whole number",
        ("fail", "200220"): "errors of the DAQ driver are negative",
        ("fail", "many"): "fail: 'many' is not a whole number",
        ("drop", "voltmeter", "9" * 5000): "999' is not a whole number from 0 to 1000000",
    }
    for command, sentence in mistakes.items():
        with pytest.raises(BenchError, match=re.escape(sentence)):
            bench.ask(*command)
    told = heliocube("bench-ctl", bench.directory, "explode")
    assert (told.returncode, told.stderr.count("\n")) == (2, 1)
    nobody = heliocube("bench-ctl", tmp_path / "nowhere", "state")
    assert (nobody.returncode, "no bench answers" in nobody.stderr) == (2, True)


def test_a_plug_pulled_again_without_a_time_stays_out_in_spite_of_an_earlier_time(start_bench):
    bench = start_bench()
    for device in ("voltmeter", "load", "positioner"):
        bench.ask("unplug", device, "2")
    bench.ask("replug", "voltmeter")
    bench.ask("unplug", "voltmeter")
    bench.ask("unplug", "load")
    bench.ask("unplug", "positioner")
    bench.ask("power-cycle", "positioner")
    time.sleep(3.0)
    state = bench.state()
    assert [state[device]["plugged"] for device in ("voltmeter", "load", "positioner")] == [False] * 3
    bench.ask("replug", "positioner")
    bench.ask("power-cycle", "positioner")
    wait_until(lambda: bench.state()["positioner"]["plugged"], "the positioner's port")


def test_the_benchs_positioner_streams_all_screens_and_comes_back_under_the_same_port_name(start_bench):
    bench = start_bench()
    link = bench.directory / "positioner"
    with serial.Serial(str(link), timeout=30, exclusive=True) as port:
        text = port.read(5000)
        assert {code for code, _ in TokenStream().feed(text)} >= {37, 38, 39, 40, 44, 45, 48, 49, 56, 58, 87, 136, 204}
        bench.ask("unplug", "positioner")
        with pytest.raises(serial.SerialException):
            read_to_the_end(port)
        assert not link.is_symlink()
    bench.ask("replug", "positioner")
    with serial.Serial(str(link), timeout=30) as port:
        assert TokenStream().feed(port.read(500))


def test_the_echo_of_a_port_in_its_default_mode_harms_the_positioner_and_raw_mode_does_not(start_bench):
    bench = start_bench()
    link = bench.directory / "positioner"
    before = bench.state()["positioner"]
    assert before["received"] == {}
    with serial.Serial(str(link), timeout=30) as port:
        # A port echoes until it is set to raw mode: on a rig the udev rule comes first, here nothing does.
        assert len(port.read(500)) == 500
        opened = bench.state()["positioner"]
        # A whole round of screens in raw mode.
        assert len(port.read(5000)) == 5000
        quiet = bench.state()["positioner"]
        for key in ("received", "destination", "stored"):
            assert quiet[key] == opened[key]
    bench.ask("unplug", "positioner")
    bench.ask("replug", "positioner")
    naive = os.open(link, os.O_RDWR | os.O_NOCTTY)
    try:
        assert termios.tcgetattr(naive)[3] & termios.ECHO
        # The echo orders it to go where it stands, to forget its status, to store its settings anew.
        harm = {"44", "48", "70", "96", "136"}
        wait_until(lambda: harm <= set(bench.state()["positioner"]["received"]), "the echo of all screens")
        assert bench.state()["positioner"]["destination"] != before["destination"]
    finally:
        os.close(naive)


def test_an_independent_client_configures_and_reads_the_voltmeter(start_bench):
    bench = start_bench("--weather", "clear")
    bench.ask("sensor", "zenith", "0.0625")
    program = f"""
        from pymeasure.instruments.keithley import Keithley2000

        meter = Keithley2000("ASRL{bench.directory}/voltmeter::INSTR", visa_library="@py",
                             asrl=dict(baud_rate=19200), read_termination="\\n", write_termination="\\n")
        assert "MODEL 2000" in meter.id, meter.id
        meter.reset()
        meter.measure_voltage(max_voltage=0.1)
        meter.voltage_nplc = 2
        assert meter.mode == "voltage", meter.mode
        assert meter.voltage_nplc == 2, meter.voltage_nplc
        assert meter.voltage_range == 0.1, meter.voltage_range
        print(meter.voltage)
        errors = meter.check_errors()
        assert not errors, errors
        meter.adapter.close()
    """
    # After power-up the multiplexer stands on its last input, where nothing is connected: the zenith is selected first.
    run_python(select(bench, 3))
    reading = float(run_python(program))
    assert reading == pytest.approx(0.0625, abs=2e-6)


def test_the_voltmeter_line_is_no_faster_than_its_baud_rate(start_bench, tmp_path):
    config = tmp_path / "slow.toml"
    config.write_text("[instruments.voltmeter]\nbaud_rate = 600\n")
    bench = start_bench("--config", config)
    with serial.Serial(str(bench.directory / "voltmeter"), timeout=10) as port:
        start_s = time.monotonic()
        port.write(b"*IDN?\n")
        identity = port.read_until(b"\n")
        # A lower bound is no race: the bits cannot have come sooner.
        assert time.monotonic() - start_s >= (len(identity) + len(b"*IDN?\n")) * 10 / 600
        assert b"MODEL 2000" in identity


def test_an_independent_client_switches_the_multiplexer_and_loses_its_task_with_the_plug(start_bench):
    bench = start_bench()
    assert bench.state()["multiplexer"]["selected"] == 7
    run_python(select(bench, 2))
    assert bench.state()["multiplexer"]["selected"] == 2
    bench.ask("mux-line", "0", "high")
    assert bench.state()["multiplexer"]["selected"] == 3
    bench.ask("mux-line", "0", "works")
    bench.ask("unplug", "multiplexer")
    assert bench.state()["multiplexer"]["selected"] == 7
    assert "-200220" in run_python(select(bench, 1), fails=True)
    bench.ask("replug", "multiplexer")
    bench.ask("fail", "-50405")
    assert "-50405" in run_python(select(bench, 1), fails=True)
    assert bench.state()["multiplexer"]["selected"] == 7
    run_python(select(bench, 1))
    assert bench.state()["multiplexer"]["selected"] == 1
    bench.ask("unplug", "server")
    assert "UNAVAILABLE" in run_python(select(bench, 1), fails=True)
    bench.ask("replug", "server")
    run_python(select(bench, 5))
    assert bench.state()["multiplexer"]["selected"] == 5


def read_to_the_end(port):
    while port.read(1000):
        pass


def select(bench, channel):
    return f"""
        import grpc, nidaqmx
        from nidaqmx.constants import LineGrouping

        with grpc.insecure_channel("{check_file(bench.config).instruments.multiplexer.server}") as channel:
            with nidaqmx.Task(grpc_options=nidaqmx.GrpcSessionOptions(channel, "")) as task:
                task.do_channels.add_do_chan("Dev1/port0/line0:2", line_grouping=LineGrouping.CHAN_FOR_ALL_LINES)
                task.write({channel})
    """


def run_python(program, fails=False):
    """Run a program in a process of its own: these libraries keep threads and descriptors until their process ends."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert (done.returncode != 0) is fails, done.stderr
    return done.stderr if fails else done.stdout


def test_a_bench_of_pyranometers_can_be_probed_with_the_configuration_that_it_writes(start_bench):
    bench = start_bench("--cube", "modbus-pyranometers", "--weather", "clear", "--start", "2022-06-21T12:00Z")
    assert check_file(bench.config).instruments.cube.line == str(bench.directory / "cube")
    for wrong in (("address", "300"), ("status", "70000"), ("corrupt", ""), ("silent", "3")):
        with pytest.raises(BenchError, match=f"^pyranometer: '{wrong[1]}' is not a whole|silent takes no value"):
            bench.ask("pyranometer", "south", *wrong)
    bench.ask("pyranometer", "south", "status", "8")
    # A busy machine lets an answer wait for longer than a sensor does.
    patient = bench.config.with_name("patient.toml")
    patient.write_text(bench.config.read_text().replace("answer_within_s = 0.3", "answer_within_s = 5.0"))
    done = heliocube("probe", "cube", "--config", patient, "--addresses", "1-4", "--clear")
    assert done.returncode == 0, done.stderr
    assert len(re.findall(r"address \d: SMP3 no. 2410\d .* W/m2", done.stdout)) == 4
    assert "error 9 cleared" in done.stdout
    network = heliocube("probe", "cube", "--line", f"tcp:127.0.0.1:{bench.state()['cube']['tcp_port']}")
    assert "address 4: SMP3 no. 24104" in network.stdout


def test_pyranometers_configured_on_several_lines_get_addresses_of_their_own_on_the_benchs_line(start_bench, tmp_path):
    config = tmp_path / "lines.toml"
    lines = {"east": "one", "south": "two", "west": "three", "zenith": "four"}
    config.write_text(
        '[instruments]\nkind = "real"\n[instruments.cube]\ndriver = "modbus-pyranometers"\n'
        + "".join(
            f'[instruments.cube.{face}]\nline = "/dev/serial/by-id/{name}"\naddress = 7\n'
            for face, name in lines.items()
        )
    )
    bench = start_bench("--config", config)
    assert [each["address"] for each in bench.state()["cube"]["sensors"]] == [1, 2, 3, 4]
    cube = check_file(bench.config).instruments.cube
    assert {(cube.line_of(face), cube.face(face).address) for face in lines} == {
        (str(bench.directory / "cube"), address) for address in (1, 2, 3, 4)
    }


def test_the_driver_reads_a_benchs_scanning_meter_before_and_after_a_pulled_plug(start_bench):
    bench = start_bench("--cube", "scanning-meter", "--weather", "clear", "--start", "2022-06-21T12:00Z")
    settings = check_file(bench.config)

    async def read():
        cube = build_cube(settings, SystemClock())
        assert "MODEL 2000" in await cube.open()
        volts = [face.value for face in (await cube.read()).faces]
        bench.ask("unplug", "cube")
        with pytest.raises(DeviceError):
            await cube.read()
        await cube.close()
        bench.ask("replug", "cube")
        await cube.open()
        again = [face.value for face in (await cube.read()).faces]
        await cube.close()
        return volts, again

    volts, again = asyncio.run(read())
    truth = [bench.state()["faces"][f"{name}_w_m2"] for name in FACES]
    gains = [getattr(settings.cube, name).gain_w_m2_per_mv for name in FACES]
    expected = [1e-3 * irradiance / gain for irradiance, gain in zip(truth, gains, strict=True)]
    assert volts == pytest.approx(expected, rel=0.1)
    assert again == pytest.approx(volts, rel=0.05)
    assert bench.state()["cube"]["make"] == "keithley2000-scan"
