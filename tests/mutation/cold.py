"""Runs the tests of one change in a process that imports source and tests anew.

That is needed for code that runs while a file is imported: limits, fields of settings, and functions that are only
called then.
"""

import contextlib
import importlib
import math
import os
import resource
import signal
import sys
import time
import traceback
from pathlib import Path

import pytest

from tests.mutation.allowance import ended_within, spent_by_children_s
from tests.mutation.nearest import Reached
from tests.mutation.operators import Mutant
from tests.mutation.tree import begin_afresh, copy_into
from tests.mutation.verdict import Verdict, applied

# Imported once, before the forks: a test's process then begins in a fraction of a second.
LIBRARIES = ("numpy", "pandas", "pvlib", "pydantic", "pyarrow", "scipy.interpolate", "scipy.optimize", "scipy.special")
PLAIN = (
    "-q",
    "-rfE",
    "--tb=no",
    "--no-header",
    "-p",
    "no:randomly",
    "-p",
    "no:cacheprovider",
    "-p",
    "no:schemathesis",
    "-o",
    "addopts=--strict-markers",
)
_ONE_TEST_S = 60
_MOST_MEMORY_BYTES = 8 << 30

_tree: Path
_reached: Reached


def settle(folder: Path, reached: Reached) -> None:
    """Give this worker its own tree."""
    global _tree, _reached
    _reached = reached
    _tree = make_ready(folder)


def make_ready(folder: Path) -> Path:
    """Make this process a worker, and return its own tree."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for library in LIBRARIES:
        importlib.import_module(library)
    return copy_into(folder / str(os.getpid()))


def attempt(work: tuple[Mutant, float]) -> Verdict:
    """Put a change to its tests until one fails or the seconds are over."""
    mutant, limit_s = work
    began_s = time.monotonic()
    with applied(mutant, _tree):
        red, whole = _first_red(mutant, limit_s)
    return Verdict(mutant, red, whole, time.monotonic() - began_s)


class _Chosen:
    """A pytest plugin that keeps these tests in this order; a file that is named keeps all of its tests."""

    def __init__(self, tests: list[str], path: str) -> None:
        self.files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
        self._place = {test: place for place, test in enumerate(tests)}
        self._path = path

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        """Leave out all others; tests that are newer than the notes come last."""
        places = [self._place_of(item.nodeid) for item in items]
        ordered = sorted(zip(places, range(len(items)), items, strict=True))
        items[:] = [item for place, _, item in ordered if place < math.inf]

    def _place_of(self, test: str) -> float:
        place = self._place.get(test, self._place.get(test.partition("::")[0]))
        if place is not None:
            return place
        return len(self._place) if _reached.is_new(test, self._path) else math.inf


def _first_red(mutant: Mutant, limit_s: float) -> tuple[str | None, bool]:
    """Run tests until one fails; return its name, or None, and whether the time was long enough."""
    before_s = spent_by_children_s()
    for tests in _reached.stages(mutant):
        left_s = limit_s - (spent_by_children_s() - before_s)
        status = _status(_Chosen(tests, mutant.path), left_s) if tests else 0
        if status is None:
            return None, False
        if status:
            return _named_in_output(), True
    return None, True


def _status(chosen: _Chosen, limit_s: float) -> int | None:
    """Run tests in a process of their own; return 0 if all pass, and None if the time was too short."""
    child = os.fork()
    if child == 0:
        _run_and_exit(chosen)
    try:
        status = ended_within(child, limit_s)
    finally:
        _end_group(child)
    if status is None:
        os.waitpid(child, 0)
        return None
    return 0 if os.waitstatus_to_exitcode(status) == pytest.ExitCode.NO_TESTS_COLLECTED else status


def _named_in_output() -> str:
    told = [line for line in _output().read_text(errors="replace").splitlines() if line.startswith(("FAILED", "ERROR"))]
    return told[0].split(" - ")[0] if told else "the tests could not be run"


def _output() -> Path:
    return _tree.with_name("output.txt")


def _end_group(leader: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(leader, signal.SIGKILL)


def _run_and_exit(chosen: _Chosen) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.setsid()
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY_BYTES, _MOST_MEMORY_BYTES))
    sys.dont_write_bytecode = True
    output = os.open(_output(), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.chdir(_tree)
    begin_afresh()
    code = 3
    try:
        code = int(pytest.main([*PLAIN, "-x", f"--timeout={_ONE_TEST_S}", *chosen.files], plugins=[chosen]))
    except BaseException:  # noqa: BLE001 - nothing may come back into the worker
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
