"""Only authentic, fresh, ordered scans of one cube come through; everything else is counted under its name."""

import asyncio
import logging
import random
import socket
from contextlib import asynccontextmanager
from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.base.addresses import BridgeError, parse_address
from daemon.base.records import FaceReading, Quality, Scan
from daemon.bridge import senml, signing
from daemon.bridge.receiver import BridgeReceiver
from daemon.bridge.sender import BridgeSender
from daemon.config.links import BridgeSettings

KEY = bytes(range(1, 33))
UTC_S = 1665742815.0
PEER = ("127.0.0.1", 40000)
SETTINGS = BridgeSettings(listen="127.0.0.1:0")


class HandClock:
    """The receiver's clock, moved by the test; UTC may be set apart from it."""

    def __init__(self):
        self.now_s = 1000.0
        self.utc_offset_s = UTC_S

    def monotonic(self):
        return self.now_s

    def utc(self):
        return self.now_s - 1000.0 + self.utc_offset_s


def scan(sequence=0, time_s=None, **changes):
    """The scan that a cube finishes `time_s` seconds (5 per number by default) after the test's beginning."""
    time_s = 5.0 * sequence if time_s is None else time_s
    utc_s, steady_s = UTC_S + time_s, 70.0 + time_s
    east, south, west, zenith = (
        FaceReading(100.0 + i, Quality.OK, utc_s - age_s, steady_s - age_s)
        for i, age_s in enumerate((0.75, 0.5, 0.25, 0.0))
    )
    return replace(Scan("cube", "first", sequence, utc_s, steady_s, east, south, west, zenith), **changes)


def signed(sent, key=KEY):
    return signing.sign(senml.encode(sent), key)


def place_of(receiver):
    address = parse_address(receiver.address)
    return address.host, address.port


class Desk:
    """A receiver without a socket: datagrams are handed in, each at its own time."""

    def __init__(self, key=KEY, **settings):
        self.clock = HandClock()
        self.scans = []
        self.receiver = BridgeReceiver(BridgeSettings(**settings), key, self.clock, self.scans.append)

    def take(self, datagram, time_s=None, peer=PEER):
        if time_s is not None:
            self.clock.now_s = 1000.0 + time_s
        self.receiver.datagram_received(datagram, peer)

    def follow(self, *scans):
        """Take each scan at the instant at which it was made."""
        for sent in scans:
            self.take(signed(sent), sent.time_monotonic_s - 70.0)

    @property
    def counts(self):
        """The counters that are not zero."""
        return {
            name: value for name, value in asdict(self.receiver.statistics).items() if isinstance(value, int) and value
        }

    @property
    def reason(self):
        return self.receiver.statistics.last_refusal


async def until_examined(receiver, expected):
    """Let the loop run until the receiver has examined so many datagrams."""
    async with asyncio.timeout(60):
        while True:
            counts = receiver.statistics
            if counts.accepted + counts.refused >= expected:
                return
            await asyncio.sleep(0)


@asynccontextmanager
async def port(settings=SETTINGS, key=KEY):
    """An open receiver on a real port, its clock, its scans, and a function that waits for so many datagrams."""
    clock, scans = HandClock(), []
    receiver = BridgeReceiver(settings, key, clock, scans.append)

    async def settle(expected):
        await until_examined(receiver, expected)

    await receiver.open()
    try:
        yield receiver, clock, scans, settle
    finally:
        await receiver.close()


def test_over_a_real_socket_good_scans_arrive_and_every_bad_datagram_is_counted_under_its_name():
    async def main():
        async with port() as (receiver, clock, scans, settle):
            target = place_of(receiver)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                datagrams = [
                    signed(scan(0)),
                    signed(scan(1)),
                    signed(scan(1)),
                    signed(scan(4)),
                    signed(scan(3)),
                    signed(scan(5))[:300],
                    b"",
                    signed(scan(5), bytes(32)),
                    senml.encode(scan(5)),
                    b"x" * 2048,
                    b"x" * 2049,
                    b"x" * 60_000,
                    signed(scan(5, source="other")),
                    signed(scan(0, session="second", time_s=-1.0)),
                    signed(scan(5, time_s=31.0)),
                    signed(scan(6)),
                ]
                clock.now_s += 25.0
                clock.utc_offset_s -= 25.0
                for datagram in datagrams:
                    sender.sendto(datagram, target)
                await settle(len(datagrams))
            assert [got.sequence for got in scans] == [0, 1, 4, 6]
            statistics = asdict(receiver.statistics)
            assert {name: value for name, value in statistics.items() if isinstance(value, int) and value} == {
                "accepted": 4,
                "lost": 1,
                "duplicate": 1,
                "reordered": 1,
                "malformed": 3,
                "forged": 2,
                "oversized": 2,
                "other_source": 1,
                "replayed": 1,
                "skewed": 1,
            }
            assert statistics["last_refusal_utc_s"] == clock.utc()

    asyncio.run(main())


def test_sender_and_receiver_agree_over_loopback_with_and_without_a_key_and_over_ipv6():
    async def main(listen, key, insecure):
        settings = BridgeSettings(listen=listen, insecure=insecure)
        async with port(settings, key) as (receiver, clock, scans, settle):
            sender = BridgeSender(BridgeSettings(send_to=(receiver.address,), insecure=insecure), key, clock)
            await sender.open()
            sender.send(scan())
            await settle(1)
            await sender.close()
            assert [got.sequence for got in scans] == [0]

    asyncio.run(main("127.0.0.1:0", KEY, insecure=False))
    asyncio.run(main("127.0.0.1:0", None, insecure=True))
    if socket.has_ipv6:
        try:
            asyncio.run(main("[::1]:0", KEY, insecure=False))
        except BridgeError as error:
            pytest.skip(f"there is no IPv6 here: {error}")


def test_one_multicast_send_reaches_every_process_of_the_group_on_one_machine():
    async def main():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("0.0.0.0", 0))
            number = probe.getsockname()[1]
        settings = BridgeSettings(
            listen=f"0.0.0.0:{number}",
            send_to=(),
            multicast_group=f"239.255.20.71:{number}",
            multicast_interface="127.0.0.1",
        )
        try:
            async with (
                port(settings) as (_, clock, scans, settle),
                port(settings) as (_, _, others, others_settle),
            ):
                sender = BridgeSender(settings, KEY, clock)
                await sender.open()
                sender.send(scan())
                failed = sender.statistics[0].last_error
                await sender.close()
                if failed:
                    pytest.skip(f"multicast does not work here: {failed}")
                await settle(1)
                await others_settle(1)
                assert [got.sequence for got in (*scans, *others)] == [0, 0]
        except BridgeError as error:
            pytest.skip(f"multicast does not work here: {error}")

    asyncio.run(main())


@given(st.binary(max_size=3000), st.booleans())
def test_arbitrary_bytes_never_raise_and_never_reach_control(datagram, with_key):
    desk = Desk(KEY) if with_key else Desk(None, insecure=True)
    desk.take(datagram)
    assert desk.scans == []
    assert sum(desk.counts.values()) == 1


GOOD = signed(scan())


@given(st.integers(0, len(GOOD) * 8 - 1))
def test_no_bit_of_a_signed_datagram_can_be_flipped(bit):
    desk = Desk()
    flipped = bytearray(GOOD)
    flipped[bit // 8] ^= 1 << bit % 8
    desk.take(bytes(flipped))
    assert desk.scans == []
    desk.take(GOOD)
    assert len(desk.scans) == 1


@given(st.lists(st.integers(0, 40), min_size=1, max_size=80))
def test_whatever_the_network_does_to_the_order_scans_come_out_rising_and_the_counts_add_up(numbers):
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


def test_a_number_that_is_far_behind_is_a_replay():
    desk = Desk()
    desk.follow(scan(0), scan(100, time_s=5.0))
    desk.take(signed(scan(0)))
    assert desk.counts == {"accepted": 2, "lost": 99, "replayed": 1}


def test_a_leap_to_the_largest_number_is_counted_and_takes_no_memory():
    desk = Desk()
    desk.follow(scan(0), scan(2**53 - 1, time_s=5.0))
    assert desk.counts == {"accepted": 2, "lost": 2**53 - 2}


def test_a_restarted_cube_is_followed_at_once_and_what_is_left_of_its_old_session_is_not():
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
    # The attacker waits for nothing and hides nothing: stamps within the skew, numbers in order.
    for _ in range(2):
        for sent in recorded:
            desk.take(signed(sent))
            desk.take(signed(replace(sent, session="unknown")))
    assert len(desk.scans) == 4
    assert desk.counts == {"accepted": 4, "replayed": 12}


def test_many_sessions_are_forgotten_and_still_cannot_return():
    desk = Desk()
    for number in range(200):
        desk.follow(scan(0, time_s=0.1 * number, session=f"run-{number}"))
    desk.take(signed(scan(0, time_s=0.0, session="run-0")))
    assert desk.counts == {"accepted": 200, "replayed": 1}


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


def test_a_scan_that_was_skewed_is_not_lost_as_well():
    desk = Desk()
    desk.follow(scan(0))
    desk.take(signed(scan(1, time_utc_s=UTC_S + 1e4)))
    desk.follow(scan(2))
    assert desk.counts == {"accepted": 2, "skewed": 1}


def test_times_are_rebased_to_the_fastest_way_and_ages_are_kept():
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
        # Its steady clock stood still for an hour.
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


def test_what_comes_over_another_transport_is_judged_like_a_datagram_and_asked_for_no_address():
    desk = Desk(accept_from=("192.168.1.10",))
    desk.receiver.take(GOOD, "the broker")
    desk.receiver.take(GOOD, "the broker")
    desk.receiver.take(b"x" * 2048, "the broker")
    desk.receiver.take(b"x" * 2049, "the broker")
    assert [got.time_monotonic_s for got in desk.scans] == [1000.0]
    assert desk.counts == {"accepted": 1, "duplicate": 1, "malformed": 1, "oversized": 1}
    assert desk.reason.startswith("oversized: a datagram from the broker has 2049 bytes")


def test_what_waited_is_judged_and_dated_by_when_it_came():
    desk = Desk()
    desk.clock.now_s += 40.0
    desk.receiver.datagram_received(GOOD, PEER, 40.0)
    assert [got.time_monotonic_s for got in desk.scans] == [1000.0]


def test_a_group_is_heard_without_an_interface_where_this_machine_has_one():
    settings = BridgeSettings(listen="0.0.0.0:20578", multicast_group="239.255.20.71:20578")
    receiver = BridgeReceiver(settings, KEY, HandClock(), print)
    try:
        receiver.bind()
    except BridgeError as error:
        assert "cannot be joined" in str(error)  # noqa: PT017 - no network is as good
    finally:
        asyncio.run(receiver.close())


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


def test_a_day_of_forged_and_malformed_datagrams_writes_few_lines_and_the_end_is_told(caplog):
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


def test_a_port_in_use_is_one_sentence_with_the_address_and_a_remedy():
    async def main():
        async with port() as (receiver, *_):
            second = BridgeReceiver(BridgeSettings(listen=receiver.address), KEY, HandClock(), print)
            with pytest.raises(BridgeError, match="in use by another program: stop that program") as caught:
                await second.open()
            assert receiver.address in str(caught.value)

    asyncio.run(main())


def test_an_address_of_another_machine_cannot_be_listened_on():
    receiver = BridgeReceiver(BridgeSettings(listen="192.0.2.1:20571"), KEY, HandClock(), print)
    with pytest.raises(BridgeError, match=r"192\.0\.2\.1:20571 is not an address of this machine"):
        asyncio.run(receiver.open())


def test_a_group_that_cannot_be_joined_is_one_sentence():
    settings = BridgeSettings(
        listen="0.0.0.0:20579", multicast_group="239.255.20.71:20579", multicast_interface="192.0.2.1"
    )
    with pytest.raises(BridgeError, match=r"cannot be joined .* set bridge\.multicast_interface"):
        asyncio.run(BridgeReceiver(settings, KEY, HandClock(), print).open())


def test_a_receiver_on_every_network_is_reached_by_this_machine_over_loopback():
    async def main(listen, reached):
        receiver = BridgeReceiver(BridgeSettings(listen=listen), KEY, HandClock(), print)
        assert receiver.address == reached

    asyncio.run(main("0.0.0.0:20571", "127.0.0.1:20571"))
    asyncio.run(main("[::]:20571", "[::1]:20571"))
    asyncio.run(main("192.168.1.20:20571", "192.168.1.20:20571"))


def test_a_receiver_opens_again_after_it_was_closed_and_still_knows_its_session():
    async def main():
        clock, scans = HandClock(), []
        receiver = BridgeReceiver(SETTINGS, KEY, clock, scans.append)
        for expected in (1, 2):
            await receiver.open()
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.sendto(GOOD, place_of(receiver))
            await until_examined(receiver, expected)
            await receiver.close()
        await receiver.close()
        assert (receiver.statistics.accepted, receiver.statistics.duplicate) == (1, 1)

    asyncio.run(main())


@pytest.mark.parametrize(
    ("settings", "key", "words"),
    [
        ({}, None, "bridge.key_file is not set"),
        ({"multicast_group": "239.255.20.71:20571"}, KEY, "listen on 0.0.0.0:20571"),
        ({"listen": "0.0.0.0:1", "multicast_group": "239.255.20.71:20571"}, KEY, "must be the same"),
    ],
)
def test_wrong_settings_are_one_sentence_with_their_key(settings, key, words):
    with pytest.raises(BridgeError) as caught:
        BridgeReceiver(BridgeSettings(**settings), key, HandClock(), print)
    assert words in str(caught.value)
