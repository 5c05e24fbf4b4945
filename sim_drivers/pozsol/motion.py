"""One motor axis of the simulated positioner: its motor, its mechanics, its Hall sensors and its end switches.

Positions are in mm of actuator travel. The true position counts from the low end switch; the unit's own count differs
from it once its reference is lost. The unit (:mod:`.unit`) decides what the axis is told to do.
"""

import math
from typing import Literal

from sim_drivers.pozsol.profile import Profile, plan_coasting, plan_drive_to, plan_endless_drive
from sim_drivers.pozsol.setup import AxisDrive, Mechanics

HARD_STOP_MM = 1.0
"""How far beyond an end switch the mechanics go if the switch does not act."""
PULSE_TIMEOUT_S = 2.0
HOMING_TIMEOUT_S = 600.0
EDGE_MEMORY_S = 0.4
"""How long after an impulse an axis counts as moving."""
HOMING_AHEAD_MM = 10.0
"""During homing the destination is this far inwards of the position, wherever that is."""
ERRORS = frozenset(("overcurrent", "cable", "homing_too_long"))
"""Faults with which an axis refuses targets."""
_HAIR_MM = 1e-6

Control = Literal["idle", "track", "stop", "home"]


class Axis:
    """State of one axis between events.

    Attributes
    ----------
    control
        What the unit wants of it.
    active
        Its motor is switched on.
    outward
        Which way it was last driven.
    manual
        Driven by hand: it is stopped as soon as nobody presses a button.
    enabled
        Not switched off by a lost Hall signal.
    """

    def __init__(self, actuator: Mechanics, drive: AxisDrive, angle_deg: float) -> None:
        low, high = sorted((actuator.low_deg, actuator.high_deg))
        if not (low <= angle_deg <= high):
            raise ValueError(f"the axis can stand between {low} and {high}, not {angle_deg} deg")
        self.actuator = actuator
        self.drive = drive
        self.travel_mm = actuator.travel_mm
        self.range_mm = math.floor(self.travel_mm)
        self.control: Control = "idle"
        self.active = self.manual = False
        self.outward = self.enabled = True
        self.faults: set[str] = set()
        self.remain = 0.0
        self.cable_broken = self.ignores_targets = False
        self.low_switch: Literal["works", "closed", "open"] = "works"
        self.homing_since_s = math.inf
        self._hall_lost = False
        self._counting = True
        self._rest_mm = actuator.position_mm(angle_deg)
        self._profile: Profile | None = None
        self._origin_mm = 0.0
        self._frozen_mm: float | None = None
        self._moving_until_s = self._last_edge_s = -math.inf
        self._planned: tuple[float, bool] | None = None
        self._passes_s = math.inf
        self._blind_s = 0.0
        self._true_cache = self._counted_cache = (math.nan, math.nan)
        self.target_mm = self.counted_mm(0.0)

    @property
    def blocked(self) -> bool:
        """Whether a fault keeps the unit from driving it at all."""
        return not self.enabled or bool(self.faults & ERRORS)

    def true_mm(self, now_s: float) -> float:
        """Where the actuator is, from the low end switch."""
        return self._profile.at(now_s)[0] if self._profile else self._rest_mm

    def velocity_mm_s(self, now_s: float) -> float:
        """How fast it moves, outwards positive."""
        return self._profile.at(now_s)[1] if self._profile else 0.0

    def counted_mm(self, now_s: float) -> float:
        """Where the unit believes it is, in whole impulses."""
        counts = math.floor(self._exact_mm(now_s) * self.drive.counts_per_mm + 1e-6)
        return counts / self.drive.counts_per_mm

    def true_deg(self, now_s: float) -> float:
        """Where the axis is."""
        self._true_cache = at = self._angle_at(self._true_cache, self.true_mm(now_s))
        return at[1]

    def counted_deg(self, now_s: float) -> float:
        """Where the unit believes it is."""
        self._counted_cache = at = self._angle_at(self._counted_cache, self.counted_mm(now_s))
        return at[1]

    def _angle_at(self, before: tuple[float, float], position_mm: float) -> tuple[float, float]:
        # At any time one of the two axes rests, but its angle is asked for all the same: do not compute it anew.
        return before if before[0] == position_mm else (position_mm, self.actuator.angle_deg(position_mm))

    def position_of(self, angle_deg: float) -> int:
        """Return what the unit makes of an angle: an unsigned whole number, so no fraction, and nothing below 0."""
        position = self.actuator.position_mm(angle_deg) if math.isfinite(angle_deg) else 0.0
        return int(max(position, 0.0)) if math.isfinite(position) else 0

    def to_counts(self, way_mm: float) -> int:
        """Return a distance in whole impulses."""
        return round(way_mm * self.drive.counts_per_mm)

    def moving(self, now_s: float) -> bool:
        """Tell whether the unit has seen an impulse lately."""
        profile = self._profile
        if profile and self._counts_impulses and profile.first_edge_s <= now_s < profile.last_edge_s + EDGE_MEMORY_S:
            return True
        return now_s < self._moving_until_s

    def low_closed(self, now_s: float) -> bool:
        """Tell what the low end switch says."""
        if self.low_switch == "works":
            return self.true_mm(now_s) <= _HAIR_MM
        return self.low_switch == "closed"

    def high_closed(self, now_s: float) -> bool:
        """Tell what the high end switch says."""
        return self.true_mm(now_s) >= self.travel_mm - _HAIR_MM

    def events(self) -> tuple[float, ...]:
        """Return when this axis next changes by itself, in times that may lie in the past."""
        still_s = self._moving_until_s
        if not (profile := self._profile):
            return still_s, self.fault_s
        if self._counts_impulses:
            still_s = max(still_s, profile.last_edge_s + EDGE_MEMORY_S)
        starts_s = profile.first_edge_s if self._counts_impulses else math.inf
        low_s, high_s = profile.time_of_reaching(0.0, -1.0), profile.time_of_reaching(self.travel_mm, 1.0)
        return still_s, self.fault_s, starts_s, profile.end_s, profile.target_reached_s, self._passes_s, low_s, high_s

    @property
    def target_reached_s(self) -> float:
        """When the motor reaches its target; infinite while it has none."""
        return self._profile.target_reached_s if self._profile and self.active else math.inf

    @property
    def motion_end_s(self) -> float:
        """When its motion ends; -inf if it does not move."""
        return self._profile.end_s if self._profile else -math.inf

    @property
    def fault_s(self) -> float:
        """When the unit's patience with a motor that gives no impulses ends."""
        if not self.active:
            return math.inf
        if self._hall_lost or self._profile is None:
            return self._last_edge_s + PULSE_TIMEOUT_S
        return self._profile.last_edge_s + PULSE_TIMEOUT_S

    def drive_towards(self, target_mm: float, now_s: float, *, outward: bool, brakes: bool = True) -> None:
        """Drive towards a target of the unit's count [mm], or past it; infinite for a motion without end."""
        starts = not (self.active and self.outward is outward)
        brakes = brakes and not self._hall_lost and math.isfinite(target_mm)
        plan = (target_mm, brakes)
        if not starts and plan == self._planned:
            # The same order again changes nothing: against a hard stop an axis stays switched on, and at rest.
            return
        if not self.active:
            self._last_edge_s = now_s - self._blind_s
        self.active, self.outward, self._planned = True, outward, plan
        here, velocity, side = self.true_mm(now_s), self.velocity_mm_s(now_s), 1.0 if outward else -1.0
        goal = target_mm + self._origin_mm + 0.5 / self.drive.counts_per_mm
        if brakes:
            self._replace(plan_drive_to(now_s, here, velocity, goal, self.drive, starts=starts), now_s)
        else:
            profile = plan_endless_drive(now_s, here, velocity, side, self.drive)
            self._replace(profile, now_s)
            self._passes_s = profile.time_of_reaching(goal + side / self.drive.counts_per_mm, side)

    def coast_to_stop(self, now_s: float) -> None:
        """Run out without a motor."""
        if self._profile:
            self._planned = None
            self._replace(plan_coasting(now_s, self.true_mm(now_s), self.velocity_mm_s(now_s), self.drive), now_s)

    def switch_off_motor(self, now_s: float) -> None:
        """Switch the motor off."""
        if self.active:
            # The unit adds up how long it has driven blind, with pauses or without.
            self._blind_s = now_s - self._last_edge_s if self._hall_lost else 0.0
            self.active = self.manual = False
            self.coast_to_stop(now_s)

    def freeze(self, now_s: float) -> None:
        """Stand still at once, as without power in a simulation that is switched off."""
        self._rest_mm, self._profile = self.true_mm(now_s), None
        self.active = self.manual = False
        self._moving_until_s = -math.inf

    def lose_hall(self, lost: bool, now_s: float) -> None:
        """Let the Hall sensors die, or come back to life."""
        if lost is not self._hall_lost:
            self._freeze_count(now_s)
            self._hall_lost = lost
            self._resume_count(now_s)
            self._last_edge_s, self._planned, self._blind_s = now_s, None, 0.0

    def set_counting(self, counting: bool, now_s: float) -> None:
        """Begin or stop to count impulses: the unit counts those of one axis at a time."""
        if counting is not self._counting:
            self._freeze_count(now_s)
            self._counting = counting
            self._resume_count(now_s)

    def slip(self, way_mm: float) -> None:
        """Falsify the count."""
        self._origin_mm -= way_mm

    def forget_faults(self) -> None:
        """Forget all faults but a broken cable; an axis that a fault has disabled stays so."""
        self.faults = {"cable"} if self.cable_broken else set()

    def forget_position(self, now_s: float) -> None:
        """Lose the count: wherever the axis is now is 0."""
        self._origin_mm, self._frozen_mm = self.true_mm(now_s), None

    def settle(self, now_s: float) -> None:
        """Carry out the end of a motion, and of the unit's patience, if they are due."""
        if now_s >= self.fault_s:
            self.faults.add("hall_fault")
            self.enabled = False
            self._last_edge_s, self._blind_s = now_s, 0.0
        if self._profile and now_s >= self._profile.end_s:
            profile, self._profile = self._profile, None
            self._rest_mm = profile.end
            self._last_edge_s = max(self._last_edge_s, profile.last_edge_s)
            if self._counts_impulses:
                self._moving_until_s = max(self._moving_until_s, profile.last_edge_s + EDGE_MEMORY_S)

    @property
    def _counts_impulses(self) -> bool:
        return self._counting and not self._hall_lost

    def _exact_mm(self, now_s: float) -> float:
        return self.true_mm(now_s) - self._origin_mm if self._frozen_mm is None else self._frozen_mm

    def _freeze_count(self, now_s: float) -> None:
        if self._counts_impulses:
            self._remember_edges(now_s)
            self._frozen_mm = self._exact_mm(now_s)

    def _resume_count(self, now_s: float) -> None:
        if self._counts_impulses and self._frozen_mm is not None:
            self._origin_mm, self._frozen_mm = self.true_mm(now_s) - self._frozen_mm, None

    def _remember_edges(self, now_s: float) -> None:
        profile = self._profile
        if profile and self._counts_impulses and profile.first_edge_s <= now_s:
            last_s = min(now_s, profile.last_edge_s)
            self._moving_until_s = max(self._moving_until_s, last_s + EDGE_MEMORY_S)

    def _replace(self, profile: Profile, now_s: float) -> None:
        self._remember_edges(now_s)
        self._passes_s = math.inf
        self._profile = profile.cut_at(-HARD_STOP_MM, self.travel_mm + HARD_STOP_MM)
