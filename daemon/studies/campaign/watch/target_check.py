"""Whether a target that goes out is still the one that is asked for."""

from collections.abc import Callable

from daemon.base.records import Mode
from daemon.config.settings import Settings
from daemon.rigs.campaign.plant import PlantTracker
from solar.frames import Angles

_BEYOND_TOLERANCE_DEG = 0.5
"""How far beyond a move's tolerance an axis that has arrived may stand."""


def park_positions(settings: Settings) -> dict[Mode, tuple[float, float]]:
    """Return A and B [deg] of each mode that parks a tracker at one place."""
    safety = settings.safety
    return {
        Mode.STOW: (safety.stow_a_deg, safety.stow_b_deg),
        Mode.NIGHT: (safety.night_a_deg, safety.night_b_deg),
        Mode.SNOW: settings.limits.limits().clip(safety.snow_a_deg, safety.snow_b_deg),
    }


def is_at_position(at: Angles, place: tuple[float, ...], settings: Settings) -> bool:
    """Tell whether axes that have arrived at a place [deg] may stand where they do."""
    a_deg, b_deg = place
    away_deg = max(abs(at.a_deg - a_deg), abs(at.b_deg - b_deg))
    return away_deg <= settings.motion.tolerance_deg + _BEYOND_TOLERANCE_DEG


def check_target(mount: PlantTracker, target: tuple[float, float], fails: Callable[[str, str], None]) -> None:
    """Look at a target [deg] that is about to be sent; `fails` is called with a promise and a text.

    A mode that parks the tracker asks for one place only: any other target is left over from an earlier mode.
    """
    control = mount.control
    hold = control.wishes.hold
    places = {**park_positions(mount.settings), Mode.HOLD: None if hold is None else hold.goto_deg}
    if control.mode in places and target != places[control.mode]:
        fails("superseded", f"{target} is sent in mode {control.mode}, which asks for {places[control.mode]}")
