"""What speaks against the positioner's count of its position, until reference runs or a person settle it."""

from dataclasses import dataclass, field

from drivers.interfaces import AxisName

_BOTH: frozenset[AxisName] = frozenset(("a", "b"))
DESTINATION_TOLERANCE = 0.5
"""A destination that shows within this of the one that was sent is that one."""


@dataclass
class _Doubt:
    text: str
    axes: set[AxisName]
    needs_travel: bool = False
    stands: float | None = None


@dataclass
class Reference:
    """The doubts that stand, by kind."""

    _doubts: dict[str, _Doubt] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """All doubts in words; empty when there is none."""
        return "; ".join(dict.fromkeys(doubt.text for doubt in self._doubts.values()))

    @property
    def kinds(self) -> tuple[str, ...]:
        """What `forgive` takes."""
        return tuple(self._doubts)

    def doubts(self, axis: AxisName) -> bool:
        """Tell whether the count of one axis is in doubt."""
        return any(axis in doubt.axes for doubt in self._doubts.values())

    def note(
        self,
        kind: str,
        text: str,
        axis: AxisName | None = None,
        *,
        needs_travel: bool = False,
        stands: float | None = None,
    ) -> None:
        """Note a doubt of one axis or, with None, of both; an event that can happen again needs a kind of its own.

        With `needs_travel` only a reference run on which the axis has moved settles the doubt; `stands` is where the
        axis stands, in the unit's position units, if its end switch has lied.
        """
        known = self._doubts.setdefault(kind, _Doubt(text, set(), needs_travel, stands))
        known.axes |= _BOTH if axis is None else {axis}

    def possible_position(self, axis: AxisName) -> float | None:
        """Return where an axis may stand although its count says that it is on its end switch; None without doubt."""
        places = [doubt.stands for doubt in self._doubts.values() if axis in doubt.axes and doubt.stands is not None]
        return max(places, default=None)

    def proven(self, axis: AxisName, *, travelled: bool) -> None:
        """Forget what one axis' good reference run has settled."""
        for kind, doubt in list(self._doubts.items()):
            if travelled or not doubt.needs_travel:
                doubt.axes.discard(axis)
            if not doubt.axes:
                del self._doubts[kind]

    def forgive(self, kinds: tuple[str, ...]) -> None:
        """Forget these doubts: a person has seen them."""
        for kind in kinds:
            self._doubts.pop(kind, None)


class LastKnownPositions:
    """Where each axis stands if it has not moved while its count was lost, in the unit's position units.

    A unit that forgets its count begins again at some number, and a reference run may then end on a switch that is
    stuck: the place that is known from before the loss tells how far the axis has to go to its end.
    """

    def __init__(self) -> None:
        self._seen_positions: dict[AxisName, float] = {}
        # Where each axis may be on its way to: what it last showed, and what it was told and has not shown since.
        self._shown_destinations: dict[AxisName, float] = {}
        self._told_destinations: dict[AxisName, float] = {}
        # What has to be added to the count; there is no entry until a count could be trusted.
        self._count_offset: dict[AxisName, float] = {}
        # What has to be added if the end switch that set the count has lied.
        self._offset_if_switch_lied: dict[AxisName, float] = {}

    def note_target(self, axis: AxisName, destination: float) -> None:
        """Take note of a target that is about to be sent."""
        self._told_destinations[axis] = destination

    def forget_targets(self) -> None:
        """Take note that no axis is on its way any more."""
        self._told_destinations.clear()

    def stray_text(self, axis: AxisName, position: float, slip: float) -> str:
        """Return in words that an axis is where its last known move cannot have led it; empty if it is not."""
        if axis not in self._seen_positions:
            return ""
        way = (
            self._seen_positions[axis],
            self._shown_destinations[axis],
            self._told_destinations.get(axis, self._shown_destinations[axis]),
        )
        if min(way) - slip <= position <= max(way) + slip:
            return ""
        to = f" on its way to {way[1]:.0f}" if abs(way[1] - way[0]) > slip else ""
        return (
            f"axis {axis.upper()} has the count {position:.0f}, and had {way[0]:.0f}{to} when it was seen last: it was"
            " moved by hand, or its count is lost"
        )

    def note(self, axis: AxisName, position: float, destination: float, *, trusted: bool, set_anew: bool) -> None:
        """Take note of a look: whether its count is to be trusted, and whether it was set anew since the one before."""
        if trusted:
            self.note_referenced(axis)
        elif set_anew:
            for lost in (self._count_offset, self._offset_if_switch_lied):
                if axis in lost:
                    lost[axis] += self._seen_positions[axis] - position
        self._seen_positions[axis], self._shown_destinations[axis] = position, destination
        if abs(destination - self._told_destinations.get(axis, destination)) <= DESTINATION_TOLERANCE:
            self._told_destinations.pop(axis, None)

    def of(self, axis: AxisName, position: float) -> float | None:
        """Return where an axis stands whose count is `position`; None where that is unknown."""
        return position + self._count_offset[axis] if axis in self._count_offset else None

    def worst_case_position(self, axis: AxisName) -> float | None:
        """Return where an axis stands by its newest count, or would if its end switch has lied; None where unknown."""
        lost = self._offset_if_switch_lied.get(axis, self._count_offset.get(axis))
        return None if lost is None or axis not in self._seen_positions else self._seen_positions[axis] + lost

    def recall(self, axis: AxisName, place: float) -> None:
        """Take over where an axis stood before this process began."""
        self._seen_positions[axis] = self._shown_destinations[axis] = place
        self._count_offset[axis] = 0.0

    def note_referenced(self, axis: AxisName) -> None:
        """Take note that the count was set on the end switch: it is true from there on."""
        self._count_offset[axis] = 0.0
        self._offset_if_switch_lied.pop(axis, None)

    def note_contradiction(self, axis: AxisName, stands: float, position: float) -> None:
        """Take note that an end switch set the count, and that the axis stands at `stands` if the switch has lied."""
        self._offset_if_switch_lied[axis] = stands - position

    def note_stuck_switch(self, axis: AxisName, stood: float, position: float) -> None:
        """Take note that the count was set where the axis stood, which was not on its end switch."""
        self._count_offset[axis] = stood - position
