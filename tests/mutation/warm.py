"""Runs the tests of changed functions in copies of one process that has imported source and tests already.

A change replaces the code of the existing functions. Nothing is imported again, and a copy begins in some milliseconds;
a process that imports anew takes seconds (tests.mutation.cold).
"""

import ast
import contextlib
import functools
import gc
import multiprocessing
import os
import queue
import signal
import sys
import time
import types
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutation.allowance import ended_within
from tests.mutation.cold import PLAIN, make_ready
from tests.mutation.nearest import Reached
from tests.mutation.operators import Mutant
from tests.mutation.tree import begin_afresh
from tests.mutation.verdict import Verdict, applied

# A change can make a loop endless. The longest of 4,700 tests that compute takes less than this on an idle machine.
_ONE_TEST_S = 30
_RED = 1
_ENDS_WITHIN_S = 5.0

Work = tuple[Mutant, list[str]]


def is_of_a_function(mutant: Mutant, source: bytes) -> bool:
    """Whether the change is in code that runs when a function is called, not when its file is imported."""
    below = list(ast.parse(source).body)
    while below:
        node = below.pop()
        if not node.lineno <= mutant.line <= (node.end_lineno or node.lineno):
            continue
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            return mutant.line >= node.body[0].lineno
        below += [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt)]
    return False


def keeps_its_cells(mutant: Mutant, source: bytes) -> bool:
    """Whether the functions can take the new code: without its `super()` it has a cell less, and they cannot."""
    before, after = (
        [code.co_freevars for code in _codes(compile(text, mutant.path, "exec"))]
        for text in (source, mutant.applied(source))
    )
    return len(before) != len(after) or before == after


def tried_warm(work: list[Work], reached: Reached, limit_s: float, jobs: int, folder: Path) -> Iterator[Verdict]:
    """Yield the verdicts as they come; a test may also be the name of a file, for all of its tests."""
    if not work:
        return
    context = multiprocessing.get_context("fork")
    todo, done = context.Queue(), context.Queue()
    for place in range(len(work)):
        todo.put(place)
    workers = [
        context.Process(target=_serve, args=(_Warm(work, reached, todo, done, limit_s), work, folder))
        for _ in range(jobs)
    ]
    for worker in workers:
        worker.start()
    try:
        for _ in work:
            place, *said = _heard(done, workers)
            yield Verdict(work[place][0], *said)
        for worker in workers:
            worker.join(_ENDS_WITHIN_S)
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()


def _heard(done: multiprocessing.Queue, workers: list[multiprocessing.Process]) -> tuple:
    while True:
        with contextlib.suppress(queue.Empty):
            return done.get(timeout=1.0)
        if not any(worker.is_alive() for worker in workers):
            raise RuntimeError("the tests could not be read: run pytest on them first")


def _serve(warm: "_Warm", work: list[Work], folder: Path) -> None:
    os.chdir(make_ready(folder))
    begin_afresh()
    sys.dont_write_bytecode = True
    files = sorted({test.partition("::")[0] for _, tests in work for test in tests})
    kept = [
        "--continue-on-collection-errors",
        f"--timeout={_ONE_TEST_S}",
        f"--basetemp={folder / f'{os.getpid()}-tests'}",
    ]
    with (folder / f"{os.getpid()}.txt").open("w") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
        pytest.main([*PLAIN, *kept, *files], plugins=[warm])


class _Warm:
    """A pytest plugin that collects the tests, and instead of running them all runs those that each change asks for."""

    def __init__(self, work, reached, todo, done, limit_s):
        self._work = work
        self._reached = reached
        self._todo = todo
        self._done = done
        self._limit_s = limit_s
        self._order = _Order()
        self._items = {}
        self._of_file = defaultdict(list)
        self._green = set()
        self._tell = None

    def pytest_runtestloop(self, session):
        """Take one change after the other until there are no more."""
        self._items = {item.nodeid: item for item in session.items}
        for name in self._items:
            self._of_file[name.partition("::")[0]].append(name)
        program = Program(Path.cwd())
        gc.collect()
        gc.freeze()
        with contextlib.suppress(queue.Empty):
            while True:
                place = self._todo.get(timeout=0.2)
                mutant, tests = self._work[place]
                began_s = time.monotonic()
                names = self._order.of(mutant, self._named(tests, mutant.path))
                with applied(mutant, Path.cwd()) as source:
                    red, whole = self._first_red(program.with_change(mutant, source), names)
                if red in self._items and not self._is_green(red):
                    del self._items[red]
                    self._todo.put(place)
                    continue
                self._order.note(mutant, red)
                self._done.put((place, red, whole, time.monotonic() - began_s))
        self._done.close()
        self._done.join_thread()
        return True

    def _named(self, tests, path):
        names = [name for test in tests for name in self._of_file.get(test, [test])]
        names += [name for name in self._items if self._reached.is_new(name, path)]
        return [name for name in dict.fromkeys(names) if name in self._items]

    def _is_green(self, name):
        """Whether a test passes without a change: one that fails anyway tells nothing."""
        if name not in self._green:
            red, _ = self._first_red(lambda: None, [name])
            if red is None:
                self._green.add(name)
        return name in self._green

    def pytest_runtest_logreport(self, report):
        """End this copy at the first test that fails."""
        if report.failed and self._tell is not None:
            os.write(self._tell, report.nodeid.encode())
            os._exit(_RED)

    def _first_red(self, change, names):
        hear, tell = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(hear)
            self._tell = tell
            self._run_and_exit(change, [self._items[name] for name in names])
        os.close(tell)
        try:
            ended = ended_within(child, self._limit_s)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
        if ended is None:
            os.waitpid(child, 0)
        with os.fdopen(hear) as said:
            red = said.read()
        return red or ("the process ended" if ended else None), ended is not None

    def _run_and_exit(self, change, items):
        code = _RED
        try:
            os.setsid()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            change()
            for item, following in zip(items, [*items[1:], None], strict=True):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            code = 0
        except BaseException as fault:  # noqa: BLE001 - nothing may come back into the worker
            os.write(self._tell, f"{type(fault).__name__}: {fault}".encode())
        finally:
            os._exit(code)


class _Order:
    """An order in which tests that have noticed a neighbouring change come first; otherwise it stays."""

    def __init__(self) -> None:
        self._red: dict[str, Counter[str]] = defaultdict(Counter)

    def note(self, mutant: Mutant, red: str | None) -> None:
        """Remember a test that has noticed a change."""
        if red is not None:
            self._red[mutant.path][red] += 1
            self._red[mutant.path + mutant.function][red] += 1

    def of(self, mutant: Mutant, names: list[str]) -> list[str]:
        """Return the tests in the order in which to run them."""
        near, far = self._red[mutant.path + mutant.function], self._red[mutant.path]
        return sorted(names, key=lambda name: (-near[name], -far[name]))


class Program:
    """The existing functions of a tree, and their caches."""

    def __init__(self, tree: Path) -> None:
        self._tree = tree
        self._functions = defaultdict(list)
        self._caches = []
        # The collector does not list frozen objects.
        gc.unfreeze()
        for found in gc.get_objects():
            if type(found) is types.FunctionType:
                self._functions[found.__code__.co_filename].append(found)
            elif type(found) is functools._lru_cache_wrapper and self._is_ours(found.__wrapped__):
                self._caches.append(found)

    def _is_ours(self, function: object) -> bool:
        code = getattr(function, "__code__", None)
        return code is not None and Path(code.co_filename).is_relative_to(self._tree)

    def with_change(self, mutant: Mutant, source: bytes):
        """Return a function that puts the change into the functions of its file."""
        file = str(self._tree / mutant.path)
        codes = _new_codes(file, source, mutant.applied(source))

        def change() -> None:
            for function in self._functions[file]:
                old = function.__code__
                function.__code__ = codes.get((old.co_qualname, old.co_firstlineno), old)
            for cache in self._caches:
                cache.cache_clear()

        return change


def _new_codes(file: str, source: bytes, changed: bytes) -> dict[tuple[str, int], types.CodeType]:
    """Return the code of each function after the change, by name and line.

    A change may move the lines below it, so functions of the same name are told apart by their order.
    """
    before, after = (list(_codes(compile(text, file, "exec"))) for text in (source, changed))
    of_name = defaultdict(list)
    for code in after:
        of_name[code.co_qualname].append(code)
    times = Counter((code.co_qualname, code.co_firstlineno) for code in before)
    new = {}
    for code in before:
        key = code.co_qualname, code.co_firstlineno
        same = of_name[code.co_qualname]
        other = same.pop(0) if same else code
        # Two lambdas in one line cannot be told apart; but the function that creates them gets its new code anyway.
        if times[key] == 1 and other.co_freevars == code.co_freevars:
            new[key] = other
    return new


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield constant
            yield from _codes(constant)
