"""Which lines are reached together, and that a change is put to the tests that reach its line."""

import json
import sys
from types import ModuleType

import pytest

from tests.mutation.blocks import HITS, block_of_line, digest, marked
from tests.mutation.nearest import Reached
from tests.mutation.operators import mutants
from tests.support import ROOT

SOURCE = b'''"""A module."""

LIMIT = 3

class A:
    best = LIMIT

    def f(self, x):
        """Say."""
        if x > LIMIT:
            return "high"
        elif x < 0:
            raise ValueError
        try:
            y = 1 / x
        except ZeroDivisionError:
            y = 0
        else:
            y += 1

        def g():
            return y

        return g
'''


def reached(call):
    known = []
    module = ModuleType("marked")
    hits = ModuleType(HITS)
    text = marked("m.py", SOURCE, known)
    hits.HITS = bytearray(len(known))
    sys.modules[HITS] = hits
    try:
        exec(compile(text, "m.py", "exec"), module.__dict__)
        call(module.A())
    finally:
        del sys.modules[HITS]
    return sorted(int(block.partition(":")[2]) for block, hit in zip(known, hits.HITS, strict=True) if hit)


@pytest.mark.parametrize(
    ("call", "lines"),
    [
        (lambda _a: None, []),
        (lambda a: a.f(4), [9, 11]),
        (lambda a: a.f(0), [9, 12, 14, 15, 17, 21, 24]),
        (lambda a: a.f(1), [9, 12, 14, 15, 19, 21, 24]),
        (lambda a: a.f(1)(), [9, 12, 14, 15, 19, 21, 22, 24]),
    ],
)
def test_a_block_is_marked_when_it_is_reached(call, lines):
    assert reached(call) == lines


def test_each_line_of_a_function_belongs_to_one_block():
    blocks = {line: int(block.partition(":")[2]) for line, block in block_of_line("m.py", SOURCE).items()}
    assert {line: blocks.get(line) for line in (3, 6, 8, 9, 10, 11, 12, 13, 15, 16, 19, 21, 22, 24)} == {
        3: None, 6: None, 8: 9, 9: 9, 10: 9, 11: 11, 12: 12, 13: 13, 15: 15, 16: 14, 19: 19, 21: 21, 22: 22, 24: 24,
    }  # fmt: skip


def test_a_mutant_of_a_cached_function_is_put_to_all_tests_that_reach_its_file(tmp_path):
    path = "solar/skies/dome.py"
    source = (ROOT / path).read_bytes()
    change = next(mutant for mutant in mutants(path, source) if mutant.function == "dome")
    tests = {f"tests/solar/skies/test_sky.py::test_{at}": {"seconds": 1.0, "blocks": [f"{path}:1"]} for at in "ab"}
    notes = tmp_path / "reach.json"
    notes.write_text(json.dumps({"sources": {path: digest(ROOT / path)}, "tests": tests}))
    assert {test for stage in Reached(notes).stages(change) for test in stage} >= tests.keys()


def test_a_mutant_is_put_to_the_tests_of_its_module_first_and_then_to_others_reaching_its_line(tmp_path):
    path = "daemon/base/reconnect.py"
    source = (ROOT / path).read_bytes()
    blocks = block_of_line(path, source)
    mutant = next(mutant for mutant in mutants(path, source) if mutant.line in blocks)
    near, far = "tests/daemon/base/test_reconnect.py::test_near", "tests/solar/skies/test_sky.py::test_far"
    notes = tmp_path / "reach.json"

    def note(sources, **of_block):
        tests = {
            near: {"seconds": 2.0, "blocks": [blocks[mutant.line]]},
            far: {"seconds": 1.0, "blocks": [blocks[mutant.line]]},
            "tests/solar/test_gone.py::test_of_a_file_that_was_renamed": {
                "seconds": 0.1,
                "blocks": [blocks[mutant.line]],
            },
            "tests/solar/skies/test_sky.py::test_elsewhere": {"seconds": 0.1, "blocks": [], **of_block},
        }
        notes.write_text(json.dumps({"sources": sources, "tests": tests}))
        return [test for stage in Reached(notes).stages(mutant) for test in stage if "::" in test]

    assert note({path: digest(ROOT / path)}) == [near, far]
    # If the source has changed since, every test that reaches the file may reach the line.
    elsewhere = note({path: "another"}, blocks=[f"{path}:1"])
    assert set(elsewhere) == {near, far, "tests/solar/skies/test_sky.py::test_elsewhere"}
