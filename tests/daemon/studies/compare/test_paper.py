"""The paper's experiment, run once."""

import csv
import sys
from datetime import UTC, datetime

import pytest

from daemon.commands.main import main
from daemon.config.settings import Settings
from daemon.studies.compare import paper
from daemon.studies.compare.paper import PAPER_GAINS, Spread, as_text, notes, overcast_gain_limits
from solar.ephemeris import Site
from solar.frames import Limits

pytestmark = pytest.mark.slow

SIRTA = Site(48.717607, 2.209002, 156.0)


# A scan a minute: the figures move by hundredths of a percent, and the run takes a third of the time.
SELDOM = "[cube]\nscan_every_s = 60\n\n[safety]\nscan_stale_s = 120\n\n[site]\nlatitude_deg = 10.0\n"


@pytest.mark.long
def test_the_shape_of_the_papers_results_is_found_again(monkeypatch, capsys, tmp_path):
    # The first three hours of the flat day span all powers of the two days in October. Of these days only the hours up
    # to the afternoon, 08:00 to 12:20, are simulated.
    monkeypatch.setattr(paper, "_FLAT_START", datetime(2022, 8, 3, 6, tzinfo=UTC))
    monkeypatch.setattr(paper, "_FLAT_DAYS", 3.0 / 24.0)
    monkeypatch.setattr(paper, "_BEGIN_HOUR", 8)
    monkeypatch.setattr(paper, "_DAY_SHARE", (4.0 + 20.0 / 60.0) / 24.0)
    config = tmp_path.with_name("seldom.toml")
    config.write_text(SELDOM)
    words = ["--seeds", "1", "--skies", "isotropic", "--config", str(config), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["heliocube", "compare", "paper", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    out = capsys.readouterr().out
    rows = {row["period"]: row for row in csv.DictReader((tmp_path / "paper.csv").read_text().splitlines())}
    gain = {period: float(row["gain_pct"]) for period, row in rows.items()}
    assert -0.5 <= gain["clear"] <= 0.1
    assert gain["overcast"] >= 10.0
    assert gain["overcast day"] >= 25.0
    for line in ("SIMULATED.", "+40.50", "+25 or more", "The model cannot show", "a scan every 60 s"):
        assert line in out
    assert (tmp_path / "paper.txt").read_text().splitlines()[0] in out
    for name in ("curve", "bias", "power-2022-10-12", "movement-2022-10-12", "power-2022-10-14"):
        assert (tmp_path / f"{name}.png").stat().st_size > 5000
        assert (tmp_path / f"{name}.svg").stat().st_size > 5000
    assert (tmp_path / "paper.html").read_text().count("data:image/png;base64,") == 6
    # An existing file of the results is found before the minutes of work, whichever file it is.
    for path in tmp_path.iterdir():
        other = tmp_path.with_name("other") / path.name
        other.mkdir(parents=True)
        monkeypatch.setattr(sys, "argv", ["heliocube", "compare", "paper", "--seeds", "1", "--out", str(other)])
        path.rename(other / path.name)
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2, path.name
        assert f"{path.name} is there already" in capsys.readouterr().err


def test_the_ceiling_of_the_gain_at_an_overcast_noon_agrees_with_a_calculation_by_hand():
    found = {(period, sky): gain for period, sky, gain in overcast_gain_limits(SIRTA, Limits())}
    # 11:15 UTC: the sun is 33.8 deg high, the tilt 56.2 deg; before and after, the sun is lower.
    # (1 + 0.556)/2 + 0.2 (1 - 0.556)/2 = 0.8225, that is 21.6 %.
    assert found["overcast", "isotropic"] == pytest.approx(22.0, abs=0.5)
    # Moon & Spencer's sky: 4/(7 pi) (0.831 - 0.981 x 0.556 - 0.697) = -0.075 less.
    assert found["overcast", "Moon & Spencer"] == pytest.approx(100 / (0.8225 - 0.0748) - 100, abs=1.0)
    assert found["overcast day", "isotropic"] > found["overcast", "isotropic"]
    # A darker ground: (1 + 0.556)/2 + 0.1 (1 - 0.556)/2 = 0.8002, that is 25.0 %, and again lower sun before and after.
    dark = overcast_gain_limits(SIRTA, Limits(), albedo=0.1)
    assert dark[0] == ("overcast", "isotropic", pytest.approx(25.5, abs=0.5))


def test_the_notes_of_a_study_that_was_ended_early_say_how_many_of_its_runs_were_done():
    whole, part = (notes(Settings(), "broken", "mu-prime", 30, done=done, asked=60)[0] for done in (60, 8))
    assert "30 seeds from 1 on for each sky: on 12 October" in whole
    assert "30 seeds from 1 on for each sky (8 of these 60 runs: it was ended before the others): on 12" in part


def test_variable_weather_is_shown_by_the_median_quartiles_and_range_of_its_gains():
    *_, variable, _overcast_day = PAPER_GAINS
    shown = Spread(variable, "haydavies", (-6.0, -3.0, -1.5, 0.5, 20.0), has_bounds=True)
    assert (shown.median_pct, shown.quartiles_pct, shown.within_bounds_text) == (-1.5, (-3.0, 0.5), "2 of 5")
    first, second = (line for line in as_text([shown]).splitlines() if line.startswith("variable"))
    assert all(text in f"{first} {second}" for text in ("-1.00", "-2..+1", "2 of 5", "-3.00..+0.50", "-6.00..+20.00"))
    assert Spread(variable, "haydavies", shown.gains_pct, has_bounds=False).within_bounds_text == ""
