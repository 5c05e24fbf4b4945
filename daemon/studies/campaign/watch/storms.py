"""Whether the tracker is stowed in a storm, arrives there, and stays so after a gust."""

import math
from collections.abc import Callable

from daemon.base.records import Mode, MoveOutcome
from daemon.rigs.campaign.plant import PlantTracker
from daemon.studies.campaign.watch.target_check import is_at_position, park_positions
from solar.frames import Angles

STORM_RESPONSE_S = 11.0
"""How soon the service must answer a strong wind: two decisions of control, and a margin."""
STOWED_AFTER_GUST_S = 60.0
LOOKS_WITHIN_S = 1.5
"""The service counts the wind as calm from its last look at a strong one, up to this long before the gust ends."""
STOWED_WITHIN_S = 420.0
"""From one corner of the limits to the stow position, one axis after the other, with a second try."""
SENT_WITHIN_S = 12.0
"""How soon a stow that has not failed must be sent: two decisions of control, and a margin."""
UNSTOWED_MODES = (Mode.TRACKING, Mode.FALLBACK, Mode.NIGHT, Mode.SNOW)


class Storms:
    """Compares the wind with the mode.

    Parameters
    ----------
    fails
        Called with a promise and a text.

    Attributes
    ----------
    gust_s
        When the last gust ended that was long enough for the service to see it.
    excused
        Another fault is on, or the unit's count is wrong: a stow may be impossible, or end elsewhere.
    """

    def __init__(self, fails: Callable[[str, str], None]) -> None:
        self._fails = fails
        self._storm_s: float | None = None
        self._unsent_since_s: float | None = None
        self._undisturbed_since_s = -math.inf
        self.gust_s = -math.inf
        self.excused = False

    def note_disturbance(self, now_s: float) -> None:
        """Note that a fault or a person's command comes in between: a stow may take longer."""
        self._undisturbed_since_s = now_s

    def is_pending(self, now_s: float) -> bool:
        """Tell whether time alone may break a promise: in a storm, or shortly after a gust."""
        return self._storm_s is not None or now_s < self.gust_s + STOWED_AFTER_GUST_S

    def check(self, mount: PlantTracker, at: Angles, now_s: float, reachable_s: float, *, live: bool) -> None:
        """Compare wind, mode and where the axes truly stand.

        `reachable_s` and `live` say since when, and whether, the service can do anything.
        """
        self._check_storm(mount, at, now_s, reachable_s, live=live)
        stows_s = min(STOWED_AFTER_GUST_S, mount.settings.safety.stow_at_least_s - LOOKS_WITHIN_S)
        after_gust = self.gust_s + STORM_RESPONSE_S < now_s < self.gust_s + stows_s
        if after_gust and reachable_s < now_s - STORM_RESPONSE_S and mount.control.mode in UNSTOWED_MODES and live:
            self._fails("storm", f"mode {mount.control.mode} {now_s - self.gust_s:.0f} s after a gust")

    def _check_storm(self, mount: PlantTracker, at: Angles, now_s: float, reachable_s: float, *, live: bool) -> None:
        wind = mount.wind_m_s
        strong = wind is not None and wind >= mount.settings.safety.stow_wind_m_s
        if not strong or not mount.is_served:
            self._storm_s = None
            return
        if self._storm_s is None:
            self._storm_s = now_s
        since_s = max(self._storm_s, reachable_s)
        if now_s - since_s > STORM_RESPONSE_S and mount.control.mode in UNSTOWED_MODES and live:
            self._fails("storm", f"mode {mount.control.mode} {now_s - since_s:.0f} s into a wind of {wind} m/s")
        since_s = max(since_s, self._undisturbed_since_s)
        if live and not self.excused and mount.control.mode is Mode.STOW:
            self._check_stow(mount, at, now_s, since_s)
        else:
            self._unsent_since_s = None

    def _check_stow(self, mount: PlantTracker, at: Angles, now_s: float, since_s: float) -> None:
        last = mount.motion.last_move
        there = is_at_position(at, park_positions(mount.settings)[Mode.STOW], mount.settings)
        if now_s - since_s > STOWED_WITHIN_S and not there:
            self._fails("stow", f"the tracker stands at {at} {now_s - since_s:.0f} s into a storm")
        # A move that has failed waits to be tried again.
        failed = last is not None and last.outcome not in (MoveOutcome.ARRIVED, MoveOutcome.INTERRUPTED)
        if there or failed or mount.motion.target is not None:
            self._unsent_since_s = None
        elif self._unsent_since_s is None:
            self._unsent_since_s = now_s
        elif now_s - max(self._unsent_since_s, since_s) > SENT_WITHIN_S:
            self._fails("stow", f"the tracker stands at {at} in a storm, and is not sent to the stow position")
