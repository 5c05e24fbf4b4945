"""Whether a positioner moves on although it was told to stop."""

from collections.abc import Callable

from drivers.interfaces import Telemetry

_DEAF_AFTER_S = 5.0
# A computer that was busy for seconds saw nothing meanwhile: so several looks in a row have to show motion.
_LOOKS_IN_A_ROW = 2
_STILL_S = 3.0


class StopMonitor:
    """Judges the looks at a positioner between a stop and its standstill.

    Each look is compared with the last one that showed the axes elsewhere, not with the one before it: from one look to
    the next, a slow axis with a coarse position shows no motion.

    Parameters
    ----------
    same_place
        Tells whether neither axis moved between two looks.
    still_s
        Time [s] after which even the slowest motion that matters shows in positions rounded as they are.
    """

    def __init__(self, same_place: Callable[[Telemetry, Telemetry], bool], still_s: float) -> None:
        self._same_place = same_place
        self._still_s = max(still_s, _STILL_S)
        self._place: Telemetry | None = None
        self._moving_looks = 0

    def is_ignoring_stop(self, seen: Telemetry, stop_s: float) -> bool:
        """Take in a look; return whether the axes have moved on for more than 5 s after the monotonic time `stop_s`."""
        place = self._place
        if place is None or place.time_monotonic_s <= stop_s + _DEAF_AFTER_S:
            self._place, self._moving_looks = seen, 0
        elif not self._same_place(place, seen):
            self._place, self._moving_looks = seen, self._moving_looks + 1
        elif seen.time_monotonic_s - place.time_monotonic_s > self._still_s:
            self._moving_looks = 0
        return self._moving_looks >= _LOOKS_IN_A_ROW
