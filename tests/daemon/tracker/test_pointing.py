"""The laws as the service calls them: with the settings' parameters and the ephemeris."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from daemon.base.errors import UserError
from daemon.base.plugins import LAWS, load, names
from daemon.base.records import FaceReading, Irradiances, Quality, Scan, Target
from daemon.base.state import StateFolder
from daemon.config.settings import Settings
from daemon.tracker import pointing
from daemon.tracker.law_file import LawFile
from solar.ephemeris import Site, sun_position
from solar.frames import Angles, Limits, azimuth_from_direction, direction_from_azimuth
from solar.laws.flat import FlatLaw, FlatSettings
from solar.laws.law import Aim, Moment, Reading, TrackerFacts
from solar.laws.paper import sun_vector

NOON = datetime(2022, 10, 12, 11, 50, tzinfo=UTC).timestamp()
JUNE_MORNING = datetime(2022, 6, 21, 5, 0, tzinfo=UTC).timestamp()
SITE = Site(48.717607, 2.209002, 156.0)


def built(name, **settings):
    module = load(LAWS, name)
    return module.build(module.SETTINGS(**settings), TrackerFacts(SITE, Limits(), 5.0, 300.0, NOON))


def aim(name, faces, utc_s=NOON, *, sun_known=True, **settings):
    mean = None if faces is None else Irradiances(*faces, 1.0)
    return pointing.aim(built(name, **settings), mean, None, utc_s, sun_known=sun_known)


@pytest.mark.parametrize("name", names(LAWS))
def test_every_law_answers_before_any_reading_with_a_target_or_the_reason_why_it_stays(name):
    says = aim(name, None)
    assert says.target is None or Limits().contain(*says.target)
    assert says.target is not None or says.why


def test_sun_vector_uses_the_albedo_of_the_settings():
    faces = (100.0, 500.0, 100.0, 450.0)
    angles = [aim("sun-vector", faces, albedo=albedo).target.b_deg for albedo in (0.0, 0.2, 0.6)]
    up = [450 - 200 + albedo * 450 for albedo in (0.0, 0.2, 0.6)]
    assert angles == pytest.approx([np.degrees(np.arctan2(z, 400)) for z in up])


@pytest.mark.parametrize("law", ["mu-prime", "sun-vector"])
def test_mu_prime_and_sun_vector_use_the_uniform_threshold_of_the_settings(law):
    faces = (200.0, 240.0, 200.0, 420.0)
    sure = {"gain_uncertainty": 0.0} if law == "sun-vector" else {}
    found = [aim(law, faces, uniform_threshold=share, **sure).target.b_deg for share in (0.0, 0.05, 0.2, 0.5)]
    assert found[0] == found[1] < 90.0
    assert found[2] == found[3] == 90.0


def test_sun_vector_uses_the_gain_uncertainty_of_the_settings():
    faces = (200.0, 240.0, 200.0, 420.0)
    assert aim("sun-vector", faces, gain_uncertainty=0.0).target.b_deg < 90.0
    assert aim("sun-vector", faces, gain_uncertainty=0.2).target.b_deg == 90.0


def beyond_the_east_west_plane():
    """Return the faces of a June morning, with the sun in the north-east, and its azimuth."""
    sun = sun_position(JUNE_MORNING, *SITE)
    south, east, up = direction_from_azimuth(sun.azimuth_deg, sun.elevation_deg, SITE.latitude_deg)
    assert south < 0
    return (600 * east + 40.0, 40.0, 40.0, 600 * up + 60.0), sun.azimuth_deg


def test_sun_vector_gives_the_azimuth_of_the_ephemeris_while_the_sun_is_in_the_north_east():
    faces, azimuth = beyond_the_east_west_plane()
    assert azimuth < 90
    assert aim("sun-vector", faces, JUNE_MORNING).azimuth_deg == pytest.approx(azimuth, abs=0.5)


def test_with_the_clock_in_doubt_the_laws_do_not_use_the_ephemeris():
    faces, _ = beyond_the_east_west_plane()
    seen, _ = azimuth_from_direction(sun_vector(faces), SITE.latitude_deg)
    assert aim("sun-vector", faces, JUNE_MORNING, sun_known=False).azimuth_deg == pytest.approx(float(seen)) == 90.0
    assert aim("chronometric", None, sun_known=False).target is None
    assert aim("chronometric", None).target is not None
    for law in ("mu-prime", "flat"):
        known, unknown = (aim(law, (100.0, 500.0, 100.0, 450.0), sun_known=known).target for known in (True, False))
        assert known == unknown


def test_mu_prime_and_sun_vector_give_no_target_without_a_mean_of_the_faces():
    assert aim("mu-prime", None).target is None
    assert aim("sun-vector", None).target is None


def test_the_law_and_the_fallback_law_backtrack_out_of_the_shade_of_the_trackers_in_rows():
    group = {"east_m": (0.0, 5.0), "north_m": (0.0, 0.0), "module_width_m": 2.0, "module_height_m": 2.0}
    group["turn_back"] = "always"
    low = datetime(2022, 9, 23, 6, 0, tzinfo=UTC).timestamp()
    alone, among = (
        pointing.build_pointing(Settings(law={"driver": "chronometric"}, rows=rows), low, StateFolder(None))
        for rows in ({}, group)
    )
    for before, after in ((alone.law, among.law), (alone.fallback.law, among.fallback.law)):
        targets = [pointing.aim(law, None, None, low).target for law in (before, after)]
        assert targets[0].a_deg == pytest.approx(-50.0)
        assert targets[1].a_deg > -40.0


class Noting(FlatLaw):
    """A law that notes what it is given, and fails if a test wants it to."""

    faces_needed = 2
    needs_sun = True

    def __init__(self, facts):
        super().__init__(FlatSettings(), facts)
        self.told, self.fails = [], False

    def _note(self, *what):
        if self.fails:
            raise RuntimeError("no such sky")
        self.told.append(what)

    def observe(self, reading):
        self._note("observe", reading)

    def turn(self, utc_s):
        self._note("turn", utc_s)
        return utc_s > NOON

    def affords(self, distance_deg):
        self._note("affords", distance_deg)
        return False

    def book(self, distance_deg):
        self._note("book", distance_deg)

    def relearn(self):
        self._note("relearn")

    def to_dict(self):
        return {"notes": len(self.told)}


def noting(folder=None):
    facts = TrackerFacts(SITE, Limits(), 5.0, 300.0, NOON)
    law, flat = Noting(facts), FlatLaw(FlatSettings(), facts)
    flat.decide_every_s = 60.0
    file = LawFile(StateFolder(folder))
    return pointing.Pointing(pointing.NamedLaw("noting", law), pointing.NamedLaw("flat", flat), file), law


def scan():
    good, bad = (FaceReading(100.0, quality, 0.0, 7.0) for quality in (Quality.OK, Quality.IMPLAUSIBLE))
    return Scan("cube", "s", 0, NOON - 1.0, 7.0, good, bad, good, good)


def test_a_law_receives_scans_days_moves_and_relearn_and_its_learned_values_are_kept(tmp_path):
    points, law = noting(tmp_path)
    points.receive(scan(), NOON)
    ((name, reading),) = law.told
    assert (name, reading[:2]) == ("observe", Reading(NOON, 7.0, ())[:2])
    assert reading.faces_w_m2 == pytest.approx((100.0, np.nan, 100.0, 100.0), nan_ok=True)
    assert not points.law.affords(3.0)
    assert LawFile(StateFolder(tmp_path)).load() is None
    points.begin_day_if_due(NOON)
    assert LawFile(StateFolder(tmp_path)).load() is None, "no new day"
    for count, (call, told) in enumerate(
        ((points.begin_day_if_due, ("turn", NOON + 1.0)), (points.book, ("book", 3.0)), (points.relearn, ("relearn",))),
        4,
    ):
        call(*told[1:])
        assert law.told[-1] == told
        assert LawFile(StateFolder(tmp_path)).load() == {"notes": count}


def test_once_a_law_has_failed_the_fallback_law_answers_with_its_own_needs():
    points, law = noting()
    assert (points.chosen.name, points.law.faces_needed, points.law.needs_sun) == ("noting", 2, True)
    assert (points.law.decide_every_s, points.failed_why) == (300.0, None)
    law.fails = True
    assert points.law.affords(3.0), "the other one has no plan of the day"
    assert points.failed_why == "the law noting has failed (RuntimeError: no such sky), and flat points instead"
    law.fails = False
    points.book(3.0)
    assert law.told == [], "it is not asked again"
    assert (points.chosen.name, points.law.faces_needed, points.law.needs_sun) == ("flat", 3, False)
    assert points.law.decide_every_s == 60.0


def answering(monkeypatch, **answers):
    """Return the pointing by a law that gives these answers; a dict changes fields of the answer of `aim`."""
    points, law = noting()
    said = law.aim(Moment(NOON, None, None))
    for name, answer in answers.items():
        answer = replace(said, **answer) if name == "aim" and isinstance(answer, dict) else answer
        monkeypatch.setattr(law, name, lambda *_, answer=answer: answer)
    return points


@pytest.mark.parametrize(("answer", "words"), [
    (
        {"target": Angles(np.nan, 60.0)},
        "ValueError: its target is A nan, B 60 deg: a law without a target answers None",
    ),
    ({"target": Angles(np.zeros(2), np.zeros(2))}, "TypeError: "),
    ({"target": 60.0}, "TypeError: its target is 60.0, not Angles"),
    ({"target": (1.0, 2.0, 3.0)}, "TypeError: its target is .*, not Angles"),
    ({"azimuth_deg": None}, "TypeError: "),
    ({"sun": None}, "TypeError: the sun of its Aim is None, not a SunPosition"),
    (Angles(0.0, 60.0), "TypeError: Angles is not an Aim"),
    (None, "TypeError: NoneType is not an Aim"),
])  # fmt: skip
def test_a_law_with_an_invalid_answer_counts_as_failed_and_the_fallback_law_points(monkeypatch, answer, words):
    points = answering(monkeypatch, aim=answer)
    said = pointing.ask_law(points.chosen, None, pointing.PoseAndTarget(None, None), NOON, sun_known=True)
    assert (said.target.a_deg, said.target.b_deg) == (0.0, 90.0)
    assert re.search(rf"the law noting has failed \({words}", points.failed_why)


def test_an_answer_of_a_law_in_numpy_numbers_is_converted_to_floats_and_cut_to_the_limits(monkeypatch):
    beyond = Angles(np.float32(300.0), np.float32(60.5))
    points = answering(monkeypatch, aim={"target": beyond, "azimuth_deg": np.float32(180.0), "albedo": np.array(0.25)})
    said = pointing.ask_law(points.chosen, None, pointing.PoseAndTarget(None, None), NOON, sun_known=True)
    assert (said.target.a_deg, said.target.b_deg) == (Limits().a_max_deg, 60.5)
    numbers = (said.target.a_deg, said.target.b_deg, said.aim.azimuth_deg, said.aim.albedo)
    assert [type(number) for number in numbers] == [float] * 4
    assert points.failed_why is None


@pytest.mark.parametrize(("kept", "words"), [
    ([1], r"TypeError: what it wants to keep is \[1\], not a mapping"),
    ({"days": {1}}, "TypeError: "),
])  # fmt: skip
def test_a_law_whose_values_to_keep_cannot_be_written_to_a_file_counts_as_failed(monkeypatch, tmp_path, kept, words):
    points = answering(monkeypatch, to_dict=kept)
    points.book(3.0)
    assert re.search(words, points.failed_why)


def test_the_values_that_a_law_keeps_or_shows_may_be_numpy_numbers(monkeypatch, tmp_path):
    points, law = noting(tmp_path)
    monkeypatch.setattr(law, "to_dict", lambda: {"albedo": np.float32(0.25)})
    monkeypatch.setattr(law, "shown", lambda: {"learned": {"albedo": np.float32(0.25)}})
    points.book(3.0)
    assert LawFile(StateFolder(tmp_path)).load() == {"albedo": 0.25}
    assert json.dumps(points.law.shown()) == '{"learned": {"albedo": 0.25}}'
    assert points.failed_why is None


def test_a_law_that_answers_a_yes_or_no_question_with_an_array_counts_as_failed(monkeypatch):
    points = answering(monkeypatch, affords=np.array([True, False]))
    assert points.law.affords(3.0) is True
    assert points.failed_why is not None


@pytest.mark.parametrize(("target", "heading", "worth"), [
    ((0.0, 84.0), (0.0, 90.0), True),
    ((0.0, 86.0), (0.0, 90.0), False),
    ((np.nan, np.nan), (0.0, 90.0), True),
    ((0.0, 60.0), None, False),
    (None, (0.0, 90.0), False),
])  # fmt: skip
def test_a_move_is_worth_making_beyond_the_deadband_if_the_law_has_a_target_and_the_pose_is_known(
    target, heading, worth
):
    sun = sun_position(NOON, *SITE)
    to = None if target is None else Angles(*target)
    said = pointing.LawAnswer(Aim(0.0, 0.0, sun, to), Target(*(target or (0.0, 60.0)), "why"))
    assert said.worth_moving(None if heading is None else Angles(*heading), 5.0) is worth


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: None, "the law flat cannot be built: TypeError: .* takes 0 positional arguments but 2 were given"),
        (lambda _settings, _tracker: None, "what the law flat builds is not a law but None"),
    ],
)
def test_a_law_that_cannot_be_built_is_refused_in_a_sentence(monkeypatch, build, words):
    monkeypatch.setattr(load(LAWS, "flat"), "build", build)
    with pytest.raises(UserError, match=words):
        pointing.build_pointing(Settings(law={"driver": "flat"}), NOON, StateFolder(None))


@pytest.mark.parametrize(("name", "value", "words"), [
    ("faces_needed", 0, "asks for 0 good faces, not for 1 to 4"),
    ("faces_needed", 5, "asks for 5 good faces, not for 1 to 4"),
    ("decide_every_s", 0.0, "asks for a decision every 0 s"),
    ("decide_every_s", np.inf, "asks for a decision every inf s"),
    ("faces_needed", 1, None), ("faces_needed", 4, None), ("decide_every_s", 0.5, None),
])  # fmt: skip
def test_a_law_is_refused_unless_it_needs_1_to_4_faces_and_decides_at_a_finite_positive_interval(
    monkeypatch, name, value, words
):
    # A value of the law's own takes precedence over what it is given.
    monkeypatch.setattr(FlatLaw, name, property(lambda _law: value, lambda *_: None), raising=False)
    settings = Settings(law={"driver": "flat"})
    if words is None:
        assert getattr(pointing.build_pointing(settings, NOON, StateFolder(None)).law, name) == value
    else:
        with pytest.raises(UserError, match=words):
            pointing.build_pointing(settings, NOON, StateFolder(None))
