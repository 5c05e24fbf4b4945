"""The page of all faults: what is declared for each, and the worst that was seen."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from daemon.base.errors import UserError
from daemon.base.files import replace_file
from daemon.studies.campaign.declared import REASONS_WITHOUT_DRILL, declared_drills
from daemon.studies.campaign.drills import Drill, WorstSeen, describe_exceeded_bounds
from daemon.studies.campaign.many import run_all
from daemon.studies.campaign.matrix import COMPONENTS, FAULT_KINDS, cell
from daemon.studies.campaign.pairs import LEFT_OUT, Pair, declared_pairs, measure_pairs, pair_rows
from daemon.studies.spread.workers import Workers

_HEAD = """# Reliability: every fault, what is declared for it, and the worst seen

Written by `heliocube campaign --reliability docs/reliability.md`. The figures are those of the simulated rig under
virtual time, with the real drivers and the service itself. They are the same on every machine, and no rig was measured.
Here each fault happens alone, {runs} times, at rest or in mid-move, each time at another moment of the unit's screens
and of the service's decisions. Then each two of them happen together, once. Every promise of the campaign is watched
throughout. In [the campaign](campaign.md) the faults happen at random.

## One fault at a time

"Mode" is what the tracker must go to, and the first "Bound" how soon after the fault began; "goes on" means that it
keeps its mode. "Back by" is what brings it back to work: itself, or commands that a person has to give. The second
bound is for the time from the end of the fault, or from the last of those commands, until it works again. {broken}

| Fault | For | When | Mode | Bound | Worst | Back by | Bound | Worst |
|---|---|---|---|---|---|---|---|---|
"""
_PAIRS = """
## Two faults at once

Each pair of the faults above is tried once: at rest the second begins 7 s after the first, in mid-move 0.2 s after it.
The tracker must be in the stronger of the two declared modes within the longer of their two bounds, or within the sum
of both where a fault is of the process. When both faults are over and a person has given the commands, it must work
again within the sum of the two bounds for coming back.

{left_out}

{broken}

| Mode | Pairs | Bound, at most | Worst | Back: bound, at most | Worst |
|---|---|---|---|---|---|
"""
_UNSEEN_HEAD = """
These faults have no row above; the campaign uses them all the same:

| Fault | Why |
|---|---|
"""
_MATRIX = """
## Component by component

The table names the faults that the campaign gives each component; kinds of fault with the same answer share a row. A
kind that is not done is refused by `--only COMPONENT:FAULT`, for the reason in the last column.

| Component | Kinds of fault | Done as, or why not |
|---|---|---|
"""


def write_reliability(path: Path, workers: Workers, progress: Callable[[float], None]) -> list[str]:
    """Run all drills, write the page and return a sentence for each bound that was not kept.

    Raises `UserError` where the page cannot be written.
    """
    drills = declared_drills()
    pairs = declared_pairs(drills)
    alone = sum(1 for drill in drills for _ in drill.schedules())
    share = alone / (alone + len(pairs))
    results = measure_drills(drills, workers, lambda done: progress(done * share))
    seen = measure_pairs(pairs, workers, lambda done: progress(share + done * (1 - share)))
    try:
        replace_file(path, page(drills, results, pairs, seen))
    except OSError as error:
        raise UserError(f"--reliability: {path} cannot be written: {error}") from error
    return [*_drill_failures(drills, results), *_pair_failures(pairs, seen)]


def measure_drills(drills: Sequence[Drill], workers: Workers, progress: Callable[[float], None]) -> list[WorstSeen]:
    """Return the worst of each drill's runs."""
    schedules = [tuple(drill.schedules()) for drill in drills]
    outcomes = iter(run_all([one for some in schedules for one in some], workers, progress))
    return [drill.measure(some, [next(outcomes) for _ in some]) for drill, some in zip(drills, schedules, strict=True)]


def exceeded_bounds(drill: Drill, measured: WorstSeen) -> Iterator[str]:
    """Yield a sentence for each thing in which a drill was worse than declared."""
    yield from describe_exceeded_bounds(
        f"{drill.fault} {drill.phase}", _modes(drill), drill.within_s, drill.recovery_s, measured
    )


def _drill_failures(drills: Sequence[Drill], results: Sequence[WorstSeen]) -> list[str]:
    return [text for drill, measured in zip(drills, results, strict=True) for text in exceeded_bounds(drill, measured)]


def _pair_failures(pairs: Sequence[Pair], seen: Sequence[WorstSeen]) -> list[str]:
    return [text for pair, found in zip(pairs, seen, strict=True) for text in pair.exceeded_bounds(found)]


def _verdict(broken: Sequence[str]) -> str:
    return f"Not kept: {'; '.join(broken)}." if broken else "Every bound is kept, and no promise was broken."


def page(
    drills: Sequence[Drill], results: Sequence[WorstSeen], pairs: Sequence[Pair], seen: Sequence[WorstSeen]
) -> str:
    """Return the page."""
    kept = _verdict(_drill_failures(drills, results))
    runs = sum(measured.runs for measured in results)
    text = _HEAD.format(runs=f"{results[0].runs if results else 0}", broken=f"{kept} {runs} runs in all.")
    for drill, measured in zip(drills, results, strict=True):
        text += f"| {_row(drill, measured)} |\n"
    text += _PAIRS.format(
        left_out=LEFT_OUT, broken=f"{_verdict(_pair_failures(pairs, seen))} {len(pairs)} runs in all."
    )
    text += "".join(f"| {row} |\n" for row in pair_rows(pairs, seen))
    text += _UNSEEN_HEAD + "".join(f"| `{name}` | {why} |\n" for name, why in REASONS_WITHOUT_DRILL.items())
    text += _MATRIX
    return text + "".join(f"| {row} |\n" for component in COMPONENTS for row in _component_rows(component))


def _component_rows(component: str) -> Iterator[str]:
    """Yield a row for each answer that a component's kinds of fault have."""
    kinds: dict[str, list[str]] = {}
    for kind in FAULT_KINDS:
        found = cell(component, kind)
        done = f"not done: {found}" if isinstance(found, str) else ", ".join(f"`{name}`" for name in found)
        kinds.setdefault(done, []).append(kind)
    for done, alike in kinds.items():
        yield f"{component} | {', '.join(alike)} | {done}"


def _row(drill: Drill, measured: WorstSeen) -> str:
    value = f" {' '.join(f'{number:g}' for number in drill.value)}" if drill.value else ""
    lasts = f"{drill.lasts_s:g} s" if drill.lasts_s else "at once"
    bound, worst = (f"{drill.within_s:g} s", f"{measured.reached_s:.1f} s") if drill.mode else ("", "")
    by = ", ".join(f"`{name}`" for name in drill.commands) or "itself"
    back = f"{drill.recovery_s:g} s | {measured.recovery_s:.1f} s"
    of = " of a rotator" if drill.positioner == "rotctld" else ""
    return f"`{drill.fault}`{value}{of} | {lasts} | {drill.phase} | {_modes(drill)} | {bound} | {worst} | {by} | {back}"


def _modes(drill: Drill) -> str:
    return " or ".join(drill.mode) or "goes on"
