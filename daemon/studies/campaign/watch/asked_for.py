"""Whether a target that goes out is still the one that is asked for."""

from collections.abc import Callable

from daemon.base.records import Mode
from daemon.rigs.campaign.plant import PlantTracker


def check_asked_for(mount: PlantTracker, target: tuple[float, float], fails: Callable[[str, str], None]) -> None:
    """Look at a target [deg] that is about to be sent; `fails` is called with a promise and a text.

    A mode that parks the tracker asks for one place alone: any other was asked for before, and has waited.
    """
    control, settings = mount.control, mount.settings
    safety, hold = settings.safety, control.wishes.hold
    places = {
        Mode.STOW: (safety.stow_a_deg, safety.stow_b_deg),
        Mode.NIGHT: (safety.night_a_deg, safety.night_b_deg),
        Mode.SNOW: tuple(settings.limits.limits().clip(safety.snow_a_deg, safety.snow_b_deg)),
        Mode.HOLD: None if hold is None else hold.goto_deg,
    }
    if control.mode in places and target != places[control.mode]:
        fails("superseded", f"{target} is sent in mode {control.mode}, which asks for {places[control.mode]}")
