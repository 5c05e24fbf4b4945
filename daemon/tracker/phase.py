"""When each tracker of a process has its turn, so that many trackers do not all work in one instant."""

from dataclasses import dataclass

_LEAST_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class Phase:
    """A tracker's place among the trackers of its process, which take turns in every interval.

    A single tracker waits for no turn: its intervals count from when it last worked.

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
        """Return how long this tracker waits [s] when all are called at once and take turns within `within_s`."""
        return within_s * self.place / self.trackers

    def next_s(self, now_s: float, every_s: float) -> float:
        """Return when this tracker's next turn is [s] after one at `now_s`, half an interval later at the earliest."""
        if self.trackers == 1:
            return now_s + every_s
        delay_s = self.delay_s(every_s)
        turns = -((delay_s - now_s - _LEAST_SHARE * every_s) // every_s)
        return delay_s + turns * every_s


ALONE = Phase()
