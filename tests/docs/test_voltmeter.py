"""The worked example of docs/develop/add-voltmeter.md, installed as a package of somebody else."""

import asyncio
import math
import re
import subprocess
import sys

import numpy as np
import pytest

import heliocube
from daemon.base.clock import LoopClock, SystemClock
from daemon.base.errors import UserError
from daemon.base.plugins import load
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.file import load_settings
from daemon.rigs.probe_cube import probe_multiplexer, probe_voltmeter
from daemon.rigs.real import build_cube, cube_surroundings
from drivers.errors import DeadlineError, IdentityError, LinkLostError
from drivers.transcript import no_tap
from tests.support import DOCS
from tests.support.packages import install

pytestmark = pytest.mark.slow

PAGE = (DOCS / "develop" / "add-voltmeter.md").read_text()
(CODE,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
PYPROJECT, CONFIG = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
HALF_AN_HOUR = {"start": "2022-10-14T10:00Z", "days": 0.5 / 24, "weather": "clear", "seed": 3}


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A configuration that takes the example, which lies in a folder on the path as an installer leaves it."""
    points = PYPROJECT.replace('[project.entry-points."heliocube.cube"]', "[heliocube.cube]")
    install(monkeypatch, tmp_path / "site", points.replace('"', ""), {"scanner": CODE})
    config = tmp_path / "heliocube.toml"
    config.write_text(CONFIG)
    return config


def test_a_simulated_rig_reads_the_same_with_the_example_cube_as_with_the_usual_one(file):
    start = HALF_AN_HOUR["start"]
    rest = {name: value for name, value in HALF_AN_HOUR.items() if name != "start"}
    own, usual = heliocube.simulate(start, config=file, **rest), heliocube.simulate(start, **rest)
    assert own["decisions"]["mode"].iloc[-1] == "tracking"
    numbers = [name for name in own["scans"].columns if name.endswith("_w_m2")]
    assert len(numbers) == 4
    np.testing.assert_allclose(own["scans"][numbers].mean(), usual["scans"][numbers].mean(), rtol=0.01)


class Answers:
    """A line on which the meter gives these answers; an exception is raised."""

    def __init__(self, *answers):
        self.answers = list(answers)
        self.asked = []

    async def open(self):
        pass

    async def close(self):
        pass

    async def interrupt(self):
        pass

    async def drain(self, quiet_s):
        pass

    async def ask(self, text, within_s):
        self.asked.append(text)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


def reading_of(file, line):
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        settings = load_settings(file)
        around = cube_surroundings(settings, LoopClock(runner.get_loop().time, 1665576000.0))
        cube = load("heliocube.cube", "scanner").Scanner(line, settings.instruments.cube, around)

        async def work():
            await cube.open()
            return await cube.read()

        return runner.run(work())


def test_a_face_without_a_valid_voltage_does_not_affect_the_other_faces(file):
    line = Answers("HEWLETT-PACKARD,34970A,0,1", "+3.0E-02,+9.9E+37,NAN,-1.0E-05")
    faces = reading_of(file, line).faces
    assert [face.flaw for face in faces] == [None, "over-range", "missing", None]
    assert [face.value for face in faces] == pytest.approx([0.03, math.nan, math.nan, -1e-5], nan_ok=True)
    assert line.asked == ["*IDN?", "MEAS:VOLT:DC? (@201:204)"]


@pytest.mark.parametrize("answer", ["+1.0E-02", "+1E-02,+1E-02,+1E-02,+1E-02,+1E-02", DeadlineError("scanner", "late")])
def test_a_late_answer_or_one_without_exactly_four_voltages_is_a_lost_link(file, answer):
    with pytest.raises(LinkLostError):
        reading_of(file, Answers("HEWLETT-PACKARD,34970A,0,1", answer))


def test_an_instrument_of_another_model_is_refused(file):
    with pytest.raises(IdentityError, match="no 34970A"):
        reading_of(file, Answers("KEITHLEY,2000"))


def test_a_real_rig_without_a_meter_address_is_refused_naming_the_missing_key(file):
    file.write_text(CONFIG + '[instruments]\nkind = "real"\n')
    with pytest.raises(UserError, match=r"instruments\.cube\.resource is missing"):
        build_cube(load_settings(file), SystemClock())


def test_the_rules_of_the_multiplexer_do_not_apply_to_the_example_cube(file):
    file.write_text(CONFIG + "[cube]\nscan_every_s = 0.5\n[cube.south]\nchannel = 0\n")
    assert load_settings(file).cube.scan_every_s == 0.5


def test_a_wrong_setting_of_the_example_cube_is_refused_with_its_key_and_allowed_range(file):
    file.write_text(CONFIG.replace("201", "7"))
    with pytest.raises(
        UserError, match=r"instruments\.cube\.first_channel = 7: must be a whole number from 101 to 316"
    ):
        load_settings(file)


def test_an_unknown_cube_driver_is_refused_with_a_list_of_the_known_ones(file):
    file.write_text(CONFIG.replace('"scanner"', '"scaner"'))
    with pytest.raises(UserError, match=r'instruments\.cube\.driver = "scaner".*"multiplexed".*"scanner"'):
        load_settings(file)


def test_probing_a_multiplexer_or_voltmeter_is_refused_with_the_example_cube(file):
    settings = load_settings(file)
    with pytest.raises(UserError, match='only the cube "multiplexed" has a multiplexer'):
        asyncio.run(probe_multiplexer(settings, no_tap, print, write=False))
    with pytest.raises(UserError, match='only the cube "multiplexed" has a voltmeter'):
        asyncio.run(probe_voltmeter(settings, lambda: 0.0, no_tap, print, write=False))


def test_built_in_cube_drivers_are_not_imported_when_the_example_cube_is_configured(file, tmp_path):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from pathlib import Path;"
        "from daemon.config.file import load_settings; load_settings(Path(sys.argv[2])); import daemon.rigs.simulated;"
        "print(*(name for name in sys.modules if name.startswith(('scanner', 'drivers.cube.'))))"
    )
    command = [sys.executable, "-c", code, tmp_path / "site", file]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["scanner"]
