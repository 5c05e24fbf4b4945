"""Writes docs/modes.md: which mode follows from which situation, asked of `daemon.tracker.modes.next_mode` itself.

Run `python docs/modes_table.py` after a change; a test compares.
"""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

from daemon.base.records import Mode
from daemon.tracker.modes import DataState, Situation, next_mode

PAGE = Path(__file__).parent / "modes.md"

# Each field of a situation, its values, and the words for the one that matters; in the order of the rows.
CONDITIONS: dict[str, tuple[str, Any, Any]] = {
    "maintenance_why": ("maintenance", "x", None),
    "blocked_why": ("the positioner can move nothing", "x", None),
    "connected": ("no telemetry", False, True),
    "stop_why": ("a person's stop", "x", None),
    "buttons_why": ("a button pressed at the unit", "x", None),
    "stow_why": ("stow wanted", "x", None),
    "homing": ("a reference run", True, False),
    "doubt_why": ("reference in doubt, or last move failed", "x", None),
    "snow_why": ("snow position asked for", "x", None),
    "hold_why": ("hold or goto", "x", None),
    "night_why": ("night", "x", None),
}
DATA = {
    DataState.FRESH: "readings good",
    DataState.BAD: "no good readings, or dark by day",
    DataState.WAITING: "readings awaited",
}
_INTRO = """# Modes: every situation by every mode

This page shows which mode follows from which situation. `docs/modes_table.py` writes it from the state machine itself,
over all {count:,} situations in each of the {modes} modes; a test compares. What the modes do is in
[operate.md](operate.md#modes).

## The first row that applies decides

Read the table from the top: the first row whose situation holds decides, and the rows below it change nothing. The mode
in which the tracker was before (the columns) matters in the last row only. The last column counts the situations that a
row decides.

| Situation | {heads} | Situations |
|---|{rules}---|
"""
_PAIRS = """
## Two at once

This table has the mode when the conditions of row and column hold, and no other, with good readings by day.

"""


def situations() -> Iterator[Situation]:
    """Yield every situation there is."""
    for values in product(*([met, unmet] for _, met, unmet in CONDITIONS.values())):
        for data in DataState:
            yield Situation(**dict(zip(CONDITIONS, values, strict=True)), data=data, data_why="x")


def first_condition(situation: Situation) -> str:
    """Return the words for the first condition that a situation meets."""
    for field, (words, met, _) in CONDITIONS.items():
        if getattr(situation, field) == met:
            return words
    return DATA[situation.data]


def table() -> dict[str, tuple[tuple[Mode, ...], int]]:
    """Return, by first condition, the next mode from each mode, and how many situations that decides.

    Raises `ValueError` where situations with the same first condition lead to different modes.
    """
    found: dict[str, tuple[tuple[Mode, ...], int]] = {}
    for situation in situations():
        words = first_condition(situation)
        after = tuple(next_mode(mode, situation)[0] for mode in Mode)
        known, count = found.get(words, (after, 0))
        if known != after:
            raise ValueError(f"'{words}' alone does not decide: {situation}")
        found[words] = (after, count + 1)
    return {words: found[words] for words in [*(words for words, *_ in CONDITIONS.values()), *DATA.values()]}


def page() -> str:
    """Return docs/modes.md."""
    rows = table()
    count = sum(number for _, number in rows.values())
    heads = " | ".join(f"from `{mode}`" for mode in Mode)
    text = _INTRO.format(count=count, modes=len(Mode), heads=heads, rules="---|" * len(Mode))
    for words, (after, number) in rows.items():
        text += f"| {words} | {' | '.join(mode.value for mode in after)} | {number} |\n"
    names = [words for words, *_ in CONDITIONS.values()]
    text += _PAIRS + f"| | {' | '.join(names)} |\n|---|{'---|' * len(names)}\n"
    for row in CONDITIONS:
        cells = (next_mode(Mode.TRACKING, _with(row, column))[0].value for column in CONDITIONS)
        text += f"| **{CONDITIONS[row][0]}** | {' | '.join(cells)} |\n"
    return text


def _with(*fields: str) -> Situation:
    values = {field: met if field in fields else unmet for field, (_, met, unmet) in CONDITIONS.items()}
    return Situation(**values, data=DataState.FRESH, data_why="x")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
