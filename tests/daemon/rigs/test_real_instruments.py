"""Choosing real instruments: what the configuration takes, and what is never done silently."""

import subprocess
import sys
from pathlib import Path

import pytest

from daemon.base.clock import LoopClock, SystemClock
from daemon.base.errors import UserError
from daemon.config.file import ConfigError, load_settings
from daemon.rigs.real import build_real_rig
from daemon.service.rig import Role
from tests.support import PATIENCE_S

pytestmark = pytest.mark.slow

HELIOCUBE = Path(sys.executable).with_name("heliocube")
REAL = """
[instruments]
kind = "real"
[instruments.voltmeter]
resource = "ASRL/dev/serial/by-id/usb-FTDI_FT232R-if00-port0::INSTR"
[instruments.positioner]
port = "/dev/heliocube-positioner"
"""


@pytest.fixture
def load(tmp_path):
    def load_text(text):
        (tmp_path / "heliocube.toml").write_text(text)
        return load_settings(tmp_path / "heliocube.toml")

    return load_text


def test_a_real_rig_has_the_instruments_of_its_role_and_no_wind_sensor_and_is_not_simulated(load):
    settings = load(REAL)
    assert settings.real
    for role, present in ((Role.BOTH, (1, 1)), (Role.CUBE, (1, 0)), (Role.TRACKER, (0, 1))):
        rig = build_real_rig(settings, role, SystemClock())
        assert tuple(bool(part) for part in (rig.cube, rig.trackers)) == present
        assert (rig.simulated, rig.wind_speed_m_s, rig.sky_text) == (False, None, None)
        assert rig.has_persistent_clock


def test_the_clock_of_a_bench_is_not_taken_to_go_on_over_restarts(load):
    settings = load(REAL.replace('kind = "real"', 'kind = "real"\nbench = true'))
    assert not build_real_rig(settings, Role.BOTH, LoopClock(lambda: 0.0, 1.7e9)).has_persistent_clock


def test_a_rig_at_a_bench_is_marked_as_simulated(load):
    settings = load(REAL.replace('kind = "real"', 'kind = "real"\nbench = true'))
    assert settings.real
    assert build_real_rig(settings, Role.BOTH, SystemClock()).simulated


def test_a_role_requires_the_instrument_addresses_that_it_needs_and_no_others(load):
    settings = load('[instruments]\nkind = "real"\n')
    with pytest.raises(UserError, match=r"instruments.voltmeter.resource is missing"):
        build_real_rig(settings, Role.CUBE, SystemClock())
    with pytest.raises(UserError, match=r"instruments.positioner.port is missing"):
        build_real_rig(settings, Role.TRACKER, SystemClock())


@pytest.mark.parametrize(
    ("key", "names"),
    [
        ("positioner.port", ["/dev/ttyACM0", "/dev/ttyUSB12", "/dev/pts/4", "ttyACM0", ""]),
        ("voltmeter.prologix_port", ["/dev/ttyUSB0"]),
        ("voltmeter.resource", ["ASRL/dev/ttyUSB0::INSTR", "ASRL/dev/pts/3::INSTR", "/dev/ttyUSB0", "GPIB::X::INSTR"]),
        ("multiplexer.server", ["192.168.1.30", "192.168.1.30:0", "192.168.1.30:99999", "http://pc:31763"]),
        ("multiplexer.digital_port", ["Dev1", "Dev1/port0/line0", "/port0"]),
    ],
)
def test_an_instrument_address_that_changes_when_replugged_or_is_invalid_is_refused_with_the_remedy(load, key, names):
    section, name = key.split(".")
    for value in names:
        with pytest.raises(ConfigError) as caught:
            load(f'[instruments.{section}]\n{name} = "{value}"\n')
        (problem,) = caught.value.problems
        assert problem.startswith(f'instruments.{key} = "{value}": must be ')


@pytest.mark.parametrize(
    ("key", "names"),
    [
        ("positioner.port", ["/dev/serial/by-id/usb-X", "/dev/heliocube-positioner", "COM5", "/dev/ttyS0"]),
        ("voltmeter.resource", ["GPIB0::16::INSTR", "ASRLCOM5::INSTR", "ASRL3::INSTR", "ASRL/dev/meter::INSTR"]),
        ("multiplexer.server", ["192.168.1.30:31763", "daq-pc.lab:31763", "[fd00::5]:31763"]),
    ],
)
def test_instrument_addresses_that_stay_the_same_when_replugged_are_accepted(load, key, names):
    section, name = key.split(".")
    for value in names:
        load(f'[instruments.{section}]\n{name} = "{value}"\n')


def test_settings_that_do_not_go_together_are_refused_by_name(load):
    mistakes = {
        "[cube.east]\nchannel = 9\n": "cube.east.channel = 9: is not among the inputs",
        "[instruments.multiplexer]\nenable_line = 1\n": "instruments.multiplexer.enable_line = 1: is used by",
        "[instruments.positioner.a_axis]\napex_deg = 150.0\n": "instruments.positioner.a_axis.apex_deg = 150.0: makes",
    }
    for text, start in mistakes.items():
        with pytest.raises(ConfigError) as caught:
            load(text)
        (problem,) = caught.value.problems
        assert problem.startswith(start)


def test_an_axis_with_only_some_keys_in_the_file_keeps_its_own_defaults_for_the_others(load):
    positioner = load("[instruments.positioner.b_axis]\narm_1_mm = 310.0\n").instruments.positioner
    assert (positioner.b_axis.arm_1_mm, positioner.b_axis.low_deg, positioner.b_axis.apex_deg) == (310.0, 13.0, 37.5)
    assert positioner.a_axis.low_deg == -52.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--speed", "60"], "--speed: this configuration has real instruments"),
        (["--weather", "clear", "--seed", "2"], "--weather, --seed: this configuration has real instruments"),
        ([], "instruments.voltmeter.resource is missing"),
    ],
)
def test_run_with_wrong_options_or_a_missing_address_of_real_instruments_ends_with_a_sentence_and_2(
    tmp_path, arguments, sentence
):
    (tmp_path / "heliocube.toml").write_text('[instruments]\nkind = "real"\n')
    done = subprocess.run(
        [str(HELIOCUBE), "run", "--config", str(tmp_path / "heliocube.toml"), *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
    assert "SIMULATED" not in done.stderr + done.stdout


def test_a_service_with_real_instruments_imports_neither_simulators_nor_libraries_of_the_studies(tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text(REAL + '[bridge]\ninsecure = true\nlisten = "127.0.0.1:0"\n[api]\nlisten = "127.0.0.1:0"\n')
    done = subprocess.run(
        [sys.executable, "-X", "importtime", str(HELIOCUBE), "run", "--config", str(file), "--for", "1"],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-1000:]
    loaded = {line.rpartition("|")[2].strip().partition(".")[0] for line in done.stderr.splitlines() if "|" in line}
    assert "numpy" in loaded
    assert not loaded & {"sim_drivers", "pvlib", "pandas", "scipy", "h5py", "matplotlib"}
