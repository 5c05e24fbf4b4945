"""Every script of `tests/measurements`: a small part of it is run, or the reason why not is named here.

The pages quote their figures, and nobody runs them for months. The usage of each names its options.
"""

import ast
import importlib
import logging
import re
import subprocess
import sys
from typing import NamedTuple

import pytest

from daemon.commands.main import main
from tests.support import ROOT

pytestmark = pytest.mark.slow

FOLDER = ROOT / "tests" / "measurements"
SCRIPTS = {path.stem: path.read_text(encoding="utf-8") for path in sorted(FOLDER.glob("*.py"))}
GUARD = '\nif __name__ == "__main__":\n'
WITH_OPTIONS = [name for name, text in SCRIPTS.items() if "\nimport argparse\n" in text]
OPTION = re.compile(r"--[a-z-]+")
SIRTA = "48.7176,2.2090,156"


class Slice(NamedTuple):
    """The least that a script can do: its arguments, a pattern of its answer, and constants that make it smaller."""

    arguments: tuple[str, ...]
    answer: str
    smaller: tuple[tuple[str, float], ...] = ()


SLICES = {
    "ceilings": Slice((SIRTA, "weather/day.csv", "--without-trees", "--prices", "1"), r"optimal +-?\d"),
    "compare_measured": Slice((SIRTA, "weather/day.csv"), r"1 afternoons: median", (("AFTERNOON_S", 3600.0),)),
    "curve_size": Slice((), r"with points: \d+ bytes", (("CURVES", 50),)),
    "face_faults": Slice(("weather", "13"), r"\| dead \|.*\| [0-4] of 4"),
    "optimal_burdens": Slice((SIRTA, "weather/day.csv"), r"sun-vector, a dead zenith face +-?\d"),
    "overcast_pointing": Slice((), r"clear sky: turned by 0\.000 deg", (("DRAWS", 100),)),
    "rows": Slice(("weather", "--every", "1", "--laws", "optimal"), r"optimal: a decision takes"),
    "site_years": Slice(("days", "1"), r"1 sites of one day"),
    "speed": Slice(
        ("1", SIRTA, "weather/day.csv"), r"a year of weather, all laws: median", (("DAYS", 1), ("LOWEST_SUN", 0.88))
    ),
    "theory_grid": Slice(("1",), r"all three: median"),
    "wrong_readings": Slice((SIRTA, "weather/day.csv", "--every", "1", "--days", "1", "--scan", "60"), r"gaps +-?\d"),
}
# Why no part of the others is run.
PROCESSES = "real time, processes of its own and what they need"
BROWSER = "real time, and a browser"
NOT_RUN = {
    **dict.fromkeys(("api_attack", "archive", "bridge_flood", "browser_storm", "fleet", "modbus_scan"), PROCESSES),
    **dict.fromkeys(("positioner_wire", "shares", "slow_disk", "stop_latency"), PROCESSES),
    **dict.fromkeys(("dashboard", "dashboard_day", "dashboard_pictures", "report_picture"), BROWSER),
    **dict.fromkeys(
        ("calibration_level", "calibration_pointing", "face_plausibility", "face_weeks"), "months of weather"
    ),
    "endurance": "a day takes many seconds",
    "firmware_agreement": "tests/firmware does the same with some sequences",
    "home_assistant": "asks for another Python, and installs Home Assistant",
    "make_samples": "tests/daemon/studies/samples makes them again",
    "theory_octave": "asks for Octave",
}
# What makes the commands shorter that a script gives the program.
SHORTER = {"simulate": ("--days", "0.01"), "campaign": ("--hours", "0.1")}


@pytest.fixture(autouse=True)
def logged_again():
    """Let later tests in this process log again: some scripts disable all logging."""
    yield
    logging.disable(logging.NOTSET)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where a script finds some hours of weather: five minutes with sun, five without."""
    (tmp_path / "weather").mkdir()
    lines = ["time,ghi,dni,dhi"]
    for minute in range(630, 780):
        dni = 600 * (minute // 5 % 2)
        lines.append(f"2022-10-13T{minute // 60:02d}:{minute % 60:02d}Z,{120 + dni / 2},{dni},120")
    (tmp_path / "weather" / "day.csv").write_text("\n".join([*lines, ""]))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def program(monkeypatch):
    """Let the scripts run the program's commands in this process, over a short time."""

    def run(command, **_):
        words = [str(word) for word in command[1:]]
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["heliocube", *words, *SHORTER.get(words[0], ())])
            with pytest.raises(SystemExit) as ended:
                main()
        assert not ended.value.code, command
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(subprocess, "run", run)


def begin(name, arguments, monkeypatch):
    """Do what ``python tests/measurements/NAME.py ARGUMENTS`` does."""
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    code = f"if True:\n{SCRIPTS[name].partition(GUARD)[2]}"
    exec(compile(code, name, "exec"), vars(importlib.import_module(f"tests.measurements.{name}")))


@pytest.mark.usefixtures("folder", "program")
@pytest.mark.parametrize("name", SLICES)
def test_a_measurement_script_prints_its_figures_when_run_on_little_data(name, monkeypatch, capsys):
    module = importlib.import_module(f"tests.measurements.{name}")
    for constant, value in SLICES[name].smaller:
        monkeypatch.setattr(module, constant, value)
    begin(name, SLICES[name].arguments, monkeypatch)
    assert re.search(SLICES[name].answer, capsys.readouterr().out)


def test_every_measurement_script_is_run_here_or_listed_with_the_reason_why_not():
    assert {*SLICES, *NOT_RUN} == set(SCRIPTS)
    assert not SLICES.keys() & NOT_RUN


@pytest.mark.parametrize("name", WITH_OPTIONS)
def test_a_measurement_script_has_exactly_the_options_that_its_docstring_names(name, monkeypatch, capsys):
    module = importlib.import_module(f"tests.measurements.{name}")
    with pytest.raises(SystemExit) as ended:
        begin(name, ["--help"], monkeypatch)
    assert ended.value.code == 0
    named = set(OPTION.findall(module.__doc__))
    # A description may repeat the usage.
    assert set(re.findall(r"^  (--[a-z-]+)", capsys.readouterr().out, re.MULTILINE)) == named


def test_a_measurement_script_that_takes_no_options_names_none_in_its_docstring():
    without = SCRIPTS.keys() - set(WITH_OPTIONS)
    named = {name: OPTION.findall(ast.get_docstring(ast.parse(SCRIPTS[name]))) for name in without}
    assert {name: options for name, options in named.items() if options} == {}
