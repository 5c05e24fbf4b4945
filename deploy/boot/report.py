"""The lines that a run prints: one a point, with what was seen and how long it took."""

import threading
import time
from collections.abc import Callable

from boot.host import CheckFailed, CheckSkipped


class Report:
    """Prints each point as it is done, from any thread, and remembers whether all were as they should be.

    Attributes
    ----------
    failed
        How many were not.
    """

    def __init__(self) -> None:
        self.failed = 0
        self._began_s = time.monotonic()
        self._count = 0
        self._one = threading.Lock()

    def run_check(self, name: str, see: Callable[[], str]) -> bool:
        """Look at one point, print it, and return whether it was as it should be."""
        began_s = time.monotonic()
        try:
            mark, seen = "ok", see()
        except CheckSkipped as why:
            mark, seen = "left out", str(why)
        except CheckFailed as why:
            mark, seen = "FAILED", str(why)
        with self._one:
            self.failed += mark == "FAILED"
            self._count += mark == "ok"
            print(f"{mark:8} {time.monotonic() - began_s:5.1f} s  {name}: {seen}", flush=True)
        return mark == "ok"

    def end(self) -> None:
        """Print the last line."""
        took_s = time.monotonic() - self._began_s
        failed = f", {self.failed} FAILED" if self.failed else ""
        print(f"test-boot: {self._count} points as they should be{failed}, in {took_s:.0f} s")
