"""How far and how often the laws may move the tracker in a day: a drive wears by the metre and by the start."""

import logging

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.alarms.alarms import Alarms
from daemon.base.state import StateFile, StateFolder, UnreadableStateError
from daemon.config.sections import MotionSettings
from solar.ephemeris import DAY_S

log = logging.getLogger("heliocube.control")

FILE_NAME = "day.json"
_ALARM = "day-budget"
_FOR_THE_SUN = 0.25
"""Of both limits: the sun's own day takes some 250 degrees and 100 moves, its afternoon half of that."""
_SEE = "see motion.moves_per_day and motion.travel_per_day_deg"


class Used(BaseModel):
    """What the laws have used of a solar day, counted from 1970: degrees, A and B added, and moves."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    day: int
    travelled_deg: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    moves: int = Field(default=0, ge=0)


class DayBudget:
    """Counts the moves of the laws, and lets none go beyond the day's limits.

    Parameters
    ----------
    settings
        The limits.
    longitude_deg
        Of the site, east positive: a day is the sun's, from midnight to midnight.
    folder
        Where the count is kept over a restart.
    alarms
        Where the end of the budget is told.
    utc_s
        The time of construction [s].
    """

    def __init__(
        self, settings: MotionSettings, longitude_deg: float, folder: StateFolder, alarms: Alarms, utc_s: float
    ) -> None:
        self._settings = settings
        self._longitude_deg = longitude_deg
        self._file = StateFile(folder, FILE_NAME, Used, log, "the moves of the day")
        self._alarms = alarms
        # An older day's count ends with the first `turn`, which comes when the clock can be trusted.
        self.used = self._load() or Used(day=self._day_of(utc_s))

    @property
    def moves_left(self) -> int:
        """How many more moves the laws may make today."""
        return max(self._settings.moves_per_day - self.used.moves, 0)

    @property
    def travel_left_deg(self) -> float:
        """How much further the laws may go today, A and B added."""
        return max(self._settings.travel_per_day_deg - self.used.travelled_deg, 0.0)

    @property
    def is_for_the_sun(self) -> bool:
        """Whether what is left is kept for following the sun by the clock, which beats standing until the evening."""
        settings = self._settings
        return (
            self.moves_left < _FOR_THE_SUN * settings.moves_per_day
            or self.travel_left_deg < _FOR_THE_SUN * settings.travel_per_day_deg
        )

    def turn(self, utc_s: float) -> None:
        """Begin a new day when the sun has passed its lowest point since the last call."""
        today = self._day_of(utc_s)
        if today != self.used.day:
            self.used = Used(day=today)
            self._file.save(self.used)
            self._alarms.set(_ALARM, None)

    def refusal(self, distance_deg: float) -> str | None:
        """Return why one more move of this length [deg] is too much, and tell it once a day; None if it is not."""
        if self.moves_left >= 1 and distance_deg <= self.travel_left_deg:
            return None
        text = f"the laws have used up the day's budget of motion: {self._account}; {_SEE}"
        self._alarms.set(_ALARM, text)
        return text

    def book(self, distance_deg: float) -> None:
        """Count a move that was ordered, and note that on disk."""
        used = self.used
        self.used = Used(day=used.day, travelled_deg=used.travelled_deg + distance_deg, moves=used.moves + 1)
        self._file.save(self.used)
        if self.is_for_the_sun:
            self._alarms.set(
                _ALARM,
                f"three quarters of the day's budget of motion are used ({self._account}): the rest is kept for"
                f" following the sun by the clock; {_SEE}",
            )

    @property
    def _account(self) -> str:
        return (
            f"{self.used.moves} moves of {self._settings.moves_per_day}, {self.used.travelled_deg:.0f} deg of"
            f" {self._settings.travel_per_day_deg:g}"
        )

    def _day_of(self, utc_s: float) -> int:
        return int((utc_s + self._longitude_deg * DAY_S / 360.0) // DAY_S)

    def _load(self) -> Used | None:
        try:
            return self._file.load()
        except UnreadableStateError as error:
            log.warning("%s: the moves of the day are counted from zero again", error)
            return None
