"""Which tests are run for a change, and in which order."""

import ast
import functools
import itertools
import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

from tests.mutation.blocks import block_of_line, digest
from tests.mutation.operators import Mutant
from tests.support import ROOT

OURS = ("solar", "drivers", "daemon")
# Tests that start processes or brokers tell little about one line, and late.
_TOO_FAR = {"campaign", "docs", "firmware", "fuzz", "measurements", "mutation", "support", "system"}
# This test contains every default and bound of the settings.
_OF_SETTINGS = "tests/daemon/config/test_file.py::test_the_reference_document_is_current"
_CACHED = re.compile(r"^ *@(functools\.)?(lru_cache|cache|cached_property)\b", re.MULTILINE)
# How many files are collected at once: each takes a second, and the very first test may fail.
_AT_ONCE = 8


class Reached:
    """The notes of `tests.mutation.reach`. Without notes a change is put to the nearest tests."""

    def __init__(self, kept: Path | None = None) -> None:
        noted = json.loads(kept.read_text()) if kept else {"tests": {}, "sources": {}}
        self._sources = noted["sources"]
        # Tests whose file has moved since cannot be found.
        there = {test: entry for test, entry in noted["tests"].items() if (ROOT / _file(test)).is_file()}
        self._seconds = {test: entry["seconds"] for test, entry in there.items()}
        self._files = {_file(test) for test in self._seconds}
        self._tests: dict[str, set[str]] = defaultdict(set)
        for test, entry in there.items():
            for block in entry["blocks"]:
                self._tests[block].add(test)

    def stages(self, mutant: Mutant) -> list[list[str]]:
        """Return tests and whole test files to run together, one lot after the other.

        First those of the module, then those that import it, those of its folder, and then all others that reach the
        line, or use its value. Files without notes are run whole if they lie near.
        """
        near = _nearest(mutant.path)
        reaching = self._reaching(mutant)
        if not reaching:
            return [list(files) for files in near]
        stages = []
        for files in near:
            known = {test for test in reaching if _file(test) in files}
            unknown = [file for file in files if _file(file) not in self._files]
            stages.append(self._quickest_first(known) + unknown)
            reaching -= known
        return [*stages, *self._by_file(reaching)]

    def knows(self, mutant: Mutant) -> bool:
        """Whether some test has been seen to reach the change."""
        return bool(self._reaching(mutant))

    def is_new(self, test: str, path: str) -> bool:
        """Whether a test lies near a module and did not exist, or did not pass, when the notes were taken."""
        return test not in self._seconds and _file(test) in (*_nearest(path)[0], *_nearest(path)[1])

    def _reaching(self, mutant: Mutant) -> set[str]:
        if self._sources.get(mutant.path) != digest(ROOT / mutant.path) or _remembers(mutant.path):
            return self._of_blocks(block for block in self._tests if block.startswith(f"{mutant.path}:"))
        block = _blocks(mutant.path).get(mutant.line)
        return self._of_blocks([block] if block else _blocks_that_name(mutant))

    def _of_blocks(self, blocks: Iterable[str]) -> set[str]:
        return set(itertools.chain.from_iterable(self._tests.get(block, ()) for block in blocks))

    def _quickest_first(self, tests: Iterable[str]) -> list[str]:
        return sorted(tests, key=lambda test: (self._seconds[test], test))

    def _by_file(self, tests: Iterable[str]) -> Iterator[list[str]]:
        of_file = defaultdict(list)
        for test in tests:
            of_file[_file(test)].append(test)
        lots = sorted(of_file.values(), key=lambda lot: sum(self._seconds[test] for test in lot) / len(lot))
        for begin in range(0, len(lots), _AT_ONCE):
            yield self._quickest_first(itertools.chain.from_iterable(lots[begin : begin + _AT_ONCE]))


def _file(test: str) -> str:
    return test.partition("::")[0]


@functools.cache
def _blocks(path: str) -> dict[int, str]:
    return block_of_line(path, (ROOT / path).read_bytes())


@functools.cache
def _remembers(path: str) -> bool:
    """Whether a file caches results: then only the first of the tests that depend on one was seen to reach the code."""
    return _CACHED.search((ROOT / path).read_text()) is not None


@functools.cache
def _names(path: str) -> dict[str, set[int]]:
    """Return the lines of a file in which each name is used, as a variable, an attribute or a keyword."""
    found = defaultdict(set)
    for node in ast.walk(ast.parse((ROOT / path).read_bytes())):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name):
                found[name].add(node.lineno)
            case ast.keyword(arg=str() as name):
                found[name].add(node.value.lineno)
    return found


def _blocks_that_name(mutant: Mutant) -> Iterator[str]:
    """Yield the blocks that use what a line outside of functions sets; all blocks of its file, if that is unknown."""
    names = _set_in(mutant)
    private = all(name.startswith("_") for name in names)
    paths = [mutant.path] if private else _sources()
    yielded = False
    for path in paths:
        blocks = _blocks(path)
        for line in set(itertools.chain.from_iterable(_names(path)[name] for name in names)) & blocks.keys():
            yielded = True
            yield blocks[line]
    if not yielded:
        yield from set(_blocks(mutant.path).values())


@functools.cache
def _sources() -> list[str]:
    return [str(file.relative_to(ROOT)) for folder in OURS for file in sorted((ROOT / folder).rglob("*.py"))]


def _set_in(mutant: Mutant) -> set[str]:
    for statement in ast.walk(ast.parse((ROOT / mutant.path).read_bytes())):
        if (
            isinstance(statement, ast.Assign | ast.AnnAssign)
            and statement.lineno <= mutant.line <= statement.end_lineno
        ):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            nodes = itertools.chain.from_iterable(ast.walk(target) for target in targets)
            return {node.id for node in nodes if isinstance(node, ast.Name)}
    return set()


def _holds(statement: ast.stmt, line: int) -> bool:
    return statement.lineno <= line <= (statement.end_lineno or statement.lineno)


@functools.cache
def _nearest(path: str) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Return the test files of a module, those that import it, and those of its folder."""
    module = Path(path)
    folder = Path("tests", module.parent)
    name = ".".join(module.with_suffix("").parts)
    imports = re.compile(
        rf"(?:from|import) {re.escape(name)}\b|from {re.escape(name.rpartition('.')[0])} import .*\b{module.stem}\b"
    )
    own, importing, beside = [], [], []
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        place = file.relative_to(ROOT)
        if place.parts[1] in _TOO_FAR:
            continue
        if place == folder / f"test_{module.name}":
            own.append(str(place))
        elif imports.search(file.read_text()):
            importing.append(str(place))
        elif folder in place.parents:
            beside.append(str(place))
    of_settings = (_OF_SETTINGS,) if "Field(" in (ROOT / path).read_text() else ()
    return (*own, *of_settings), tuple(importing), tuple(beside)
