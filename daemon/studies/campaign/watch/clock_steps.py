"""Whether a tracker that follows the clock believes a clock that was set wrong."""

import math
from collections.abc import Callable

from daemon.base.records import Mode, ModeChange
from daemon.rigs.campaign.plant import PlantTracker

CLOCK_STEP_S = 30.0
_NOTICED_WITHIN_S = 1.0


class ClockSteps:
    """Knows when the clock was set, and how far it was off then.

    Parameters
    ----------
    fails
        Called with a promise and a text.
    """

    def __init__(self, fails: Callable[[str, str], None]) -> None:
        self._fails = fails
        self._clock_offsets = [(-math.inf, 0.0)]

    def note(self, off_s: float, now_s: float) -> None:
        """Take note by how much the clock is off from now on."""
        self._clock_offsets.append((now_s, off_s))

    def check(self, mount: PlantTracker, target: tuple[float, float], now_s: float, begun_s: float) -> None:
        """Look at a target [deg] that a service, begun at `begun_s`, sends by the clock."""
        clock, control = mount.clock, mount.control
        # A process that began after a step has never known another time, and believes that one.
        began_off_s = next(off_s for at_s, off_s in reversed(self._clock_offsets) if at_s <= begun_s)
        known = min(abs(clock.step_s), abs(clock.step_s - began_off_s)) > CLOCK_STEP_S
        wrong = known and now_s - self._clock_offsets[-1][0] > _NOTICED_WITHIN_S
        # Parking is right while it is truly night, or while it is night by the clock that the service started with.
        true_s, sun_deg = clock.utc() - clock.step_s, mount.service.sun_elevation_deg
        parked = control.mode is Mode.NIGHT and min(sun_deg(true_s), sun_deg(true_s + began_off_s)) < 0.0
        if wrong and not parked and not _is_from_earlier_mode(mount):
            text = f"{target} is sent in mode {control.mode} with the clock off by {clock.step_s:g} s: {control.why}"
            self._fails("clock", text)


def _is_from_earlier_mode(mount: PlantTracker) -> bool:
    """Tell whether the move that is sent was ordered in an earlier mode: the present one did not decide it."""
    changes = (record for record in reversed(mount.records) if isinstance(record, ModeChange))
    latest = next(changes, None)
    return latest is not None and mount.motion.last_move_started_s < latest.time_monotonic_s
