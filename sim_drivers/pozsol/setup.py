"""How a simulated positioner is built and set: the mechanics of its axes, their drive, its own modes."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from solar.frames import Angles


@dataclass(frozen=True, slots=True)
class Actuator:
    """The triangle of a linear actuator and two fixed arms.

    Attributes
    ----------
    arm_1_mm, arm_2_mm
        The fixed sides.
    apex_deg
        Angle between the arms where the tracker's angle is 0.
    low_deg, high_deg
        The tracker's angle at the low and at the high end switch.
    holder_mm
        How far the holder sets the actuator off the line between its joints.
    extension_raises_angle
        Extension raises the tracker's angle; else it lowers it, and `low_deg` is the higher of the two.
    zero_offset_mm
        What the unit adds to every target, as its fields 192 and 193 have it.
    stator_mm, travel_mm
        Length of the actuator at the low end switch, and from there to the high one; they follow from the rest.
    """

    arm_1_mm: float
    arm_2_mm: float
    apex_deg: float
    low_deg: float
    high_deg: float
    holder_mm: float = 0.0
    extension_raises_angle: bool = True
    zero_offset_mm: float = 0.0
    stator_mm: float = field(init=False, repr=False, compare=False)
    travel_mm: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not (
            self.arm_1_mm > 0 and self.arm_2_mm > 0 and (self.low_deg < self.high_deg) is self.extension_raises_angle
        ):
            raise ValueError(f"an actuator needs arms longer than 0 and a low end where it is retracted, not {self}")
        if not (self._between_arms_deg(self.low_deg) > 0 and self._between_arms_deg(self.high_deg) < 180):
            raise ValueError(f"the triangle must stay between 0 and 180 deg over the whole travel, not {self}")
        if not (0 <= self.holder_mm < self._side_mm(self.low_deg) and math.isfinite(self.zero_offset_mm)):
            raise ValueError(f"the holder must be shorter than the retracted actuator, not {self}")
        # Asked for at every look at the unit, so worked out once.
        object.__setattr__(self, "stator_mm", self._length_mm(self.low_deg))
        object.__setattr__(self, "travel_mm", self.position_mm(self.high_deg))

    def position_mm(self, angle_deg: float) -> float:
        """Extension beyond the low end switch at a tracker angle [deg]; NaN where the triangle does not close."""
        return self._length_mm(angle_deg) - self.stator_mm

    def angle_deg(self, position_mm: float) -> float:
        """Tracker angle [deg] at an extension beyond the low end switch."""
        square = (position_mm + self.stator_mm) ** 2 + self.holder_mm**2
        a, b = self.arm_1_mm, self.arm_2_mm
        cosine = (a * a + b * b - square) / (2 * a * b)
        beyond = math.degrees(math.acos(min(max(cosine, -1.0), 1.0))) - self.apex_deg
        return beyond if self.extension_raises_angle else -beyond

    def _length_mm(self, angle_deg: float) -> float:
        square = self._side_mm(angle_deg) ** 2 - self.holder_mm**2
        return math.sqrt(square) if square >= 0 else math.nan

    def _side_mm(self, angle_deg: float) -> float:
        a, b = self.arm_1_mm, self.arm_2_mm
        cosine = math.cos(math.radians(max(self._between_arms_deg(angle_deg), 0.0)))
        return math.sqrt(max(a * a + b * b - 2 * a * b * cosine, 0.0))

    def _between_arms_deg(self, angle_deg: float) -> float:
        return self.apex_deg + (angle_deg if self.extension_raises_angle else -angle_deg)


@dataclass(frozen=True, slots=True)
class SlewDrive:
    """A gear on the axis itself. Position units stand where an actuator has millimetres: degrees, or motor impulses.

    Attributes
    ----------
    units_per_deg
        Position units per degree of the tracker.
    low_deg, high_deg
        The tracker's angle at the low and at the high end switch.
    zero_offset_mm
        What the unit adds to every target, in position units.
    """

    units_per_deg: float
    low_deg: float
    high_deg: float
    zero_offset_mm: float = 0.0

    def __post_init__(self) -> None:
        if not (self.units_per_deg > 0 and self.low_deg < self.high_deg):
            raise ValueError(f"a slew drive needs positive units and a low end below its high end, not {self}")

    @property
    def travel_mm(self) -> float:
        """Position units between the end switches."""
        return self.position_mm(self.high_deg)

    def position_mm(self, angle_deg: float) -> float:
        """Position units from the low end switch at a tracker angle [deg]."""
        return (angle_deg - self.low_deg) * self.units_per_deg

    def angle_deg(self, position_mm: float) -> float:
        """Tracker angle [deg] so many position units from the low end switch."""
        return self.low_deg + position_mm / self.units_per_deg


Mechanics = Actuator | SlewDrive
"""What turns an axis."""

A_ACTUATOR = Actuator(300.0, 300.0, apex_deg=90.0, low_deg=-52.0, high_deg=54.7)
B_ACTUATOR = Actuator(300.0, 300.0, apex_deg=37.5, low_deg=13.0, high_deg=92.0)


@dataclass(frozen=True, slots=True)
class AxisDrive:
    """How an axis moves. The defaults are those of the maker's firmware on mechanics of 235 impulses per second.

    Attributes
    ----------
    speed_mm_s, acceleration_mm_s2
        Full speed, and how fast it is reached.
    run_out_s
        How long an axis runs out from full speed once its motor is off.
    braking_mm
        How far before its target an axis at full speed begins to brake.
    overshoot_mm
        How far beyond its target an axis comes to rest.
    dead_band_mm
        The smallest move that an axis starts when the other one was the last to move.
    counts_per_mm
        Impulses of the Hall sensors; the unit knows positions in whole impulses.
    """

    speed_mm_s: float = 235 / 75
    acceleration_mm_s2: float = 8.7
    run_out_s: float = 0.25
    braking_mm: float = 0.156
    overshoot_mm: float = 0.143
    dead_band_mm: float = 5 / 75
    counts_per_mm: float = 75.0

    def __post_init__(self) -> None:
        positive = (self.speed_mm_s, self.acceleration_mm_s2, self.run_out_s, self.counts_per_mm)
        if not all(value > 0 for value in positive):
            raise ValueError(f"speed, acceleration, run-out and impulses must be positive, not {self}")
        if not (self.dead_band_mm >= 0 and self.overshoot_mm >= 0 and self.braking_mm >= 0):
            raise ValueError(f"dead-band, braking distance and overshoot must not be negative, not {self}")

    def scaled(self, units_per_mm: float) -> "AxisDrive":
        """Return the same drive where positions are counted in other units."""
        return AxisDrive(
            speed_mm_s=self.speed_mm_s * units_per_mm,
            acceleration_mm_s2=self.acceleration_mm_s2 * units_per_mm,
            run_out_s=self.run_out_s,
            braking_mm=self.braking_mm * units_per_mm,
            overshoot_mm=self.overshoot_mm * units_per_mm,
            dead_band_mm=self.dead_band_mm * units_per_mm,
            counts_per_mm=self.counts_per_mm / units_per_mm,
        )


_DRIVE = AxisDrive()

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
        What the unit says of this setting in its service text; its axes take turns all the same.
    high_switches
        The unit looks at its high end switches; the maker's build for this board does not.
    b_out_bit, b_high_bit
        Where the status word has the first of B's three motion bits, and B's high end switch.
    own_target
        Where the unit's own sun tracking would point, of time [s].
    own_interval_s
        Time from one such target to the next.
    wind_stow, snow_stow
        Where it goes in wind and under snow; None as the unit's "off".
    wind_hold_s, snow_hold_s
        How long it stays there after the wind or the snow has ended.
    """

    a_actuator: Mechanics = A_ACTUATOR
    b_actuator: Mechanics = B_ACTUATOR
    drive: AxisDrive = _DRIVE
    start: Angles = FLAT
    synchronous: bool = False
    high_switches: bool = True
    b_out_bit: int = 15
    b_high_bit: int = 22
    own_target: Callable[[float], Angles] = _flat
    own_interval_s: float = 300.0
    wind_stow: Angles | None = None
    snow_stow: Angles | None = None
    wind_hold_s: float = 300.0
    snow_hold_s: float = 60.0
