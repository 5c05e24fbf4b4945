"""Receivers on real sockets: what arrives over loopback, IPv6 and multicast, and where none can listen."""

import asyncio
import socket
from dataclasses import asdict

import pytest

from daemon.base.addresses import BridgeError
from daemon.bridge import senml
from daemon.bridge.receiver import BridgeReceiver
from daemon.bridge.sender import BridgeSender
from daemon.config.links import BridgeSettings
from tests.daemon.bridge.desk import GOOD, KEY, SETTINGS, HandClock, place_of, port, scan, signed, until_examined


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


def groups(*names):
    """Settings of processes that hear these groups on one free port of this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("0.0.0.0", 0))
        number = probe.getsockname()[1]
    return [
        BridgeSettings(
            listen=f"0.0.0.0:{number}",
            send_to=(),
            multicast_group=f"{name}:{number}",
            multicast_interface="127.0.0.1",
        )
        for name in names
    ]


async def send_to_group(settings, clock, sent):
    sender = BridgeSender(settings, KEY, clock)
    await sender.open()
    sender.send(sent)
    failed = sender.statistics[0].last_error
    await sender.close()
    if failed:
        pytest.skip(f"multicast does not work here: {failed}")


def test_one_multicast_send_reaches_every_process_of_the_group_on_one_machine():
    async def main():
        (settings,) = groups("239.255.20.71")
        try:
            async with (
                port(settings) as (_, clock, scans, settle),
                port(settings) as (_, _, others, others_settle),
            ):
                await send_to_group(settings, clock, scan())
                await settle(1)
                await others_settle(1)
                assert [got.sequence for got in (*scans, *others)] == [0, 0]
        except BridgeError as error:
            pytest.skip(f"multicast does not work here: {error}")

    asyncio.run(main())


def test_a_group_that_another_process_of_the_machine_has_joined_is_not_heard():
    async def main():
        own, other = groups("239.255.20.71", "239.255.20.72")
        try:
            async with (
                port(own) as (_, clock, scans, settle),
                port(other) as (_, _, others, others_settle),
            ):
                await send_to_group(other, clock, scan(0))
                await send_to_group(own, clock, scan(1))
                await settle(1)
                await others_settle(1)
                assert [[got.sequence for got in each] for each in (scans, others)] == [[1], [0]]
        except BridgeError as error:
            pytest.skip(f"multicast does not work here: {error}")

    asyncio.run(main())


def test_a_multicast_group_without_an_interface_setting_is_joined_if_a_network_leads_to_it():
    settings = BridgeSettings(listen="0.0.0.0:20578", multicast_group="239.255.20.71:20578")
    receiver = BridgeReceiver(settings, KEY, HandClock(), print)

    async def main():
        await receiver.open()
        # Hearing nothing because there is no network is right too.
        assert receiver.down_why is None or "no network of this machine leads to it" in receiver.down_why
        await receiver.close()

    asyncio.run(main())


def test_a_bridge_port_in_use_is_refused_with_its_address_and_a_remedy():
    async def main():
        async with port() as (receiver, *_):
            second = BridgeReceiver(BridgeSettings(listen=receiver.address), KEY, HandClock(), print)
            with pytest.raises(BridgeError, match="in use by another program: stop that program") as caught:
                await second.open()
            assert receiver.address in str(caught.value)

    asyncio.run(main())


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
