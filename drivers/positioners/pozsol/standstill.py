"""Whether both axes stand, from positions that keep coming: bits and destinations say so too early."""

from dataclasses import dataclass, field

STILL_FOR_S = 0.3
# After a stop the unit aims at where it is; a run-out that the last stop has not caught up with is less than this.
_AIMLESS_WITHIN = 1.0


@dataclass
class _Anchor:
    position: float
    since_s: float


@dataclass
class Standstill:
    """Watches positions from one instant on.

    Parameters
    ----------
    begin_s
        Telemetry from before this time does not count.
    jitter
        Position units by which a standing axis may seem to move: one Hall count.

    Attributes
    ----------
    still, is_at_destination
        Whether both axes have not moved for a while, and whether their destinations are where they stand.
    """

    begin_s: float
    jitter: tuple[float, float]
    still: bool = False
    is_at_destination: bool = False
    _anchors: list[_Anchor] = field(default_factory=list, repr=False)

    @property
    def reached(self) -> bool:
        """Whether the axes stand and will go on standing."""
        return self.still and self.is_at_destination

    def update(self, positions: tuple[float, float], destinations: tuple[float, float], time_s: float) -> None:
        """Take in one look at positions and destinations of A and B, received at `time_s` or later."""
        if time_s <= self.begin_s:
            return
        if not self._anchors:
            self._anchors = [_Anchor(position, time_s) for position in positions]
        for anchor, position, jitter in zip(self._anchors, positions, self.jitter, strict=True):
            if not abs(position - anchor.position) <= jitter:
                anchor.position, anchor.since_s = position, time_s
        self.still = all(time_s - anchor.since_s >= STILL_FOR_S for anchor in self._anchors)
        self.is_at_destination = all(
            abs(destination - position) <= _AIMLESS_WITHIN
            for destination, position in zip(destinations, positions, strict=True)
        )
