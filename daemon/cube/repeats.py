"""Finding a face whose reading stands still to the last digit."""

import math

from daemon.base.records import FACES

# A six-and-a-half-digit meter on a live sensor does not give the very same digits this many times in a row.
_STUCK_AFTER = 6
# Values in steps of up to 1 W/m2 stand still at noon for a quarter of an hour, and in the dark for a night.
_ROUNDED_STUCK_AFTER_S = 1800.0
_ROUNDED_STUCK_ABOVE_W_M2 = 20.0


class Repeats:
    """Counts how often each face has given the same value one after another; a value of 0 does not count.

    Parameters
    ----------
    scan_every_s
        Time from one reading to the next.
    """

    def __init__(self, scan_every_s: float) -> None:
        self._scan_every_s = scan_every_s
        self._count = [0] * len(FACES)
        self._last = [math.nan] * len(FACES)

    def note(self, face: int, value: float) -> None:
        """Take in a reading of a face, in whatever unit it was read."""
        repeated = value == self._last[face] and value != 0.0
        self._count[face] = self._count[face] + 1 if repeated else 0
        self._last[face] = value

    def frozen(self, face: int, irradiance_w_m2: float, *, rounded: bool) -> bool:
        """Tell whether a face has stood still for too long at an irradiance; `rounded` values come in coarse steps."""
        if not rounded:
            return self._count[face] >= _STUCK_AFTER
        stood_s = self._count[face] * self._scan_every_s
        return stood_s >= _ROUNDED_STUCK_AFTER_S and irradiance_w_m2 > _ROUNDED_STUCK_ABOVE_W_M2
