"""Sections whose keys belong to a plug-in that is chosen by name."""

import pickle
import subprocess
import sys

import pytest

from daemon.config.file import override
from daemon.config.plugin_sections import dump_explicit_values
from daemon.config.settings import Settings


@pytest.mark.parametrize("key", ["driver", "name"])
def test_a_law_is_chosen_by_the_key_driver_or_by_its_earlier_spelling(read, key):
    law = read(f"[law]\n{key} = 'optimal'\nthrift = 2.0\n").law
    assert (law.driver, law.thrift, law.moves_per_day) == ("optimal", 2.0, 250)


def test_the_key_driver_together_with_its_earlier_spelling_is_refused(problem):
    assert 'law.name = "flat": is the earlier name of law.driver' in problem("[law]\ndriver = 'flat'\nname = 'flat'\n")


def test_the_refusal_of_an_unknown_law_lists_the_known_laws(problem):
    line = problem("[law]\ndriver = 'fastest'\n")
    assert line == 'law.driver = "fastest": must be "chronometric", "flat", "mu-prime", "optimal" or "sun-vector"'


def test_keys_of_a_law_that_is_not_chosen_are_kept_and_used_once_it_is_chosen(read):
    settings = read("[law]\ndriver = 'mu-prime'\nthrift = 2.0\n")
    assert override(settings, {"law": {"driver": "optimal"}}).law.thrift == 2.0
    again = override(override(settings, {"law": {"driver": "flat"}}), {"law": {"name": "optimal"}})
    assert again.law.thrift == 2.0


@pytest.mark.parametrize("driver", ["optimal", "mu-prime"])
def test_a_wrong_value_in_a_key_of_a_law_is_refused_even_if_that_law_is_not_chosen(problem, driver):
    line = problem(f"[law]\ndriver = '{driver}'\nthrift = 500.0\n")
    assert line == "law.thrift = 500.0: must be a number from 0.1 to 100"


def test_the_refusal_of_a_misspelt_key_suggests_the_key_that_was_meant(problem):
    assert problem("[law]\nthirft = 2.0\n").endswith("there is no such key; did you mean law.thrift?")


def test_only_the_law_that_is_chosen_is_imported(tmp_path):
    (tmp_path / "heliocube.toml").write_text("[law]\ndriver = 'flat'\n")
    code = (
        "import sys; from pathlib import Path; from daemon.config.file import load_settings;"
        f"load_settings(Path({str(tmp_path / 'heliocube.toml')!r}));"
        "print(*(name for name in sys.modules if name.startswith('solar.laws.')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    imported = {name.rpartition(".")[2] for name in done.stdout.split()}
    assert "flat" in imported
    assert not imported & {"mu_prime", "sun_vector", "chronometric", "optimal_live"}


def test_settings_made_in_a_program_are_checked_alike():
    assert Settings(law={"driver": "optimal", "thrift": 2.0}).law.thrift == 2.0
    with pytest.raises(ValueError, match="thrift = 500"):
        Settings(law={"driver": "optimal", "thrift": 500.0})


def test_settings_stay_the_same_when_they_are_pickled_for_another_process():
    given = Settings.model_validate({"law": {"driver": "flat", "thrift": 2.0}, "simulation": {"seed": 7}})
    there = pickle.loads(pickle.dumps(given))
    assert there == given
    assert dump_explicit_values(there.law) == dump_explicit_values(given.law) == {"driver": "flat", "thrift": 2.0}
    assert override(there, {"law": {"driver": "optimal"}}).law.thrift == 2.0
