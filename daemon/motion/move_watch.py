"""Judging a move in progress from telemetry alone: the positioner neither acknowledges nor complains."""

import math
from enum import StrEnum

from daemon.base.records import Pose, Target
from daemon.config.sections import MotionSettings
from daemon.motion.watch import displacement_threshold, jitter
from drivers.interfaces import Telemetry
from drivers.settings import PositionerSettings
from solar.frames import Limits

# Longer than the pause between the two axes and the start-up ramp together.
_STALLED_AFTER_S = 6.0
_SPARE_S = 20.0
# Telemetry comes several times a second: two looks closer than this may show the same.
_STANDS_AFTER_S = 0.3
# A rounded position may stay the same while an axis turns: within two steps even the slowest motion shows.
_STANDS_STEPS, _STALLED_STEPS = 2.0, 3.0
# The positioner may start an axis that is near enough only after the other one, to go the rest of the way.
_TAKES_UP_S = 3.0


class Progress(StrEnum):
    """What one look says about the move; the failures are named as the outcomes of a move."""

    GOING = "going"
    ARRIVED = "arrived"
    STALLED = "stalled"
    OVERSHOT = "overshot"
    TIMED_OUT = "timed-out"


class MoveWatch:
    """One move from its start to a verdict.

    Parameters
    ----------
    target, start
        Where to and where from.
    limits
        Nothing may go beyond them by more than the tolerance.
    settings, expected
        Tolerance, and the slowest speed that counts as moving properly.
    now_s
        Monotonic time of the start.
    """

    def __init__(
        self,
        target: Target,
        start: Pose,
        limits: Limits,
        settings: MotionSettings,
        expected: PositionerSettings,
        now_s: float,
    ) -> None:
        self._target = target
        self._tolerance_deg = settings.tolerance_deg
        self._slowest_deg_per_s = expected.slowest_deg_per_s
        # If the drive's axes are not A and B, their ways are known only with the first look.
        self._axis_paths: tuple[_AxisPath, _AxisPath] | None = None
        self._by_angles, self._axis_names = expected.axes_are_angles, expected.axis_names
        if self._by_angles:
            self._axis_paths = (
                _AxisPath("A", start.a_deg, target.a_deg, limits.a_min_deg, limits.a_max_deg, settings.tolerance_deg),
                _AxisPath("B", start.b_deg, target.b_deg, limits.b_min_deg, limits.b_max_deg, settings.tolerance_deg),
            )
        self._start_s = now_s
        self._jitter, self._displacement_threshold = jitter(expected), displacement_threshold(expected)
        step_s = expected.resolution() / expected.slowest_deg_per_s
        self._stands_after_s = max(_STANDS_AFTER_S, _STANDS_STEPS * step_s)
        self._stalled_after_s = max(_STALLED_AFTER_S, _STALLED_STEPS * step_s)
        self._positions: tuple[float, float] | None = None
        self._moved_s = now_s

    def judge(self, telemetry: Telemetry, now_s: float) -> tuple[Progress, str]:
        """Return the verdict on the newest look, and a sentence for a bad one."""
        angles = (telemetry.a_deg, telemetry.b_deg)
        positions = (telemetry.position_a, telemetry.position_b)
        still = self._positions is not None and all(
            abs(here - there) <= self._jitter for here, there in zip(positions, self._positions, strict=True)
        )
        if not still:
            self._positions = positions
            self._moved_s = now_s
        if telemetry.faults:
            return Progress.STALLED, f"the positioner reports {', '.join(telemetry.faults)}"
        ways = self._axis_paths
        if ways is None:
            ways = self._axis_paths = _paths_of_positions(telemetry, self._axis_names, self._tolerance_deg)
        for way, place in zip(ways, angles if self._by_angles else positions, strict=True):
            if way.overshot(place):
                return Progress.OVERSHOT, f"{way.name} stands at {place:z.1f} deg, beyond its target {way.target:z.1f}"
        if self._is_at_target(angles):
            after_s = max(self._stands_after_s, _TAKES_UP_S if self._aims_elsewhere(telemetry) else 0.0)
            if still and now_s - self._moved_s >= after_s:
                return Progress.ARRIVED, ""
        where = f"A {angles[0]:z.1f}, B {angles[1]:z.1f} deg"
        if now_s - self._moved_s > self._stalled_after_s:
            text = f"no movement for {now_s - self._moved_s:.0f} s at {where}"
            return Progress.STALLED, "; ".join((text, *_hints(telemetry)))
        budget_s = sum(way.length for way in ways) / self._slowest_deg_per_s + _SPARE_S
        if now_s - self._start_s > budget_s:
            missing = "at rest" if self._is_at_target(angles) else "there"
            return Progress.TIMED_OUT, f"not {missing} after {now_s - self._start_s:.0f} s, at {where}"
        return Progress.GOING, ""

    def _aims_elsewhere(self, telemetry: Telemetry) -> bool:
        left = telemetry.destination_a - telemetry.position_a, telemetry.destination_b - telemetry.position_b
        return not all(abs(way) <= self._displacement_threshold for way in left)

    def _is_at_target(self, angles: tuple[float, float]) -> bool:
        wanted = (self._target.a_deg, self._target.b_deg)
        return all(abs(here - there) <= self._tolerance_deg for here, there in zip(angles, wanted, strict=True))


class _AxisPath:
    """What one axis may pass on its way."""

    def __init__(self, name: str, start: float, target: float, low: float, high: float, tolerance: float) -> None:
        self.name = name
        self.target = target
        self.length = abs(target - start)
        # Past the target by twice the tolerance on the far side, or outside the limits: whichever comes first. An axis
        # that starts outside the limits may of course come back in.
        margin = 2 * tolerance
        self._lowest = min(start - margin, low - margin) if start < low else low - margin
        self._highest = max(start + margin, high + margin) if start > high else high + margin
        if target >= start:
            self._highest = min(self._highest, target + margin)
        if target <= start:
            self._lowest = max(self._lowest, target - margin)

    def overshot(self, angle: float) -> bool:
        return not (self._lowest <= angle <= self._highest)


def _paths_of_positions(first: Telemetry, names: tuple[str, str], tolerance_deg: float) -> tuple[_AxisPath, _AxisPath]:
    """Return the ways from where the axes are to where they are sent; the drive's own range is its driver's matter."""
    start_a, start_b, aim_a, aim_b = first.position_a, first.position_b, first.destination_a, first.destination_b
    return (
        _AxisPath(names[0], start_a, aim_a, min(start_a, aim_a), max(start_a, aim_a), tolerance_deg),
        _AxisPath(names[1], start_b, aim_b, min(start_b, aim_b), max(start_b, aim_b), tolerance_deg),
    )


def _hints(telemetry: Telemetry) -> tuple[str, ...]:
    """Return what else the positioner tells, for the person who looks for the cause."""
    supply = (f"supply {telemetry.supply_v:.1f} V",) if math.isfinite(telemetry.supply_v) else ()
    told = ", ".join((*supply, *(f"{name} {value}" for name, value in telemetry.details.items())))
    return (told,) if told else ()
