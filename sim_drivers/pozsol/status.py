"""The simulated positioner's status word and mode text."""

from collections.abc import Mapping

from drivers.interfaces import AxisName
from drivers.positioners.pozsol import wire
from sim_drivers.pozsol.modes import OwnModes
from sim_drivers.pozsol.motion import Axis
from sim_drivers.pozsol.setup import Setup

DESTINATION_BITS = {"a_destination": 28, "b_destination": 31}
"""Latched: the unit gave up a target."""
_FAULT_BITS = {**wire.FAULT_BITS, **DESTINATION_BITS}


def mode_text(modes: OwnModes) -> str:
    """Return the unit's own words for its mode; they do not say that tracking is off."""
    if modes.slave:
        return "sigma tracking" if modes.tracking else "sigma standby"
    if not modes.tracking:
        return "tracker ok"
    return "wind mode" if modes.wind.active else "snow mode" if modes.snow.active else "Micro tracking"


def status_word(
    setup: Setup,
    modes: OwnModes,
    axes: Mapping[AxisName, Axis],
    destinations_mm: Mapping[AxisName, float],
    now: float,
    *,
    was_reset: bool,
    button_held: bool,
) -> int:
    """Return the 32 bits of field 136; `destinations_mm` are those that are shown."""
    a, b = axes["a"], axes["b"]
    a_way, b_way = _counts_to_go(a, destinations_mm["a"], now), _counts_to_go(b, destinations_mm["b"], now)
    if b_way:
        # Motion of one axis wipes out the other's bits; if both move, only B's remain.
        a_way = 0
    marks = (
        (was_reset, wire.RESET_BIT),
        (button_held, wire.BUTTON_BIT),
        (a_way > 0, wire.A_OUT_BIT),
        (a_way < 0, wire.A_OUT_BIT + 1),
        (_homing(a, now), wire.A_OUT_BIT + 2),
        (b_way > 0, setup.b_out_bit),
        (b_way < 0, setup.b_out_bit + 1),
        (_homing(b, now), setup.b_out_bit + 2),
        (a.low_closed(now), wire.SWITCH_BITS["a_low"]),
        (setup.high_switches and a.high_closed(now), wire.SWITCH_BITS["a_high"]),
        (b.low_closed(now), wire.SWITCH_BITS["b_low"]),
        (setup.high_switches and b.high_closed(now), setup.b_high_bit),
        (modes.tracking, wire.TRACKING_BIT),
        (modes.tracking and modes.snow.active, wire.SNOW_BIT),
        (modes.tracking and modes.wind.active, wire.WIND_BIT),
    )
    word = 0
    for on, bit in marks:
        if on:
            word |= 1 << bit
    for name, axis in axes.items():
        for fault in axis.faults:
            word |= 1 << _FAULT_BITS[f"{name}_{fault}"]
    return word


def _counts_to_go(axis: Axis, destination_mm: float, now: float) -> int:
    return axis.to_counts(destination_mm - axis.counted_mm(now)) if axis.moving(now) else 0


def _homing(axis: Axis, now: float) -> bool:
    return axis.control == "home" and axis.moving(now)
