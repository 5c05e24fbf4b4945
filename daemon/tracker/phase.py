"""Whose turn it is when: so that the many trackers of a process do not all work in one instant."""

from dataclasses import dataclass

_LEAST_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class Phase:
    """A tracker's place among those of its process, which take their turns in every interval one after the other.

    The only one has no turn to wait for: its intervals count from what it did last.

    Attributes
    ----------
    place
        Counted from 0.
    trackers
        How many there are.
    """

    place: int = 0
    trackers: int = 1

    def delay_s(self, within_s: float) -> float:
        """Return how long it waits where all are called at once, and have so long to come one after the other [s]."""
        return within_s * self.place / self.trackers

    def next_s(self, now_s: float, every_s: float) -> float:
        """Return when it is its turn again [s], in half an interval at the earliest, for what it does at `now_s`."""
        if self.trackers == 1:
            return now_s + every_s
        delay_s = self.delay_s(every_s)
        turns = -((delay_s - now_s - _LEAST_SHARE * every_s) // every_s)
        return delay_s + turns * every_s


ALONE = Phase()
