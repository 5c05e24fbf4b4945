"""Whether a tracker that goes by the clock believes one that was just set wrong."""

import math
from collections.abc import Callable

from daemon.base.records import Mode, ModeChange
from daemon.rigs.campaign.plant import Plant

CLOCK_SETTLES_S = 890.0
CLOCK_STEP_S = 30.0


class ClockSteps:
    """Knows when the clock was set last.

    Parameters
    ----------
    fails
        Called with a promise and a text.
    """

    def __init__(self, fails: Callable[[str, str], None]) -> None:
        self._fails = fails
        self._stepped_s = -math.inf
        self._off_s = 0.0

    def note(self, off_s: float, now_s: float) -> None:
        """Take note by how much the clock is off; to set it to what it shows anyway changes nothing."""
        if off_s != self._off_s:
            self._off_s, self._stepped_s = off_s, now_s

    def check(self, plant: Plant, target: tuple[float, float], now_s: float, begun_s: float) -> None:
        """Look at a target [deg] that is sent by the clock, of a service that began at `begun_s`."""
        clock, control = plant.clock, plant.control
        # A process that began after the step has never known another time.
        known = self._stepped_s > begun_s
        wrong = known and abs(clock.step_s) > CLOCK_STEP_S and 1.0 < now_s - self._stepped_s < CLOCK_SETTLES_S
        # To be parked when it is night in truth takes no clock.
        parked = control.mode is Mode.NIGHT and plant.service.sun_elevation_deg(clock.utc() - clock.step_s) < 0.0
        if wrong and not parked and not _ordered_before(plant):
            text = f"{target} is sent in mode {control.mode} with the clock off by {clock.step_s:g} s: {control.why}"
            self._fails("clock", text)


def _ordered_before(plant: Plant) -> bool:
    """Tell whether the move that is sent was ordered in another mode: it is no decision of this one."""
    changes = (record for record in reversed(plant.records) if isinstance(record, ModeChange))
    latest = next(changes, None)
    return latest is not None and plant.motion.last_move_started_s < latest.time_monotonic_s
