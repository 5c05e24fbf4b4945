"""A third party's package in a folder of its own: a positioner and a law, installed by its entry points alone."""

import subprocess
import sys
from datetime import UTC, datetime

import pandas as pd
import pytest

from daemon.base.clock import SystemClock
from daemon.base.errors import UserError
from daemon.base.state import StateFolder
from daemon.commands.file_check import check_file
from daemon.config.file import ConfigError
from daemon.rigs.real import build_positioner
from daemon.rigs.simulated import build_simulated_positioner
from daemon.studies.simulate import simulate
from daemon.tracker.pointing import build_pointing
from tests.support.packages import install

LAW = '''
from pydantic import Field

from solar.frames import direction_from_azimuth
from solar.laws.law import DirectionLaw, LawSettings


class BearingSettings(LawSettings):
    """bearing: towards one point of the compass."""

    bearing_deg: float = Field(180.0, ge=90, le=270, description="Where to, from north clockwise.")


class BearingLaw(DirectionLaw):
    def __init__(self, settings, tracker):
        super().__init__(tracker)
        self._direction = direction_from_azimuth(settings.bearing_deg, 45.0, tracker.site.latitude_deg)

    def direction(self, now, to_sun):
        return self._direction


SETTINGS = BearingSettings
build = BearingLaw
'''

POSITIONER = '''
from pydantic import Field

from drivers.interfaces import PositionerIdentity, Telemetry
from drivers.settings import PositionerSettings, SettingsError


class TurntableSettings(PositionerSettings):
    """turntable: moves at once."""

    serial_number: str | None = Field(None, examples=["T-1"], description="Which one.")


class Turntable:
    def __init__(self, surroundings):
        self._now = surroundings.monotonic
        self._limits = surroundings.limits
        self.angles = (0.0, 90.0)

    async def open(self):
        return PositionerIdentity("turntable", "1", "T-1", simulated=True)

    async def close(self):
        pass

    async def read_telemetry(self):
        a, b = self.angles
        return Telemetry(self._now(), a, b, a, b, a, b, status_monotonic_s=self._now())

    async def disable_autonomy(self):
        pass

    async def move_to(self, a_deg, b_deg, *, first="a"):
        if not self._limits.contain(a_deg, b_deg):
            raise ValueError("outside")
        self.angles = (a_deg, b_deg)

    async def stop(self):
        pass

    async def halt(self):
        pass

    async def home(self, axis):
        pass

    async def clear_faults(self, *, forgive=True):
        return await self.read_telemetry()


SETTINGS = TurntableSettings


def build(settings, surroundings):
    if settings.serial_number is None:
        raise SettingsError("instruments.positioner.serial_number is missing: give that of the turntable")
    return Turntable(surroundings)


def simulate(settings, surroundings):
    table = Turntable(surroundings)
    return lambda now_s: table.angles, table
'''


@pytest.fixture
def package(tmp_path, monkeypatch):
    points = "[heliocube.law]\nbearing = acme_law\n\n[heliocube.positioner]\nturntable = acme_turntable\n"
    install(monkeypatch, tmp_path / "site", points, {"acme_law": LAW, "acme_turntable": POSITIONER})


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "heliocube.toml"
    path.write_text(
        "[law]\ndriver = 'bearing'\nbearing_deg = 150.0\n[instruments.positioner]\ndriver = 'turntable'\n"
        "[simulation]\nweather = 'clear'\n"
    )
    return path


def test_a_third_party_law_points_a_third_party_positioner_on_the_simulated_rig(package, file, tmp_path):
    settings = check_file(file)
    out = tmp_path / "out"
    start = datetime(2022, 10, 12, 10, 0, tzinfo=UTC)
    summary = simulate(settings, start, 0.02, out, "csv", lambda _share: None)
    decisions = pd.read_csv(out / "decisions.csv")
    assert set(decisions["law"]) == {"bearing"}
    assert decisions["direction_azimuth_deg"].to_numpy() == pytest.approx(150.0, abs=0.1)
    poses = pd.read_csv(out / "poses.csv")
    last = poses.iloc[-1]
    assert (last["a_deg"], last["b_deg"]) == pytest.approx(
        (decisions["target_a_deg"].iloc[-1], decisions["target_b_deg"].iloc[-1]), abs=0.1
    )
    assert summary.moves == 1


@pytest.mark.parametrize("faces", [1, 4])
def test_a_third_party_law_may_need_one_face_or_all_four(package, file, tmp_path, faces):
    law = tmp_path / "site" / "acme_law.py"
    asking = f"        self.faces_needed = {faces}\n        self._direction ="
    law.write_text(LAW.replace("        self._direction =", asking))
    assert build_pointing(check_file(file), 0.0, StateFolder(None)).law.faces_needed == faces


@pytest.mark.parametrize("wrong", ["faces_needed = 0", "faces_needed = 5", "decide_every_s = float('nan')"])
def test_a_law_that_asks_for_0_or_5_faces_or_no_valid_interval_is_refused_at_the_start(package, file, tmp_path, wrong):
    law = tmp_path / "site" / "acme_law.py"
    law.write_text(LAW.replace("        self._direction =", f"        self.{wrong}\n        self._direction ="))
    with pytest.raises(UserError, match=r"law\.driver: the law bearing asks for"):
        build_pointing(check_file(file), 0.0, StateFolder(None))


def test_a_third_party_driver_reports_its_missing_settings_in_its_own_words(package, file):
    settings = check_file(file)
    with pytest.raises(UserError, match="serial_number is missing"):
        build_positioner(settings, SystemClock())


def test_a_driver_that_cannot_simulate_its_unit_is_refused_on_a_simulated_rig_with_the_remedy(package, file, tmp_path):
    module = tmp_path / "site" / "acme_turntable.py"
    module.write_text(module.read_text().replace("def simulate(", "def simulated("))
    with pytest.raises(UserError, match=r'"turntable" cannot be simulated .*: set instruments\.positioner\.driver to'):
        build_simulated_positioner(check_file(file), SystemClock())


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "[law]\ndriver = 'q'",
            'law.driver = "q": must be "bearing", "chronometric", "flat", "mu-prime", "optimal" or "sun-vector"',
        ),
        (
            "[instruments.positioner]\ndriver = 'lathe'",
            'instruments.positioner.driver = "lathe": must be "pozsol", "rotctld" or "turntable"',
        ),
        (
            "[law]\ndriver = 'bearing'\nbearing_deg = 300",
            "law.bearing_deg = 300: must be a number from 90 to 270 deg",
        ),
        (
            "[instruments.positioner]\ndriver = 'turntable'\nserial_numbr = 'T-1'",
            (
                'instruments.positioner.serial_numbr = "T-1": there is no such key;'
                " did you mean instruments.positioner.serial_number?"
            ),
        ),
        (
            "[instruments.positioner]\ndriver = 'turntable'\nserial_number = 1",
            "instruments.positioner.serial_number = 1: must be text in quotes",
        ),
    ],
)
def test_mistakes_in_third_party_settings_are_reported_like_those_in_built_in_settings(package, tmp_path, text, line):
    (tmp_path / "wrong.toml").write_text(text + "\n")
    with pytest.raises(ConfigError) as caught:
        check_file(tmp_path / "wrong.toml")
    assert caught.value.problems == (line,)


def test_with_a_third_party_positioner_the_built_in_drivers_are_not_imported(package, file, tmp_path):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from pathlib import Path;"
        "from daemon.config.file import load_settings; load_settings(Path(sys.argv[2]));"
        "print(*(name for name in sys.modules if name.startswith(('acme', 'drivers.positioners'))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "site", file], capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == {"acme_law", "acme_turntable"}
