"""What the simulated positioner does, whoever asks: two axes of which it drives one at a time, and its own modes.

The rules are those that the maker's public firmware was seen to follow, odd ones included. It looks after one axis, the
chosen one: only that axis' impulses are counted, and only its motor is controlled.
"""

import math
from typing import Literal

from drivers.interfaces import AxisName
from sim_drivers.pozsol.modes import OwnModes
from sim_drivers.pozsol.motion import ERRORS, HOMING_AHEAD_MM, HOMING_TIMEOUT_S, Axis
from sim_drivers.pozsol.screens import AxisReadout, Readout, axis_readout
from sim_drivers.pozsol.setup import Setup
from sim_drivers.pozsol.status import mode_text, status_word
from sim_drivers.pozsol.supply import MotorSupply
from solar.frames import Angles

POLL_S = 0.02
MANUAL_POLLS = 14
"""After an action (code 57) and so many looks at its input the unit takes its axes to be driven by hand."""
SELF_CLEAR_S = 900.0
BRAKING_S = 0.34
"""Time from an axis' target until the unit has braked it; commands in that time are lost."""
IDLE_S = 1.0
"""How long an axis stays switched on without a reason to be driven."""
BUTTON_S, BUTTON_AGAIN_S = 0.32, 0.301
"""How long a button has to be held before it does something, and until it does so again."""
Button = Literal["out", "in", "both"]
"""Which of the unit's buttons is held; both together choose the other axis."""


class PositionerUnit:
    """The positioner without its link. Time [s] is an argument and never runs backwards.

    Every command is either carried out or silently refused, as the unit does.

    Attributes
    ----------
    changes
        How often it has looked at its state; in between its axes go on as they do.
    """

    def __init__(self, now: float, setup: Setup) -> None:
        self.setup = setup
        self.axes: dict[AxisName, Axis] = {
            "a": Axis(setup.a_actuator, setup.drive, setup.start.a_deg),
            "b": Axis(setup.b_actuator, setup.drive, setup.start.b_deg),
        }
        self.axes["b"].set_counting(False, now)
        self.modes = OwnModes(setup)
        self.was_reset = False
        self.supply = MotorSupply()
        self.button: Button | None = None
        self.due_s = math.inf
        self._chosen_name: AxisName = "a"
        self._button_axis: AxisName = "a"
        self._self_clear_s = now + SELF_CLEAR_S
        self._button_s = self._manual_s = self._idle_s = self._braked_s = math.inf
        self._homing_ordered = self._runs_out = self._idled = False
        self.changes = 0
        self._schedule(now)

    def advance(self, now: float) -> None:
        """Let everything happen that is due until `now`."""
        while self.due_s <= now:
            self._run(self.due_s)

    def go_to_angle(self, name: AxisName, angle_deg: float, now: float) -> None:
        """Go to an angle, truncated to a whole unit of position and held in the unit's range."""
        self.go_to_position(name, self.axes[name].position_of(angle_deg), now)

    def go_to_position(self, name: AxisName, position: int, now: float) -> None:
        """Go to a position in whole units."""
        if not self.modes.ignores_host_targets:
            self._leave_manual()
            if not self.axes[name].ignores_targets:
                self._aim(name, position, now)
        self.decide(now)

    def note_action(self, now: float) -> None:
        """Take note of any action (code 57): unless it is a reference run, the unit soon stops what moves."""
        self._homing_ordered = False
        self._manual_s = now + MANUAL_POLLS * POLL_S
        self.decide(now)

    def jog(self, name: AxisName, outwards: bool, now: float) -> None:
        """Drive towards an end for as long as this is repeated."""
        self.note_action(now)
        if not self.modes.tracking:
            self._set_manual(False)
            # The unit takes the end point of A for B as well; B's own range still holds.
            self._aim(name, self.axes["a"].range_mm if outwards else 0, now)
        self.decide(now)

    def home(self, name: AxisName, now: float) -> None:
        """Begin a reference run, which also clears the status."""
        self.note_action(now)
        self.clear(now)
        self._begin_homing(name, now)
        self.decide(now)

    def re_reference(self, now: float) -> None:
        """Order reference runs of both axes, as the unit does every so many days; only that of B takes place."""
        self._begin_homing("b", now)
        # A was told first, and loses its turn before it has moved: it waits until something stops both.
        self.axes["a"].control = "home"
        self.decide(now)

    def stop(self, now: float) -> None:
        """Switch both motors off and forget every target."""
        self.note_action(now)
        self._stop_all(now)
        self.decide(now)

    def switch_tracking(self, on: bool, now: float) -> None:
        """Switch the unit's own sun tracking; a running motor goes on."""
        self.modes.set_tracking(on, now)
        self.decide(now)

    def clear(self, now: float) -> None:
        """Clear the status and enable the axes."""
        self.was_reset = False
        self.clear_faults()
        self.decide(now)

    def clear_faults(self) -> None:
        """Forget all faults but a broken cable, and enable the axes."""
        for axis in self.axes.values():
            axis.forget_faults()
            axis.enabled = True

    def power_cycle(self, now: float, *, keep_position: bool = True) -> None:
        """Restart: faults are gone, the reset mark is set, the count is kept or starts at 0.

        An axis that a fault has disabled stays so until the status is cleared, by the host or by the unit itself.
        """
        for axis in self.axes.values():
            axis.freeze(now)
            axis.forget_faults()
            if not keep_position:
                axis.forget_position(now)
            axis.control, axis.target_mm, axis.outward = "idle", axis.counted_mm(now), True
        self._choose("a", now)
        self._forget_orders()
        self.modes.restart(now)
        self.was_reset, self._self_clear_s = True, now + SELF_CLEAR_S
        self.decide(now)

    def set_supply(self, volts: float, now: float) -> None:
        """Change the motor supply."""
        self.supply.set(volts, now)
        if self.supply.cuts_off:
            self._stop_all(now)
        self.decide(now)

    def press(self, button: Button | None, now: float) -> None:
        """Hold one of the unit's buttons (out, in, both), or let it go."""
        self.button = button
        self._button_s = now + BUTTON_S if button else math.inf
        self.decide(now)

    def truth(self, now: float) -> Angles:
        """Return where the axes really stand."""
        a, b = self.axes.values()
        return Angles(a.true_deg(now), b.true_deg(now))

    def destination(self, name: AxisName, now: float) -> float:
        """Return the destination [mm] that the unit shows; where it follows the position, it moves with that."""
        axis = self.axes[name]
        if name == self._chosen_name:
            if axis.blocked or axis.control == "stop" or self._runs_out:
                return axis.counted_mm(now)
            if axis.control == "home":
                return axis.counted_mm(now) - HOMING_AHEAD_MM
        return axis.target_mm

    @property
    def standstill_version(self) -> int | None:
        """A number that stays the same while nothing has moved or changed; None while an axis moves."""
        a, b = self.axes.values()
        return self.changes if a.motion_end_s == b.motion_end_s == -math.inf else None

    def axis_readout(self, name: AxisName, now: float) -> AxisReadout:
        """Return what the unit would print of an axis now."""
        return axis_readout(self.axes[name], self.destination(name, now), now)

    def readout(self, now: float, link_counter: int) -> Readout:
        """Return what the unit would print now."""
        a, b = self.axis_readout("a", now), self.axis_readout("b", now)
        return Readout(
            a=a,
            b=b,
            clock_s=now,
            service=f"Run:{'synch' if self.setup.synchronous else 'normal'},Wi=0,Si=0",
            supply_v=self.supply.volts,
            mode=mode_text(self.modes),
            status=status_word(
                self.setup,
                self.modes,
                self.axes,
                {"a": a.destination_mm, "b": b.destination_mm},
                now,
                was_reset=self.was_reset,
                button_held=self.button is not None,
            ),
            link_counter=link_counter,
        )

    def decide(self, now: float) -> None:
        """Let the unit look at its state, and find out when it has to do so again."""
        for name, angle_deg in self.modes.targets(now):
            self._leave_manual()
            self._aim(name, self.axes[name].position_of(angle_deg), now)
        # One decision can make the next one possible at once, as the end of a reference run at standstill does.
        for _ in range(3):
            before = self._chosen_name, self._runs_out, self._axis.control, self._axis.active
            self._control(now)
            if before == (self._chosen_name, self._runs_out, self._axis.control, self._axis.active):
                break
        self._schedule(now)

    def _run(self, now: float) -> None:
        for axis in self.axes.values():
            axis.settle(now)
        if self._self_clear_s <= now:
            self._self_clear_s, self.was_reset = math.inf, False
            self.clear_faults()
        self._run_timers(now)
        self.decide(now)

    def _run_timers(self, now: float) -> None:
        axis = self._axis
        if axis.target_reached_s <= now < self._braked_s == math.inf:
            self._braked_s = max(now + BRAKING_S, axis.motion_end_s)
        if self._braked_s <= now:
            self._end_braking(now)
        if self._idle_s <= now:
            self._idle_s, self._idled = math.inf, True
            axis.target_mm, axis.control = self.destination(self._chosen_name, now), "idle"
            axis.switch_off_motor(now)
        if self._manual_s <= now:
            self._manual_s = math.inf
            if self._homing_ordered:
                self._manual_s = now + MANUAL_POLLS * POLL_S
            else:
                self._set_manual(True)
        if self._button_s <= now:
            self._obey_button(now)
        if now - axis.homing_since_s >= HOMING_TIMEOUT_S and axis.control == "home":
            axis.faults.add("homing_too_long")

    def _control(self, now: float) -> None:
        if self._runs_out and not self._axis.moving(now):
            self._stop_all(now)
            self._axis.control = "idle"
            self._runs_out = False
        self._take_turns(now)
        axis = self._axis
        if axis.blocked:
            axis.target_mm, axis.control = axis.counted_mm(now), "idle"
            axis.switch_off_motor(now)
        elif axis.low_closed(now) and axis.control == "home":
            self._finish_homing(axis, now)
        elif self._at_switch(axis, now):
            axis.target_mm, axis.control = axis.counted_mm(now), "stop"
            axis.switch_off_motor(now)
        else:
            self._drive(axis, now)
        if self.button is None and any(one.manual and one.active for one in self.axes.values()):
            self._stop_all(now)

    def _take_turns(self, now: float) -> None:
        other: AxisName = "b" if self._chosen_name == "a" else "a"
        dead_mm = self.setup.drive.dead_band_mm
        if self._any_moving(now) or abs(self._way_to_go_mm(self._chosen_name, now)) >= dead_mm:
            return
        if abs(self._way_to_go_mm(other, now)) > dead_mm:
            if self._axis.control == "home":
                self._axis.control = "idle"
            self._choose(other, now)
            self._axis.control = "track"

    def _at_switch(self, axis: Axis, now: float) -> bool:
        way = self._way_to_go_mm(self._chosen_name, now)
        inwards = axis.low_closed(now) and way < 0
        return inwards or (self.setup.high_switches and axis.high_closed(now) and way > 0)

    def _drive(self, axis: Axis, now: float) -> None:
        if self._braked_s < math.inf:
            return
        way = axis.to_counts(self._way_to_go_mm(self._chosen_name, now))
        moving = self._any_moving(now)
        outward = way > 0
        if way and not (moving and axis.outward is not outward):
            self._idle_s, self._idled = math.inf, False
            other = self.axes["b" if self._chosen_name == "a" else "a"]
            if other.active:
                # Both motors share a half bridge: the one that is switched on takes it from the other.
                other.coast_to_stop(now)
            target_mm = -math.inf if axis.control == "home" else axis.target_mm
            # With a button held it does not brake, and looks for its target from the other side then.
            axis.drive_towards(target_mm, now, outward=outward, brakes=self.button is None)
            return
        if axis.active and way:
            # It notices a target behind it, and drives on until it gives up.
            axis.drive_towards(math.inf, now, outward=axis.outward)
        elif axis.active and self.button is None and axis.velocity_mm_s(now):
            axis.coast_to_stop(now)
            self._braked_s = now + BRAKING_S
        if self._idle_s == math.inf and not self._idled:
            self._idle_s = now + IDLE_S

    def _aim(self, name: AxisName, position: float, now: float) -> None:
        axis = self.axes[name]
        if self.supply.refuses(now) or axis.faults & ERRORS or axis.control == "home" or axis.manual:
            return
        held = min(max(position + axis.actuator.zero_offset_mm, 0), axis.range_mm)
        per_mm = axis.drive.counts_per_mm
        axis.target_mm, axis.control = math.floor(held * per_mm + 1e-6) / per_mm, "track"

    def _begin_homing(self, name: AxisName, now: float) -> None:
        self._set_manual(False)
        self._homing_ordered = True
        self._choose(name, now)
        axis = self.axes[name]
        if not (axis.blocked or self.supply.refuses(now)):
            # An axis at rest without a target of its own may lose its turn at once to an axis that has one.
            self._take_turns(now)
            axis.control, axis.homing_since_s = "home", now

    def _finish_homing(self, axis: Axis, now: float) -> None:
        axis.remain = axis.counted_mm(now)
        axis.forget_position(now)
        self._set_manual(True)
        self._stop_all(now)
        self._runs_out = True

    def _stop_all(self, now: float) -> None:
        for axis in self.axes.values():
            axis.target_mm, axis.control = axis.counted_mm(now), "stop"
            axis.switch_off_motor(now)

    def _end_braking(self, now: float) -> None:
        self._braked_s = math.inf
        self._axis.target_mm = self._axis.counted_mm(now)
        self._axis.switch_off_motor(now)
        for axis in self.axes.values():
            axis.control = "stop"

    def _choose(self, name: AxisName, now: float) -> None:
        if name == self._chosen_name:
            return
        self._axis.target_mm = self.destination(self._chosen_name, now)
        self._axis.set_counting(False, now)
        self._chosen_name = name
        self._axis.set_counting(True, now)
        if self._braked_s < math.inf:
            self._braked_s = min(self._braked_s, now + 2 * POLL_S)

    def _obey_button(self, now: float) -> None:
        self._button_s = now + BUTTON_AGAIN_S
        if self.button == "both":
            self._button_axis = "b" if self._button_axis == "a" else "a"
            self._set_manual(True)
            self._stop_all(now)
        elif self.button:
            self._set_manual(False)
            self._aim(self._button_axis, self.axes[self._button_axis].range_mm if self.button == "out" else 0, now)
            self._set_manual(True)

    def _leave_manual(self) -> None:
        self._manual_s = math.inf
        self._set_manual(False)

    def _set_manual(self, manual: bool) -> None:
        for axis in self.axes.values():
            axis.manual = manual

    def _forget_orders(self) -> None:
        self._homing_ordered = self._runs_out = self._idled = False
        self._manual_s = self._idle_s = self._braked_s = math.inf

    def _schedule(self, now: float) -> None:
        self.changes += 1
        a, b = self.axes.values()
        homing_s = self._axis.homing_since_s + HOMING_TIMEOUT_S
        own = (self._manual_s, self._idle_s, self._braked_s, self._self_clear_s, self._button_s, homing_s)
        times = (*own, *self.modes.events(), *a.events(), *b.events())
        self.due_s = min((time_s for time_s in times if time_s > now), default=math.inf)

    @property
    def _axis(self) -> Axis:
        return self.axes[self._chosen_name]

    def _way_to_go_mm(self, name: AxisName, now: float) -> float:
        return self.destination(name, now) - self.axes[name].counted_mm(now)

    def _any_moving(self, now: float) -> bool:
        return any(axis.moving(now) for axis in self.axes.values())
