"""Two cubes under one name and key: the elder is followed, the other steers nothing, and nothing old is ever new."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from tests.daemon.bridge.test_receiver import UTC_S, Desk, scan, signed


def follow_both(desk, first_s, last_s, second="second", second_from_s=0.0):
    """Let both cubes send every 5 s, the second one 2 s after the first."""
    for time_s in range(first_s, last_s, 5):
        desk.follow(scan(time_s // 5, time_s=time_s))
        if time_s >= second_from_s:
            desk.follow(scan(time_s // 5, time_s=time_s + 2.0, session=second))


def sessions(desk):
    return [got.session for got in desk.scans]


def test_a_second_cube_that_was_started_by_mistake_costs_the_first_one_no_scan():
    desk = Desk()
    desk.follow(*(scan(number) for number in range(4)))
    follow_both(desk, 20, 40)
    desk.follow(*(scan(number) for number in range(8, 20)))
    assert [got.sequence for got in desk.scans if got.session == "first"] == list(range(20))
    # Its beginning could have been a restart of the first one.
    assert sessions(desk).count("second") == 1
    assert desk.counts == {"accepted": 21, "second_cube": 3}
    assert "the session second, a second cube under the name cube, while the session first is followed" in desk.reason


def test_a_first_cube_that_was_silent_meanwhile_is_followed_again_at_once():
    desk = Desk()
    desk.follow(scan(0), *(scan(number, time_s=5.0 + 5.0 * number, session="second") for number in range(4)))
    desk.follow(*(scan(number) for number in range(5, 9)))
    assert sessions(desk) == ["first"] + ["second"] * 4 + ["first"] * 4
    assert desk.counts == {"accepted": 9, "lost": 4}


def test_the_second_cube_is_followed_when_the_first_has_been_silent_for_a_minute_and_no_longer_than_that():
    desk = Desk()
    follow_both(desk, 0, 15)
    desk.follow(*(scan(number, time_s=5.0 * number + 2.0, session="second") for number in range(3, 20)))
    assert desk.scans[-1].session == "second"
    waited_s = next(got.time_utc_s for got in desk.scans[-8:] if got.session == "second") - UTC_S - 10.0
    assert 60.0 <= waited_s < 66.0
    assert "lost" not in desk.counts, "what was refused has not been lost"
    desk.follow(scan(25), scan(26), scan(25, time_s=132.0, session="second"))
    assert sessions(desk)[-2:] == ["first", "first"]


def test_a_restart_of_the_first_cube_is_followed_beside_a_second_one():
    desk = Desk()
    follow_both(desk, 0, 15)
    for number in range(4):
        desk.follow(scan(number, time_s=20.0 + 5 * number, session="anew"))
        desk.follow(scan(4 + number, time_s=22.0 + 5 * number, session="second"))
    assert sessions(desk)[-4:] == ["anew"] * 4
    assert desk.counts["second_cube"] == 2 + 4


def test_what_two_cubes_have_sent_cannot_be_played_again():
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
def test_whoever_sends_and_whatever_is_replayed_no_scan_comes_through_twice_and_stamps_rise_between_sessions(sent):
    desk = Desk()
    for number, (session, back) in enumerate(sent):
        # `back` numbers ago: what is recorded comes again between what is new.
        made = max(number - back, 0)
        desk.take(signed(scan(made, time_s=0.3 * made, session=session)), time_s=0.3 * number)
    came = [(got.session, got.sequence) for got in desk.scans]
    assert len(came) == len(set(came))
    stamps = [got.time_utc_s for got in desk.scans]
    assert stamps == sorted(stamps)


def test_of_very_many_sessions_the_one_that_is_followed_is_never_forgotten():
    desk = Desk()
    desk.follow(scan(0))
    for number in range(100):
        desk.follow(scan(0, time_s=1.0 + 0.1 * number, session=f"run-{number}"))
        desk.follow(
            replace(scan(1 + number), time_utc_s=UTC_S + 1.05 + 0.1 * number, time_monotonic_s=71.05 + 0.1 * number)
        )
    assert sessions(desk) == ["first"] + [name for n in range(100) for name in (f"run-{n}", "first")]
