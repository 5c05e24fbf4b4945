"""What the simulated positioner does, whoever asks: two axes that take turns, protection, stow modes, faults."""

import math
from dataclasses import dataclass
from typing import Literal

from drivers import pozsol_wire as wire
from drivers.interfaces import Axis as AxisName
from sim_drivers.positioner_motion import Axis
from sim_drivers.positioner_screens import AxisReadout, Readout
from sim_drivers.positioner_setup import Setup
from solar.frames import Angles

POLL_S = 0.02
JOG_POLLS = 13
SELF_CLEAR_S = 900.0
NOMINAL_V, LOW_V = 24.0, 15.0
MOVE_V, CUT_OFF_V = 20.0, 17.0
MOTOR_CURRENT_A = 0.8

_AXIS_FAULTS = ("overcurrent", "hall_loss", "cable", "switch_closed", "switch_open")
_UNIT_CONDITIONS = ("undervoltage", "own_tracking", "slave_mode", "wind", "snow")
_UNIT_EVENTS = ("button", "re_reference", "reset_position_kept", "reset_position_lost")
FAULTS = (*(f"{axis}_{fault}" for axis in "ab" for fault in _AXIS_FAULTS), *_UNIT_CONDITIONS, *_UNIT_EVENTS)
"""Everything that `PositionerUnit.inject` can do."""


@dataclass(slots=True)
class _Stow:
    """One of the unit's own stow modes: entered `delay_s` after its cause appears, left `hold_s` after it ends."""

    pose: Angles | None
    delay_s: float
    hold_s: float
    active: bool = False
    change_s: float = math.inf

    def cause(self, present: bool, now_s: float) -> None:
        if self.pose is None or present is self.active:
            self.change_s = math.inf
        else:
            self.change_s = now_s + (self.delay_s if present else self.hold_s)


class PositionerUnit:
    """The positioner without its link. Time [s] is an argument and never runs backwards.

    Every command is either carried out or silently refused, as the unit does.
    """

    def __init__(self, now: float, setup: Setup) -> None:
        self.setup = setup
        self.axes: dict[AxisName, Axis] = {
            "a": Axis(setup.a_actuator, setup.drive, setup.start.a_deg),
            "b": Axis(setup.b_actuator, setup.drive, setup.start.b_deg),
        }
        self._wind = _Stow(setup.wind_stow, 0.5, setup.wind_hold_s)
        self._snow = _Stow(setup.snow_stow, 10.0, setup.snow_hold_s)
        self._own_tracking = False
        self._slave = False
        self._supply_v = NOMINAL_V
        self._was_reset = self._button = self._manual = False
        self._self_clear_s = now + SELF_CLEAR_S
        self._jog_ends_s = self._own_s = math.inf
        self._schedule()

    def advance(self, now: float) -> None:
        """Let everything happen that is due until `now`."""
        while self.due_s <= now:
            self._run(self.due_s)

    def point(self, name: AxisName, angle_deg: float, now: float) -> None:
        """Go to an angle, truncated to a whole unit of position and held in the unit's range."""
        if not self._own_tracking:
            self._go(self.axes[name], self._position(name, angle_deg), now)

    def go(self, name: AxisName, position: int, now: float) -> None:
        """Go to a position in whole units."""
        if not self._own_tracking:
            self._go(self.axes[name], position, now)

    def jog(self, name: AxisName, outwards: bool, now: float) -> None:
        """Drive towards an end for as long as this is repeated."""
        if self._own_tracking:
            return
        # The unit takes the end point of A for B as well; B's own range still holds.
        self._go(self.axes[name], self.axes["a"].range_mm if outwards else 0, now)
        self._jog_ends_s = now + JOG_POLLS * POLL_S
        self._schedule()

    def home(self, name: AxisName, now: float) -> None:
        """Begin a reference run, which also clears the status."""
        self.clear(now)
        self._home(self.axes[name], now)
        self._settle(now)

    def stop(self, now: float) -> None:
        """Run both axes out on their ramps and forget every target."""
        self._jog_ends_s = math.inf
        for axis in self.axes.values():
            axis.halt(now)
        self._settle(now)

    def switch_tracking(self, on: bool, now: float) -> None:
        """Switch the unit's own sun tracking; a slave takes "off" for "the other way round"."""
        self._own_tracking = not self._own_tracking if self._slave and not on else on
        self._own_s = now if self._own_tracking else math.inf
        self._schedule()

    def clear(self, now: float) -> None:
        """Clear the status and enable the axes; what was pending behind a fault goes on."""
        self._was_reset = self._button = False
        self._clear_faults()
        self._settle(now)

    def power_cycle(self, now: float, *, keep_position: bool = True) -> None:
        """Restart: faults are gone, the reset mark is set, the count is kept or starts at 0."""
        for axis in self.axes.values():
            axis.cut_power(now)
            axis.halt(now)
            axis.faults.clear()
            if not keep_position:
                axis.forget_position()
        self._power_up(now)

    def inject(self, fault: str, now: float, *, present: bool = True) -> None:
        """Begin, or with `present` false end, one of `FAULTS`; `ValueError` for any other, or for ending an event."""
        if fault not in FAULTS:
            raise ValueError(f"the simulated positioner has no fault {fault!r}; it has {', '.join(FAULTS)}")
        if not present and fault.endswith(("overcurrent", *_UNIT_EVENTS)):
            raise ValueError(f"{fault!r} is an event, not a condition: there is nothing to end")
        name, _, kind = fault.partition("_")
        if kind in _AXIS_FAULTS:
            self._inject_axis(self.axes["a" if name == "a" else "b"], kind, present, now)
        elif fault == "undervoltage":
            self._supply_v = LOW_V if present else NOMINAL_V
            if present:
                self._cut_off(now)
        elif fault == "button":
            self._button = True
            self._take_by_hand(now)
        elif fault in ("own_tracking", "slave_mode"):
            self._slave = present and (self._slave or fault == "slave_mode")
            self._own_tracking = present
            self._own_s = now if present else math.inf
        elif fault == "re_reference":
            for axis in self.axes.values():
                self._home(axis, now)
        elif fault in ("wind", "snow"):
            (self._wind if fault == "wind" else self._snow).cause(present, now)
        else:
            self.power_cycle(now, keep_position=fault == "reset_position_kept")
        self._settle(now)

    def truth(self, now: float) -> Angles:
        """Return where the axes really stand."""
        a, b = self.axes.values()
        return Angles(a.actuator.angle_deg(a.true_mm(now)), b.actuator.angle_deg(b.true_mm(now)))

    def readout(self, now: float, link_counter: int) -> Readout:
        """Return what the unit would print now."""
        a, b = (self._axis_readout(axis, now) for axis in self.axes.values())
        service = "Run:synch" if self.setup.synchronous else "Run:normal"
        return Readout(a, b, now, service, self._supply_v, self._mode(), self._status(now), link_counter)

    def _run(self, now: float) -> None:
        for axis in self.axes.values():
            if axis.event_s <= now:
                axis.arrive(now)
        if self._jog_ends_s <= now:
            self._take_by_hand(now)
        if self._self_clear_s <= now:
            self._self_clear_s = math.inf
            self._clear_faults()
        for stow in (self._wind, self._snow):
            if stow.change_s <= now:
                stow.active, stow.change_s = not stow.active, math.inf
                self._own_s = now if self._own_tracking else math.inf
        if self._own_s <= now:
            self._own_s = now + self.setup.own_interval_s
            self._track(now)
        self._settle(now)

    def _settle(self, now: float) -> None:
        """Start the axes whose turn it is, and find out when something happens next."""
        a, b = self.axes.values()
        powered = self._supply_v >= MOVE_V
        for axis, other in ((a, b), (b, a)):
            turn = self.setup.synchronous or other.driven is None
            if powered and turn and axis.driven is None and not axis.faults and (axis.homing or axis.pending):
                axis.begin(now)
        self._schedule()

    def _schedule(self) -> None:
        a, b = self.axes.values()
        changes = (self._jog_ends_s, self._self_clear_s, self._own_s, self._wind.change_s, self._snow.change_s)
        self.due_s = min(a.event_s, b.event_s, *changes)

    def _power_up(self, now: float) -> None:
        self._self_clear_s = now + SELF_CLEAR_S
        self._jog_ends_s = math.inf
        self._own_s = now if self._own_tracking else math.inf
        self._was_reset, self._button, self._manual = True, False, False
        self._clear_faults()
        self._schedule()

    def _go(self, axis: Axis, position: int, now: float) -> None:
        self._manual, self._jog_ends_s = False, math.inf
        if not (axis.faults or self._homing or self._supply_v < MOVE_V):
            axis.aim(min(max(position, 0), axis.range_mm), now)
            if axis.driven:
                axis.begin(now)
        self._settle(now)

    def _home(self, axis: Axis, now: float) -> None:
        if not (axis.faults or self._supply_v < MOVE_V):
            axis.homing, axis.pending = True, False
            axis.replan(now)

    def _track(self, now: float) -> None:
        if self._manual:
            return
        stow = self._wind if self._wind.active else self._snow if self._snow.active else None
        pose = stow.pose if stow and stow.pose else self.setup.own_target(now)
        for name, angle_deg in (("a", pose.a_deg), ("b", pose.b_deg)):
            axis_name: AxisName = "a" if name == "a" else "b"
            self._go(self.axes[axis_name], self._position(axis_name, angle_deg), now)

    def _position(self, name: AxisName, angle_deg: float) -> int:
        # The unit computes an unsigned whole number: no fraction, and nothing below 0.
        return max(int(self.axes[name].actuator.position_mm(angle_deg)), 0)

    @property
    def _homing(self) -> bool:
        return any(axis.homing for axis in self.axes.values())

    def _take_by_hand(self, now: float) -> None:
        self._manual, self._jog_ends_s = True, math.inf
        for axis in self.axes.values():
            if not axis.homing:
                axis.halt(now)

    def _cut_off(self, now: float) -> None:
        for axis in self.axes.values():
            axis.cut_power(now)
            axis.halt(now)

    def _clear_faults(self) -> None:
        for axis in self.axes.values():
            axis.faults = {"cable"} if axis.cable_broken else set()

    def _inject_axis(self, axis: Axis, kind: str, present: bool, now: float) -> None:
        if kind == "hall_loss":
            axis.hall_lost = present
            axis.replan(now)
        elif kind in ("switch_closed", "switch_open"):
            stuck: Literal["closed", "open"] = "closed" if kind == "switch_closed" else "open"
            axis.low_switch = stuck if present else "works"
            axis.replan(now)
        else:
            axis.cable_broken = present if kind == "cable" else axis.cable_broken
            if present:
                axis.cut_power(now)
                axis.faults.add(kind)

    def _axis_readout(self, axis: Axis, now: float) -> AxisReadout:
        counted = axis.counted_mm(now)
        current_a = MOTOR_CURRENT_A if axis.driven else 0.0
        return AxisReadout(axis.actuator.angle_deg(counted), counted, axis.destination, current_a, axis.remain)

    def _mode(self) -> str:
        if self._slave:
            return "sigma tracking" if self._own_tracking else "sigma standby"
        if not self._own_tracking:
            return "tracking disabled"
        return "wind mode" if self._wind.active else "snow mode" if self._snow.active else "Micro tracking"

    def _status(self, now: float) -> int:
        a, b = self.axes.values()
        word = sum(1 << wire.FAULT_BITS[f"{name}_{fault}"] for name, axis in self.axes.items() for fault in axis.faults)
        for axis, out_bit in ((a, wire.A_OUT_BIT), (b, wire.B_OUT_BIT_STM)):
            velocity = axis.velocity_mm_s(now)
            if velocity:
                word |= 1 << (out_bit if velocity > 0 else out_bit + 1)
            if axis.homing:
                word |= 1 << out_bit + 2
        marks = (
            (self._was_reset, wire.RESET_BIT),
            (self._button, wire.BUTTON_BIT),
            (a.low_closed(now), wire.SWITCH_BITS["a_low"]),
            (a.high_closed(now), wire.SWITCH_BITS["a_high"]),
            (b.low_closed(now), wire.SWITCH_BITS["b_low"]),
            (b.high_closed(now), wire.B_HIGH_BIT_STM),
            (self._own_tracking, wire.TRACKING_BIT),
            (self._own_tracking and self._snow.active, wire.SNOW_BIT),
            (self._own_tracking and self._wind.active, wire.WIND_BIT),
        )
        for on, bit in marks:
            if on:
                word |= 1 << bit
        return word
