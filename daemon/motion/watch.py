"""What telemetry says about motion: since when both axes stand, and what moves although nothing of ours explains it."""

import math
from dataclasses import dataclass

from drivers.interfaces import AxisName, Telemetry
from drivers.settings import PositionerSettings

# In the drive's own unit. Two counts, or a shake by the wind, are no motion; a distance above the second
# number from where an axis came to rest is motion, however slow.
_JITTER = {"mm": 0.15, "deg": 0.035, "impulse": 2.0}
_STRAY_DISTANCE = {"mm": 0.4, "deg": 0.1, "impulse": 6.0}
# In steps of a position that is coarsely rounded: one step is no motion, and two are not elsewhere yet.
_JITTER_STEPS, _STRAY_STEPS = 1.2, 2.5
# A second look at the same place, at least this much later, shows a standstill.
_SHOWN_AFTER_S = 0.25
# The positioner may start the second axis so long after the first one stands near enough to count as arrived.
_SETTLES_S = 10.0
# No drive of this kind turns so fast [deg/s]: the count has changed, and not the tracker.
_JUMP_DEG_PER_S = 10.0
_SHORTEST_LOOK_S = 0.5
_AXES: tuple[AxisName, AxisName] = ("a", "b")
_TURN_DEG = 360.0
BLOCKED_UNTIL_CLEARED = "nothing moves until a person has looked and given 'heliocube clear'"
"""The end of every sentence about an axis that moved by itself, or does not stop."""


def jitter(expected: PositionerSettings) -> float:
    """Return how far a position, in its unit, may differ from the last one while the axis stands."""
    return max(_JITTER[expected.position_unit], _JITTER_STEPS * expected.resolution())


def displacement_threshold(expected: PositionerSettings) -> float:
    """Return from what distance to a place, in its unit, a position counts as elsewhere."""
    return max(_STRAY_DISTANCE[expected.position_unit], _STRAY_STEPS * expected.resolution())


@dataclass(frozen=True, slots=True)
class MotionAnomaly:
    """Something in telemetry that no order explains.

    Attributes
    ----------
    text
        What was seen, as the beginning of a sentence.
    seen_s
        Monotonic time of the telemetry that showed it.
    is_count_jump
        The count changed faster than an axis can turn: the reference is in doubt, but nothing has moved.
    """

    text: str
    seen_s: float
    is_count_jump: bool = False

    def incident_text(self, frozen: str | None) -> str:
        """Return it as a sentence for a person who has to look; `frozen` is why nothing may move, or None."""
        how = f"against a stop ({frozen})" if frozen else "without an order"
        return f"{self.text} {how}: {BLOCKED_UNTIL_CLEARED}"


class AxisWatch:
    """Both axes, look by look.

    Parameters
    ----------
    expected
        What the drive counts in, how coarsely, and whether its axes are A and B.
    """

    def __init__(self, expected: PositionerSettings) -> None:
        self._jitter = jitter(expected)
        self._displacement_threshold = displacement_threshold(expected)
        self._axes_are_angles = expected.axes_are_angles
        self._names = expected.axis_names
        # A drive with a reference run tells by itself that it may have lost its count.
        self._keeps_way = not expected.has_reference_run
        self._lost_way: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._last: Telemetry | None = None
        self._aim: tuple[float, float] | None = None
        self.forget()

    def forget(self) -> None:
        """Know nothing, as after the loss of the link, until `note_rest` says that a look shows the place of rest."""
        if self._keeps_way and self._aim is not None and self._last is not None:
            self._lost_way = _positions(self._last), self._aim
        self._last = None
        self._anchor: tuple[float, float] | None = None
        self._since_s = 0.0
        self._standstill_shown = False
        self._rest_look: Telemetry | None = None
        # Where the axes were sent, and until when (`_settled_s`) they may still get there: for ever during the move.
        self._aim = None
        self._gaps = [0.0, 0.0]
        self._settled_s = -math.inf
        self._homing: frozenset[AxisName] = frozenset()

    def off_course_text(self, telemetry: Telemetry, tolerance_deg: float) -> str:
        """Return in words that the move on which the link was lost does not lead to this place; empty where it does.

        Told once, and only for a drive without a reference run: after the loss a rotator may count from another turn.
        """
        lost, self._lost_way = self._lost_way, None
        if lost is None:
            return ""
        within = tolerance_deg + self._displacement_threshold
        on_it = (
            (here - min(ends) + within) % _TURN_DEG <= abs(ends[1] - ends[0]) + 2.0 * within
            for here, ends in zip(_positions(telemetry), zip(*lost, strict=True), strict=True)
        )
        if all(on_it):
            return ""
        return (
            f"positioner stands at A {telemetry.a_deg:z.1f}, B {telemetry.b_deg:z.1f} deg; the move during which"
            " the link was lost does not lead there"
        )

    @property
    def stands_since_s(self) -> float | None:
        """Monotonic time since which both axes have been seen unmoved, or None."""
        return self._since_s if self._standstill_shown else None

    def suspend_judging(self) -> None:
        """Judge nothing until the next rest: an order may have been taken in part."""
        self._rest_look = None

    def note_rest(self, telemetry: Telemetry) -> None:
        """Take this look for the place of rest: from now on nothing explains any motion."""
        self._rest_look = self._last = telemetry
        self._aim, self._settled_s, self._homing = None, -math.inf, frozenset()
        here, anchor = _positions(telemetry), self._anchor
        if not (self._standstill_shown and anchor is not None and _near(here, anchor, self._jitter)):
            self._anchor, self._since_s, self._standstill_shown = here, telemetry.time_monotonic_s, True

    def note_repeat(self, telemetry: Telemetry) -> None:
        """Take this for the last look: it shows the same at a later time."""
        self._last = telemetry

    def same_place(self, one: Telemetry, other: Telemetry) -> bool:
        """Tell whether neither axis moved between two looks."""
        return _near(_positions(one), _positions(other), self._jitter)

    def expect(self, telemetry: Telemetry) -> None:
        """Let the axes go to the destinations that telemetry shows, and nowhere else: a move was confirmed."""
        # The axes may have moved for a second already: their way is judged from where they stood before.
        # Motion since the last arrival was allowed, and is no part of this way.
        settling = self._aim is not None and self._settled_s != math.inf
        self._rest_look = (self._last if settling else self._rest_look) or telemetry
        self._last = telemetry
        self._aim = aim = (telemetry.destination_a, telemetry.destination_b)
        self._gaps = [abs(start - there) for start, there in zip(_positions(self._rest_look), aim, strict=True)]
        self._settled_s = math.inf

    def note_arrival(self, telemetry: Telemetry) -> None:
        """End the move; for a few seconds the axes may still go the rest of the way to their destinations."""
        self._rest_look = telemetry
        self._settled_s = telemetry.time_monotonic_s + _SETTLES_S

    @property
    def settled(self) -> bool:
        """Whether both axes stand, and no order explains any further motion."""
        return self._standstill_shown and self._aim is None and not self._homing

    @property
    def is_motion_expected(self) -> bool:
        """Whether an order explains motion at present."""
        return bool(self._homing) or self._settled_s == math.inf

    def expect_homing(self, axis: AxisName, telemetry: Telemetry) -> None:
        """Let one axis make a reference run while the other stands."""
        self.note_rest(telemetry)
        self._homing, self._standstill_shown = frozenset((axis,)), False

    def update(self, telemetry: Telemetry, known_s: float | None = None) -> MotionAnomaly | None:
        """Take in the newest telemetry; return what it shows that no order explains.

        `known_s` is when the telemetry had arrived [s], None for its own time: it may show a position as late as that.
        """
        self._note_standstill(telemetry)
        before, self._last = self._last, telemetry
        if self._rest_look is None or before is None:
            return None
        took_s = (telemetry.time_monotonic_s if known_s is None else known_s) - before.time_monotonic_s
        if not self._homing and (leap := _jump_text(before, telemetry, took_s, by_angles=self._axes_are_angles)):
            self._gaps = [math.inf, math.inf]
            self._rest_look = telemetry
            return MotionAnomaly(leap, telemetry.time_monotonic_s, is_count_jump=True)
        text = self._wrong_way_text(telemetry) if self._settled_s == math.inf else self._departure_text(telemetry)
        return None if text is None else MotionAnomaly(text, telemetry.time_monotonic_s)

    def _note_standstill(self, telemetry: Telemetry) -> None:
        here, now_s = _positions(telemetry), telemetry.time_monotonic_s
        anchor = self._anchor
        if anchor is None or not _near(here, anchor, self._jitter):
            self._anchor, self._since_s, self._standstill_shown = here, now_s, False
        elif now_s - self._since_s >= _SHOWN_AFTER_S:
            self._standstill_shown = True

    def _wrong_way_text(self, telemetry: Telemetry) -> str | None:
        """Say what is wrong with a move in progress: a destination that is not ours, or the wrong way."""
        assert self._aim is not None  # noqa: S101 - narrowing for the type checker
        assert self._rest_look is not None  # noqa: S101
        destinations = (telemetry.destination_a, telemetry.destination_b)
        starts = _positions(self._rest_look)
        for at, (name, here, start) in enumerate(zip(self._names, _positions(telemetry), starts, strict=True)):
            aim, to = self._aim[at], destinations[at]
            if not (abs(to - aim) <= 1.0 or abs(to - here) <= 1.0):
                return f"{name} heads for position {to:g}, but was sent to {aim:g}"
            gap = abs(here - aim)
            if gap > self._gaps[at] + self._displacement_threshold and (start - aim) * (here - aim) >= 0.0:
                return f"{name} moves away from where it was sent, {self._motion_text(at, self._rest_look, telemetry)}"
            self._gaps[at] = min(self._gaps[at], gap)
        return None

    def _departure_text(self, telemetry: Telemetry) -> str | None:
        """Say which axis has left the place where it came to rest."""
        rest = self._rest_look
        assert rest is not None  # noqa: S101 - narrowing for the type checker
        if self._aim is not None and telemetry.time_monotonic_s > self._settled_s:
            self._aim, self._rest_look = None, telemetry
            return None
        now, before = _positions(telemetry), _positions(rest)
        if now == before:
            return None
        ways = zip(_AXES, now, before, self._aim or before, strict=True)
        for at, (axis, here, start, aim) in enumerate(ways):
            low, high = min(start, aim) - self._displacement_threshold, max(start, aim) + self._displacement_threshold
            if axis not in self._homing and not (low <= here <= high):
                return self._motion_text(at, rest, telemetry)
        return None

    def _motion_text(self, at: int, before: Telemetry, after: Telemetry) -> str:
        see = _angles if self._axes_are_angles else _positions
        return f"{self._names[at]} moved from {see(before)[at]:+z.1f} to {see(after)[at]:+z.1f} deg"


def _positions(telemetry: Telemetry) -> tuple[float, float]:
    return telemetry.position_a, telemetry.position_b


def _angles(telemetry: Telemetry) -> tuple[float, float]:
    return telemetry.a_deg, telemetry.b_deg


def _near(here: tuple[float, float], there: tuple[float, float], within: float) -> bool:
    return abs(here[0] - there[0]) <= within and abs(here[1] - there[1]) <= within


def _jump_text(before: Telemetry, after: Telemetry, took_s: float, *, by_angles: bool) -> str | None:
    most_deg = _JUMP_DEG_PER_S * max(took_s, _SHORTEST_LOOK_S)
    see = _angles if by_angles else _positions
    if _near(see(before), see(after), most_deg):
        return None
    return (
        f"the count jumped from A {before.a_deg:+z.1f}, B {before.b_deg:z.1f}"
        f" to A {after.a_deg:+z.1f}, B {after.b_deg:z.1f} deg"
    )
