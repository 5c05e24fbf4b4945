"""How a simulated positioner is built and set: the triangles of its actuators, its drive, its own modes."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from solar.frames import Angles


@dataclass(frozen=True, slots=True)
class Actuator:
    """The triangle of a linear actuator and two fixed arms; extension raises the angle.

    Attributes
    ----------
    arm_1_mm, arm_2_mm
        The fixed sides.
    apex_deg
        Angle between the arms where the tracker's angle is 0.
    low_deg, high_deg
        The tracker's angle at the low and at the high end switch.
    """

    arm_1_mm: float
    arm_2_mm: float
    apex_deg: float
    low_deg: float
    high_deg: float

    def __post_init__(self) -> None:
        if not (self.arm_1_mm > 0 and self.arm_2_mm > 0 and self.low_deg < self.high_deg):
            raise ValueError(f"an actuator needs arms longer than 0 and a low end below its high end, not {self}")
        if not (self.apex_deg + self.low_deg > 0 and self.apex_deg + self.high_deg < 180):
            raise ValueError(f"the triangle must stay between 0 and 180 deg over the whole travel, not {self}")

    @property
    def travel_mm(self) -> float:
        """Distance between the two end switches."""
        return self.position_mm(self.high_deg)

    def position_mm(self, angle_deg: float) -> float:
        """Extension beyond the low end switch at a tracker angle [deg]."""
        return self._length_mm(angle_deg) - self._length_mm(self.low_deg)

    def angle_deg(self, position_mm: float) -> float:
        """Tracker angle [deg] at an extension beyond the low end switch."""
        length = position_mm + self._length_mm(self.low_deg)
        a, b = self.arm_1_mm, self.arm_2_mm
        cosine = (a * a + b * b - length * length) / (2 * a * b)
        return math.degrees(math.acos(min(max(cosine, -1.0), 1.0))) - self.apex_deg

    def _length_mm(self, angle_deg: float) -> float:
        a, b = self.arm_1_mm, self.arm_2_mm
        return math.sqrt(a * a + b * b - 2 * a * b * math.cos(math.radians(self.apex_deg + angle_deg)))


A_ACTUATOR = Actuator(300.0, 300.0, apex_deg=90.0, low_deg=-52.0, high_deg=52.0)
B_ACTUATOR = Actuator(300.0, 300.0, apex_deg=37.5, low_deg=13.0, high_deg=92.0)


@dataclass(frozen=True, slots=True)
class Drive:
    """How an axis moves: full speed, ramp, the smallest move it starts, and how far it runs past its target."""

    speed_mm_s: float = 3.2
    acceleration_mm_s2: float = 6.4
    dead_band_mm: float = 0.05
    overshoot_mm: float = 0.0

    def __post_init__(self) -> None:
        if not (self.speed_mm_s > 0 and self.acceleration_mm_s2 > 0):
            raise ValueError(f"speed and acceleration must be positive, not {self}")
        if not (self.dead_band_mm >= 0 and self.overshoot_mm >= 0):
            raise ValueError(f"dead-band and overshoot must not be negative, not {self}")


_DRIVE = Drive()

FLAT = Angles(0.0, 90.0)


def _flat(_now_s: float) -> Angles:
    return FLAT


@dataclass(frozen=True, slots=True)
class Setup:
    """How the unit is built and set.

    Attributes
    ----------
    a_actuator, b_actuator, drive
        Mechanics of the axes, and how both of them move.
    start
        Where the tracker stands at first.
    synchronous
        Both axes may move at once.
    own_target
        Where the unit's own sun tracking would point, of time [s].
    own_interval_s
        How often it does.
    wind_stow, snow_stow
        Where it goes in wind and under snow; None as the unit's "off".
    wind_hold_s, snow_hold_s
        For how long after the wind, the snow, has ended.
    """

    a_actuator: Actuator = A_ACTUATOR
    b_actuator: Actuator = B_ACTUATOR
    drive: Drive = _DRIVE
    start: Angles = FLAT
    synchronous: bool = False
    own_target: Callable[[float], Angles] = _flat
    own_interval_s: float = 300.0
    wind_stow: Angles | None = None
    snow_stow: Angles | None = None
    wind_hold_s: float = 300.0
    snow_hold_s: float = 60.0
