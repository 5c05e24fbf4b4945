"""Two clocks that are set, drift or sleep: which scans are followed, which are late, and how old they are."""

from dataclasses import replace

import pytest

from tests.daemon.bridge.desk import GOOD, PEER, UTC_S, Desk, scan, signed


def test_after_both_clocks_were_set_back_a_restarted_cube_is_followed():
    desk = Desk()
    desk.follow(scan(0), scan(1))
    desk.clock.utc_offset_s -= 86400.0
    back = scan(0, time_s=10.0, session="second")
    desk.take(signed(replace(back, time_utc_s=back.time_utc_s - 86400.0)), time_s=10.0)
    assert desk.counts == {"accepted": 3}


def test_a_step_of_both_clocks_within_a_session_changes_nothing():
    desk = Desk()
    desk.follow(scan(0))
    for number, step_s in ((1, -86400.0), (2, 86400.0), (3, 3600.0)):
        desk.clock.utc_offset_s = UTC_S + step_s
        desk.take(signed(scan(number, time_utc_s=UTC_S + 5.0 * number + step_s)), time_s=5.0 * number)
    assert [got.sequence for got in desk.scans] == [0, 1, 2, 3]


@pytest.mark.parametrize("skew_s", [-30.0, 30.0])
def test_a_clock_just_within_the_allowed_skew_is_accepted_and_just_beyond_is_not(skew_s):
    desk = Desk()
    desk.clock.utc_offset_s = UTC_S + skew_s
    desk.follow(scan(0))
    desk.clock.utc_offset_s = UTC_S + 1.01 * skew_s
    desk.follow(scan(1))
    assert desk.counts == {"accepted": 1, "skewed": 1}
    assert "30.3 s" in desk.reason
    assert "NTP" in desk.reason


def test_a_scan_refused_as_skewed_is_not_counted_as_lost_as_well():
    desk = Desk()
    desk.follow(scan(0))
    desk.take(signed(scan(1, time_utc_s=UTC_S + 1e4)))
    desk.follow(scan(2))
    assert desk.counts == {"accepted": 2, "skewed": 1}


def test_scan_times_are_rebased_by_the_smallest_delay_and_face_ages_are_kept():
    desk = Desk()
    for number, delay_s in enumerate((0.5, 0.1, 2.1)):
        desk.take(signed(scan(number)), time_s=5.0 * number + delay_s)
    assert [got.time_monotonic_s for got in desk.scans] == pytest.approx([1000.5, 1005.1, 1010.1])
    last = desk.scans[-1]
    assert [last.time_monotonic_s - face.time_monotonic_s for face in last.faces] == pytest.approx(
        [0.75, 0.5, 0.25, 0.0]
    )
    assert last.time_utc_s == UTC_S + 10.0


def test_a_scan_held_up_for_too_long_is_late_and_the_next_one_is_not():
    desk = Desk()
    desk.follow(scan(0))
    desk.take(signed(scan(1)), time_s=15.2)
    desk.take(signed(scan(2)), time_s=15.2)
    desk.take(signed(scan(4)), time_s=20.0)
    assert [got.sequence for got in desk.scans] == [0, 2, 4]
    assert desk.counts == {"accepted": 3, "late": 1, "lost": 1}
    assert "10.2 s longer" in desk.reason


def test_clocks_that_drift_apart_for_days_make_no_scan_late():
    desk = Desk()
    minutes = 3 * 24 * 60
    for minute in range(minutes):
        true_s = 60.0 * minute
        desk.take(signed(scan(minute, time_s=true_s, time_monotonic_s=70.0 + true_s * (1 - 1e-4))), time_s=true_s)
    assert desk.counts == {"accepted": minutes}
    assert desk.scans[-1].time_monotonic_s == pytest.approx(desk.clock.monotonic(), abs=0.1)


def test_a_sender_that_slept_is_followed_again_within_ten_minutes():
    desk = Desk()
    desk.follow(*(scan(number) for number in range(100)))
    for number in range(100, 300):
        # The sender's steady clock stood still for an hour.
        sent = scan(number, time_s=3600.0 + 5.0 * number)
        desk.take(signed(replace(sent, time_monotonic_s=70.0 + 5.0 * number)), time_s=3600.0 + 5.0 * number)
    assert desk.scans[-1].sequence == 299
    assert desk.counts.get("late", 0) <= 120


def test_a_steady_clock_that_steps_back_never_makes_time_run_back_for_control():
    desk = Desk()
    desk.follow(scan(0))
    desk.take(signed(scan(1, time_monotonic_s=84.0)), time_s=5.0)
    desk.follow(scan(2))
    assert [got.sequence for got in desk.scans] == [0, 1]
    assert "steady clock" in desk.reason


def test_a_datagram_that_waited_is_judged_and_dated_by_its_arrival():
    desk = Desk()
    desk.clock.now_s += 40.0
    desk.receiver.datagram_received(GOOD, PEER, 40.0)
    assert [got.time_monotonic_s for got in desk.scans] == [1000.0]
