"""How many bytes of the store an I-V curve takes, with and without its points.

Usage: python tests/measurements/curve_size.py
"""

import base64
import tempfile
from pathlib import Path

import numpy as np

from daemon.base.clock import SystemClock
from daemon.base.records import CurveQuality, IvCurve
from daemon.store.schema import FILE_NAME
from daemon.store.store import Origin, Store

CURVES, POINTS = 9000, 30


def bytes_of(count: int, *, points: bool) -> int:
    """Return the size of a store with so many curves."""
    random = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        origin = Origin(0.0, "both", "0", True, "nowhere", 0.0, 0.0, 0.0)
        store = Store(Path(folder), 0.2, 400, origin, SystemClock(), lambda _event: None)
        for number in range(count):
            values = [float(value) for value in 100.0 * random.random(9)]
            text = base64.b64encode(random.random(2 * POINTS).astype("<f4").tobytes()).decode() if points else ""
            store.keep(IvCurve(1.7e9 + 5 * number, 5.0 * number, *values, POINTS, CurveQuality.OK, "", text))
        store.close()
        return (Path(folder) / FILE_NAME).stat().st_size


if __name__ == "__main__":
    for points in (False, True):
        each = (bytes_of(CURVES, points=points) - bytes_of(0, points=points)) / CURVES
        print(f"{'with' if points else 'without'} points: {each:.0f} bytes a curve, {each * 8640 / 1e6:.1f} MB in 12 h")
