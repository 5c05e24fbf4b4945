"""The law of the configuration, and the one that needs no readings: fed by scans, asked by control."""

import copy
import logging
import math
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

import numpy as np

from daemon.base import plugins
from daemon.base.errors import UserError
from daemon.base.files import StateFolder
from daemon.base.records import FACES, Irradiances, Pose, Quality, Scan, Target
from daemon.config.plugged import FALLBACK_LAW
from daemon.config.settings import Settings
from daemon.tracker.law_file import LawFile
from solar.frames import Angles, normal_from_angles, separation_deg
from solar.laws.law import Aim, Law, Moment, Reading, TrackerFacts

log = logging.getLogger("heliocube.control")


class NamedLaw(NamedTuple):
    """A law and what the configuration calls it."""

    name: str
    law: Law


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """Where a tracker stands, and where it is on its way to; None for what is not known or not so."""

    pose: Pose | None
    target: Target | None

    @property
    def heading(self) -> Angles | None:
        """Where it will be when nothing else is ordered."""
        whence = self.target or self.pose
        return Angles(whence.a_deg, whence.b_deg) if whence else None


class LawAnswer(NamedTuple):
    """What a law says, and where the tracker is to be by that: where it stands, without a target of the law's."""

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
class Foresight:
    """What the next decision would be, were the light to stay as it is.

    Attributes
    ----------
    law
        Which will decide.
    target
        Where the tracker would be then: where it stands, without a target of the law's.
    moves
        Whether that would be worth a move; the budget of the day may still say no.
    """

    law: str
    target: Target
    moves: bool


class Pointing:
    """What points one tracker.

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
        self.chosen = chosen
        self.fallback = fallback
        self._file = file

    @property
    def law(self) -> Law:
        """The law of the configuration."""
        return self.chosen.law

    def receive(self, scan: Scan, utc_s: float) -> None:
        """Hand a scan that has just arrived to the law."""
        east, south, west, zenith = (
            face.irradiance_w_m2 if face.quality is Quality.OK else math.nan for face in scan.faces
        )
        self.law.observe(Reading(utc_s, scan.time_monotonic_s, (east, south, west, zenith)))

    def turn(self, utc_s: float) -> None:
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


def ask(
    chosen: NamedLaw, mean: Irradiances | None, whereabouts: Whereabouts, utc_s: float, *, sun_known: bool
) -> LawAnswer:
    """Ask a law where the tracker is to be, by the window's mean at this UTC [s]."""
    answer = aim(chosen.law, mean, whereabouts.heading, utc_s, sun_known=sun_known)
    if chosen.law.needs_sun and not sun_known:
        why = "the clock was set a short while ago: the sun's position is in doubt"
        return LawAnswer(replace(answer, target=None), _standing(whereabouts.pose, why))
    why = f"{chosen.name}: {answer.why}" if answer.why else chosen.name
    if answer.target is None:
        return LawAnswer(answer, _standing(whereabouts.pose, why))
    return LawAnswer(answer, Target(answer.target.a_deg, answer.target.b_deg, why))


def foresee(
    chosen: NamedLaw,
    mean: Irradiances | None,
    whereabouts: Whereabouts,
    utc_s: float,
    deadband_deg: float,
    *,
    sun_known: bool,
) -> Foresight | None:
    """Return what a law would say at a later instant, UTC [s], by the readings of now; None where it cannot be asked.

    The question goes to a copy: whether anybody looks must not change what the law remembers.
    """
    try:
        asked = NamedLaw(chosen.name, copy.deepcopy(chosen.law))
        answer = ask(asked, mean, whereabouts, utc_s, sun_known=sun_known)
    except Exception:
        log.debug("the law %s cannot be asked ahead", chosen.name, exc_info=True)
        return None
    return Foresight(chosen.name, answer.target, answer.worth_moving(whereabouts.heading, deadband_deg))


def _standing(pose: Pose | None, why: str) -> Target:
    return Target(pose.a_deg, pose.b_deg, why) if pose else Target(math.nan, math.nan, why)


def aim(law: Law, mean: Irradiances | None, heading: Angles | None, utc_s: float, *, sun_known: bool = True) -> Aim:
    """Ask a law where to point by the window's mean at this UTC [s]."""
    faces = None
    if mean is not None:
        east, south, west, zenith = (getattr(mean, f"{face}_w_m2") for face in FACES)
        faces = (east, south, west, zenith)
    return law.aim(Moment(utc_s, faces, heading, sun_known))


def build_pointing(settings: Settings, utc_s: float, folder: StateFolder) -> Pointing:
    """Build the law of the settings and its fallback; raises `UserError` for a law that cannot be used."""
    file = LawFile(folder)
    tracker = TrackerFacts(
        site=settings.site.place(),
        limits=settings.limits.limits(),
        scan_every_s=settings.cube.scan_every_s,
        decide_every_s=settings.windows.decide_every_s,
        utc_s=utc_s,
        kept=file.load(),
        group=settings.rows.group(settings.site.latitude_deg),
    )
    fallback = plugins.load(plugins.LAWS, FALLBACK_LAW)
    return Pointing(
        NamedLaw(settings.law.driver, _checked(_build(settings, tracker, file), settings.law.driver)),
        NamedLaw(FALLBACK_LAW, cast("Law", fallback.build(fallback.SETTINGS(), replace(tracker, kept=None)))),
        file,
    )


def _checked(law: Law, name: str) -> Law:
    """Return the law; `UserError` for one that asks for what there is not."""
    if not 1 <= law.faces_needed <= len(FACES):
        raise UserError(f"law.driver: the law {name} asks for {law.faces_needed} good faces, not for 1 to {len(FACES)}")
    if not 0.0 < law.decide_every_s < math.inf:
        raise UserError(f"law.driver: the law {name} asks for a decision every {law.decide_every_s:g} s")
    return law


def _build(settings: Settings, tracker: TrackerFacts, file: LawFile) -> Law:
    module = plugins.load(plugins.LAWS, settings.law.driver)
    if tracker.kept is not None:
        try:
            return cast("Law", module.build(settings.law, tracker))
        except ValueError:
            file.refuse()
    return cast("Law", module.build(settings.law, replace(tracker, kept=None)))
