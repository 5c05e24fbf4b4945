"""Whether the tracker is stowed in a storm, and stays so after a gust."""

import math

from daemon.base.records import Mode

STORM_S = 11.0
"""Two looks of control, and a little."""
GUST_STOWS_S = 60.0
FREE = (Mode.TRACKING, Mode.FALLBACK, Mode.NIGHT, Mode.SNOW)


class Storms:
    """Compares the wind with the mode.

    Parameters
    ----------
    fails
        Called with a promise and a text.

    Attributes
    ----------
    gust_s
        When a gust ended that lasted longer than the service looks away.
    """

    def __init__(self, fails):
        self._fails = fails
        self._storm_s = None
        self.gust_s = -math.inf

    def look(self, plant, now_s, reachable_s, *, live):
        """Look at wind and mode; `reachable_s` and `live` say since when, and whether, the service can do anything."""
        self._look_at_storm(plant, now_s, reachable_s, live=live)
        after_gust = self.gust_s + STORM_S < now_s < self.gust_s + GUST_STOWS_S
        if after_gust and reachable_s < now_s - STORM_S and plant.control.mode in FREE and live:
            self._fails("storm", f"mode {plant.control.mode} {now_s - self.gust_s:.0f} s after a gust")

    def _look_at_storm(self, plant, now_s, reachable_s, *, live):
        wind = plant.wind_m_s
        strong = wind is not None and wind >= plant.service.settings.safety.stow_wind_m_s
        if not strong or not plant.is_served:
            self._storm_s = None
            return
        if self._storm_s is None:
            self._storm_s = now_s
        since_s = max(self._storm_s, reachable_s)
        if now_s - since_s > STORM_S and plant.control.mode in FREE and live:
            self._fails("storm", f"mode {plant.control.mode} {now_s - since_s:.0f} s into a wind of {wind} m/s")
