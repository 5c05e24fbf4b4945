"""How long the tests of one change may take, in processor time: a busy machine is not to decide what is caught."""

import os
import resource
import time
from pathlib import Path

_LOOK_EVERY_S = 0.01
# What waits takes no processor time; a test that waits for ever ends too.
_REAL_PER_PROCESSOR_S = 8.0
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def ended_within(child: int, limit_s: float) -> int | None:
    """Wait for a child and return its status, or None where its seconds of processor time are over before."""
    ends_s = time.monotonic() + _REAL_PER_PROCESSOR_S * limit_s
    while time.monotonic() < ends_s and _spent_s(child) < limit_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        time.sleep(_LOOK_EVERY_S)
    return None


def spent_by_children_s() -> float:
    """Return the processor time [s] of all children that have ended, with theirs."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _spent_s(child: int) -> float:
    # After the name, which may have blanks in it: user and system time, and those of its children that have ended.
    fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
    return sum(int(ticks) for ticks in fields[11:15]) / _TICKS_PER_S
