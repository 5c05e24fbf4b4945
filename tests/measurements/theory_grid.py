"""Time and memory of the exact ratios on the paper's whole grid: 66 latitudes, 91 tilts, 365 days.

Usage: python tests/measurements/theory_grid.py [repetitions]
"""

import os
import platform
import resource
import statistics
import sys
import time
from typing import TYPE_CHECKING

import numpy as np

from solar import gain

if TYPE_CHECKING:
    from collections.abc import Callable

    from solar.frames import Array


def main() -> None:
    """Print the time of each repetition's parts, their spread, and the peak of the process's memory."""
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 15
    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    phi, beta = np.arange(66.0)[:, None, None], np.arange(91.0)[:, None]
    parts: dict[str, Callable[[], Array]] = {
        "K_DS": lambda: gain.k_ds(phi, beta, gain.DAYS, 5.0),
        "K_DV": lambda: gain.k_dv(phi, beta, gain.DAYS),
        "K_DH": lambda: gain.k_dh(phi, beta, gain.DAYS, 5.0),
    }
    times: dict[str, list[float]] = {name: [] for name in (*parts, "all three")}
    for _ in range(repetitions):
        total = 0.0
        for name, ratio in parts.items():
            started = time.perf_counter()
            ratio()
            times[name].append(time.perf_counter() - started)
            total += times[name][-1]
        times["all three"].append(total)
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
          f"NumPy {np.__version__}, {repetitions} repetitions")  # fmt: skip
    for name, seconds in times.items():
        print(f"{name}: median {statistics.median(seconds):.3f} s, {min(seconds):.3f}..{max(seconds):.3f} s")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"memory: {before_mb:.0f} MB before, {peak_mb:.0f} MB at the peak")


if __name__ == "__main__":
    main()
