"""The recent past of the cube, averaged over time and not over samples."""

import math
from collections import deque

from daemon.base.records import Irradiances, Quality, Scan


class Window:
    """Time-weighted mean of each face over the last `mean_s` seconds.

    A reading stands for the time since the one before it on the same face, for `longest_s` at the most; a reading that
    is not ok stands for nothing. At an even rhythm this is the plain mean of the samples inside the window.

    Parameters
    ----------
    mean_s
        Length of the window.
    nominal_s
        What the first reading after a gap stands for.
    longest_s
        The longest time that one reading may stand for.
    stale_s
        A face of which the newest good reading is older than this has no mean and covers nothing.
    """

    def __init__(self, mean_s: float, nominal_s: float, longest_s: float, stale_s: float = math.inf) -> None:
        self._mean_s = mean_s
        self._nominal_s = nominal_s
        self._longest_s = longest_s
        self._stale_s = stale_s
        self._faces = tuple(_FaceWindow(mean_s) for _ in range(4))

    def add(self, scan: Scan) -> None:
        """Take in a scan; its monotonic times must not run backwards."""
        for window, face in zip(self._faces, scan.faces, strict=True):
            if face.quality is not Quality.OK:
                continue
            elapsed_s = face.time_monotonic_s - window.newest_s
            stands_for_s = elapsed_s if elapsed_s <= self._longest_s else self._nominal_s
            window.add(face.time_monotonic_s, stands_for_s, face.irradiance_w_m2)

    def clear(self) -> None:
        """Forget everything."""
        self._faces = tuple(_FaceWindow(self._mean_s) for _ in range(4))

    def mean(self, now_s: float, faces_needed: int = 4) -> Irradiances | None:
        """Return the mean over (now - mean_s, now], or None while too many faces have no fresh good reading in it.

        A face without one is NaN; coverage is that of the worst among the `faces_needed` best.
        """
        means, covered = [], []
        for window in self._faces:
            stale = now_s - window.newest_s > self._stale_s
            mean, covered_s = (math.nan, 0.0) if stale else window.mean(now_s)
            means.append(mean)
            covered.append(covered_s)
        needed_s = min(covered) if faces_needed == 4 else sorted(covered)[4 - faces_needed]
        if not needed_s > 0:
            return None
        east, south, west, zenith = means
        return Irradiances(east, south, west, zenith, min(1.0, needed_s / self._mean_s))


class _FaceWindow:
    """One face: its readings with the time each stands for, and their running totals."""

    def __init__(self, mean_s: float) -> None:
        self._mean_s = mean_s
        self._readings: deque[tuple[float, float, float]] = deque()
        self._covered_s = 0.0
        self._total = 0.0
        self.newest_s = -math.inf

    def add(self, end_s: float, length_s: float, irradiance: float) -> None:
        self._readings.append((end_s, length_s, irradiance))
        self._covered_s += length_s
        self._total += length_s * irradiance
        self.newest_s = end_s

    def mean(self, now_s: float) -> tuple[float, float]:
        """Return the mean and how much of the window it stands for [s]; what is older is forgotten."""
        readings, start_s = self._readings, now_s - self._mean_s
        while readings and readings[0][0] <= start_s:
            _, length_s, irradiance = readings.popleft()
            self._covered_s -= length_s
            self._total -= length_s * irradiance
        if not readings:
            self._covered_s = self._total = 0.0
            return math.nan, 0.0
        end_s, length_s, irradiance = readings[0]
        # Only the oldest reading can reach beyond the window's start.
        outside_s = length_s - (end_s - start_s)
        if outside_s <= 0.0:
            return self._total / self._covered_s, self._covered_s
        covered_s = self._covered_s - outside_s
        return (self._total - outside_s * irradiance) / covered_s, covered_s
