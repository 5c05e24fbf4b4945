"""The law `optimal` as a tracker runs it, compared with the law itself fed by hand with means, suns and days."""

import math
import re

import numpy as np
import pytest

from solar.energy import arrange_daylight, build_sky, face_irradiances
from solar.ephemeris import DAY_S, Site, sun_day, sun_direction, sun_position
from solar.frames import Angles, Limits, angles_within, azimuth_from_direction
from solar.laws import optimal_live
from solar.laws.law import Moment, Reading, TrackerFacts
from solar.laws.optimal import OptimalLaw, OptimalSettings
from solar.laws.reasons import move_reason
from solar.laws.site import LearnedSite
from solar.skies.sky import sky

SITE = Site(48.7176, 2.2090, 156.0)
LIMITS = Limits()
NOON = 1665576000.0  # 2022-10-12 12:00 UTC
SCAN_S = 5.0
SETTINGS = OptimalSettings()
NORMALS = np.array([[0.0, 1, 0], [1, 0, 0], [0, -1, 0], [0, 0, 1]])


def live(utc_s=NOON, site=SITE, kept=None, **settings):
    tracker = TrackerFacts(site=site, limits=LIMITS, scan_every_s=SCAN_S, decide_every_s=300.0, utc_s=utc_s, kept=kept)
    return optimal_live.build(optimal_live.SETTINGS(**settings), tracker)


def faces_at(utc_s, dni=700.0, dhi=120.0, albedo=0.3):
    return sky("isotropic", sun_direction(utc_s, *SITE), dni, dhi, 1360.0).irradiance_on(NORMALS, albedo)


def scans(count, every_s=SCAN_S, start_s=NOON, **light):
    for number in range(count):
        utc_s = start_s + number * every_s
        yield Reading(utc_s, utc_s - 1e9, tuple(map(float, faces_at(utc_s, **light))))


def in_means(readings, per_mean, elapsed_s):
    """Return the middles, lengths and faces of means of so many readings each."""
    groups = [readings[at : at + per_mean] for at in range(0, len(readings) - per_mean + 1, per_mean)]
    middles = np.array([np.mean([one.utc_s for one in group]) for group in groups])
    with np.errstate(invalid="ignore"):
        faces = np.array([np.nanmean([one.faces_w_m2 for one in group], axis=0) for group in groups])
    return middles, np.full(len(groups), elapsed_s), faces


def expected_aim(means, utc_s, heading, used=(0.0, 0), settings=SETTINGS, learned=None):
    law = OptimalLaw(settings, LIMITS, learned=learned)
    law.resume(*used)
    middles, elapsed_s, faces = means
    law.observe(faces, sun_direction(middles, *SITE), elapsed_s)
    day = sun_day(utc_s, *SITE)
    left = (day.sunset_utc_s - utc_s) / (day.sunset_utc_s - day.sunrise_utc_s)
    return law.choose(*heading, sun_direction(utc_s + settings.lead_s, *SITE), left), law


def assert_alike(aim, expected):
    choice, law = expected
    azimuth, elevation = azimuth_from_direction(choice.vector, SITE.latitude_deg)
    assert (aim.azimuth_deg, aim.elevation_deg) == (pytest.approx(float(azimuth)), pytest.approx(float(elevation)))
    assert aim.why == move_reason(float(choice.gain_w_m2), float(choice.price_w_m2), moves=bool(choice.move))
    assert (aim.target is not None) == bool(choice.move)
    if aim.target is not None:
        assert aim.target == (pytest.approx(float(choice.a_deg)), pytest.approx(float(choice.b_deg)))
    assert aim.beam_w_m2 == pytest.approx(float(law.light.beam))
    assert aim.diffuse_w_m2 == pytest.approx(float(law.light.uniform))


@pytest.mark.parametrize(
    ("every_s", "per_mean", "first_s"),
    [(5.0, 3, 5.0), (15.0, 1, 5.0), (30.0, 1, 5.0), (60.0, 1, 5.0)],
)
def test_readings_are_averaged_over_15_s_or_one_scan_with_the_sun_direction_of_each_mean(every_s, per_mean, first_s):
    law, readings = live(), list(scans(12, every_s))
    for reading in readings:
        law.observe(reading)
    utc_s, heading = readings[-1].utc_s, Angles(0.0, 90.0)
    # The first reading counts for the cube's rhythm only: more readings are needed for a mean.
    lone = every_s > first_s
    begin = min(1 + int((15.0 - first_s - 1e-3) // every_s), 3) if lone else 0
    means = in_means(readings[begin + 1 if lone else 0 :], per_mean, per_mean * every_s)
    if lone:
        weights = np.array([first_s, *[every_s] * begin])
        faces = np.array([one.faces_w_m2 for one in readings[: begin + 1]])
        times = np.array([one.utc_s for one in readings[: begin + 1]])
        means = (
            np.append(weights @ times / weights.sum(), means[0]),
            np.append(weights.sum(), means[1]),
            np.vstack([weights @ faces / weights.sum(), means[2]]),
        )
    aim = law.aim(Moment(utc_s, None, heading))
    assert_alike(aim, expected_aim(means, utc_s, heading))
    assert aim.target is not None
    assert aim.sun == pytest.approx(sun_position(utc_s, *SITE))


def test_a_reading_after_a_gap_counts_for_one_scan_interval_only():
    law = live()
    readings = [*scans(3), *scans(3, start_s=NOON + 110.0)]
    for reading in readings:
        law.observe(reading)
    aim = law.aim(Moment(readings[-1].utc_s, None, Angles(0.0, 90.0)))
    assert_alike(aim, expected_aim(in_means(readings, 3, 15.0), readings[-1].utc_s, (0.0, 90.0)))


@pytest.mark.parametrize(("gap_s", "forgotten"), [(600.0, False), (1200.0, True), (7200.0, True)])
def test_light_from_before_a_gap_of_1200_s_is_forgotten_and_from_before_one_of_600_s_is_not(gap_s, forgotten):
    law = live()
    before, after = list(scans(4)), list(scans(3, start_s=NOON + gap_s, dni=0.0, dhi=150.0))
    for reading in (*before, *after):
        law.observe(reading)
    # The fourth scan before the gap does not form a mean with those after it.
    heard = after if forgotten else [*before[:3], *after]
    aim = law.aim(Moment(after[-1].utc_s, None, Angles(-50.0, 15.0)))
    assert_alike(aim, expected_aim(in_means(heard, 3, 15.0), after[-1].utc_s, (-50.0, 15.0)))


def test_the_mean_of_a_face_is_taken_over_the_readings_that_it_has():
    law, readings = live(), list(scans(6))
    readings[1] = readings[1]._replace(faces_w_m2=(math.nan, *readings[1].faces_w_m2[1:]))
    for at in (3, 4, 5):
        readings[at] = readings[at]._replace(faces_w_m2=(*readings[at].faces_w_m2[:2], math.nan, 400.0))
    for reading in readings:
        law.observe(reading)
    means = in_means(readings[:3], 3, 15.0)
    late = in_means([one._replace(faces_w_m2=(*one.faces_w_m2[:2], 0.0, 400.0)) for one in readings[3:]], 3, 15.0)
    late[2][:, 2] = math.nan
    means = tuple(np.concatenate(pair) for pair in zip(means, late, strict=True))
    aim = law.aim(Moment(readings[-1].utc_s, None, Angles(0.0, 90.0)))
    assert_alike(aim, expected_aim(means, readings[-1].utc_s, (0.0, 90.0)))


def test_all_of_41_means_that_wait_for_a_decision_count_in_it():
    law, readings = live(), list(scans(3 * 41))
    for reading in readings:
        law.observe(reading)
    aim = law.aim(Moment(readings[-1].utc_s, None, Angles(0.0, 90.0)))
    assert_alike(aim, expected_aim(in_means(readings, 3, 15.0), readings[-1].utc_s, (0.0, 90.0)))


def test_the_price_of_a_move_rises_with_the_budget_that_is_used_and_the_daylight_that_is_left():
    law, readings = live(), list(scans(3, start_s=NOON - 14_400.0))
    # The daylight of this day counts, although the law was asked for the day before as well.
    law.aim(Moment(NOON - DAY_S, None, Angles(0.0, 90.0)))
    for reading in readings:
        law.observe(reading)
    law.book(1000.0)
    law.book(100.0)
    assert (law.affords(200.0), law.affords(200.1)) == (True, False)
    now = Moment(readings[-1].utc_s, None, Angles(0.0, 90.0))
    expected = expected_aim(in_means(readings, 3, 15.0), now.utc_s, (0.0, 90.0), used=(1100.0, 2))
    assert_alike(law.aim(now), expected)
    assert float(expected[0].price_w_m2) > 1.5 * float(expected_aim(
        in_means(readings, 3, 15.0), now.utc_s, (0.0, 90.0))[0].price_w_m2)  # fmt: skip


@pytest.mark.parametrize("limit", [{"travel_per_day_deg": 50.0}, {"moves_per_day": 1}])
def test_a_move_beyond_the_days_budget_is_reported_with_its_gain_and_the_budget_as_the_reason(limit):
    law = live(**limit)
    law.book(0.0)
    aim = law.aim(Moment(NOON, None, Angles(-50.0, 15.0)))
    assert aim.target is None
    assert re.fullmatch(
        r"\d+\.\d W/m2 to gain, but the law's budget of motion for the day does not allow it \(.*\)", aim.why
    )


def test_the_settings_thrift_travel_moves_and_albedo_take_effect_in_the_optimal_law():
    law = live(thrift=3.0, travel_per_day_deg=200.0, moves_per_day=2, albedo=0.4)
    readings = list(scans(3, start_s=NOON - 14_400.0))
    for reading in readings:
        law.observe(reading)
    assert law.learned.albedo == 0.4
    assert (law.affords(200.0), law.affords(200.1)) == (True, False)
    law.book(10.0)
    plan = OptimalSettings(thrift=3.0, travel_per_day_deg=200.0, moves_per_day=2)
    now = Moment(readings[-1].utc_s, None, Angles(0.0, 90.0))
    expected = expected_aim(in_means(readings, 3, 15.0), now.utc_s, now.heading, (10.0, 1), plan, LearnedSite(0.4))
    aim = law.aim(now)
    # The reason has the price in it, which thrift multiplies and the used half of the moves raises.
    assert_alike(aim, expected)
    assert aim.albedo == 0.4
    law.book(0.0)
    assert not law.affords(0.0)


def test_while_the_trackers_pose_is_unknown_the_law_gives_no_target():
    aim = live().aim(Moment(NOON, None, None))
    assert aim.target is None
    assert math.isnan(aim.azimuth_deg)
    assert math.isnan(aim.elevation_deg)
    assert aim.why == "where the tracker stands is not known"


def test_the_days_budget_survives_a_clock_that_shows_1970_until_it_is_set():
    law = live(moves_per_day=3)
    law.book(20.0)
    for _ in range(2):
        kept = law.to_dict()
        law = live(utc_s=60.0, kept=kept, moves_per_day=3)
        assert law.shown()["today"] == {"travelled_deg": 0.0, "moves": 0}
    law.book(10.0)
    assert law.turn(NOON)
    assert law.shown()["today"] == {"travelled_deg": 30.0, "moves": 2}
    law.turn(60.0)
    law.book(5.0)
    assert law.affords(5.0)
    law.turn(NOON)
    assert law.to_dict() == kept | {"travelled_deg": 35.0, "moves": 3}
    assert not law.affords(5.0)
    assert law.turn(NOON + DAY_S)
    assert law.affords(5.0)


@pytest.mark.parametrize("longitude_deg", [0.0, 100.0, -150.0])
def test_the_day_of_the_budget_ends_at_the_solar_midnight_of_the_site(longitude_deg):
    midnight_s = 19_277 * DAY_S - longitude_deg * 240.0
    law = live(utc_s=midnight_s - 3600.0, site=Site(40.0, longitude_deg, 0.0))
    law.book(10.0)
    assert not law.turn(midnight_s - 1.0)
    assert law.shown()["today"] == {"travelled_deg": 10.0, "moves": 1}
    assert law.turn(midnight_s + 1.0)
    assert law.shown()["today"] == {"travelled_deg": 0.0, "moves": 0}
    assert not law.turn(midnight_s + 3600.0)
    assert law.to_dict()["day"] == 19_277


def test_readings_of_a_days_last_minutes_count_in_what_is_learned_from_that_day():
    law, other = live(), live()
    for reading in scans(3 * 39):
        law.observe(reading)
        other.observe(reading)
    # One of them was asked at the day's end, so it has observed its last means already.
    other.aim(Moment(NOON + 600.0, None, Angles(0.0, 90.0)))
    assert law.turn(NOON + DAY_S)
    assert other.turn(NOON + DAY_S)
    assert law.learned != LearnedSite()
    assert law.to_dict() == pytest.approx(other.to_dict())


def test_a_restart_keeps_todays_used_budget_and_the_learned_values_but_not_yesterdays_used_budget():
    law = live()
    law.book(123.0)
    kept = law.to_dict()
    assert live(kept=kept).to_dict() == kept
    assert live(kept=kept, utc_s=NOON + DAY_S).shown()["today"] == {"travelled_deg": 0.0, "moves": 0}
    gains = {"gain_east": 1.02, "gain_south": 1 / 1.02}
    learned = live(kept={**kept, **gains, "albedo": 0.5}, utc_s=NOON + DAY_S).learned
    assert learned.to_dict() == pytest.approx({**gains, "albedo": 0.5, "gain_west": 1.0})


def test_relearning_also_discards_means_that_wait_for_a_decision():
    law = live(albedo=0.25, kept={"albedo": 0.5, "gain_west": 0.98, "day": 0})
    for reading in scans(3 * 30):
        law.observe(reading)
    law.relearn()
    assert law.learned == LearnedSite(0.25)
    law.turn(NOON + DAY_S)
    assert law.learned.to_dict() == pytest.approx(LearnedSite(0.25).to_dict())


def test_where_the_sun_does_not_set_the_share_of_daylight_left_is_that_of_24_hours():
    site, noon_s = Site(80.0, 0.0, 0.0), 1687348800.0  # 2023-06-21 12:00 UTC
    law = live(utc_s=noon_s, site=site, travel_per_day_deg=1000.0)
    law.book(750.0)
    for hours, left in ((0.0, 0.5), (6.0, 0.25), (-6.0, 0.75)):
        utc_s = noon_s + 3600.0 * hours
        aim = law.aim(Moment(utc_s, None, Angles(0.0, 90.0)))
        same = OptimalLaw(OptimalSettings(travel_per_day_deg=1000.0), LIMITS)
        same.resume(750.0, 1)
        day = sun_day(utc_s, *site)
        exact = (day.noon_utc_s + DAY_S / 2 - utc_s) / DAY_S
        assert exact == pytest.approx(left, abs=0.01)
        choice = same.choose(0.0, 90.0, sun_direction(utc_s + SETTINGS.lead_s, *site), exact)
        assert aim.why == move_reason(float(choice.gain_w_m2), float(choice.price_w_m2), moves=bool(choice.move))


def test_the_law_decides_once_a_minute_and_shows_learned_values_apart_from_those_of_the_day():
    law = live()
    assert law.decide_every_s == 60.0
    assert law.shown()["learned"] == LearnedSite().to_dict()


def test_kept_state_of_a_day_without_moves_is_accepted_and_infinite_travel_is_refused():
    fresh = live().to_dict()
    assert (fresh["travelled_deg"], fresh["moves"]) == (0.0, 0)
    assert live(kept=fresh).to_dict() == fresh
    assert live(kept={"albedo": 0.2, "day": fresh["day"]}).to_dict() == fresh
    with pytest.raises(ValueError, match="travelled_deg"):
        live(kept={**fresh, "travelled_deg": math.inf})


@pytest.mark.parametrize("site", [Site(-33.9, 18.4, 0.0), Site(48.7, -2.2, 0.0)])
def test_without_readings_the_law_aims_at_the_sun_four_minutes_ahead_in_either_hemisphere(site):
    aim = live(site=site).aim(Moment(NOON - 10_800.0, None, Angles(0.0, 90.0)))
    ahead = sun_position(NOON - 10_800.0 + 240.0, *site)
    assert (aim.azimuth_deg, aim.elevation_deg) == (
        pytest.approx(ahead.azimuth_deg),
        pytest.approx(ahead.elevation_deg),
    )


def test_the_albedo_known_each_morning_is_that_learned_on_the_clear_days_before():
    # By hand: each clear day of more than an hour moves the albedo a fifth of the way from 0.2 to the ground's.
    utc_s = NOON - DAY_S / 2 + 600.0 * np.arange(3 * 144)
    weather = arrange_daylight(utc_s, np.full(utc_s.size, 800.0), np.full(utc_s.size, 1e-3), SITE, 600.0)
    known = optimal_live.learned_by_day(weather, face_irradiances(build_sky(weather, "isotropic"), 0.5))
    np.testing.assert_allclose(known.albedo, [0.2, 0.26, 0.308], atol=0.01)


def test_estimates_of_beam_and_diffuse_light_are_right_for_each_reading_and_nan_where_unknown():
    law = live()
    faces = np.stack([faces_at(NOON, 600.0, 100.0, albedo=0.2)] * 4)
    faces[1, 0] = math.nan
    faces[2, :2] = math.nan
    sun = np.stack([sun_direction(NOON, *SITE)] * 4)
    sun[3, 2] = -0.1
    found = law.estimates(faces, sun, LearnedSite(0.2))
    np.testing.assert_allclose(found.beam_w_m2[:2], 600.0, rtol=0.01)
    np.testing.assert_allclose(found.diffuse_w_m2[:2], 100.0, rtol=0.05)
    assert np.isnan([*found.beam_w_m2[2:], *found.diffuse_w_m2[2:]]).all()
    np.testing.assert_array_equal(found.albedo, 0.2)
    high = law.estimates(1.05 * faces[:1], sun[:1], LearnedSite(0.2, 1.05, 1.05, 1.05))
    assert float(high.beam_w_m2[0]) == pytest.approx(600.0, rel=0.02)


def test_a_zenith_face_that_the_others_contradict_is_not_believed():
    east, south, west, zenith = map(float, faces_at(NOON))
    assert live().believes_zenith((east, south, west, zenith), NOON)
    assert not live().believes_zenith((500.0, 600.0, 500.0, 5.0), NOON)


def test_the_fast_steering_of_the_benchmark_stays_in_place_until_the_first_reading():
    utc_s = NOON + 60.0 * np.arange(3)
    weather = arrange_daylight(utc_s, np.full(3, 700.0), np.full(3, 80.0), SITE)
    faces = face_irradiances(build_sky(weather, "isotropic"), 0.2)
    next_pose = optimal_live.steer(optimal_live.SETTINGS(), weather, faces, LIMITS)
    a, b = np.zeros(1), np.full(1, 90.0)
    assert next_pose(0, a, b) == (a, b)
    expected = angles_within(sun_direction(NOON + SETTINGS.lead_s, *SITE), LIMITS)
    np.testing.assert_allclose(np.ravel(next_pose(1, a, b)), expected, atol=5.0)
