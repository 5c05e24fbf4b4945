"""Studies that a batch system or `timeout` ends by SIGTERM."""

import signal
import sys
from pathlib import Path

import pytest

from tests.daemon.commands.studies.test_full_disk import inputs, study

__all__ = ["inputs", "study"]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no such signal")

NOTHING = "interrupted before its end; no whole result was written"


@pytest.fixture(autouse=True)
def _two_sites(tmp_path, monkeypatch):
    """Put half an hour of weather, and a table of two sites with it, into the folder where the study runs."""
    monkeypatch.chdir(tmp_path)
    minutes = [f"2016-06-05T10:{minute:02d}:00Z,{400 + 5 * minute},300,150\n" for minute in range(30)]
    (tmp_path / "weather.csv").write_text("time,ghi,dni,dhi\n" + "".join(minutes))
    sites = [f"{name},48.7,2.2,156,weather.csv\n" for name in ("here", "there")]
    (tmp_path / "sites.csv").write_text("name,latitude,longitude,altitude,weather\n" + "".join(sites))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("energy --sites sites.csv --laws flat --out out", "interrupted: out has 1 of the table's 2 lines"),
        ("energy weather.csv --site 48.7,2.2,156 --laws flat,bound --out out", NOTHING),
        ("energy weather.csv --site 48.7,2.2,156 --losses --out out", NOTHING),
        ("gain --lat-range 0:60:30 --weather clear --out gain.csv --format csv", NOTHING),
        ("compare paper --out out", NOTHING),
    ],
)
def test_a_study_ended_by_sigterm_exits_with_130_and_says_what_was_written(
    heliocube, signal_at_first_progress, words, told
):
    signal_at_first_progress(signal.SIGTERM)
    code, _, said = heliocube(*words.split())
    assert (code, said.splitlines()[-1]) == (130, f"heliocube: {told}")


def test_a_campaign_ended_by_sigterm_reports_the_schedules_that_are_done(heliocube, signal_at_first_progress):
    signal_at_first_progress(signal.SIGTERM)
    code, told, _ = heliocube("campaign", "--seeds", "2", "--hours", "0.1")
    assert code == 130
    assert told.startswith("1 schedule, 0.1 h of virtual time")
    assert told.endswith("ended before 1 more\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "calibrate cube reference.csv sensors.csv --lag 0 --plot beside.png --out c.toml",
        "compare fit flat.csv --out bias.json",
        "compare report flat.csv --out .",
    ],
)
def test_a_study_ended_by_sigterm_while_it_writes_leaves_no_part_of_a_file(study, tmp_path, monkeypatch, words):
    before = signal.signal(signal.SIGTERM, lambda *_: None)
    replace = Path.replace
    monkeypatch.setattr(Path, "replace", lambda *paths: (signal.raise_signal(signal.SIGTERM), replace(*paths)))
    code, told = study(words)
    signal.signal(signal.SIGTERM, before)
    assert (code, told) == (130, f"heliocube: {NOTHING}\n")
    assert not list(tmp_path.glob(".*.part"))
