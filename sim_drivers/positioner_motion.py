"""One motor axis of the simulated positioner, moving on closed-form ramps.

Positions are in mm of actuator travel. The true position counts from the low end switch; the unit's own count differs
from it once its reference is lost. Nothing here runs by ticks: a move is planned once and evaluated at any time.
"""

import math
from dataclasses import dataclass
from typing import Literal

from sim_drivers.positioner_setup import Actuator, Drive

HARD_STOP_MM = 1.0
"""How far beyond the low end switch the mechanics go if the switch does not act."""
_FAR_MM = 1e5
_HAIR_MM = 1e-9


@dataclass(frozen=True, slots=True)
class _Piece:
    start_s: float
    position: float
    velocity: float
    acceleration: float

    def at(self, time_s: float) -> tuple[float, float]:
        dt = time_s - self.start_s
        return (
            self.position + dt * (self.velocity + 0.5 * dt * self.acceleration),
            self.velocity + dt * self.acceleration,
        )

    def time_at(self, position: float) -> float:
        """When this piece, moving towards `position`, gets there."""
        way = position - self.position
        if self.acceleration == 0.0:
            return self.start_s + way / self.velocity
        square = max(self.velocity**2 + 2 * self.acceleration * way, 0.0)
        end_velocity = math.copysign(math.sqrt(square), way)
        return self.start_s + (end_velocity - self.velocity) / self.acceleration


@dataclass(frozen=True, slots=True)
class Profile:
    """A planned motion: pieces of constant acceleration, and where and when it ends."""

    pieces: tuple[_Piece, ...]
    end_s: float
    end: float
    cut: bool = False

    def at(self, time_s: float) -> tuple[float, float]:
        """Position [mm] and velocity [mm/s]."""
        if time_s >= self.end_s:
            return self.end, 0.0
        for piece in reversed(self.pieces):
            if time_s >= piece.start_s:
                return piece.at(time_s)
        return self.pieces[0].position, self.pieces[0].velocity

    def cut_at(self, low: float, high: float) -> "Profile":
        """Return the motion as it ends, at once, where it would leave low..high outwards."""
        for index, piece in enumerate(self.pieces):
            end_s = self.pieces[index + 1].start_s if index + 1 < len(self.pieces) else self.end_s
            end = piece.at(end_s)[0] if end_s < self.end_s else self.end
            for limit, side in ((low, -1.0), (high, 1.0)):
                if side * end > side * limit + _HAIR_MM and side * (end - piece.position) > 0:
                    if side * piece.position >= side * limit:
                        return Profile(self.pieces[: index + 1], piece.start_s, piece.position, cut=True)
                    return Profile(self.pieces[: index + 1], piece.time_at(limit), limit, cut=True)
        return self


def brake(start_s: float, position: float, velocity: float, drive: Drive) -> Profile:
    """Plan a stop on the ramp."""
    duration = abs(velocity) / drive.acceleration_mm_s2
    piece = _Piece(start_s, position, velocity, -math.copysign(drive.acceleration_mm_s2, velocity))
    return Profile((piece,), start_s + duration, position + 0.5 * velocity * duration)


def travel(start_s: float, position: float, velocity: float, target: float, drive: Drive) -> Profile:
    """Plan a move to `target` [mm], with a stop first where it lies behind or within the stopping distance."""
    rate, full = drive.acceleration_mm_s2, drive.speed_mm_s
    pieces: tuple[_Piece, ...] = ()
    way = target - position
    if velocity != 0.0 and not (way * velocity > 0 and abs(way) >= velocity**2 / (2 * rate)):
        stop = brake(start_s, position, velocity, drive)
        pieces = stop.pieces
        start_s, position, velocity = stop.end_s, stop.end, 0.0
        way = target - position
    side, distance, speed = math.copysign(1.0, way), abs(way), abs(velocity)
    peak = min(full, math.sqrt(rate * distance + 0.5 * speed**2))
    up_s, down_s = (peak - speed) / rate, peak / rate
    up = 0.5 * (peak + speed) * up_s
    down = 0.5 * peak * down_s
    cruise_s = max(distance - up - down, 0.0) / peak if peak > 0 else 0.0
    rise = _Piece(start_s, position, velocity, side * rate)
    level = _Piece(start_s + up_s, position + side * up, side * peak, 0.0)
    fall = _Piece(level.start_s + cruise_s, target - side * down, side * peak, -side * rate)
    return Profile((*pieces, rise, level, fall), fall.start_s + down_s, target)


Driven = Literal["target", "home", "stop"]


class Axis:
    """State of one axis between events.

    The owner calls `begin`, `halt` and `arrive` at the right times; everything else can be asked at any time.
    """

    PULSE_TIMEOUT_S = 2.0
    HOMING_TIMEOUT_S = 600.0

    def __init__(self, actuator: Actuator, drive: Drive, angle_deg: float) -> None:
        if not (actuator.low_deg <= angle_deg <= actuator.high_deg):
            raise ValueError(
                f"the axis can stand between {actuator.low_deg} and {actuator.high_deg}, not {angle_deg} deg"
            )
        self.actuator = actuator
        self.drive = drive
        self.range_mm = math.floor(actuator.travel_mm)
        self.destination = actuator.position_mm(angle_deg)
        self.remain = 0.0
        self.pending = False
        self.homing = False
        self.driven: Driven | None = None
        self.faults: set[str] = set()
        self.hall_lost = False
        self.cable_broken = False
        self.low_switch: Literal["works", "closed", "open"] = "works"
        self.trip_s = math.inf
        self._homing_ends_s = math.inf
        self._rest_mm = self.destination
        self._profile: Profile | None = None
        self._origin_mm = 0.0
        self._frozen_count: float | None = None

    @property
    def event_s(self) -> float:
        """When this axis next changes by itself."""
        arrives_s = self._profile.end_s if self._profile else math.inf
        return min(arrives_s, self.trip_s, self._homing_ends_s)

    def true_mm(self, now_s: float) -> float:
        """Where the actuator is, from the low end switch."""
        return self._profile.at(now_s)[0] if self._profile else self._rest_mm

    def velocity_mm_s(self, now_s: float) -> float:
        """How fast it moves, outwards positive."""
        return self._profile.at(now_s)[1] if self._profile else 0.0

    def counted_mm(self, now_s: float) -> float:
        """Where the unit believes it is."""
        return self.true_mm(now_s) - self._origin_mm if self._frozen_count is None else self._frozen_count

    def low_closed(self, now_s: float) -> bool:
        """Tell what the low end switch says."""
        if self.low_switch == "works":
            return self.true_mm(now_s) <= _HAIR_MM
        return self.low_switch == "closed"

    def high_closed(self, now_s: float) -> bool:
        """Tell what the high end switch says."""
        return self.true_mm(now_s) >= self.actuator.travel_mm - _HAIR_MM

    def aim(self, destination: float, now_s: float) -> None:
        """Take a destination [mm, by the unit's count]; it is driven to once `begin` is called."""
        self.destination = destination
        way = destination - self.counted_mm(now_s)
        self.pending = self.driven is not None or abs(way) > self.drive.dead_band_mm

    def begin(self, now_s: float) -> None:
        """Drive towards the destination, or inwards for the low end switch, from the present motion."""
        self.driven = "home" if self.homing else "target"
        if self.homing and self._homing_ends_s == math.inf:
            self._homing_ends_s = now_s + self.HOMING_TIMEOUT_S
        here, velocity = self.true_mm(now_s), self.velocity_mm_s(now_s)
        if not self.hall_lost:
            self._count_again(here)
            self.trip_s = math.inf
        target = -_FAR_MM if self.homing else self.destination + self._origin_mm
        if self.hall_lost:
            # Without pulses the unit sees no progress and drives on until it notices.
            target = math.copysign(_FAR_MM, target - here)
            self._frozen_count = self.counted_mm(now_s)
            self.trip_s = min(self.trip_s, now_s + self.PULSE_TIMEOUT_S)
        elif not self.homing:
            target += math.copysign(self.drive.overshoot_mm, target - here)
        self._profile = travel(now_s, here, velocity, target, self.drive).cut_at(*self._walls())

    def replan(self, now_s: float) -> None:
        """Take a changed condition into account while driving."""
        if self.driven == "stop":
            self._brake(now_s)
        elif self.driven:
            self.begin(now_s)

    def halt(self, now_s: float) -> None:
        """Run out on the ramp; the destination becomes where that ends."""
        self.homing, self.pending, self._homing_ends_s = False, False, math.inf
        self.trip_s = math.inf
        if self._profile is None:
            self._count_again(self._rest_mm)
            self.destination = self.counted_mm(now_s)
            self.driven = None
            return
        self.driven = "stop"
        self._brake(now_s)

    def cut_power(self, now_s: float) -> None:
        """Stand still at once; what is pending stays pending, but a homing run is over."""
        self._rest_mm = self.true_mm(now_s)
        self._count_again(self._rest_mm)
        self._profile, self.trip_s = None, math.inf
        if self.homing or self.driven == "stop":
            self.destination, self.pending = self.counted_mm(now_s), False
        self.homing, self.driven, self._homing_ends_s = False, None, math.inf

    def forget_position(self) -> None:
        """Lose the count: wherever the axis stands is now 0."""
        self._origin_mm = self._rest_mm
        self.destination = 0.0

    def arrive(self, now_s: float) -> None:
        """Carry out what is due at `now_s`: the end of a motion or of the unit's patience."""
        if now_s >= self.trip_s:
            self._fail(now_s, "hall_fault", "pulse_loss")
        elif now_s >= self._homing_ends_s:
            self._fail(now_s, "homing_too_long")
        elif self._profile and now_s >= self._profile.end_s:
            self._come_to_rest(now_s, self._profile)

    def _come_to_rest(self, now_s: float, profile: Profile) -> None:
        self._rest_mm = profile.end
        self._profile = None
        at_switch = profile.cut and (self.low_closed(now_s) or self.high_closed(now_s))
        if not at_switch and (profile.cut or self.trip_s < math.inf):
            # Against the hard stop behind a dead switch, or without pulses: driven, and nothing seems to turn.
            self.trip_s = min(self.trip_s, now_s + self.PULSE_TIMEOUT_S)
            return
        self.trip_s = math.inf
        self._count_again(self._rest_mm)
        if self.homing:
            self.remain = self.counted_mm(now_s)
            self._origin_mm = self._rest_mm
            self.destination = 0.0
            self.homing, self._homing_ends_s = False, math.inf
        elif at_switch or self.driven == "stop":
            self.destination = self.counted_mm(now_s)
        self.driven, self.pending = None, False

    def _fail(self, now_s: float, *faults: str) -> None:
        self.cut_power(now_s)
        self.faults.update(faults)

    def _count_again(self, here_mm: float) -> None:
        if self._frozen_count is not None:
            self._origin_mm, self._frozen_count = here_mm - self._frozen_count, None

    def _brake(self, now_s: float) -> None:
        here, velocity = self.true_mm(now_s), self.velocity_mm_s(now_s)
        self._profile = brake(now_s, here, velocity, self.drive).cut_at(*self._walls())

    def _walls(self) -> tuple[float, float]:
        # A switch that is stuck closed ends every inward motion where it begins.
        low = {"works": 0.0, "open": -HARD_STOP_MM, "closed": _FAR_MM}[self.low_switch]
        return low, self.actuator.travel_mm
