"""What the tests say about a change."""

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.mutation.operators import Mutant


@dataclass(frozen=True, slots=True)
class Verdict:
    """The test that failed, if any, and whether the time was enough for all."""

    mutant: Mutant
    red: str | None
    whole: bool
    took_s: float

    @property
    def caught(self) -> bool:
        """Whether a test has noticed the change."""
        return self.red is not None

    def __str__(self) -> str:
        """Say it in a few words."""
        said = self.red or ("by all its tests" if self.whole else "by those tests that the time was enough for")
        return f"{said}, {self.took_s:.0f} s"


@contextlib.contextmanager
def applied(mutant: Mutant, tree: Path) -> Iterator[bytes]:
    """Apply the change in the tree for a while, and yield the source without it."""
    file = tree / mutant.path
    source, times = file.read_bytes(), file.stat()
    file.write_bytes(mutant.applied(source))
    try:
        yield source
    finally:
        file.write_bytes(source)
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
