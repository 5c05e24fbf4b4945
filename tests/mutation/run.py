"""Tell which share of small wrong changes of the source some test notices, by a sample, and name those that none does.

Usage: ``python -m tests.mutation.run --sample 250 --seed 7`` (``--help`` for the rest). Everything happens in a copy of
the tree. Each change is put to the tests that lie nearest: those of its module, those that import it, those of its
folder, in this order, until one is red or `--limit` seconds are over. With `--reach`, which knows the lines that each
test reaches (tests.mutation.reach), it is put to all that reach its line, those of its module first, the quickest
first; without, what tests further away would notice is not asked, so the share is rather too low. What is left alive is
printed with what was changed. A change that no test can notice is listed in equivalent.toml with the reason and is not
counted. Ctrl-C ends it early and tells the share of what has been tried.
"""

import argparse
import contextlib
import importlib
import itertools
import math
import multiprocessing
import os
import random
import resource
import signal
import sys
import tempfile
import time
import tomllib
import traceback
from pathlib import Path

import pytest

from tests.mutation.nearest import Reached
from tests.mutation.operators import Mutant, mutants
from tests.mutation.tree import begin_afresh, copy_into
from tests.support import ROOT

EQUIVALENT = Path(__file__).with_name("equivalent.toml")
# The parts where a slip costs most: what computes, what moves, what stops, and what is believed.
PARTS = (
    "solar",
    "drivers",
    "daemon/tracker",
    "daemon/cube",
    "daemon/bridge",
    "daemon/motion",
    "daemon/base/clock_watch.py",
    "daemon/base/reconnect.py",
    "daemon/mqtt/safety_inputs.py",
    "daemon/service/operator.py",
)
# Read once, before the forks: a test's process then begins in a fraction of a second.
_LIBRARIES = ("numpy", "pandas", "pvlib", "pydantic", "pyarrow", "scipy.interpolate", "scipy.optimize", "scipy.special")
_PLAIN = (
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
_CAUGHT, _ALIVE = "caught", "alive"


def main() -> None:
    """Sample, try and tell."""
    global _reached
    arguments = _arguments()
    # Before the forks: a process of the pool that cannot begin is begun again for ever.
    _reached = Reached(arguments.reach)
    all_mutants = _all_mutants(arguments.paths)
    if arguments.list:
        print("\n".join(f"{mutant.path}:{mutant.line}: {mutant.was}  ->  {mutant.now}" for mutant in all_mutants))
        return
    os.environ["CI"] = "yes"  # Hypothesis draws the same examples every time.
    unequal = _without_equivalent(all_mutants)
    chosen = unequal
    if arguments.sample < len(unequal):
        chosen = random.Random(arguments.seed).sample(unequal, arguments.sample)
    chosen = [mutant for mutant in chosen if arguments.only is None or mutant.path.startswith(arguments.only)]
    print(f"{len(chosen)} of {len(unequal)} changes, seed {arguments.seed}", flush=True)
    results: dict[Mutant, str] = {}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with (
        contextlib.suppress(KeyboardInterrupt),
        tempfile.TemporaryDirectory(prefix="heliocube-mutation-") as folder,
        multiprocessing.get_context("fork").Pool(arguments.jobs, _settle, (Path(folder),)) as pool,
    ):
        work = [(mutant, arguments.limit) for mutant in chosen]
        for number, (mutant, verdict, note) in enumerate(pool.imap_unordered(_try, work), 1):
            results[mutant] = verdict
            if verdict == _ALIVE or arguments.verbose:
                print(f"{number:4} {verdict} {mutant.path}:{mutant.line} ({note})", flush=True)
                print(f"       - {mutant.was}\n       + {mutant.now}", flush=True)
    if results:
        _tell(results)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", default=PARTS, help="files and folders to change (the parts that count)")
    parser.add_argument("--sample", type=int, default=250, help="how many changes")
    parser.add_argument("--seed", type=int, default=1, help="of the choice")
    parser.add_argument("--jobs", type=int, default=1, help="how many at a time")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds of tests for one change")
    parser.add_argument("--reach", type=Path, help="what tests.mutation.reach has noted")
    parser.add_argument("--only", help="of the sample, what begins with this path")
    parser.add_argument("--verbose", action="store_true", help="print what was caught, too")
    parser.add_argument("--list", action="store_true", help="print all changes, and try none")
    return parser.parse_args()


def _all_mutants(paths: tuple[str, ...]) -> list[Mutant]:
    files = itertools.chain.from_iterable(
        [ROOT / path] if (ROOT / path).is_file() else sorted((ROOT / path).rglob("*.py")) for path in paths
    )
    return [mutant for file in files for mutant in mutants(str(file.relative_to(ROOT)), file.read_bytes())]


def _without_equivalent(found: list[Mutant]) -> list[Mutant]:
    known = {f"{entry['path']} | {entry['was']} | {entry['now']}" for entry in equivalent()}
    return [mutant for mutant in found if mutant.key not in known]


def equivalent() -> list[dict[str, str]]:
    """Return the changes that no test can notice: path, was, now, and why."""
    return tomllib.loads(EQUIVALENT.read_text())["equivalent"] if EQUIVALENT.exists() else []


_tree: Path
_reached: Reached


def _settle(folder: Path) -> None:
    """Give this worker a tree of its own."""
    global _tree
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _tree = copy_into(folder / str(os.getpid()))
    for library in _LIBRARIES:
        importlib.import_module(library)


def _try(work: tuple[Mutant, float]) -> tuple[Mutant, str, str]:
    mutant, limit_s = work
    file = _tree / mutant.path
    source, times = file.read_bytes(), file.stat()
    file.write_bytes(mutant.applied(source))
    began_s = time.monotonic()
    try:
        red, whole = _first_red(mutant, limit_s)
    finally:
        file.write_bytes(source)
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    took_s = time.monotonic() - began_s
    note = red or ("by all its tests" if whole else "by those tests that the time was enough for")
    return mutant, _ALIVE if red is None else _CAUGHT, f"{note}, {took_s:.0f} s"


class _Chosen:
    """A pytest plugin that keeps these tests in this order, and all of a file that is named as a whole."""

    def __init__(self, tests: list[str], path: str) -> None:
        self.files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
        self._place = {test: place for place, test in enumerate(tests)}
        self._path = path

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        """Leave out the others; what was not there when the tests were looked at comes last."""
        places = [self._place_of(item.nodeid) for item in items]
        ordered = sorted(zip(places, range(len(items)), items, strict=True))
        items[:] = [item for place, _, item in ordered if place < math.inf]

    def _place_of(self, test: str) -> float:
        place = self._place.get(test, self._place.get(test.partition("::")[0]))
        if place is not None:
            return place
        return len(self._place) if _reached.is_new(test, self._path) else math.inf


def _first_red(mutant: Mutant, limit_s: float) -> tuple[str | None, bool]:
    """Run tests until one is red; return its name, or None where none is, and whether the time was enough."""
    ends_s = time.monotonic() + limit_s
    for tests in _reached.stages(mutant):
        status = _status(_Chosen(tests, mutant.path), ends_s) if tests else 0
        if status is None:
            return None, False
        if status:
            return _named_in_output(), True
    return None, True


def _status(chosen: _Chosen, ends_s: float) -> int | None:
    """Run tests in a process of their own; return 0 for green, and None where the time was too short."""
    child = os.fork()
    if child == 0:
        _run_and_exit(chosen)
    try:
        while time.monotonic() < ends_s:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                return 0 if os.waitstatus_to_exitcode(status) == pytest.ExitCode.NO_TESTS_COLLECTED else status
            time.sleep(0.02)
    finally:
        _end_group(child)
    os.waitpid(child, 0)
    return None


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
        code = int(pytest.main([*_PLAIN, "-x", f"--timeout={_ONE_TEST_S}", *chosen.files], plugins=[chosen]))
    except BaseException:  # noqa: BLE001 - nothing may come back into the worker
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _tell(results: dict[Mutant, str]) -> None:
    by_part = itertools.groupby(sorted(results, key=_part), key=_part)
    for part, members in by_part:
        _line(part, [results[mutant] for mutant in members])
    _line("all", list(results.values()))


def _part(mutant: Mutant) -> str:
    return next(part for part in (*PARTS, mutant.path) if mutant.path.startswith(part))


def _line(name: str, verdicts: list[str]) -> None:
    caught, tried = verdicts.count(_CAUGHT), len(verdicts)
    low, high = _interval(caught, tried)
    print(f"{name:30} {caught:4} of {tried:4} caught: {caught / tried:6.1%} ({low:.1%} to {high:.1%})")


def _interval(hits: int, tries: int, z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's interval of a share; at z = 1.96 it holds 95 times in a hundred."""
    share = hits / tries
    middle = share + z * z / (2 * tries)
    half = z * math.sqrt(share * (1 - share) / tries + z * z / (4 * tries * tries))
    return (middle - half) / (1 + z * z / tries), (middle + half) / (1 + z * z / tries)


if __name__ == "__main__":
    main()
