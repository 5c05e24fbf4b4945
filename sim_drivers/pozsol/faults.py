"""What may go wrong at the simulated positioner, by name."""

from typing import Literal

from sim_drivers.pozsol.motion import Axis
from sim_drivers.pozsol.supply import LOW_V, NOMINAL_V
from sim_drivers.pozsol.unit import Button, PositionerUnit

SLIP_COUNTS = 375
"""Hall impulses that one slip takes from the count, 5 mm of an actuator: the axis is then further out than counted."""

_AXIS_EVENTS = ("overcurrent", "pulse_loss", "destination", "slip")
_AXIS_CONDITIONS = ("hall_loss", "cable", "switch_closed", "switch_open", "ignores_targets")
_BUTTONS: dict[str, Button] = {"button": "out", "button_in": "in", "buttons_both": "both"}
_UNIT_CONDITIONS = (*_BUTTONS, "undervoltage", "own_tracking", "slave_mode", "slave_standby", "wind", "snow")
_UNIT_EVENTS = ("re_reference", "reset_position_kept", "reset_position_lost")
_AXIS_FAULTS = (*_AXIS_EVENTS, *_AXIS_CONDITIONS)
FAULTS = (*(f"{axis}_{fault}" for axis in "ab" for fault in _AXIS_FAULTS), *_UNIT_CONDITIONS, *_UNIT_EVENTS)
"""Everything that `inject` can do."""


def inject(unit: PositionerUnit, fault: str, now: float, *, present: bool = True) -> None:
    """Begin, or with `present` false end, one of `FAULTS`; `ValueError` for any other, or for ending an event."""
    if fault not in FAULTS:
        raise ValueError(f"the simulated positioner has no fault {fault!r}; it has {', '.join(FAULTS)}")
    name, _, kind = fault.partition("_")
    if not present and (fault in _UNIT_EVENTS or kind in _AXIS_EVENTS):
        raise ValueError(f"{fault!r} is an event, not a condition: there is nothing to end")
    if kind in _AXIS_FAULTS:
        _inject_axis(unit.axes["a" if name == "a" else "b"], kind, present, now)
    elif fault in _BUTTONS:
        unit.press(_BUTTONS[fault] if present else None, now)
    elif fault == "undervoltage":
        unit.set_supply(LOW_V if present else NOMINAL_V, now)
    elif fault == "own_tracking":
        unit.modes.set_tracking(present, now)
    elif fault == "slave_mode":
        unit.modes.set_led_by_master(present, now)
    elif fault == "slave_standby":
        unit.modes.slave = present
    elif fault == "re_reference":
        unit.re_reference(now)
    elif fault in ("wind", "snow"):
        (unit.modes.wind if fault == "wind" else unit.modes.snow).cause(present, now)
    else:
        unit.power_cycle(now, keep_position=fault == "reset_position_kept")
    unit.decide(now)


def _inject_axis(axis: Axis, kind: str, present: bool, now: float) -> None:
    if kind == "hall_loss":
        axis.lose_hall(present, now)
    elif kind in ("switch_closed", "switch_open"):
        stuck: Literal["closed", "open"] = "closed" if kind == "switch_closed" else "open"
        axis.low_switch = stuck if present else "works"
    elif kind == "ignores_targets":
        axis.ignores_targets = present
    elif kind == "slip":
        axis.slip(SLIP_COUNTS / axis.drive.counts_per_mm)
    else:
        axis.cable_broken = present if kind == "cable" else axis.cable_broken
        if present:
            axis.faults.add(kind)
