"""The recent past of the cube, averaged over time and not over samples."""

from collections import deque

from daemon.records import Irradiances, Quality, Scan


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
    """

    def __init__(self, mean_s: float, nominal_s: float, longest_s: float) -> None:
        self._mean_s = mean_s
        self._nominal_s = nominal_s
        self._longest_s = longest_s
        # Of each face: (end of the time it stands for, its length, irradiance).
        self._faces: tuple[deque[tuple[float, float, float]], ...] = tuple(deque() for _ in range(4))

    def add(self, scan: Scan) -> None:
        """Take in a scan; its monotonic times must not run backwards."""
        for readings, face in zip(self._faces, scan.faces, strict=True):
            if face.quality is not Quality.OK:
                continue
            elapsed = face.time_monotonic_s - readings[-1][0] if readings else self._nominal_s
            stands_for = elapsed if elapsed <= self._longest_s else self._nominal_s
            readings.append((face.time_monotonic_s, stands_for, face.irradiance_w_m2))
            oldest = face.time_monotonic_s - self._mean_s
            while readings[0][0] <= oldest:
                readings.popleft()

    def clear(self) -> None:
        """Forget everything."""
        for readings in self._faces:
            readings.clear()

    def mean(self, now_s: float) -> Irradiances | None:
        """Return the mean over (now - mean_s, now], or None while a face has no good reading in it."""
        start = now_s - self._mean_s
        means, coverage = [], 1.0
        for readings in self._faces:
            weight = total = 0.0
            for end, length, irradiance in readings:
                inside = min(length, end - start)
                if inside > 0:
                    weight += inside
                    total += inside * irradiance
            if not weight > 0:
                return None
            means.append(total / weight)
            coverage = min(coverage, weight / self._mean_s)
        east, south, west, zenith = means
        return Irradiances(east, south, west, zenith, coverage)
