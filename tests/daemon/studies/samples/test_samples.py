"""The sample days: made by the simulator, marked as simulated, and accepted by everything that reads such files."""

import csv

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import heliocube
from daemon.commands.main import app
from daemon.studies.samples import DAYS
from tests.measurements.make_samples import text

pytestmark = pytest.mark.slow


@pytest.fixture(params=DAYS)
def name(request):
    return request.param


def day_of(name):
    return pd.read_csv(heliocube.sample(name), index_col="time", parse_dates=["time"])


def test_a_sample_day_is_what_its_seed_makes(name):
    kept = list(csv.reader(heliocube.sample(name).read_text().splitlines()))
    made = list(csv.reader(text(name).splitlines()))
    assert kept[0] == made[0]
    # Another machine may round the last digit the other way.
    here, there = ([row[1:-1] for row in rows[1:]] for rows in (kept, made))
    np.testing.assert_allclose(np.array(here, dtype=float), np.array(there, dtype=float), atol=0.11)
    assert [(row[0], row[-1]) for row in kept] == [(row[0], row[-1]) for row in made]


def test_a_sample_day_is_complete_and_marked_as_simulated(name):
    day = day_of(name)
    assert len(day) == 1440
    assert str(day.index[0].date()) == DAYS[name]
    assert day["simulated"].all()
    assert not day.isna().any(axis=None)


def test_the_share_of_diffuse_light_of_each_sample_day_fits_its_name():
    share = {name: day_of(name)["dhi"].sum() / day_of(name)["ghi"].sum() for name in DAYS}
    assert share["clear"] < 0.3 < share["mixed"] < 0.9 < share["overcast"] == pytest.approx(1.0)


def test_a_sample_day_can_be_read_as_a_recording_and_as_a_weather_file(name):
    faces = heliocube.read_faces(heliocube.sample(name))
    assert list(faces.columns) == ["east", "south", "west", "zenith"]
    start = f"{DAYS[name]}T11:00Z"
    tables = heliocube.simulate(start, days=0.25 / 24, weather=heliocube.sample(name), seed=1)
    assert tables["decisions"]["mode"].iloc[-1] == "tracking"


def test_samples_are_overwritten_only_with_force_and_for_an_unknown_day_the_known_ones_are_listed(tmp_path):
    out = tmp_path / "days"
    done = CliRunner().invoke(app, ["samples", "--out", str(out)])
    assert "SIMULATED" in done.output
    assert sorted(path.name for path in out.iterdir()) == ["LICENSE.txt", "clear.csv", "mixed.csv", "overcast.csv"]
    again = CliRunner().invoke(app, ["samples", "--out", str(out)])
    assert "is there already: --force overwrites it" in str(again.exception)
    assert CliRunner().invoke(app, ["samples", "--out", str(out), "--force"]).exit_code == 0
    with pytest.raises(heliocube.UserError, match="no sample day 'foggy': choose clear, mixed, overcast"):
        heliocube.sample("foggy")


def test_a_sample_file_stays_as_it_was_when_the_new_one_does_not_fit_on_the_disk(tmp_path):
    (tmp_path / "mixed.csv").write_text("of yesterday")
    (tmp_path / ".mixed.csv.part").symlink_to("/dev/full")
    done = CliRunner().invoke(app, ["samples", "--out", str(tmp_path), "--force"])
    assert str(done.exception) == f"--out: {tmp_path} cannot take mixed.csv: No space left on device"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clear.csv", "mixed.csv"]
    assert (tmp_path / "mixed.csv").read_text() == "of yesterday"


def test_a_sample_file_that_cannot_be_overwritten_stays_as_it_was(tmp_path):
    (tmp_path / "mixed.csv").symlink_to("/proc/version")
    done = CliRunner().invoke(app, ["samples", "--out", str(tmp_path), "--force"])
    assert f"{tmp_path} cannot take mixed.csv" in str(done.exception)
    assert (tmp_path / "mixed.csv").is_symlink()
