"""Why the unit does not do what it is told, in words, as far as its telemetry shows it."""

from collections.abc import Mapping

from drivers.interfaces import AxisName, Telemetry
from drivers.positioners.pozsol.geometry import AxisSetup

_LOWEST_SUPPLY_V = 20.0


def why_not_standing(seen: Telemetry, within_s: float, *, still: bool) -> str:
    """Return why stops have not brought both axes to a standstill within this time [s]."""
    if still:
        aims = f"A at {seen.position_a:g} of {seen.destination_a:g}, B at {seen.position_b:g} of {seen.destination_b:g}"
        return f"does not accept the stop: it stands short of its destinations: {aims}"
    return f"keeps moving after {within_s:g} s of stops, at A {seen.a_deg:z.1f}, B {seen.b_deg:z.1f} deg"


def geometry_mismatch(seen: Telemetry, axes: Mapping[AxisName, AxisSetup]) -> str | None:
    """Return at which axis angle and position do not go together, or None."""
    shown = {"a": (seen.a_deg, seen.position_a), "b": (seen.b_deg, seen.position_b)}
    for axis, setup in axes.items():
        angle_deg, position = shown[axis]
        if not setup.fits(angle_deg, position):
            return (
                f"it shows {angle_deg:z.1f} deg at position {position:g} of axis {axis.upper()}, but by"
                f" instruments.positioner.{axis}_axis that angle is position {setup.geometry.position(angle_deg):.1f};"
                " is the geometry that of this unit?"
            )
    return None


def likely_cause(seen: Telemetry) -> str:
    """Return why a command shows no effect."""
    if seen.faults:
        return f"it reports {', '.join(seen.faults)}"
    if seen.homing:
        return "it is homing"
    if seen.was_reset:
        return "it has restarted, and may take no target before its status is cleared"
    if seen.supply_v < _LOWEST_SUPPLY_V:
        return f"its motor supply is {seen.supply_v:g} V"
    if seen.autonomous:
        return f"its own mode is on ({seen.details['mode']})"
    shown = f"destinations {seen.destination_a:g} and {seen.destination_b:g}"
    # After its supply was low the unit takes no target for five seconds more, and does not report that.
    return (
        f"it shows {shown} and no reason; was its motor supply low until just now, or is the geometry in"
        " instruments.positioner not that of this unit?"
    )
