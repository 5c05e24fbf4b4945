"""How long a tracker has been in each mode today."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from daemon.base.clock import Clock
from daemon.base.records import Mode, ModeChange
from solar.ephemeris import DAY_S

_S_PER_DEG = DAY_S / 360.0


@dataclass(frozen=True, slots=True)
class ModesOfDay:
    """Time in each mode [s] since an instant (UTC, s): solar midnight, or the start of the service on its first day."""

    since_utc_s: float
    lasted_s: Mapping[Mode, float]


class ModeTimes:
    """Adds up the modes of a solar day, counted on a clock that is never set; `note` takes in each change.

    Parameters
    ----------
    clock
        The service's time.
    longitude_deg
        Of the site, east positive. A day is the solar day there, from midnight to midnight, as for the laws' moves.
    """

    def __init__(self, clock: Clock, longitude_deg: float) -> None:
        self._clock = clock
        self._solar_time_offset_s = longitude_deg * _S_PER_DEG
        self._mode = Mode.STARTING
        self._entered_s = clock.monotonic()
        self._since_utc_s = clock.utc()
        self._earlier_modes_s: Counter[Mode] = Counter()

    def note(self, change: ModeChange) -> None:
        """Take in a change of mode."""
        found = self.today()
        self._earlier_modes_s, self._since_utc_s = Counter(found.lasted_s), found.since_utc_s
        self._mode, self._entered_s = change.after, self._clock.monotonic()

    def today(self) -> ModesOfDay:
        """Return the modes of the day so far; changes nothing."""
        utc_s = self._clock.utc()
        lasted_s = self._clock.monotonic() - self._entered_s
        midnight_utc_s = math.floor((utc_s + self._solar_time_offset_s) / DAY_S) * DAY_S - self._solar_time_offset_s
        since_utc_s = self._since_utc_s
        if since_utc_s > utc_s:
            # The clock was ahead and has been set back: count back from its present time to the beginning.
            since_utc_s = utc_s - lasted_s - self._earlier_modes_s.total()
        if since_utc_s >= midnight_utc_s:
            return ModesOfDay(
                since_utc_s, {**self._earlier_modes_s, self._mode: self._earlier_modes_s[self._mode] + lasted_s}
            )
        # The time before midnight is yesterday's.
        today = Counter({self._mode: min(lasted_s, utc_s - midnight_utc_s)})
        return ModesOfDay(midnight_utc_s, today)
