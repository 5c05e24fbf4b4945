"""The worked example of docs/develop/add-law.md, installed as a package of somebody else."""

import re
import tomllib

import pytest

import heliocube
from daemon.base.errors import UserError
from daemon.base.plugins import LAWS, load, names
from daemon.config.file import load_settings
from tests.support import DOCS
from tests.support.packages import install

PAGE = (DOCS / "develop" / "add-law.md").read_text()
(CODE,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
PYPROJECT, CONFIG = (tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL))


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The example in a folder on the path, as an installer leaves it; returns its module's name."""
    ((name, module),) = PYPROJECT["project"]["entry-points"][LAWS].items()
    install(monkeypatch, tmp_path / "site", f"[{LAWS}]\n{name} = {module}\n", {module: CODE})
    return name


def test_the_law_is_found_by_its_name_with_its_settings(installed):
    assert installed in names(LAWS)
    settings = load(LAWS, installed).SETTINGS.model_validate(CONFIG["law"])
    assert (settings.driver, settings.least_zenith_w_m2) == ("bright-only", 250.0)


def test_the_configuration_accepts_the_example_law_by_name_and_refuses_wrong_settings_of_it(installed, tmp_path):
    file = tmp_path / "heliocube.toml"
    file.write_text(re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[1])
    law = load_settings(file).law
    assert (law.driver, law.least_zenith_w_m2) == (installed, 250.0)
    file.write_text(file.read_text().replace("250.0", "-1.0"))
    with pytest.raises(UserError, match=r"law\.least_zenith_w_m2 = -1\.0"):
        load_settings(file)


@pytest.mark.parametrize(("weather", "flat"), [("clear", False), ("overcast", True)])
def test_the_law_points_the_simulated_rig(installed, weather, flat):
    decisions = heliocube.simulate("2022-10-14T10:00Z", days=0.5 / 24, weather=weather, law=installed, seed=3)[
        "decisions"
    ]
    tracking = decisions[decisions["mode"] == "tracking"]
    assert len(tracking) > 3
    assert set(tracking["law"]) == {installed}
    assert (tracking["target_b_deg"] == 90.0).all() == flat
