"""Every example of docs/instruments.md is a whole file: it is checked, built, and run on simulated instruments."""

import re

import pytest

import heliocube
from daemon.base.clock import SystemClock
from daemon.config.file import load_settings
from daemon.rigs.real import build_cube
from tests.support import DOCS

pytestmark = pytest.mark.slow

PAGE = (DOCS / "instruments.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(params=range(len(EXAMPLES)))
def example(request, tmp_path):
    path = tmp_path / "heliocube.toml"
    path.write_text(EXAMPLES[request.param], encoding="utf-8")
    return path


def test_the_instruments_page_has_at_least_four_examples():
    assert len(EXAMPLES) >= 4


def test_each_instruments_page_example_builds_a_real_cube_and_tracks_on_a_simulated_rig(example):
    settings = load_settings(example)
    assert settings.real
    assert build_cube(settings, SystemClock()) is not None
    example.write_text(example.read_text(encoding="utf-8").replace('kind = "real"', 'kind = "simulated"'))
    tables = heliocube.simulate("2022-10-14T10:00Z", config=example, days=0.3 / 24, weather="clear", seed=3)
    assert tables["decisions"]["mode"].iloc[-1] == "tracking"
    qualities = {value for name in ("east", "south", "west", "zenith") for value in tables["scans"][f"{name}_quality"]}
    assert qualities == {"ok"}
