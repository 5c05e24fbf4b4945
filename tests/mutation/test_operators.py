"""What counts as a small wrong change, and that the list of unnoticeable changes belongs to this source."""

import ast

import pytest

from tests.mutation.operators import mutants
from tests.mutation.run import equivalent
from tests.support import ROOT


def changes(line):
    source = f"def f(x, y):\n    {line}\n".encode()
    found = mutants("f.py", source)
    for mutant in found:
        ast.parse(mutant.applied(source))
    return {f"{mutant.was} -> {mutant.now}" for mutant in found}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("return x < y", {"x < y -> (x >= y)"}),
        ("return len(x) < y", {"len(x) < y -> (len(x) >= y)", "len(x) < y -> (len(x) <= y)"}),
        ("return x and y", {"x and y -> (x or y)", "x and y -> (x)", "x and y -> (y)"}),
        ("return x - y", {"x - y -> (x + y)"}),
        ("return -x", {"-x -> (x)"}),
        ("return 'a' + x", set()),
        ("return min(x, y)", {"min(x, y) -> (max(x, y))"}),
        ("return x(a=y)", {"x(a=y) -> (x())"}),
        ("return x(axis=-1)", {"x(axis=-1) -> (x())", "x(axis=-1) -> (x(axis=0))"}),
        ("return Record(a=y)", set()),
        ("return zip(x, y, strict=True)", set()),
        ("x.stop()", {"x.stop() -> pass"}),
        ("log.info('%s', x < y)", set()),
        ("if x:\n        return y", {"x -> (not x)"}),
        ("return [x for x in y if x]", {"x -> (True)"}),
        ("raise x", {"raise x -> pass"}),
        ("x: int | None = 0.5", {"0.5 -> (1.0)"}),
    ],
)
def test_each_line_of_code_yields_the_expected_mutants(line, expected):
    assert changes(line) == expected


def test_a_mutant_knows_its_line_and_the_function_that_contains_it():
    source = b"LIMIT = 3\nclass A:\n    best = 4\n    def f(self):\n        return lambda: 5\n"
    assert [(mutant.line, mutant.function) for mutant in mutants("f.py", source)] == [(1, ""), (3, ""), (5, "A.f")]


def test_every_mutant_listed_as_equivalent_exists_in_the_present_source_and_has_a_reason():
    for entry in equivalent():
        keys = {mutant.key for mutant in mutants(entry["path"], (ROOT / entry["path"]).read_bytes())}
        assert f"{entry['path']} | {entry['was']} | {entry['now']}" in keys, "it has changed: judge it anew"
        assert entry["why"]
