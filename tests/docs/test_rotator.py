"""The example of docs/rotator.md."""

import re

import heliocube
from daemon.base.clock import SystemClock
from daemon.commands.file_check import check_file
from daemon.rigs.real import build_positioner
from drivers.positioners.rotctld.positioner import RotctldPositioner
from tests.support import DOCS

(EXAMPLE,) = re.findall(r"```toml\n(.*?)```", (DOCS / "rotator.md").read_text(), re.DOTALL)


def test_the_rotator_page_example_is_a_valid_file_for_a_real_rotctld_positioner(tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text(EXAMPLE)
    settings = check_file(file)
    assert settings.instruments.kind == "real"
    assert isinstance(build_positioner(settings, SystemClock()), RotctldPositioner)


def test_all_moves_arrive_when_the_rotator_page_example_is_simulated(tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text(EXAMPLE.replace('kind = "real"', 'kind = "simulated"'))
    moves = heliocube.simulate("2022-10-14T10:00Z", days=0.5 / 24, weather="clear", config=file, seed=3)["moves"]
    assert set(moves["outcome"]) == {"arrived"}
