"""Motions of the simulated positioner's axes in closed form: planned once, evaluated at any time.

Positions are in mm of actuator travel, times in seconds; outwards is positive.
"""

import math
from dataclasses import dataclass, replace

from sim_drivers.pozsol.setup import AxisDrive

_FAR_MM = 1e5
_FIRST_EDGE_S = 0.05
"""From the start of a motor to its first impulse."""
_LAST_EDGE_S = 0.045
"""From the last impulse to standstill."""
_BRAKED_EDGE_S = 0.245
"""From the target to the last impulse, when the unit has braked at its target."""
_FULL_OVERSHOOT = 0.69
"""From this share of full speed on an axis overshoots in full."""
_SAG_S = 0.1
"""How long a running axis that is not driven loses speed when its motor starts anew; it keeps half of its speed."""


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
    """A planned motion: pieces of constant acceleration, and where and when it ends.

    Attributes
    ----------
    first_edge_s, last_edge_s
        Between them the Hall sensors tell of motion.
    target_reached_s
        When the target is reached; infinite for a motion without one.
    cut
        It ends, at once, against a hard stop.
    """

    pieces: tuple[_Piece, ...]
    end_s: float
    end: float
    first_edge_s: float
    last_edge_s: float
    target_reached_s: float = math.inf
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
        met_s, limit = min((self.time_of_reaching(low, -1.0), low), (self.time_of_reaching(high, 1.0), high))
        if met_s >= self.end_s:
            return self
        pieces = tuple(piece for piece in self.pieces if piece.start_s <= met_s)
        return replace(self, pieces=pieces, end_s=met_s, end=limit, last_edge_s=met_s, cut=True)

    def time_of_reaching(self, limit: float, side: float) -> float:
        """When the motion first comes to a position from within, going to `side` (-1 in, 1 out); infinite if never."""
        for index, piece in enumerate(self.pieces):
            end_s = self.pieces[index + 1].start_s if index + 1 < len(self.pieces) else self.end_s
            end = piece.at(end_s)[0] if end_s < self.end_s else self.end
            if side * end >= side * limit and side * (end - piece.position) > 0:
                return piece.start_s if side * piece.position >= side * limit else min(piece.time_at(limit), end_s)
        return math.inf


def plan_coasting(start_s: float, position: float, velocity: float, drive: AxisDrive) -> Profile:
    """Plan how an axis runs out with its motor off."""
    rate = drive.speed_mm_s / drive.run_out_s
    duration = abs(velocity) / rate
    piece = _Piece(start_s, position, velocity, -math.copysign(rate, velocity))
    end_s = start_s + duration
    last_s = max(end_s - _LAST_EDGE_S, start_s)
    return Profile(
        pieces=(piece,), end_s=end_s, end=position + 0.5 * velocity * duration, first_edge_s=start_s, last_edge_s=last_s
    )


def plan_endless_drive(start_s: float, position: float, velocity: float, side: float, drive: AxisDrive) -> Profile:
    """Plan a motion to one side (-1 in, 1 out) that has no end of its own."""
    return _drive(start_s, position, velocity, position + side * _FAR_MM, drive, starts=False)


def plan_drive_to(
    start_s: float, position: float, velocity: float, target: float, drive: AxisDrive, *, starts: bool = True
) -> Profile:
    """Plan a motion to `target` as the unit does it: braked close before it, at rest a little beyond.

    Parameters
    ----------
    starts
        The motor is switched on for this; else it has been running and gets a new target.
    """
    return _drive(start_s, position, velocity, target, drive, starts=starts)


def _drive(
    start_s: float, position: float, velocity: float, target: float, drive: AxisDrive, *, starts: bool
) -> Profile:
    pieces: list[_Piece] = []
    first_s = start_s if velocity else start_s + _FIRST_EDGE_S
    if velocity * (target - position) < 0:
        stop = plan_coasting(start_s, position, velocity, drive)
        pieces += stop.pieces
        start_s, position, velocity = stop.end_s, stop.end, 0.0
    distance, speed = abs(target - position), abs(velocity)
    side = math.copysign(1.0, target - position if distance else velocity)
    if starts and speed and distance > 0.75 * speed * _SAG_S:
        pieces.append(_Piece(start_s, position, velocity, -side * 0.5 * speed / _SAG_S))
        start_s, position = start_s + _SAG_S, position + side * 0.75 * speed * _SAG_S
        distance, speed = distance - 0.75 * speed * _SAG_S, 0.5 * speed
    top, brake = _top_speed(distance, speed, drive)
    rate = drive.acceleration_mm_s2
    up_s, up = (top - speed) / rate, 0.5 * (top**2 - speed**2) / rate
    level_s = max(distance - up - brake, 0.0) / top if top else 0.0
    beyond = drive.overshoot_mm * min(1.0, top / (_FULL_OVERSHOOT * drive.speed_mm_s))
    fall_mm = max(distance - up - top * level_s, 0.0) + beyond
    rise = _Piece(start_s, position, side * speed, side * rate)
    level = _Piece(start_s + up_s, position + side * up, side * top, 0.0)
    fall = _fall(level.start_s + level_s, level.position + side * top * level_s, side, top, fall_mm)
    end_s = fall.start_s + (2 * fall_mm / top if top else 0.0)
    crosses_s = min(fall.time_at(target), end_s) if top and distance else fall.start_s
    pieces += [rise, level, fall]
    last_s = max(crosses_s + _BRAKED_EDGE_S, end_s - _LAST_EDGE_S)
    return Profile(
        pieces=tuple(pieces),
        end_s=end_s,
        end=target + side * beyond,
        first_edge_s=first_s,
        last_edge_s=last_s,
        target_reached_s=crosses_s,
    )


def _top_speed(distance: float, speed: float, drive: AxisDrive) -> tuple[float, float]:
    """Return the highest speed on the way, and how far before the target it has to brake."""
    brake = 0.0
    top = speed
    for _ in range(3):
        square = speed**2 + 2 * drive.acceleration_mm_s2 * max(distance - brake, 0.0)
        top = max(min(drive.speed_mm_s, math.sqrt(square)), speed)
        brake = drive.braking_mm * (top / drive.speed_mm_s) ** 3
    return top, min(brake, distance)


def _fall(start_s: float, position: float, side: float, speed: float, way_mm: float) -> _Piece:
    rate = speed**2 / (2 * way_mm) if way_mm > 0 else 0.0
    return _Piece(start_s, position, side * speed, -side * rate)
