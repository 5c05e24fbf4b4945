"""A second law beside the one that points: it moves nothing, and each night it tells what it would have gained.

While the tracker's own law decides, the other one is asked as if it pointed: with the same scans and the same mean, a
positioner of the usual speed and the same rules for moves. In every other mode its plane stands where the tracker
stands, so that night, stow, a person or missing readings count alike for both. The same light counts for both planes.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.clock import iso_utc
from daemon.base.records import Event, Irradiances, Mode, Pose, Record, Scan, Target
from daemon.base.state import StateFile, StateFolder, UnreadableStateError, roll_over_day
from daemon.config.settings import Settings
from daemon.received.today import Insolation, ReceivedToday
from daemon.tracker.budget import UsedBudget, is_ahead_of_schedule
from daemon.tracker.law_answers import checked_kept
from daemon.tracker.phase import ALONE, Phase
from daemon.tracker.pointing import PoseAndTarget, ShadowLaw, ask_law, reading_of
from solar.energy import Drive
from solar.ephemeris import DAY_S
from solar.frames import Angles

log = logging.getLogger("heliocube.received")

# If the times that the two have counted differ by more than this, there is no comparison.
_MOST_TIME_DIFFERENCE_S = 120.0
# A shorter time of light tells nothing.
_LEAST_LIGHT_S = 600.0
_SAVE_EVERY_S = 900.0

_Degrees = Field(default=0.0, ge=0.0, allow_inf_nan=False)
_Moves = Field(default=0, ge=0)


@dataclass(frozen=True, slots=True)
class ActiveTracker:
    """What the tracker itself is doing.

    Attributes
    ----------
    mode
        The mode that it is in.
    pose
        Where it stands; None for not known.
    used
        What its laws have used of the day's budget.
    received
        Its own count of the day.
    mean
        Returns the mean of the readings that its law decides by.
    """

    mode: Mode
    pose: Pose | None
    used: UsedBudget
    received: ReceivedToday
    mean: Callable[[], Irradiances | None]


class Travel(BaseModel):
    """How far [deg, A and B added] and how often the law in the shadow and the active law moved on a solar day.

    `day` is counted from 1970.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    day: int
    travelled_deg: float = _Degrees
    moves: int = _Moves
    active_deg: float = _Degrees
    active_moves: int = _Moves

    def plus(self, *, shadow: tuple[float, int] = (0.0, 0), active: tuple[float, int] = (0.0, 0)) -> "Travel":
        """Return the count with so many degrees and moves more."""
        return Travel(
            day=self.day,
            travelled_deg=self.travelled_deg + shadow[0],
            moves=self.moves + shadow[1],
            active_deg=self.active_deg + active[0],
            active_moves=self.active_moves + active[1],
        )


@dataclass(frozen=True, slots=True)
class ShadowState:
    """The day's count so far.

    Attributes
    ----------
    law
        The one in the shadow.
    failed_why
        Why it has failed, in a sentence, or None.
    received
        By the plane that it would have pointed.
    travel
        Of both laws.
    """

    law: str
    failed_why: str | None
    received: Insolation
    travel: Travel

    def gain_over(self, own: Insolation) -> float:
        """Return the share that it would have received more than the tracker; NaN if the two cannot be compared."""
        alike = own.day == self.received.day and abs(own.known_s - self.received.known_s) <= _MOST_TIME_DIFFERENCE_S
        return self.received.actual_kwh_m2 / own.actual_kwh_m2 - 1.0 if alike and own.actual_kwh_m2 > 0.0 else math.nan


class Shadow:
    """A law that runs beside the one that points.

    Parameters
    ----------
    law
        What is asked.
    settings
        The tracker's.
    received
        Counts what the plane of the law receives.
    folder
        Where the day's travel is kept over a restart.
    publish
        Takes the event of each night.
    utc_s
        The time of construction [s].
    phase
        When its turn is among the trackers of the process.
    """

    def __init__(
        self,
        law: ShadowLaw,
        settings: Settings,
        received: ReceivedToday,
        folder: StateFolder,
        publish: Callable[[Record], None],
        utc_s: float,
        phase: Phase = ALONE,
    ) -> None:
        self._phase = phase
        self._named, self._law_file = law
        self._settings = settings
        self._received = received
        self._publish = publish
        name = law.named.name
        self._file = StateFile(folder, f"shadow-{name}-day.json", Travel, log, f"the day of {name} in the shadow")
        self._travel = self._load() or Travel(day=received.day_of(utc_s))
        self._later_day: Travel | None = None
        self._axes = _SimulatedAxes()
        self._due_s = self._moved_s = self._saved_s = self._heard_s = -math.inf
        self._used_before: UsedBudget | None = None
        self._mode_before = Mode.STARTING
        self._failed_why: str | None = None
        self._failure_told = False

    @property
    def state(self) -> ShadowState:
        """The day's count so far."""
        return ShadowState(self._named.name, self._failed_why, self._received.today, self._travel)

    def relearn(self) -> None:
        """Forget what was learned of the site."""
        try:
            self._named.law.relearn()
            self._keep()
        except Exception as error:  # noqa: BLE001 - it is logged once
            self._fail(error)

    @property
    def albedo(self) -> float | None:
        """What the law has learned of the ground; None where it learns nothing."""
        if self._failed_why is not None:
            return None
        try:
            albedo = getattr(self._named.law.learned, "albedo", None)
            return None if albedo is None else float(albedo)
        except Exception as error:  # noqa: BLE001 - it is logged once
            self._fail(error)
            return None

    def add(self, scan: Scan, active: ActiveTracker, utc_s: float) -> None:
        """Take in a scan that has just arrived at this UTC [s], before the tracker's own count takes it in."""
        if self._failed_why is None:
            try:
                self._add(scan, active, utc_s)
            except Exception as error:  # noqa: BLE001 - it is logged once
                self._fail(error)
        if self._failed_why is not None and not self._failure_told:
            self._failure_told = True
            text = f"the law {self._named.name} in the shadow has failed and is left out until the service is restarted"
            self._publish(Event(utc_s, scan.time_monotonic_s, "shadow", f"{text} ({self._failed_why})"))

    def _fail(self, error: Exception) -> None:
        if self._failed_why is None:
            log.error("the law %s in the shadow has failed", self._named.name, exc_info=error)
            self._failed_why = f"{type(error).__name__}: {error}"

    def _keep(self) -> None:
        self._law_file.save(checked_kept(self._named.law.to_dict()))

    def _add(self, scan: Scan, active: ActiveTracker, utc_s: float) -> None:
        now_s = scan.time_monotonic_s
        if now_s - self._heard_s > self._settings.safety.fallback_after_s:
            # If the tracker moved without readings, no law that decides by readings has moved it.
            self._mode_before = Mode.FALLBACK
        self._heard_s = now_s
        self._turn_day(scan, active, utc_s)
        self._named.law.observe(reading_of(scan, utc_s))
        if active.mode is Mode.TRACKING and active.pose is not None:
            self._axes.go_on(now_s, active.pose)
            if now_s >= self._due_s:
                self._decide(now_s, active.mean(), utc_s)
                next_s = self._phase.next_s(now_s, self._named.law.decide_every_s)
                self._due_s = max(next_s, self._moved_s + self._settings.motion.minimum_interval_s)
        else:
            self._axes.stand(now_s, active.pose)
        self._count_moves(active)
        self._received.add(scan, self._axes.pose(utc_s), utc_s)
        if now_s >= self._saved_s + _SAVE_EVERY_S and self._later_day is None:
            self._saved_s = now_s
            self._file.save(self._travel)

    def _decide(self, now_s: float, mean: Irradiances | None, utc_s: float) -> None:
        law, motion, heading = self._named.law, self._settings.motion, self._axes.heading
        if heading is None:
            return
        whereabouts = PoseAndTarget(self._axes.pose(utc_s), Target(*heading, ""))
        said = ask_law(self._named, mean, whereabouts, utc_s, sun_known=True)
        if not said.worth_moving(heading, motion.deadband_deg):
            return
        there = Angles(said.target.a_deg, said.target.b_deg)
        distance_deg = abs(heading.a_deg - there.a_deg) + abs(heading.b_deg - there.b_deg)
        travel = self._travel
        within = (
            travel.travelled_deg + distance_deg <= motion.travel_per_day_deg
            and travel.moves < motion.moves_per_day
            and not is_ahead_of_schedule(travel.moves, motion, self._settings.site.place(), utc_s)
        )
        if within and law.affords(distance_deg):
            law.book(distance_deg)
            self._keep()
            self._axes.send(there)
            self._moved_s = now_s
            self._travel = travel.plus(shadow=(distance_deg, 1))

    def _count_moves(self, active: ActiveTracker) -> None:
        """Count what the tracker's laws have moved since the last scan; outside of tracking, it counts for both."""
        used, mode = active.used, active.mode
        before, self._used_before = self._used_before, used
        if before is None:
            # The first move of a service that has just begun is often ordered before the first scan gets here.
            before = UsedBudget(day=used.day) if used.moves <= 1 and self._travel.active_moves == 0 else used
        elif before.day != used.day:
            before = UsedBudget(day=used.day)
        alike, self._mode_before = Mode.TRACKING not in (mode, self._mode_before), mode
        # The tracker's own count may begin its day a little later.
        if used == before or used.day != self._travel.day:
            return
        more = (used.travelled_deg - before.travelled_deg, used.moves - before.moves)
        self._travel = self._travel.plus(active=more, shadow=more if alike else (0.0, 0))

    def _turn_day(self, scan: Scan, active: ActiveTracker, utc_s: float) -> None:
        """Report the day that has ended, and begin the next."""
        if self._named.law.turn(utc_s):
            self._keep()
        day = self._received.day_of(utc_s)
        if day == self._travel.day:
            return
        told = self._day_report(active.received.today) if day > self._travel.day else None
        if told:
            log.info("%s", told)
            self._publish(Event(utc_s, scan.time_monotonic_s, "shadow", told))
        self._travel, self._later_day = roll_over_day(day, self._travel, self._later_day, Travel(day=day))
        # So that the new day is saved with the next scan.
        self._saved_s = -math.inf

    def _day_report(self, own: Insolation) -> str | None:
        state = self.state
        other, travel = state.received, state.travel
        if not own.day == other.day == travel.day or max(own.known_s, other.known_s) < _LEAST_LIGHT_S:
            return None
        # After an outage the day that has ended is not always the day before.
        more, date = state.gain_over(own), iso_utc(own.day * DAY_S)[:10]
        if math.isnan(more):
            return f"{state.law} in the shadow has not seen the whole of {date}: no comparison"
        return (
            f"on {date} {state.law} in the shadow would have received {other.actual_kwh_m2:.3f} kWh/m2"
            f" where {self._settings.law.driver} received {own.actual_kwh_m2:.3f} ({100.0 * more:+z.1f} %), with"
            f" {travel.travelled_deg:.0f} deg of travel in {travel.moves} moves instead of {travel.active_deg:.0f} deg"
            f" in {travel.active_moves}; a model's result from {other.known_s / 3600.0:.1f} h of readings"
        )

    def _load(self) -> Travel | None:
        try:
            return self._file.load()
        except UnreadableStateError as error:
            log.warning("%s: the moves of the law in the shadow are counted from zero again", error)
            return None


class _SimulatedAxes:
    """Where a tracker would stand: A turns first, then B, at the speed that the studies reckon with."""

    def __init__(self) -> None:
        self._here: Angles | None = None
        self._aim: Angles | None = None
        self._time_s = 0.0

    @property
    def heading(self) -> Angles | None:
        """Where they will stand if nothing else is ordered."""
        return self._aim or self._here

    def pose(self, utc_s: float) -> Pose | None:
        """Return where they stand; None for not known."""
        if self._here is None:
            return None
        moving = self._aim not in (None, self._here)
        return Pose(utc_s, self._time_s, *self._here, moving=moving)

    def stand(self, now_s: float, pose: Pose | None) -> None:
        """Stand where the tracker stands."""
        self._here = None if pose is None else Angles(pose.a_deg, pose.b_deg)
        self._aim, self._time_s = None, now_s

    def send(self, there: Angles) -> None:
        """Set out."""
        self._aim = there

    def go_on(self, now_s: float, pose: Pose) -> None:
        """Move until now; begin where the tracker stands if the place was not known."""
        if self._here is None:
            self.stand(now_s, pose)
        elif self._aim is not None:
            left_deg = Drive().speed_deg_per_s * (now_s - self._time_s)
            a_deg = _towards(self._here.a_deg, self._aim.a_deg, left_deg)
            left_deg -= abs(a_deg - self._here.a_deg)
            self._here = Angles(a_deg, _towards(self._here.b_deg, self._aim.b_deg, left_deg))
        self._time_s = now_s


def _towards(here: float, there: float, most: float) -> float:
    return here + math.copysign(min(abs(there - here), most), there - here)
