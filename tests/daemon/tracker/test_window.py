"""The time-weighted mean."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.base.records import FaceReading, Quality, Scan
from daemon.tracker.readings import Window


def scan(now_s, value, quality=Quality.OK, number=0):
    face = FaceReading(value if quality is Quality.OK else math.nan, quality, now_s, now_s)
    return Scan("cube", "s", number, now_s, now_s, face, face, face, face)


def test_a_window_of_two_minutes_of_scans_every_5_s_gives_the_plain_mean_of_the_last_24_samples():
    window = Window(120, nominal_s=5, longest_s=60)
    for i in range(100):
        window.add(scan(5.0 * i, float(i)))
    mean = window.mean(5.0 * 99)
    assert mean.zenith_w_m2 == pytest.approx(sum(range(76, 100)) / 24)
    assert mean.coverage == pytest.approx(1.0)


def test_samples_weigh_by_the_time_they_stand_for():
    window = Window(120, nominal_s=5, longest_s=60)
    window.add(scan(100, 1000))
    window.add(scan(130, 200))
    window.add(scan(140, 600))
    # 1000 stands for the nominal 5 s, 200 for 30 s, 600 for 10 s.
    assert window.mean(140).east_w_m2 == pytest.approx((1000 * 5 + 200 * 30 + 600 * 10) / 45)
    assert window.mean(140).coverage == pytest.approx(45 / 120)


def test_the_oldest_reading_counts_only_as_far_as_it_reaches_into_the_window():
    window = Window(20, nominal_s=10, longest_s=60)
    for now, value in ((0, 100), (10, 200), (20, 300), (25, 400)):
        window.add(scan(now, value))
    # The window (5, 25]: 5 s of the second reading, 10 s of the third, 5 s of the fourth.
    assert window.mean(25).west_w_m2 == pytest.approx((200 * 5 + 300 * 10 + 400 * 5) / 20)


def test_bad_readings_add_neither_to_the_mean_nor_to_the_coverage():
    window = Window(60, nominal_s=5, longest_s=60)
    for i in range(12):
        window.add(scan(5.0 * i, 500.0, Quality.OK if i < 6 else Quality.OVER_RANGE))
    mean = window.mean(55)
    assert mean.south_w_m2 == pytest.approx(500)
    assert mean.coverage == pytest.approx(0.5)


def test_a_reading_after_a_long_gap_does_not_stand_for_the_gap():
    window = Window(600, nominal_s=5, longest_s=60)
    window.add(scan(0, 100))
    window.add(scan(300, 900))
    assert window.mean(300).east_w_m2 == pytest.approx(500)


def test_a_window_without_readings_has_no_mean():
    window = Window(120, 5, 60)
    assert window.mean(0) is None
    window.add(scan(0, 100))
    assert window.mean(500) is None


def test_the_coverage_is_1_at_most_if_readings_stand_for_more_than_the_window():
    window = Window(10, nominal_s=20, longest_s=5)
    window.add(scan(0, 100))
    window.add(scan(9, 100))
    assert window.mean(9).coverage == 1.0


@given(st.lists(st.tuples(st.floats(0.5, 90), st.floats(-20, 1500)), min_size=1, max_size=80))
def test_the_mean_lies_between_its_readings_and_covers_no_more_than_the_window(steps):
    window, now = Window(120, 5, 60), 0.0
    for step, value in steps:
        now += step
        window.add(scan(now, value))
    mean = window.mean(now)
    values = [value for _, value in steps]
    assert min(values) - 1e-9 <= mean.east_w_m2 <= max(values) + 1e-9
    assert 0 < mean.coverage <= 1


@given(st.lists(st.tuples(st.sampled_from([5.0, 7.5, 40.0]), st.sampled_from([0.0, 5.0, 10.0, 45.0, 3600.0]))))
def test_readings_dated_no_later_than_the_one_before_count_neither_in_the_mean_nor_the_coverage(scans):
    # The bridge accepts face times of up to an hour before their scan, for example from a sender whose clock was set.
    window, without, now_s, newest_s = Window(120, 5, 60), Window(120, 5, 60), 0.0, -1.0
    for number, (step_s, before_s) in enumerate([(0.0, 0.0), *scans]):
        now_s += step_s
        read_s = now_s - before_s
        late = FaceReading(100.0 + number, Quality.OK, read_s, read_s)
        given = Scan("cube", "s", number, now_s, now_s, late, late, late, late)
        window.add(given)
        if read_s > newest_s:
            newest_s = read_s
            without.add(given)
        assert window.mean(now_s) == without.mean(now_s)


def test_a_reading_that_arrives_too_late_changes_neither_the_mean_nor_the_coverage_of_the_others():
    window = Window(120, nominal_s=5, longest_s=60)
    for i in range(25):
        window.add(scan(5.0 * i, 100.0))
    late = FaceReading(900.0, Quality.OK, 80.0, 80.0)
    window.add(Scan("cube", "s", 0, 125.0, 125.0, late, late, late, late))
    window.add(scan(130.0, 100.0))
    assert window.mean(130.0).east_w_m2 == pytest.approx(100.0)
    assert window.mean(130.0).coverage == pytest.approx(1.0)


def four(now_s, values, bad=()):
    faces = [
        FaceReading(math.nan if index in bad else value, Quality.LATE if index in bad else Quality.OK, now_s, now_s)
        for index, value in enumerate(values)
    ]
    return Scan("cube", "s", 0, now_s, now_s, *faces)


def test_a_reading_at_the_windows_very_start_is_outside():
    window = Window(20, nominal_s=5, longest_s=60)
    for now, value in ((5, 999), (10, 100), (15, 100), (20, 100), (25, 100)):
        window.add(scan(now, value))
    assert window.mean(25).east_w_m2 == pytest.approx(100)
    assert window.mean(25).coverage == pytest.approx(1.0)
    assert window.mean(30).coverage == pytest.approx(0.75)


def test_coverage_is_that_of_the_worst_face_that_is_needed():
    window = Window(60, nominal_s=5, longest_s=60)
    for i in range(12):
        # South is read half of the time, west a quarter of it.
        bad = [index for index, share in ((1, 6), (2, 3)) if i < 12 - share]
        window.add(four(5.0 * i, (1, 2, 3, 4), bad))
    assert window.mean(55).coverage == pytest.approx(0.25)
    assert window.mean(55, faces_needed=3).coverage == pytest.approx(0.5)


def test_a_face_without_fresh_readings_has_no_mean_and_no_coverage():
    window = Window(120, nominal_s=5, longest_s=15, stale_s=15)
    for i in range(24):
        window.add(four(5.0 * i, (1, 2, 3, 4)))
    for i in range(24, 28):
        window.add(four(5.0 * i, (1, 2, 3, 4), bad=(3,)))
    assert window.mean(130.0).zenith_w_m2 == pytest.approx(4)
    assert window.mean(130.1) is None
    three = window.mean(130.1, faces_needed=3)
    assert math.isnan(three.zenith_w_m2)
    assert three.south_w_m2 == pytest.approx(2)


def test_a_single_reading_exactly_at_the_start_of_the_window_gives_no_mean():
    window = Window(20, nominal_s=5, longest_s=60)
    window.add(scan(5, 100))
    assert window.mean(24.9).coverage > 0
    assert window.mean(25) is None


def test_a_window_shared_by_trackers_gives_the_mean_of_one_of_its_own_and_counts_a_scan_once():
    scans = [scan(5.0 * number, 1000.0 / (number + 3.7), number=number) for number in range(400)]
    one, common = Window(120, 5, 15, 15), Window(120, 5, 15, 15)
    for each in scans:
        one.add(each)
        for place in range(3):
            common.add(each)
            common.mean(each.time_monotonic_s + 0.7 * place)
    asked_s = scans[-1].time_monotonic_s + 3.3
    assert one.mean(asked_s) == common.mean(asked_s)


def test_the_mean_needs_all_four_faces_unless_fewer_are_asked_for():
    window = Window(60, nominal_s=5, longest_s=60)
    good, bad = FaceReading(500.0, Quality.OK, 0.0, 0.0), FaceReading(math.nan, Quality.LATE, 0.0, 0.0)
    window.add(Scan("cube", "s", 0, 0.0, 0.0, good, bad, good, good))
    assert window.mean(0.0) is None
    assert window.mean(0.0, 4) is None
    assert window.mean(0.0, 3).coverage == pytest.approx(5 / 60)
