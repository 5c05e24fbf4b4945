import importlib.util

import pytest

from tests.support import DOCS

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def theory_numbers():
    specification = importlib.util.spec_from_file_location("theory_numbers", DOCS / "theory_numbers.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_every_number_in_the_errata_of_theory_md_is_reproduced(theory_numbers):
    text = (DOCS / "theory.md").read_text().partition("## 4. Errata")[2].partition("## 5.")[0]
    rows = {line.split("|")[1].split(":")[0].strip(): line for line in text.splitlines() if line.startswith("| ")}
    for number, value in theory_numbers.numbers():
        assert rows[number].endswith(f"| {value} |")


def test_the_table_of_best_tilts_in_theory_md_is_reproduced(theory_numbers):
    text = (DOCS / "theory.md").read_text()
    for row in theory_numbers.best_tilts([0.0, 50.0]):
        assert row in text
