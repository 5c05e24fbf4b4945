"""A change of a function is put into the existing function, wherever it is referenced."""

import gc
import importlib
import sys

import pytest

from tests.mutation.operators import mutants
from tests.mutation.warm import Program, is_of_a_function, keeps_its_cells

SOURCE = b"""import functools

LIMIT = 3

def kept(function):
    @functools.wraps(function)
    def called(*given):
        return function(*given) + 1
    return called

class A:
    best: int = 4

    def is_high(
        self, x, limit=5
    ):
        return (
            x > limit
        )

    @property
    def low(self):
        return 6

    @low.setter
    def low(self, value):
        self.value = value - 7

@kept
def doubled(x):
    return 2 * x

@functools.cache
def remembered(x):
    return x + 8
"""


@pytest.fixture
def program(tmp_path, monkeypatch):
    (tmp_path / "changed_while_it_runs.py").write_bytes(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("changed_while_it_runs")
    # As the warm process does it (warm.py), once the tests are imported.
    gc.freeze()
    yield module, Program(tmp_path)
    del sys.modules["changed_while_it_runs"]


def change(line, was):
    return next(
        found for found in mutants("changed_while_it_runs.py", SOURCE) if (found.line, found.was) == (line, was)
    )


def test_code_that_runs_at_import_counts_as_outside_of_any_function():
    assert {line for line in range(1, 36) if is_of_a_function_at(line)} == {7, 8, 9, 17, 18, 19, 23, 27, 31, 35}


def test_a_mutant_that_removes_super_does_not_keep_the_closure_cells_of_its_function():
    source = b"class A(B):\n    def f(self):\n        super().f(1)\n"
    kept = {mutant.now: keeps_its_cells(mutant, source) for mutant in mutants("f.py", source)}
    assert kept == {"pass": False, "(2)": True}


def is_of_a_function_at(line):
    return is_of_a_function(mutants("f.py", b"\n" * (line - 1) + b"1")[0], SOURCE)


@pytest.mark.parametrize(
    ("line", "was", "call", "before", "after"),
    [
        (18, "x > limit", lambda m: m.A().is_high(5), False, True),
        (23, "6", lambda m: m.A().low, 6, 7),
        (27, "value - 7", lambda m: setattr(a := m.A(), "low", 1) or a.value, -6, 8),
        (8, "1", lambda m: m.doubled(1), 3, 4),
        (31, "2", lambda m: m.doubled(1), 3, 4),
        (35, "x + 8", lambda m: m.remembered(1), 9, -7),
    ],
)
def test_a_mutant_takes_effect_in_existing_methods_properties_and_wrapped_functions(
    program, line, was, call, before, after
):
    module, functions = program
    assert call(module) == before
    functions.with_change(change(line, was), SOURCE)()
    assert call(module) == after
