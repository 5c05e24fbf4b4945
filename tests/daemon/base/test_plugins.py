"""What packages offer by entry points."""

import subprocess
import sys

import pytest

from daemon.base.plugins import LAWS, PluginError, load, names
from tests.support.packages import install


def test_an_unknown_law_is_refused_with_a_list_of_the_known_ones():
    with pytest.raises(
        PluginError, match='there is no law "best"; known are chronometric, flat, mu-prime, optimal, sun'
    ):
        load(LAWS, "best")


def test_only_the_module_of_the_chosen_law_is_imported():
    code = (
        "import sys; from daemon.base.plugins import LAWS, load, names; names(LAWS); load(LAWS, 'flat');"
        "print([name for name in sys.modules if name.startswith('solar.laws.')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "solar.laws.flat" in done.stdout
    for other in ("optimal", "mu_prime", "sun_vector", "chronometric"):
        assert f"solar.laws.{other}" not in done.stdout


@pytest.fixture
def offered(tmp_path, monkeypatch):
    """Return a function that installs a package with one law in a folder of its own."""

    def offer(package, name, source):
        module = f"{package}_law"
        install(monkeypatch, tmp_path / package, f"[{LAWS}]\n{name} = {module}\n", {module: source}, name=package)

    return offer


def test_a_name_that_two_packages_offer_is_refused(offered):
    offered("acme", "flat", "")
    with pytest.raises(PluginError, match='"flat" is offered by the package acme and the package heliocube'):
        load(LAWS, "flat")


def test_a_package_that_cannot_be_imported_is_named(offered):
    offered("acme", "bent", "raise OSError('no licence')")
    assert "bent" in names(LAWS)
    with pytest.raises(PluginError, match='"bent" of the package acme cannot be imported: no licence'):
        load(LAWS, "bent")


def test_a_plugin_module_without_settings_and_build_is_refused_by_name(offered):
    offered("acme", "empty", "")
    with pytest.raises(PluginError, match='"empty" of the package acme is not a module with SETTINGS and build'):
        load(LAWS, "empty")


@pytest.mark.parametrize(
    ("source", "flaw"),
    [
        ("raise SystemExit('no licence')", "cannot be imported: no licence"),
        (
            "SETTINGS, build = {'gain': 1.0}, print",
            "has SETTINGS that are not made from the settings class of its kind",
        ),
        (
            "from pydantic import BaseModel\nclass SETTINGS(BaseModel):\n    gain: float = 1.0\nbuild = print",
            "has SETTINGS that are not made from the settings class of its kind",
        ),
        (
            "from solar.laws.law import LawSettings\nclass SETTINGS(LawSettings):\n    gain: float\nbuild = print",
            "has no default for its key gain",
        ),
    ],
)
def test_a_plugin_module_that_exits_or_has_unusable_settings_is_refused_by_name(offered, source, flaw):
    offered("acme", "bent", source)
    with pytest.raises(PluginError, match=f'"bent" of the package acme {flaw}'):
        load(LAWS, "bent")
