"""What the maker's firmware did in the sequences of the oracle, so that most of them need no emulator.

    python -m tests.firmware.recorded

writes the recordings anew. A freshly started firmware does the same each time. Every twentieth sequence is used to test
that it still does what is recorded.
"""

import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from tests.firmware.odd_sequences import odd_sequence
from tests.firmware.peer import BUILD, FIRMWARE, Firmware, Look, Simulated, driver, missing
from tests.firmware.sequences import Outcome, Sequence, compare, sequence

MAKERS: dict[str, Callable[[int], Sequence]] = {"ordinary": sequence, "odd": lambda seed: odd_sequence(seed)[1]}
# Always the same, so that a failing test means a change; tests/measurements/firmware_agreement.py draws others.
SEEDS = range(1_000_000, 1_000_040)
ONCE_DIFFERED = {
    "ordinary": (50079, 3228423247, 910204, 910209, 910088, 910110),
    "odd": (16, 51, 100),
}
"""Sequences in which the two units differed before the simulated one was corrected."""
_FOLDER = Path(__file__).parent / "recordings"
_DIGITS = 3
Page = dict[str, Any]


class _Heard(Firmware):
    """The firmware, with all that it shows recorded."""

    def __init__(self, module: ModuleType, a_deg: float, b_deg: float) -> None:
        super().__init__(module, a_deg, b_deg)
        counts, left_over = self.stands()
        self.page: Page = {"true": counts, "rx": left_over, "looks": []}

    def look(self) -> Look:
        look = super().look()
        millimetres = (*look.position_mm, *look.destination_mm)
        self.page["looks"].append([*(round(value, _DIGITS) for value in millimetres), *look.motion, look.status])
        return look


class Recorded:
    """Stands where the firmware stood, and shows what it showed; calls do nothing, since they were recorded."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._looks: Iterator[list[float]] = iter(page["looks"])

    def step(self, ms: int) -> None:
        """Let time pass."""

    def feed(self, packet: bytes) -> None:
        """Send bytes."""

    def cause(self, event: str) -> None:
        """Do something to the unit other than a command."""

    def look(self) -> Look:
        """Return the next recorded look."""
        a_mm, b_mm, to_a_mm, to_b_mm, a, b, status = next(self._looks)
        return Look((a_mm, b_mm), (to_a_mm, to_b_mm), (int(a), int(b)), int(status))

    def twin(self) -> Simulated:
        """Return a simulated unit that stands where the firmware stood."""
        return Simulated.like(self._page["true"], self._page["rx"])


def fingerprint(what: object) -> str:
    """Return a text that tells one case, or one build of the firmware, from another."""
    return hashlib.sha256(what if isinstance(what, bytes) else repr(what).encode()).hexdigest()[:16]


def firmware() -> str:
    """Return the fingerprint of the firmware that lies beside the repository."""
    return fingerprint(b"".join((FIRMWARE / name).read_bytes() for name in (f"firmware_{BUILD}", "fw.py")))


def heard(module: ModuleType, case: Sequence) -> tuple[Page, Outcome]:
    """Give a case to a fresh firmware; return what it showed, and where a fresh simulated unit differed."""
    unit = _Heard(module, case.a_deg, case.b_deg)
    try:
        outcome = compare(unit, unit.twin(), case)
        return {"case": fingerprint(case), **unit.page}, outcome
    finally:
        unit.close()


def read(which: str) -> tuple[str, dict[int, Page]]:
    """Return the fingerprint of the recorded firmware, and the recording of each seed."""
    first, *lines = (_FOLDER / f"{which}.jsonl").read_text().splitlines()
    return json.loads(first)["firmware"], {page["seed"]: page for page in map(json.loads, lines)}


def main() -> None:
    """Record all sequences."""
    if why := missing():
        sys.exit(why)
    module = driver()
    _FOLDER.mkdir(exist_ok=True)
    for which, make in MAKERS.items():
        seeds = (*SEEDS, *ONCE_DIFFERED[which])
        pages = [{"firmware": firmware()}, *({"seed": seed, **heard(module, make(seed))[0]} for seed in seeds)]
        lines = (json.dumps(page, separators=(",", ":")) for page in pages)
        (_FOLDER / f"{which}.jsonl").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
