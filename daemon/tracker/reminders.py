"""Reminding people of what they asked for, and of what does not work for longer than it takes to repair itself."""

import logging
import math
from collections.abc import Callable

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.records import Event, Mode, Record
from daemon.config.sections import SiteSettings
from daemon.motion.state import MotionState
from daemon.tracker.modes import DataState, Situation
from daemon.tracker.orders import RELEASE
from daemon.tracker.wishes import Wish, Wishes
from solar.ephemeris import DAY_S, SunDay, sun_day

log = logging.getLogger("heliocube.control")

# A unit that restarts, or a cable that is put back, is found again sooner.
_DOWN_AFTER_S = 60.0
# A bad contact lets the unit answer for moments in which no move can finish: only this long counts as back.
_BACK_AFTER_S = 15.0
# A restart of the cube, or a cloud that darkens the zenith face, is over sooner.
_WITHOUT_READINGS_S = 900.0


class Reminders:
    """Checks the wishes at every tick.

    Parameters
    ----------
    clock
        The service's time.
    site
        Where the sun rises.
    alarms
        Where a forgotten hold is shown.
    publish
        Called with events that remind of maintenance, while alarms are muted.
    """

    def __init__(self, clock: Clock, site: SiteSettings, alarms: Alarms, publish: Callable[[Record], None]) -> None:
        self._clock = clock
        self._site = (site.latitude_deg, site.longitude_deg, site.altitude_m)
        self._alarms = alarms
        self._publish = publish
        self._started_utc_s = clock.utc()
        self._day: SunDay | None = None
        self._maintenance: Wish | None = None
        self._due_s = math.inf
        self._unread_s: float | None = None
        self._without_readings = False
        self._last_answer_s = clock.monotonic()
        self._connected_s: float | None = None

    def remind(self, wishes: Wishes, *, sun_known: bool) -> None:
        """Remind where it is time; where the clock is in doubt the sun's position is not used."""
        self._remind_of_maintenance(wishes)
        name = "snow" if wishes.snow is not None else "hold"
        wish: Wish | None = getattr(wishes, name)
        self._alarms.set("release-changed", wishes.held_by_program)
        if wish is None or wishes.held_by_program:
            self._alarms.set("hold-forgotten", None)
        elif sun_known:
            text = f"{wishes.describe(name)}; a night has passed since: 'heliocube auto' if it was forgotten"
            self._alarms.set("hold-forgotten", text if self._outlasted_a_night(wish) else None)

    def watch(self, motion: MotionState, mode: Mode, situation: Situation, *, sun_known: bool) -> None:
        """Raise what lasts: a positioner that does not answer, readings that are not good."""
        now_s = self._clock.monotonic()
        if not motion.connected:
            self._connected_s = None
        elif self._connected_s is None:
            self._connected_s = now_s
        if self._connected_s is not None:
            if now_s - self._connected_s >= _BACK_AFTER_S:
                self._last_answer_s = now_s
                self._alarms.set("positioner-down", None)
        elif now_s - self._last_answer_s >= _DOWN_AFTER_S:
            reason = motion.outage.reason or "its driver has not come back from opening it"
            text = f"for a minute or more the positioner has not answered, or only for moments: {reason}"
            self._alarms.set("positioner-down", text)
        self._watch_readings(mode, situation, now_s, sun_known=sun_known)

    def _watch_readings(self, mode: Mode, situation: Situation, now_s: float, *, sun_known: bool) -> None:
        """Raise that the law has no readings by day, also while something else decides where the tracker stands."""
        data = situation.data
        if data is DataState.FRESH or situation.night_why is not None:
            self._unread_s = None
        elif data is DataState.BAD and self._unread_s is None:
            self._unread_s = now_s
        lasts = self._unread_s is not None and now_s - self._unread_s >= _WITHOUT_READINGS_S
        does = "tracking by the ephemeris" if sun_known else "standing, since the clock is in doubt too,"
        told = does if mode is Mode.FALLBACK else "no good readings"
        lasted, self._without_readings = self._without_readings, lasts
        # Otherwise leave the alarm as it is: after a restart nobody knows yet whether one that stood before is over.
        if lasts or lasted or data is DataState.FRESH:
            text = f"{told} for a quarter of an hour: {situation.data_why}" if lasts else None
            self._alarms.set("no-readings", text)

    def watch_stow(self, missed_why: str | None, wishes: Wishes) -> None:
        """Raise that a person keeps the tracker from a stow that is wanted and not done; not in maintenance."""
        standstill_reason = wishes.standstill_reason
        if missed_why is None or standstill_reason is None or wishes.maintenance is not None:
            self._alarms.set("stow-wanted", None)
        else:
            self._alarms.set(
                "stow-wanted", f"stow is wanted ({missed_why}), but the tracker is {standstill_reason}; {RELEASE}"
            )

    def _remind_of_maintenance(self, wishes: Wishes) -> None:
        now_s, wish = self._clock.monotonic(), wishes.maintenance
        if wish is not self._maintenance:
            self._maintenance = wish
            self._due_s = math.inf if wish is None else now_s + DAY_S - self._age_s(wish) % DAY_S
        if now_s >= self._due_s:
            self._due_s += DAY_S
            text = f"still {wishes.describe('maintenance')}; 'heliocube auto' ends it"
            log.warning(text)
            self._publish(Event(self._clock.utc(), now_s, "operator", text))

    def _age_s(self, wish: Wish) -> float:
        return max(self._clock.utc() - self._asked_utc_s(wish), 0.0)

    def _asked_utc_s(self, wish: Wish) -> float:
        return self._started_utc_s if wish.since_utc_s is None else wish.since_utc_s

    def _outlasted_a_night(self, wish: Wish) -> bool:
        utc_s = self._clock.utc()
        if self._day is None or not abs(self._day.noon_utc_s - utc_s) < 0.51 * DAY_S:
            self._day = sun_day(utc_s, *self._site)
        rise_s = self._day.sunrise_utc_s
        if rise_s is None:
            # Where the sun neither rises nor sets, the day begins at its lowest point.
            rise_s = self._day.noon_utc_s - DAY_S / 2.0
        latest_s = rise_s if utc_s >= rise_s else rise_s - DAY_S
        return self._asked_utc_s(wish) < latest_s
