"""Tell which share of small wrong changes of the source some test notices, by a sample, and name those that none does.

Usage: ``python -m tests.mutation.run --sample 250 --seed 7`` (``--help`` for the rest). Everything happens in a copy of
the tree. Each change is put to the tests that lie nearest: those of its module, those that import it, those of its
folder, in this order, until one is red or `--limit` seconds are over; where `--reach` knows which tests enter the
function (tests.mutation.reach), to those, the quickest first. What tests further away would notice is not
asked, so the share is rather too low. What is left alive is printed with what was changed. A change that no test can
notice is listed in equivalent.toml with the reason and is not counted.
"""

import argparse
import contextlib
import functools
import importlib
import itertools
import json
import math
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import traceback
from pathlib import Path

import pytest

from tests.mutation.operators import Mutant, mutants
from tests.support import ROOT, SHARED

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
# Tests that start processes or brokers tell little of one line, and late.
_TOO_FAR = {"campaign", "docs", "firmware", "fuzz", "measurements", "mutation", "support", "system"}
# Holds every default and bound of the settings.
_OF_SETTINGS = "tests/daemon/config/test_file.py::test_the_reference_document_is_current"
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
    arguments = _arguments()
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
    results = {}
    with (
        tempfile.TemporaryDirectory(prefix="heliocube-mutation-") as folder,
        multiprocessing.get_context("fork").Pool(arguments.jobs, _settle, (Path(folder),)) as pool,
    ):
        reach = json.loads(arguments.reach.read_text()) if arguments.reach else {}
        work = [(mutant, _tests_for(mutant, reach), arguments.limit) for mutant in chosen]
        for number, (mutant, verdict, note) in enumerate(pool.imap_unordered(_try, work), 1):
            results[mutant] = verdict
            if verdict == _ALIVE or arguments.verbose:
                print(f"{number:4} {verdict} {mutant.path}:{mutant.line} ({note})", flush=True)
                print(f"       - {mutant.was}\n       + {mutant.now}", flush=True)
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


def _copy_into(folder: Path) -> Path:
    tree = folder / "tree"
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0"):
        if name and (ROOT / name).is_file():
            target = tree / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
    # The measured weather lies beside the tree.
    if SHARED.is_dir():
        (folder / SHARED.name).symlink_to(SHARED)
    return tree


def _begin_afresh() -> None:
    """Have the tests import the tree of the current folder, and nothing of this one."""
    for name in [name for name in sys.modules if name.partition(".")[0] in {"tests", "solar", "drivers", "daemon"}]:
        del sys.modules[name]
    sys.path[:] = [str(Path.cwd()), *(path for path in sys.path if Path(path or ".").resolve() != ROOT)]


_tree: Path


def _settle(folder: Path) -> None:
    """Give this worker a tree of its own."""
    global _tree
    _tree = _copy_into(folder / str(os.getpid()))
    for library in _LIBRARIES:
        importlib.import_module(library)


@functools.cache
def _nearest(path: str) -> tuple[str, ...]:
    """Return the test files of a module, then those that import it, then those of its folder."""
    module = Path(path)
    folder = Path("tests", module.parent)
    name = ".".join(module.with_suffix("").parts)
    imports = re.compile(rf"(?:from|import) {re.escape(name)}\b")
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
    return *own, *of_settings, *importing, *beside


def _tests_for(mutant: Mutant, reach: dict[str, dict]) -> tuple[str, ...]:
    """Return what to run for a change: the nearest test files, in the place of those that are known their own tests."""
    nearest = _nearest(mutant.path)
    within = f"{mutant.path}:{mutant.function}"
    entering = [test for test, entry in reach.items() if mutant.function and within in entry["functions"]]
    if not entering:
        return nearest
    known = {test.partition("::")[0] for test in reach}
    unknown = [file for file in nearest if file not in known]
    # Those of its own module come first in any case.
    first = int(unknown[:1] == list(nearest[:1]))
    return *unknown[:first], *sorted(entering, key=lambda test: reach[test]["seconds"]), *unknown[first:]


def _try(work: tuple[Mutant, tuple[str, ...], float]) -> tuple[Mutant, str, str]:
    mutant, tests, limit_s = work
    file = _tree / mutant.path
    source, times = file.read_bytes(), file.stat()
    file.write_bytes(mutant.applied(source))
    began_s = time.monotonic()
    try:
        red, whole = _first_red(tests, limit_s)
    finally:
        file.write_bytes(source)
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    took_s = time.monotonic() - began_s
    note = red or ("by all its tests" if whole else "by those tests that the time was enough for")
    return mutant, _ALIVE if red is None else _CAUGHT, f"{note}, {took_s:.0f} s"


def _first_red(tests: tuple[str, ...], limit_s: float) -> tuple[str | None, bool]:
    """Run tests until one is red; return its name, or None where none is, and whether the time was enough."""
    child = os.fork()
    if child == 0:
        _run_and_exit(tests)
    ends_s = time.monotonic() + limit_s
    status = 0
    while time.monotonic() < ends_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            _end_group(child)
            break
        time.sleep(0.02)
    else:
        _end_group(child)
        os.waitpid(child, 0)
        return None, False
    return _named_in_output() if status else None, True


def _named_in_output() -> str:
    told = [line for line in _output().read_text(errors="replace").splitlines() if line.startswith(("FAILED", "ERROR"))]
    return told[0].split(" - ")[0] if told else "the tests could not be run"


def _output() -> Path:
    return _tree.with_name("output.txt")


def _end_group(leader: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(leader, signal.SIGKILL)


def _run_and_exit(tests: tuple[str, ...]) -> None:
    os.setsid()
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY_BYTES, _MOST_MEMORY_BYTES))
    sys.dont_write_bytecode = True
    output = os.open(_output(), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.chdir(_tree)
    _begin_afresh()
    code = 3
    try:
        code = int(pytest.main([*_PLAIN, "-x", f"--timeout={_ONE_TEST_S}", *tests]))
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
