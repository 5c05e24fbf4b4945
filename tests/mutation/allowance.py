"""How long the tests of one change may take, in processor time: a busy machine must not decide what is caught."""

import os
import resource
import time
from pathlib import Path

_LOOK_EVERY_S = 0.01
# A test that waits uses no processor time; with this limit one that waits forever ends too.
_REAL_PER_PROCESSOR_S = 8.0
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def ended_within(child: int, limit_s: float) -> int | None:
    """Wait for a child and return its status, or None if it uses up its seconds of processor time first."""
    ends_s = time.monotonic() + _REAL_PER_PROCESSOR_S * limit_s
    while time.monotonic() < ends_s and _spent_s(child) < limit_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        time.sleep(_LOOK_EVERY_S)
    return None


def spent_by_children_s() -> float:
    """Return the processor time [s] of all children that have ended, and of their children."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _spent_s(child: int) -> float:
    # The fields after the name, which may contain blanks: user and system time, its own and that of ended children.
    fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
    return sum(int(ticks) for ticks in fields[11:15]) / _TICKS_PER_S
