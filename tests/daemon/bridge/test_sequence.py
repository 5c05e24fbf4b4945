"""Two cubes under one name and key: the elder is followed, the other steers nothing, and no old scan counts as new."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.bridge.refusals import ScanRefusedError
from daemon.bridge.sequence import SequenceGuard
from tests.daemon.bridge.desk import UTC_S, Desk, scan, signed


def follow_both(desk, first_s, last_s, second="second", second_from_s=0.0):
    """Let both cubes send every 5 s, the second one 2 s after the first."""
    for time_s in range(first_s, last_s, 5):
        desk.follow(scan(time_s // 5, time_s=time_s))
        if time_s >= second_from_s:
            desk.follow(scan(time_s // 5, time_s=time_s + 2.0, session=second))


def sessions(desk):
    return [got.session for got in desk.scans]


def test_a_second_cube_that_was_started_by_mistake_loses_no_scan_of_the_first_one():
    desk = Desk()
    desk.follow(*(scan(number) for number in range(4)))
    follow_both(desk, 20, 40)
    desk.follow(*(scan(number) for number in range(8, 20)))
    assert [got.sequence for got in desk.scans if got.session == "first"] == list(range(20))
    # Its first scan could have been a restart of the first cube.
    assert sessions(desk).count("second") == 1
    assert desk.counts == {"accepted": 21, "second_cube": 3}
    assert "the session second, a second cube under the name cube, while the session first is followed" in desk.reason


def test_a_first_cube_that_was_silent_meanwhile_is_followed_again_at_once():
    desk = Desk()
    desk.follow(scan(0), *(scan(number, time_s=5.0 + 5.0 * number, session="second") for number in range(4)))
    desk.follow(*(scan(number) for number in range(5, 9)))
    assert sessions(desk) == ["first"] + ["second"] * 4 + ["first"] * 4
    assert desk.counts == {"accepted": 9, "lost": 4}


def test_a_second_cube_is_followed_after_a_minute_of_silence_of_the_first_until_it_returns():
    desk = Desk()
    follow_both(desk, 0, 15)
    desk.follow(*(scan(number, time_s=5.0 * number + 2.0, session="second") for number in range(3, 20)))
    assert desk.scans[-1].session == "second"
    waited_s = next(got.time_utc_s for got in desk.scans[-8:] if got.session == "second") - UTC_S - 10.0
    assert 60.0 <= waited_s < 66.0
    assert "lost" not in desk.counts, "what was refused has not been lost"
    desk.follow(scan(25), scan(26), scan(25, time_s=132.0, session="second"))
    assert sessions(desk)[-2:] == ["first", "first"]


@pytest.mark.parametrize("ahead_s", [3.5, 29.0])
def test_a_second_cube_whose_clock_is_ahead_does_not_take_the_place_of_the_first_one(ahead_s):
    desk = Desk()
    for number in range(12):
        desk.take(signed(scan(number)), time_s=5.0 * number)
        if 4 <= number < 8:
            second = scan(number, time_s=5.0 * number + 2.0 + ahead_s, session="second")
            desk.take(signed(second), time_s=5.0 * number + 2.0)
    assert [got.sequence for got in desk.scans if got.session == "first"] == list(range(12))
    assert desk.counts == {"accepted": 13, "second_cube": 3}


def test_a_cube_whose_clock_is_set_back_and_that_is_started_again_is_followed_at_once():
    desk = Desk()
    for number in range(3):
        desk.take(signed(scan(number, time_s=5.0 * number + 20.0)), time_s=5.0 * number)
    desk.follow(scan(0, time_s=15.0, session="anew"))
    assert sessions(desk) == ["first"] * 3 + ["anew"]


@pytest.mark.parametrize(("old_s", "counts"), [(0.2, {"accepted": 3}), (0.3, {"accepted": 2, "replayed": 1})])
def test_a_scan_stamped_0_2_s_ago_by_this_machines_clock_is_no_replay_and_one_0_3_s_ago_is(old_s, counts):
    desk = Desk()
    desk.follow(scan(0))
    desk.take(signed(scan(0, time_s=25.0, session="second")), time_s=5.0)
    desk.take(signed(scan(1, time_s=10.0 - old_s)), time_s=10.0)
    assert desk.counts == counts


def test_a_restart_of_the_first_cube_is_followed_beside_a_second_one():
    desk = Desk()
    follow_both(desk, 0, 15)
    for number in range(4):
        desk.follow(scan(number, time_s=20.0 + 5 * number, session="anew"))
        desk.follow(scan(4 + number, time_s=22.0 + 5 * number, session="second"))
    assert sessions(desk)[-4:] == ["anew"] * 4
    assert desk.counts["second_cube"] == 2 + 4


def test_recorded_scans_of_two_cubes_cannot_be_played_again():
    desk = Desk()
    recorded = [scan(number) for number in range(8)]
    recorded += [scan(number, time_s=5.0 * number + 2.0, session="second") for number in range(8)]
    recorded.sort(key=lambda sent: sent.time_utc_s)
    desk.follow(*recorded)
    accepted = len(desk.scans)
    for _ in range(3):
        for sent in recorded:
            desk.take(signed(sent))
    assert len(desk.scans) == accepted
    assert set(desk.counts) == {"accepted", "second_cube", "duplicate", "replayed"}


def test_a_held_back_scan_of_a_session_that_was_replaced_is_refused_although_its_number_is_new():
    desk = Desk()
    held_back = scan(1)
    desk.follow(scan(0), scan(0, time_s=10.0, session="second"))
    desk.take(signed(held_back))
    assert sessions(desk) == ["first", "second"]
    assert "returns to the session first with a scan older than one accepted before" in desk.reason


def test_after_a_restart_of_the_receiver_an_old_session_cannot_take_the_place_of_the_living_one():
    before = [scan(number) for number in range(3)]
    desk = Desk()
    desk.take(signed(before[0]), time_s=20.0)
    assert len(desk.scans) == 1, "a receiver that knows nothing takes the first that is fresh"
    desk.follow(scan(0, time_s=21.0, session="living"))
    for sent in before:
        desk.take(signed(sent), time_s=22.0)
    desk.follow(scan(1, time_s=26.0, session="living"))
    assert sessions(desk) == ["first", "living", "living"]


@given(
    st.lists(st.tuples(st.sampled_from(("first", "second", "third")), st.integers(0, 12)), min_size=1, max_size=60),
)
def test_under_any_replay_no_scan_comes_through_twice_and_time_stamps_never_fall(sent):
    desk = Desk()
    for number, (session, back) in enumerate(sent):
        # `back` numbers ago: recorded scans come again among the new ones.
        made = max(number - back, 0)
        desk.take(signed(scan(made, time_s=0.3 * made, session=session)), time_s=0.3 * number)
    came = [(got.session, got.sequence) for got in desk.scans]
    assert len(came) == len(set(came))
    stamps = [got.time_utc_s for got in desk.scans]
    assert stamps == sorted(stamps)


@pytest.mark.parametrize(("behind", "refused"), [(63, {"reordered": 1}), (64, {"replayed": 1})])
def test_the_last_64_sequence_numbers_of_a_session_are_remembered(behind, refused):
    desk = Desk()
    desk.follow(scan(0), scan(100))
    desk.take(signed(scan(100 - behind)))
    lost = 99 - (behind == 63)
    assert desk.counts == {"accepted": 2, "lost": lost} | refused
    desk.take(signed(scan(100 - behind)))
    assert desk.counts.get("duplicate", 0) == (behind == 63)


@pytest.mark.parametrize("ahead", [1, 2, 63, 64, 65])
def test_after_a_leap_an_earlier_scan_is_a_duplicate_if_less_than_64_behind_else_a_replay(ahead):
    desk = Desk()
    desk.follow(scan(100), scan(100 + ahead))
    desk.take(signed(scan(100)))
    kind = "duplicate" if ahead < 64 else "replayed"
    assert {name: count for name, count in desk.counts.items() if name != "lost"} == {"accepted": 2, kind: 1}
    assert desk.counts.get("lost", 0) == ahead - 1


@pytest.mark.parametrize(("sessions", "words"), [(64, "has been replaced"), (65, "begins the session run-0")])
def test_the_last_64_sessions_are_remembered_as_replaced(sessions, words):
    desk = Desk()
    for number in range(sessions):
        desk.follow(scan(0, time_s=0.1 * number, session=f"run-{number}"))
    desk.take(signed(scan(0, time_s=0.0, session="run-0")))
    assert desk.counts == {"accepted": sessions, "replayed": 1}
    assert words in desk.reason


def test_lost_scans_of_a_forgotten_session_stay_counted():
    desk = Desk()
    desk.follow(scan(0, time_s=0.0), scan(4, time_s=0.05))
    for number in range(1, 70):
        desk.follow(scan(0, time_s=0.1 * number, session=f"run-{number}"))
    assert desk.counts == {"accepted": 71, "lost": 3}
    desk.follow(scan(7, time_s=100.0, source="other"), scan(9, time_s=105.0, source="other"))
    assert desk.counts == {"accepted": 73, "lost": 4}


@pytest.mark.parametrize(("silence_s", "counts"), [(550.0, {"accepted": 1, "late": 1}), (610.0, {"accepted": 2})])
def test_the_smallest_delay_is_remembered_for_550_s_and_forgotten_after_610_s(silence_s, counts):
    desk = Desk()
    desk.follow(scan(0))
    # It comes 11 s after it was made; 10 s are allowed.
    desk.take(signed(scan(1, time_s=silence_s)), time_s=silence_s + 11.0)
    assert desk.counts == counts


def test_the_known_delays_of_scans_can_be_forgotten():
    guard = SequenceGuard(clock_skew_s=30.0, late_after_s=10.0)
    guard.admit(scan(0), UTC_S, 1000.0)
    with pytest.raises(ScanRefusedError):
        guard.admit(scan(1), UTC_S + 5.0, 1016.0)
    guard.forget_delays()
    assert guard.admit(scan(2), UTC_S + 10.0, 1021.0).time_monotonic_s == 1021.0


@pytest.mark.parametrize(("stamp_s", "words"), [(31.0, "31.0 s ahead of"), (-31.0, "31.0 s behind")])
def test_the_refusal_of_a_skewed_scan_says_whether_it_is_ahead_of_or_behind_the_clock(stamp_s, words):
    desk = Desk()
    desk.take(signed(scan(0, time_s=stamp_s)))
    assert desk.counts == {"skewed": 1}
    assert f"is stamped {words} this machine's clock, more than 30 s" in desk.reason


def test_a_scan_may_be_ten_seconds_later_than_the_fastest_and_no_more():
    desk = Desk()
    desk.follow(scan(0))
    desk.take(signed(scan(1)), time_s=15.0)
    assert desk.counts == {"accepted": 2}
    desk.take(signed(scan(2)), time_s=20.125)
    assert desk.counts == {"accepted": 2, "late": 1}


def test_the_followed_session_is_never_forgotten_among_very_many_others():
    desk = Desk()
    desk.follow(scan(0))
    for number in range(100):
        desk.follow(scan(0, time_s=1.0 + 0.1 * number, session=f"run-{number}"))
        desk.follow(
            replace(scan(1 + number), time_utc_s=UTC_S + 1.05 + 0.1 * number, time_monotonic_s=71.05 + 0.1 * number)
        )
    assert sessions(desk) == ["first"] + [name for n in range(100) for name in (f"run-{n}", "first")]
