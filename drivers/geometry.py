"""How an axis turns the positioner's own position units into an angle of the tracker."""

import math
from dataclasses import dataclass
from typing import Protocol


class Geometry(Protocol):
    """The position that belongs to an angle."""

    def position(self, angle_deg: float) -> float:
        """Return the position from the low end switch, in the unit's own units."""


@dataclass(frozen=True, slots=True)
class Triangle:
    """A linear actuator between two fixed arms; positions are mm of extension, which raises the angle.

    Attributes
    ----------
    arm_1_mm, arm_2_mm
        The fixed sides.
    apex_deg
        Angle between them where the tracker's angle is 0.
    low_deg
        The tracker's angle at the low end switch.
    """

    arm_1_mm: float
    arm_2_mm: float
    apex_deg: float
    low_deg: float

    def position(self, angle_deg: float) -> float:
        """Return the extension [mm] beyond that at the low end switch, by the law of cosines."""
        return self._side_mm(angle_deg) - self._side_mm(self.low_deg)

    def _side_mm(self, angle_deg: float) -> float:
        cosine = math.cos(math.radians(self.apex_deg + angle_deg))
        return math.sqrt(self.arm_1_mm**2 + self.arm_2_mm**2 - 2 * self.arm_1_mm * self.arm_2_mm * cosine)


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


@dataclass(frozen=True, slots=True)
class AxisSetup:
    """Geometry of one axis, and the angles [deg] that it may be sent to."""

    geometry: Geometry
    minimum_deg: float
    maximum_deg: float

    def allows(self, angle_deg: float) -> bool:
        """Tell whether an angle is within the limits; NaN is not."""
        return self.minimum_deg <= angle_deg <= self.maximum_deg

    def destination(self, angle_deg: float) -> int:
        """Return the whole position units that the unit makes of an angle, cut off as it does."""
        return max(int(self.geometry.position(angle_deg)), 0)
