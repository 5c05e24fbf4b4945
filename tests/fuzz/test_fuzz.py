"""A part of the fuzzing: every kept input, thousands of mutations, and a parser that raises, which must be noticed."""

import random
import subprocess
import sys

import pytest

from tests.fuzz.parsers import PARSERS, corpus
from tests.fuzz.run import mutated
from tests.support import ROOT

pytestmark = pytest.mark.slow

# The slow ones read files and validate whole settings.
INPUTS = {"toml-settings": 300, "toml-calibration": 300}


@pytest.mark.parametrize("name", PARSERS)
def test_no_kept_and_no_mutated_input_makes_a_parser_raise(name):
    parser, kept = PARSERS[name], list(corpus(name))
    take, choice = parser.build(), random.Random(1)
    for data in kept:
        take(data)
    for _ in range(INPUTS.get(name, 1500)):
        data = mutated(choice, kept, parser.words)
        try:
            take(data)
        except BaseException as error:
            error.add_note(f"the input was {data!r}")
            raise


def test_each_parser_has_a_folder_of_the_fuzz_corpus_and_each_folder_a_parser():
    assert {path.name for path in (ROOT / "tests" / "fuzz" / "corpus").iterdir()} == set(PARSERS)


def test_the_fuzz_program_reports_the_number_of_inputs_that_it_fed():
    command = [sys.executable, "-m", "tests.fuzz.run", "mqtt-credentials", "--inputs", "200", "--seed", "3"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "200" in done.stdout + done.stderr
