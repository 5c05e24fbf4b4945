"""Results that the laws of several trackers have in common are computed once, and no law's answer depends on that."""

import gc
import math
from weakref import WeakValueDictionary, ref

import numpy as np
import pytest

from solar.ephemeris import DAY_S, Site, solar_days, sun_direction
from solar.frames import Angles, Limits
from solar.laws.history import PartialMean, ReadingHistory
from solar.laws.law import Moment, Reading, TrackerFacts
from solar.laws.memory import LightMemory, OptimalSettings
from solar.laws.optimal_live import SETTINGS, LiveOptimal
from solar.skies.sky import sky

SITE = Site(48.7176, 2.2090, 156.0)
NORMALS = np.array([[0.0, 1, 0], [1, 0, 0], [0, -1, 0], [0, 0, 1]])
BEGIN_UTC_S = 1665741600.0
EVERY_S, A_MINUTE, AN_HOUR = 5.0, 12, 720
PLACES = {0: 0, 1: 5, 2: 7, 3: 11}
"""At which scan of a minute each tracker decides."""


def day_of_scans(begin_utc_s, seed):
    """Return an hour and a half of scans under a beam that comes and goes; now and then a face is dead."""
    random = np.random.default_rng(seed)
    utc_s = begin_utc_s + EVERY_S * np.arange(AN_HOUR + AN_HOUR // 2)
    lit = np.repeat(random.random(len(utc_s) // 24) < 0.7, 24)
    faces = sky("isotropic", sun_direction(utc_s, *SITE), np.where(lit, 800.0, 10.0), 90.0, 1360.0)
    read = np.stack([faces.irradiance_on(normal, 0.3) for normal in NORMALS], axis=-1)
    read *= 1.0 + 0.01 * random.random(read.shape)
    read[random.random(read.shape) < 0.01] = math.nan
    return [
        Reading(at_s, at_s - BEGIN_UTC_S, tuple(row)) for at_s, row in zip(utc_s.tolist(), read.tolist(), strict=True)
    ]


TWO_DAYS = day_of_scans(BEGIN_UTC_S, 1) + day_of_scans(BEGIN_UTC_S + DAY_S, 2)


def drive(numbers, common=None, befalls=None):
    """Let the laws of some trackers hear all scans; return each law's answers at its minutes.

    `befalls` is called with each law before a scan, as (number of the law, count of the scan, law); it returns whether
    the law misses the scan.
    """
    common = WeakValueDictionary() if common is None else common
    facts = TrackerFacts(SITE, Limits(), EVERY_S, 300.0, BEGIN_UTC_S, common=common)
    laws = {number: LiveOptimal(SETTINGS(driver="optimal"), facts) for number in numbers}
    said = {number: [] for number in numbers}
    headings = dict.fromkeys(numbers, Angles(0.0, 90.0))
    for count, scan in enumerate(TWO_DAYS):
        for number, law in laws.items():
            if befalls is None or not befalls(number, count, law):
                law.observe(scan)
        for number, law in laws.items():
            if count % A_MINUTE == PLACES[number]:
                utc_s = scan.utc_s + 0.25 * number
                law.turn(utc_s)
                found = law.aim(Moment(utc_s, None, headings[number]))
                light = (found.beam_w_m2, found.diffuse_w_m2, found.albedo)
                # Compared as text, which has every digit, and in which NaN equals NaN.
                said[number].append(repr((found.target, *light, found.azimuth_deg, found.why, law.to_dict())))
                headings[number] = found.target or headings[number]
    return said


TODAY = int(solar_days(BEGIN_UTC_S, SITE.longitude_deg))


def first_link(scan_every_s=15.0):
    return ReadingHistory(SITE, scan_every_s, TODAY, LightMemory(OptimalSettings()))


def read_at(seconds, faces=(450.0, 450.0, 60.0, 660.0)):
    return Reading(BEGIN_UTC_S + seconds, seconds, faces)


def test_the_link_after_a_reading_is_computed_once_and_shared_and_another_reading_has_its_own_link():
    first = first_link()
    after = first.after(read_at(0.0))
    assert first.after(read_at(0.0)) is after
    other = first.after(read_at(1.0))
    assert (after.waiting_utc_s, other.waiting_utc_s) == ([BEGIN_UTC_S], [BEGIN_UTC_S + 1.0])


def test_the_link_of_a_new_day_is_shared_and_another_day_or_one_more_reading_has_its_own_link():
    first = first_link()
    turned = first.on(TODAY + 1)
    assert first.on(TODAY) is first
    assert first.on(TODAY + 1) is turned
    assert [link.day for link in (first, turned, first.on(TODAY + 2))] == [TODAY, TODAY + 1, TODAY + 2]
    first.on(TODAY + 1)
    after = first.after(read_at(0.0)).on(TODAY + 1)
    assert (turned.memory().expect().known, after.memory().expect().known) == (False, True)


@pytest.mark.parametrize(("count", "waiting"), [(39, 39), (40, 0), (41, 1)])
def test_waiting_means_are_taken_into_the_memory_as_soon_as_there_are_forty(count, waiting):
    link = first_link()
    for number in range(count):
        link = link.after(read_at(15.0 * number))
    assert len(link.waiting_utc_s) == waiting


@pytest.mark.parametrize(("scan_every_s", "means"), [(14.9995, 1), (14.9985, 0)])
def test_a_mean_is_complete_after_15_s_with_a_tolerance_of_1_ms(scan_every_s, means):
    assert len(first_link(scan_every_s).after(read_at(0.0)).waiting_utc_s) == means


def test_a_face_that_was_read_for_less_than_a_second_still_has_a_mean():
    begun = PartialMean().with_reading(read_at(0.0, (math.nan, 200.0, math.nan, 400.0)), 0.5)
    ended = begun.with_reading(read_at(1.0, (100.0, 300.0, math.nan, 500.0)), 0.5).ended()
    assert ended[:2] == (BEGIN_UTC_S + 0.5, 1.0)
    assert ended[2] == pytest.approx([100.0, 250.0, math.nan, 450.0], nan_ok=True)


@pytest.fixture
def taken_in(monkeypatch):
    """The lengths of all means that any memory has observed."""
    lengths, observe = [], LightMemory.observe

    def counted(memory, faces, sun, elapsed_s):
        lengths.extend(np.atleast_1d(elapsed_s).tolist())
        observe(memory, faces, sun, elapsed_s)

    monkeypatch.setattr(LightMemory, "observe", counted)
    return lengths


def test_laws_that_share_results_answer_exactly_as_each_alone_and_estimate_the_light_only_once(taken_in):
    together = drive(PLACES)
    means = len(TWO_DAYS) // 3
    assert means - 4 <= len(taken_in) <= means + 1, "four a minute and the night, however many trackers there are"
    for number in PLACES:
        assert together[number] == drive((number,))[number]


def test_a_law_that_misses_scans_or_relearns_answers_as_if_alone_and_does_not_affect_the_others():
    def befalls(number, count, law):
        if (number, count) == (2, AN_HOUR + 3):
            law.relearn()
        return number == 1 and 400 <= count < 410

    together = drive(PLACES, befalls=befalls)
    for number in PLACES:
        assert together[number] == drive((number,), befalls=befalls)[number]
    assert together[1] != drive((1,))[1], "ten scans that are missing show"


def test_shared_results_are_released_when_no_law_uses_them_any_more():
    common = WeakValueDictionary()
    drive(PLACES, common)
    assert dict(common) == {}


def test_a_law_that_stops_hearing_readings_does_not_keep_later_shared_results_in_memory():
    stopped = link = first_link()
    second = ref(link.after(read_at(0.0)))
    for number in range(AN_HOUR):
        link = link.after(read_at(15.0 * number))
    gc.collect()
    assert second() is None
    assert stopped.after(read_at(0.0)).waiting_utc_s == [BEGIN_UTC_S]
