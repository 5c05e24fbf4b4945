"""How far and how often the laws may move the tracker in a day: a drive wears by the metre and by the start."""

import logging

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.alarms.alarms import Alarms
from daemon.base.state import StateFile, StateFolder, UnreadableStateError, roll_over_day
from daemon.config.sections import MotionSettings
from solar.ephemeris import Site, share_of_daylight_left, solar_days

log = logging.getLogger("heliocube.control")

FILE_NAME = "day.json"
_ALARM = "day-budget"
_SHARE_KEPT_FOR_SUN = 0.25
"""Share of the day's travel that is kept for following the sun by the clock, which takes some 250 degrees in a day and
half of that in an afternoon."""
_SHARE_AHEAD_OF_TIME = 0.1
"""Share of the day's moves that may be made ahead of time, because clouds do not come evenly over the day."""
_SEE_SETTINGS = "see motion.moves_per_day and motion.travel_per_day_deg"


class UsedBudget(BaseModel):
    """The travel [deg, A and B added] and the moves of the laws on a solar day; `day` is counted from 1970."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    day: int
    travelled_deg: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    moves: int = Field(default=0, ge=0)

    def plus(self, travelled_deg: float, moves: int) -> "UsedBudget":
        """Return a count with this travel and these moves added."""
        return UsedBudget(day=self.day, travelled_deg=self.travelled_deg + travelled_deg, moves=self.moves + moves)


def is_ahead_of_schedule(moves: int, settings: MotionSettings, site: Site, utc_s: float) -> bool:
    """Whether so many moves are made by now that the next has to wait: the day's moves are to last until sunset.

    Parameters
    ----------
    moves
        How many were made today.
    settings, site
        The limit, and where the tracker is.
    utc_s
        Now [s]. While the sun is down nothing waits: it is twilight, or the clock is wrong.
    """
    left = share_of_daylight_left(utc_s, *site)
    return 0.0 < left < 1.0 and moves > settings.moves_per_day * (1.0 - left * (1.0 - _SHARE_AHEAD_OF_TIME))


class DayBudget:
    """Counts the moves of the laws, spreads them over the day, and lets none go beyond its limits.

    Parameters
    ----------
    settings
        The limits.
    site
        Where the tracker is. A day is a solar day there, from midnight to midnight.
    folder
        Where the count is kept over a restart.
    alarms
        Where the end of the budget is told.
    utc_s
        The time of construction [s].
    """

    def __init__(self, settings: MotionSettings, site: Site, folder: StateFolder, alarms: Alarms, utc_s: float) -> None:
        self._settings = settings
        self._site = site
        self._file = StateFile(folder, FILE_NAME, UsedBudget, log, "the moves of the day")
        self._alarms = alarms
        # An older day's count ends with the first `begin_day_if_due`, which comes when the clock can be trusted.
        self.used = self._load() or UsedBudget(day=int(solar_days(utc_s, site.longitude_deg)))
        self._later_day: UsedBudget | None = None

    @property
    def moves_left(self) -> int:
        """How many more moves the laws may make today."""
        return max(self._settings.moves_per_day - self.used.moves, 0)

    @property
    def travel_left_deg(self) -> float:
        """How much further the laws may go today, A and B added."""
        return max(self._settings.travel_per_day_deg - self.used.travelled_deg, 0.0)

    @property
    def is_reserved_for_sun(self) -> bool:
        """Whether the travel that is left is kept for following the sun by the clock, which beats standing."""
        return self.travel_left_deg < _SHARE_KEPT_FOR_SUN * self._settings.travel_per_day_deg

    def waits_why(self, utc_s: float) -> str | None:
        """Return why the next move has to wait for a later time of the day; None if it need not, or no move is left."""
        if self.moves_left < 1 or not is_ahead_of_schedule(self.used.moves, self._settings, self._site, utc_s):
            return None
        return f"waits, because the day's {self._settings.moves_per_day} moves are to last until sunset"

    def begin_day_if_due(self, utc_s: float) -> None:
        """Begin a new day when the sun has passed its lowest point since the last call.

        If the clock was wrong for a time and is then set to the day of the kept count, that count goes on.
        """
        today, before, later = int(solar_days(utc_s, self._site.longitude_deg)), self.used, self._later_day
        if today == before.day:
            return
        self.used, self._later_day = roll_over_day(today, before, later, UsedBudget(day=today))
        if self.used is later:
            self.used = later.plus(before.travelled_deg, before.moves)
        else:
            self._alarms.set(_ALARM, None)
        self._save()

    def refusal(self, distance_deg: float) -> str | None:
        """Return why one more move of this length [deg] is too much, and tell it once a day; None if it is not."""
        if self.moves_left >= 1 and distance_deg <= self.travel_left_deg:
            return None
        text = f"the laws have used up the day's budget of motion: {self._usage_text}; {_SEE_SETTINGS}"
        self._alarms.set(_ALARM, text)
        return text

    def book(self, distance_deg: float) -> None:
        """Count a move that was ordered, and note that on disk."""
        self.used = self.used.plus(distance_deg, 1)
        self._save()
        if self.is_reserved_for_sun:
            self._alarms.set(
                _ALARM,
                f"three quarters of the day's budget of travel are used ({self._usage_text}): the rest is kept for"
                f" following the sun by the clock; {_SEE_SETTINGS}",
            )

    def _save(self) -> None:
        used, later = self.used, self._later_day
        self._file.save(used if later is None else later.plus(used.travelled_deg, used.moves))

    @property
    def _usage_text(self) -> str:
        return (
            f"{self.used.moves} moves of {self._settings.moves_per_day}, {self.used.travelled_deg:.0f} deg of"
            f" {self._settings.travel_per_day_deg:g}"
        )

    def _load(self) -> UsedBudget | None:
        try:
            return self._file.load()
        except UnreadableStateError as error:
            log.warning("%s: the moves of the day are counted from zero again", error)
            return None
