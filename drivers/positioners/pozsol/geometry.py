"""How an axis turns the positioner's own position units into an angle of the tracker."""

import math
from dataclasses import dataclass
from typing import Literal, Protocol

Sense = Literal["raises", "lowers"]

# Angles come rounded to a tenth, and a unit of another generation may cut its positions to whole units.
_ANGLE_STEP_DEG = 0.1
_POSITION_STEP = 1.0
# How far an actuator comes to rest beyond its target.
_RUN_OUT_MM = 0.15
_HAIR = 1e-9


class Geometry(Protocol):
    """The position that belongs to an angle."""

    @property
    def low_deg(self) -> float:
        """The tracker's angle at the low end switch, where the position is 0."""

    def position(self, angle_deg: float) -> float:
        """Return the position from the low end switch, in the unit's own units; NaN where there is none."""

    def angle(self, position: float) -> float:
        """Return the angle [deg] at a position; NaN where there is none."""


@dataclass(frozen=True, slots=True)
class Triangle:
    """A linear actuator between two fixed arms; positions are mm of extension.

    Attributes
    ----------
    arm_1_mm, arm_2_mm
        The fixed sides.
    apex_deg
        Angle between them where the tracker's angle is 0.
    low_deg
        The tracker's angle at the low end switch.
    holder_mm
        How far the actuator's own line lies beside the third side: the clamp that holds it.
    sense
        Whether extension raises or lowers the tracker's angle.
    """

    arm_1_mm: float
    arm_2_mm: float
    apex_deg: float
    low_deg: float
    holder_mm: float = 0.0
    sense: Sense = "raises"

    @property
    def low_length_mm(self) -> float:
        """Length of the actuator at the low end switch."""
        return self._length_mm(self.low_deg)

    def position(self, angle_deg: float) -> float:
        """Return the extension [mm] beyond that at the low end switch, by the law of cosines."""
        return self._length_mm(angle_deg) - self._length_mm(self.low_deg)

    def angle(self, position: float) -> float:
        """Return the tracker's angle [deg] at an extension beyond that at the low end switch."""
        return self.angle_at_length(self.low_length_mm + position)

    def angle_at_length(self, length_mm: float) -> float:
        """Return the tracker's angle [deg] at a length of the actuator; NaN where the triangle does not close."""
        side_2 = length_mm**2 + self.holder_mm**2
        cosine = (self.arm_1_mm**2 + self.arm_2_mm**2 - side_2) / (2 * self.arm_1_mm * self.arm_2_mm)
        if not abs(cosine) <= 1:
            return math.nan
        turned = math.degrees(math.acos(cosine)) - self.apex_deg
        return turned if self.sense == "raises" else -turned

    def _length_mm(self, angle_deg: float) -> float:
        turned = angle_deg if self.sense == "raises" else -angle_deg
        cosine = math.cos(math.radians(self.apex_deg + turned))
        side_2 = self.arm_1_mm**2 + self.arm_2_mm**2 - 2 * self.arm_1_mm * self.arm_2_mm * cosine
        square = side_2 - self.holder_mm**2
        return math.sqrt(square) if square >= 0 else math.nan


@dataclass(frozen=True, slots=True)
class Proportional:
    """A slew drive, or a count of motor impulses.

    Attributes
    ----------
    units_per_deg
        1 where positions are degrees, else impulses per degree.
    low_deg
        The tracker's angle at position 0.
    """

    units_per_deg: float
    low_deg: float

    def position(self, angle_deg: float) -> float:
        """Return the position above that at the low end switch."""
        return (angle_deg - self.low_deg) * self.units_per_deg

    def angle(self, position: float) -> float:
        """Return the tracker's angle [deg] at a position above that at the low end switch."""
        return self.low_deg + position / self.units_per_deg


@dataclass(frozen=True, slots=True)
class AxisSetup:
    """One axis: how it is built, and where it may be sent.

    Attributes
    ----------
    geometry
        How position units become degrees.
    minimum_deg, maximum_deg
        The angles that it may be sent to.
    zero_offset
        What the unit adds to each destination, in position units.
    step
        The smallest change of position that means something, a Hall count and a little.
    """

    geometry: Geometry
    minimum_deg: float
    maximum_deg: float
    zero_offset: float = 0.0
    step: float = 0.02

    def allows(self, angle_deg: float) -> bool:
        """Tell whether an angle is within the limits; NaN is not."""
        return self.minimum_deg <= angle_deg <= self.maximum_deg

    def destination(self, angle_deg: float) -> int:
        """Return the whole position units to send for an angle, so that the axis stands within the limits.

        That is half a unit from the angle at most, and at a limit the first whole unit inside. Raises `ValueError`
        where the geometry has no such position.
        """
        ends = [self.geometry.position(end_deg) - self.zero_offset for end_deg in (self.minimum_deg, self.maximum_deg)]
        wanted = self.geometry.position(angle_deg) - self.zero_offset
        if not (math.isfinite(wanted) and math.isfinite(sum(ends))):
            raise ValueError(f"the axis's geometry has no position for {angle_deg:g} deg or for its limits")
        lowest, highest = (
            max(math.ceil(min(ends) + self._run_out_margin), 0),
            math.floor(max(ends) - self._run_out_margin),
        )
        if lowest > highest:
            raise ValueError("the axis's geometry has no whole position unit between its limits")
        return min(max(math.floor(wanted + 0.5), lowest), highest)

    @property
    def _run_out_margin(self) -> float:
        """How far an axis may run on beyond its destination, in position units."""
        return _RUN_OUT_MM if isinstance(self.geometry, Triangle) else -_HAIR

    def rests_within(self) -> float:
        """Return how far the axis comes to rest at the most [deg] from an angle within the limits that it is sent to.

        At a limit the axis rests at the first whole unit inside; elsewhere it may be off by half a unit and the
        run-out, which are most degrees at one of the two ends of the travel. NaN where there is no whole unit to send.
        """
        try:
            first, last = self.destination(self.minimum_deg), self.destination(self.maximum_deg)
        except ValueError:
            return math.nan
        first_deg, last_deg = self._angle_of(first), self._angle_of(last)
        half = math.copysign(0.5 + max(self._run_out_margin, 0.0), last - first)
        inside_deg = abs(self._angle_of(first + half) - first_deg), abs(self._angle_of(last - half) - last_deg)
        return max(abs(first_deg - self.minimum_deg), abs(last_deg - self.maximum_deg), *inside_deg)

    def _angle_of(self, destination: float) -> float:
        return self.geometry.angle(destination + self.zero_offset)

    def units(self, angle_deg: float) -> float:
        """Return how many position units an angle [deg] is at the beginning of the travel."""
        way = abs(self.geometry.position(self.geometry.low_deg + angle_deg))
        back = abs(self.geometry.position(self.geometry.low_deg - angle_deg))
        return max(way, back) if math.isfinite(way + back) else abs(angle_deg)

    def fits(self, angle_deg: float, position: float) -> bool:
        """Tell whether this geometry makes `position` of `angle_deg`, within the unit's rounding."""
        around = [self.geometry.position(angle_deg + step) for step in (-_ANGLE_STEP_DEG, _ANGLE_STEP_DEG)]
        return min(around) - _POSITION_STEP <= position <= max(around) + _POSITION_STEP
