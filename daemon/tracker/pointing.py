"""The law of the configuration, and the one that needs no readings: fed by scans, asked by control."""

import copy
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from daemon.base import plugins
from daemon.base.errors import UserError
from daemon.base.records import FACES, Irradiances, Pose, Quality, Scan, Target
from daemon.base.state import StateFolder
from daemon.config.plugin_sections import FALLBACK_LAW, LAW
from daemon.config.settings import Settings
from daemon.tracker.law_answers import checked_kept, checked_shown
from daemon.tracker.law_file import LawFile
from daemon.tracker.readings import SharedCache
from solar.frames import Angles, Array, normal_from_angles, separation_deg
from solar.laws.answers import checked_aim
from solar.laws.law import Aim, Estimates, Faces, Law, Moment, Reading, TrackerFacts

log = logging.getLogger("heliocube.control")

Answer = TypeVar("Answer")


class NamedLaw(NamedTuple):
    """A law and what the configuration calls it."""

    name: str
    law: Law


@dataclass(frozen=True, slots=True)
class PoseAndTarget:
    """Where a tracker stands (None: not known), and where it is on its way to (None: nowhere)."""

    pose: Pose | None
    target: Target | None

    @property
    def heading(self) -> Angles | None:
        """Where the tracker will be if nothing else is ordered."""
        whence = self.target or self.pose
        return Angles(whence.a_deg, whence.b_deg) if whence else None


class LawAnswer(NamedTuple):
    """What a law says, and where the tracker is to be by it: where it stands already if the law gives no target."""

    aim: Aim
    target: Target

    def worth_moving(self, heading: Angles | None, deadband_deg: float) -> bool:
        """Return whether the target is far enough from where the tracker stands or is already heading."""
        if self.aim.target is None or heading is None:
            return False
        there = normal_from_angles(self.target.a_deg, self.target.b_deg)
        apart_deg = separation_deg(normal_from_angles(*heading), there)
        return bool(np.isnan(apart_deg) or apart_deg >= deadband_deg)


@dataclass(frozen=True, slots=True)
class DecisionPreview:
    """What the next decision would be, were the light to stay as it is.

    Attributes
    ----------
    law
        The law that will decide.
    target
        Where the tracker would be then: where it stands already if the law gives no target.
    moves
        Whether the target would be worth a move that need not wait for a later time of the day. The day's budget may
        be used up all the same.
    """

    law: str
    target: Target
    moves: bool


class GuardedLaw(Law):
    """A law whose failure stops neither its tracker nor others: from then on another law answers in its place.

    Parameters
    ----------
    named
        The law, which anybody may have written.
    other
        Answers in its place once it has raised an error or given an invalid answer.

    Attributes
    ----------
    failed_why
        What has happened, in a sentence, or None.
    """

    def __init__(self, named: NamedLaw, other: NamedLaw) -> None:
        self._primary = named
        self._substitute = other
        self.failed_why: str | None = None
        self._adopt_attributes(named.law)

    @property
    def name(self) -> str:
        """Name of the law that answers."""
        return (self._primary if self.failed_why is None else self._substitute).name

    def __deepcopy__(self, memo: dict[int, Any]) -> Law:
        """Return a copy of the law that answers, for questions that are to leave no trace."""
        return copy.deepcopy((self._primary if self.failed_why is None else self._substitute).law, memo)

    def aim(self, now: Moment) -> Aim:
        """Return where the law wants to point."""
        return self._ask(lambda law: checked_aim(law.aim(now), law.limits))

    @property
    def learned(self) -> Any:
        """What was learned of the site."""
        return self._ask(lambda law: law.learned)

    def observe(self, reading: Reading) -> None:
        """Take in a scan that has just arrived."""
        self._ask(lambda law: law.observe(reading))

    def turn(self, utc_s: float) -> bool:
        """Look whether a new day has begun since the last call."""
        return self._ask(lambda law: bool(law.turn(utc_s)))

    def affords(self, distance_deg: float) -> bool:
        """Whether one more move of this length stays within the law's own plan of the day."""
        return self._ask(lambda law: bool(law.affords(distance_deg)))

    def book(self, distance_deg: float) -> None:
        """Take a move that was ordered out of the plan of the day."""
        self._ask(lambda law: law.book(distance_deg))

    def believes_zenith(self, faces_w_m2: Faces, utc_s: float) -> bool:
        """Whether the zenith face of a mean can be believed."""
        return self._ask(lambda law: bool(law.believes_zenith(faces_w_m2, utc_s)))

    def relearn(self) -> None:
        """Forget what was learned of the site."""
        self._ask(lambda law: law.relearn())

    def to_dict(self) -> dict[str, Any] | None:
        """Return what a later run needs to go on from here."""
        return self._ask(lambda law: checked_kept(law.to_dict()))

    def shown(self) -> dict[str, dict[str, float]]:
        """Return what a person may want to see of it."""
        return self._ask(lambda law: checked_shown(law.shown()))

    def estimates(self, faces: Array, sun: Array, learned: Any) -> Estimates:
        """Return what the faces show, given what was learned."""
        return self._ask(lambda law: law.estimates(faces, sun, learned))

    def _ask(self, question: Callable[[Law], Answer]) -> Answer:
        if self.failed_why is None:
            try:
                return question(self._primary.law)
            except Exception as error:
                log.exception("the law %s has failed", self._primary.name)
                why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
                self.failed_why = (
                    f"the law {self._primary.name} has failed ({why}), and {self._substitute.name} points instead"
                )
                self._adopt_attributes(self._substitute.law)
        return question(self._substitute.law)

    def _adopt_attributes(self, law: Law) -> None:
        self.site, self.limits = law.site, law.limits
        self.faces_needed, self.needs_sun, self.decide_every_s = law.faces_needed, law.needs_sun, law.decide_every_s


class ShadowLaw(NamedTuple):
    """A law that points nothing, and where it keeps what it has learned."""

    named: NamedLaw
    file: LawFile


class Pointing:
    """The laws that point one tracker.

    Parameters
    ----------
    chosen
        The law of the configuration.
    fallback
        The law for times without good readings.
    file
        Keeps what the chosen law wants to remember.
    """

    def __init__(self, chosen: NamedLaw, fallback: NamedLaw, file: LawFile) -> None:
        self._guarded = GuardedLaw(chosen, fallback)
        self.fallback = fallback
        self._file = file

    @property
    def law(self) -> Law:
        """The law of the configuration, or the one that answers in its place once it has failed."""
        return self._guarded

    @property
    def chosen(self) -> NamedLaw:
        """`law`, with the name of the law that answers."""
        return NamedLaw(self._guarded.name, self._guarded)

    @property
    def failed_why(self) -> str | None:
        """Why the law of the configuration has failed, in a sentence, or None."""
        return self._guarded.failed_why

    def receive(self, scan: Scan, utc_s: float) -> None:
        """Hand a scan that has just arrived to the law."""
        self.law.observe(reading_of(scan, utc_s))

    def begin_day_if_due(self, utc_s: float) -> None:
        """Let the law begin a new day when it is time."""
        if self.law.turn(utc_s):
            self._save()

    def book(self, distance_deg: float) -> None:
        """Take a move that was ordered out of the law's plan of the day, and note that on disk."""
        self.law.book(distance_deg)
        self._save()

    def relearn(self) -> None:
        """Forget what was learned of the site."""
        self.law.relearn()
        self._save()

    def _save(self) -> None:
        self._file.save(self.law.to_dict())


def reading_of(scan: Scan, utc_s: float) -> Reading:
    """Return what laws are told of a scan that has come at this UTC [s]."""
    east, south, west, zenith = (
        face.irradiance_w_m2 if face.quality is Quality.OK else math.nan for face in scan.faces
    )
    return Reading(utc_s, scan.time_monotonic_s, (east, south, west, zenith))


def ask_law(
    chosen: NamedLaw, mean: Irradiances | None, whereabouts: PoseAndTarget, utc_s: float, *, sun_known: bool
) -> LawAnswer:
    """Ask a law where the tracker is to be, by the window's mean at this UTC [s]."""
    answer = aim(chosen.law, mean, whereabouts.heading, utc_s, sun_known=sun_known)
    if chosen.law.needs_sun and not sun_known:
        why = "the clock was set: the sun's position is in doubt"
        return LawAnswer(replace(answer, target=None), _target_to_stay(whereabouts.pose, why))
    # The law may have failed at this very question, and another one answered.
    name = chosen.law.name if isinstance(chosen.law, GuardedLaw) else chosen.name
    why = f"{name}: {answer.why}" if answer.why else name
    if answer.target is None:
        return LawAnswer(answer, _target_to_stay(whereabouts.pose, why))
    return LawAnswer(answer, Target(answer.target.a_deg, answer.target.b_deg, why))


def preview_decision(
    chosen: NamedLaw,
    mean: Irradiances | None,
    whereabouts: PoseAndTarget,
    utc_s: float,
    deadband_deg: float,
    *,
    sun_known: bool,
    may_move: bool,
) -> DecisionPreview | None:
    """Return what a law would say at a later UTC [s] by the present readings; None where it cannot be asked.

    Without `may_move` no move is foreseen. A copy of the law is asked: a look ahead must not change what the law
    remembers.
    """
    try:
        asked = NamedLaw(chosen.name, copy.deepcopy(chosen.law))
        answer = ask_law(asked, mean, whereabouts, utc_s, sun_known=sun_known)
    except Exception:
        log.debug("the law %s cannot be asked ahead", chosen.name, exc_info=True)
        return None
    return DecisionPreview(
        chosen.name, answer.target, may_move and answer.worth_moving(whereabouts.heading, deadband_deg)
    )


def _target_to_stay(pose: Pose | None, why: str) -> Target:
    return Target(pose.a_deg, pose.b_deg, why) if pose else Target(math.nan, math.nan, why)


def aim(law: Law, mean: Irradiances | None, heading: Angles | None, utc_s: float, *, sun_known: bool = True) -> Aim:
    """Ask a law where to point by the window's mean at this UTC [s]."""
    faces = None
    if mean is not None:
        east, south, west, zenith = (getattr(mean, f"{face}_w_m2") for face in FACES)
        faces = (east, south, west, zenith)
    return checked_aim(law.aim(Moment(utc_s, faces, heading, sun_known)), law.limits)


def build_pointing(
    settings: Settings, utc_s: float, folder: StateFolder, common: SharedCache | None = None
) -> Pointing:
    """Build the law of the settings and its fallback; raises `UserError` for a law that cannot be used."""
    file = LawFile(folder)
    tracker = _tracker_facts(settings, utc_s, file, common)
    fallback = plugins.load(plugins.LAWS, FALLBACK_LAW)
    return Pointing(
        NamedLaw(settings.law.driver, _checked(_build(settings, tracker, file), settings.law.driver)),
        NamedLaw(FALLBACK_LAW, cast("Law", fallback.build(fallback.SETTINGS(), replace(tracker, kept=None)))),
        file,
    )


def build_shadow(settings: Settings, utc_s: float, folder: StateFolder, common: SharedCache | None = None) -> ShadowLaw:
    """Build the law of `law.shadow` with its parameters in the configuration; raises `UserError` if that fails."""
    name = settings.law.shadow
    file = LawFile(folder, f"shadow-{name}-learned.json")
    beside = settings.model_copy(update={"law": LAW.with_driver(settings.law, name)})
    law = _build(beside, _tracker_facts(settings, utc_s, file, common), file)
    return ShadowLaw(NamedLaw(name, _checked(law, name, "law.shadow")), file)


def _tracker_facts(settings: Settings, utc_s: float, file: LawFile, common: SharedCache | None) -> TrackerFacts:
    return TrackerFacts(
        site=settings.site.place(),
        limits=settings.limits.limits(),
        scan_every_s=settings.cube.scan_every_s,
        decide_every_s=settings.windows.decide_every_s,
        utc_s=utc_s,
        kept=file.load(),
        common=(common or SharedCache()).laws,
        group=settings.rows.group(settings.site.latitude_deg),
    )


def _checked(law: Law, name: str, key: str = "law.driver") -> Law:
    """Return the law; `UserError` if it is no law, or asks for an impossible number of faces or interval."""
    if not hasattr(law, "faces_needed"):
        raise UserError(f"{key}: what the law {name} builds is not a law but {law!r}")
    if not 1 <= law.faces_needed <= len(FACES):
        raise UserError(f"{key}: the law {name} asks for {law.faces_needed} good faces, not for 1 to {len(FACES)}")
    if not 0.0 < law.decide_every_s < math.inf:
        raise UserError(f"{key}: the law {name} asks for a decision every {law.decide_every_s:g} s")
    return law


def _build(settings: Settings, tracker: TrackerFacts, file: LawFile) -> Law:
    name = settings.law.driver
    module = plugins.load(plugins.LAWS, name)
    try:
        if tracker.kept is not None:
            try:
                return cast("Law", module.build(settings.law, tracker))
            except ValueError:
                file.refuse()
        return cast("Law", module.build(settings.law, replace(tracker, kept=None)))
    except Exception as error:
        raise UserError(f"the law {name} cannot be built: {type(error).__name__}: {error}") from error
