"""Only authentic, fresh, ordered scans of one cube come through; everything else is counted under its name."""

import logging
import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.base.addresses import BridgeError
from daemon.bridge import senml
from daemon.bridge.receiver import BridgeReceiver
from daemon.config.links import BridgeSettings
from tests.daemon.bridge.desk import GOOD, KEY, Desk, HandClock, scan, signed


@given(st.binary(max_size=3000), st.booleans())
def test_arbitrary_bytes_never_raise_and_never_reach_control(datagram, with_key):
    desk = Desk(KEY) if with_key else Desk(None, insecure=True)
    desk.take(datagram)
    assert desk.scans == []
    assert sum(desk.counts.values()) == 1


@given(st.integers(0, len(GOOD) * 8 - 1))
def test_a_signed_datagram_with_any_bit_flipped_is_refused(bit):
    desk = Desk()
    flipped = bytearray(GOOD)
    flipped[bit // 8] ^= 1 << bit % 8
    desk.take(bytes(flipped))
    assert desk.scans == []
    desk.take(GOOD)
    assert len(desk.scans) == 1


@given(st.lists(st.integers(0, 40), min_size=1, max_size=80))
def test_scans_come_out_in_rising_order_and_counts_add_up_whatever_order_they_arrive_in(numbers):
    desk = Desk()
    for number in numbers:
        desk.take(signed(scan(number, time_s=0.01 * number)), time_s=0.5)
    got = [item.sequence for item in desk.scans]
    assert got == sorted(set(got))
    times = [item.time_monotonic_s for item in desk.scans]
    assert times == sorted(times)
    statistics = desk.receiver.statistics
    assert statistics.accepted + statistics.duplicate + statistics.reordered == len(numbers)
    span = range(numbers[0], max(numbers) + 1)
    assert statistics.lost == len(span) - len(set(numbers) & set(span))
    assert statistics.accepted + statistics.reordered == len(set(numbers))


def test_a_sequence_number_far_behind_counts_as_a_replay():
    desk = Desk()
    desk.follow(scan(0), scan(100, time_s=5.0))
    desk.take(signed(scan(0)))
    assert desk.counts == {"accepted": 2, "lost": 99, "replayed": 1}


def test_a_leap_to_the_largest_sequence_number_counts_its_lost_scans_and_takes_no_memory():
    desk = Desk()
    desk.follow(scan(0), scan(2**53 - 1, time_s=5.0))
    assert desk.counts == {"accepted": 2, "lost": 2**53 - 2}


def test_a_restarted_cube_is_followed_at_once_and_late_scans_of_its_old_session_are_not():
    desk = Desk()
    desk.follow(scan(7, time_s=0.0), scan(0, time_s=5.0, session="second"))
    desk.take(signed(scan(7, time_s=0.0)), time_s=10.0)
    assert [got.session for got in desk.scans] == ["first", "second"]
    assert desk.counts == {"accepted": 2, "replayed": 1}
    assert "has been replaced" in desk.reason


def test_a_recorded_session_cannot_be_played_again_to_a_receiver_that_remembers_a_later_scan():
    desk = Desk()
    recorded = [scan(number) for number in range(3)]
    desk.follow(*recorded, scan(0, time_s=15.0, session="second"))
    # The attacker replays at once and leaves nothing out: stamps within the skew, numbers in order.
    for _ in range(2):
        for sent in recorded:
            desk.take(signed(sent))
            desk.take(signed(replace(sent, session="unknown")))
    assert len(desk.scans) == 4
    assert desk.counts == {"accepted": 4, "replayed": 12}


def test_a_session_forgotten_among_200_newer_ones_still_cannot_return():
    desk = Desk()
    for number in range(200):
        desk.follow(scan(0, time_s=0.1 * number, session=f"run-{number}"))
    desk.take(signed(scan(0, time_s=0.0, session="run-0")))
    assert desk.counts == {"accepted": 200, "replayed": 1}


def test_a_second_cube_is_refused_while_the_first_is_fresh_and_followed_when_it_is_gone():
    desk = Desk()
    desk.follow(scan(0))
    for time_s in (1.0, 59.0, 61.0):
        desk.follow(scan(int(time_s), time_s=time_s, source="other"))
    assert [got.source for got in desk.scans] == ["cube", "other"]
    assert desk.counts == {"accepted": 2, "other_source": 2}
    assert "bridge.accept_from" in desk.reason
    desk.follow(scan(13, time_s=65.0))
    assert desk.counts["other_source"] == 3
    desk.follow(scan(30, time_s=150.0))
    assert desk.scans[-1].source == "cube"


def test_only_listed_senders_are_heard():
    desk = Desk(accept_from=("192.168.1.10", "fd00::10"))
    desk.take(GOOD)
    assert desk.counts == {"refused_sender": 1}
    desk.take(GOOD, peer=("::ffff:192.168.1.10", 5, 0, 0))
    desk.take(signed(scan(1)), peer=("fd00:0::10", 5, 0, 0))
    assert desk.counts == {"refused_sender": 1, "accepted": 2}


def test_scans_over_another_transport_are_judged_like_datagrams_but_need_no_listed_address():
    desk = Desk(accept_from=("192.168.1.10",))
    desk.receiver.take(GOOD, "the broker")
    desk.receiver.take(GOOD, "the broker")
    desk.receiver.take(b"x" * 2048, "the broker")
    desk.receiver.take(b"x" * 2049, "the broker")
    assert [got.time_monotonic_s for got in desk.scans] == [1000.0]
    assert desk.counts == {"accepted": 1, "duplicate": 1, "malformed": 1, "oversized": 1}
    assert desk.reason.startswith("oversized: a datagram from the broker has 2049 bytes")


def test_a_receiver_without_a_key_never_takes_signed_scans_and_says_why():
    desk = Desk(None, insecure=True)
    desk.take(GOOD)
    assert desk.counts == {"forged": 1}
    assert "set bridge.key_file" in desk.reason
    desk.take(senml.encode(scan()))
    assert desk.counts == {"forged": 1, "accepted": 1}


def test_a_refusal_names_its_kind_its_sender_and_its_reason():
    desk = Desk(None, insecure=True)
    desk.take(b"hello")
    assert desk.reason.startswith("malformed: a datagram from 127.0.0.1:40000 is not JSON")


def test_a_day_of_forged_and_malformed_datagrams_logs_at_most_ten_lines_and_its_end(caplog):
    caplog.set_level(logging.INFO)
    desk = Desk()
    desk.follow(scan(0))
    choice = random.Random(1)
    forged = signed(scan(1), bytes(32))
    for minute in range(1, 24 * 60):
        desk.take(choice.choice([forged, b"hello", b"x" * 3000]), time_s=60.0 * minute)
    desk.follow(scan(1, time_s=86400.0), scan(2, time_s=86405.0))
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) <= 10
    assert "127.0.0.1:40000" in lines[0]
    for kind in ("forged", "malformed", "oversized"):
        assert sum(line.startswith(kind) for line in lines) == 1
    assert "accepted again" in lines[-1]
    assert desk.counts["accepted"] == 3


def test_a_network_that_doubles_every_datagram_is_reported_once(caplog):
    desk = Desk()
    for number in range(200):
        desk.follow(scan(number), scan(number))
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert desk.counts == {"accepted": 200, "duplicate": 200}


@pytest.mark.parametrize(
    ("settings", "key", "words"),
    [
        ({}, None, "bridge.key_file is not set"),
        ({"multicast_group": "239.255.20.71:20571"}, KEY, "listen on 0.0.0.0:20571"),
        ({"listen": "0.0.0.0:1", "multicast_group": "239.255.20.71:20571"}, KEY, "must be the same"),
    ],
)
def test_missing_or_contradictory_bridge_settings_are_refused_with_the_reason(settings, key, words):
    with pytest.raises(BridgeError) as caught:
        BridgeReceiver(BridgeSettings(**settings), key, HandClock(), print)
    assert words in str(caught.value)
