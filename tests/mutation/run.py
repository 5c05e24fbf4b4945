"""Make a sample of small wrong changes of the source, print which share the tests notice, and name the unnoticed ones.

Usage: ``python -m tests.mutation.run --sample 250 --seed 7`` (``--help`` for the rest). Everything happens in a copy of
the tree. For each change the nearest tests are run: those of its module, those that import the module, those of its
folder, in this order, until one fails or `--limit` seconds of processor time are over. With `--reach`, which names the
notes of tests.mutation.reach, all tests that reach the changed line are run, those of its module first, the quickest
first. Without it the share is rather too low, because tests further away might notice a change. A change that no test
notices is *alive*, and is printed. A change that no test can notice is listed in equivalent.toml with the reason, and
is not counted. After Ctrl-C the script prints the share for the changes that it has tried.
"""

import argparse
import contextlib
import itertools
import math
import multiprocessing
import os
import random
import signal
import tempfile
import tomllib
from collections.abc import Generator
from pathlib import Path

from tests.mutation import cold
from tests.mutation.nearest import Reached
from tests.mutation.operators import Mutant, mutants
from tests.mutation.verdict import Verdict
from tests.mutation.warm import is_of_a_function, keeps_its_cells, tried_warm
from tests.support import ROOT

EQUIVALENT = Path(__file__).with_name("equivalent.toml")
# The parts where a slip costs most: they compute, move, stop, or decide what is believed.
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
    verdicts: list[Verdict] = []
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with (
        contextlib.suppress(KeyboardInterrupt),
        tempfile.TemporaryDirectory(prefix="heliocube-mutation-") as folder,
        contextlib.closing(_tried(chosen, Reached(arguments.reach), arguments, Path(folder))) as tried,
    ):
        for verdict in tried:
            verdicts.append(verdict)
            if arguments.verbose or not verdict.caught:
                mutant = verdict.mutant
                word = _CAUGHT if verdict.caught else _ALIVE
                print(f"{len(verdicts):4} {word} {mutant.path}:{mutant.line} ({verdict})", flush=True)
                print(f"       - {mutant.was}\n       + {mutant.now}", flush=True)
    if verdicts:
        _tell(verdicts)


def _tried(
    chosen: list[Mutant], reached: Reached, arguments: argparse.Namespace, folder: Path
) -> Generator[Verdict, None, None]:
    """Put each change to its tests; changes of functions in copies of a process that has imported everything."""
    sources = {path: (ROOT / path).read_bytes() for path in {mutant.path for mutant in chosen}}
    functions, others = [], []
    for mutant in chosen:
        tests = list(itertools.chain.from_iterable(reached.stages(mutant)))
        # A function that no test reaches may be called while the tests are imported.
        source = sources[mutant.path]
        warm = reached.knows(mutant) and is_of_a_function(mutant, source) and keeps_its_cells(mutant, source)
        (functions if warm else others).append((mutant, tests))
    # Neighbours one after the other: a test that has noticed one change is likely to notice the next.
    functions.sort(key=lambda work: (work[0].path, work[0].begin))
    yield from tried_warm(functions, reached, arguments.limit, arguments.jobs, folder)
    context = multiprocessing.get_context("fork")
    with context.Pool(arguments.jobs, cold.settle, (folder, reached)) as pool:
        yield from pool.imap_unordered(cold.attempt, [(mutant, arguments.limit) for mutant, _ in others])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "paths", nargs="*", default=PARTS, help="files and folders to change (default: where a slip costs most)"
    )
    parser.add_argument("--sample", type=int, default=250, help="how many changes to try")
    parser.add_argument("--seed", type=int, default=1, help="chooses the sample: the same seed gives the same one")
    parser.add_argument("--jobs", type=int, default=1, help="how many changes to try at a time")
    parser.add_argument("--limit", type=float, default=120.0, help="processor time for the tests of one change [s]")
    parser.add_argument("--reach", type=Path, help="file that tests.mutation.reach has written")
    parser.add_argument("--only", help="of the sample, try only changes of files whose path begins so")
    parser.add_argument("--verbose", action="store_true", help="also print the changes that were noticed")
    parser.add_argument("--list", action="store_true", help="print all possible changes, and try none")
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


def _tell(verdicts: list[Verdict]) -> None:
    for part, members in itertools.groupby(sorted(verdicts, key=_part), key=_part):
        _line(part, [verdict.caught for verdict in members])
    _line("all", [verdict.caught for verdict in verdicts])


def _part(verdict: Verdict) -> str:
    path = verdict.mutant.path
    return next(part for part in (*PARTS, path) if path.startswith(part))


def _line(name: str, are_caught: list[bool]) -> None:
    caught, tried = sum(are_caught), len(are_caught)
    low, high = _interval(caught, tried)
    print(f"{name:30} {caught:4} of {tried:4} caught: {caught / tried:6.1%} ({low:.1%} to {high:.1%})")


def _interval(hits: int, tries: int, z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's interval of a share; at z = 1.96 it holds the true share 95 times in a hundred."""
    share = hits / tries
    middle = share + z * z / (2 * tries)
    half = z * math.sqrt(share * (1 - share) / tries + z * z / (4 * tries * tries))
    return (middle - half) / (1 + z * z / tries), (middle + half) / (1 + z * z / tries)


if __name__ == "__main__":
    main()
