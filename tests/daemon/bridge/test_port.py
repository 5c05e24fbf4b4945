"""However the port is flooded, the cube's scans come through, and the port stays the tracker's own."""

import asyncio
import itertools
import socket
import struct
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from daemon.base.addresses import BridgeError
from daemon.base.timeloop import ScaledTimeLoop
from daemon.bridge.receiver import BridgeReceiver
from daemon.config.links import BridgeSettings
from tests.daemon.bridge.desk import KEY, HandClock, place_of, port, scan, signed
from tests.support import PATIENCE_S

SO_TIMESTAMPNS = 35
only_linux = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux hands a peer's datagrams to a line of its own"
)


async def until_accepted(receiver, number):
    async with asyncio.timeout(PATIENCE_S):
        while receiver.statistics.accepted < number:  # noqa: ASYNC110 - the loop has to go round
            await asyncio.sleep(0)


def udp():
    return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


@only_linux
@pytest.mark.parametrize("listen", ["127.0.0.1:0", "0.0.0.0:0"])
def test_a_flood_that_overflows_the_bridge_port_loses_no_scan_of_the_cube(listen):
    async def main():
        async with port(BridgeSettings(listen=listen)) as (receiver, _, scans, settle):
            place = place_of(receiver)
            with udp() as cube, udp() as attacker:
                cube.sendto(signed(scan(0)), place)
                await settle(1)
                sent = 0
                for number in range(1, 6):
                    # Nobody reads meanwhile, and the kernel keeps far less than this for a socket.
                    for _ in range(4000):
                        attacker.sendto(b"x" * 2000, place)
                        sent += 1
                    cube.sendto(signed(scan(number, time_s=0.1 * number)), place)
                await until_accepted(receiver, 6)
                assert [got.sequence for got in scans] == list(range(6))
                assert receiver.statistics.malformed < sent, "the flood was not one"

    asyncio.run(main())


@only_linux
def test_an_attacker_sending_copies_of_scans_ahead_of_the_cube_does_not_take_its_socket():
    async def main():
        async with port() as (receiver, _, scans, settle):
            place = place_of(receiver)
            with udp() as cube, udp() as attacker:
                cube.sendto(signed(scan(0)), place)
                await settle(1)
                for number in range(1, 10):
                    datagram = signed(scan(number, time_s=0.1 * number))
                    attacker.sendto(datagram, place)
                    await until_accepted(receiver, number + 1)
                    cube.sendto(datagram, place)
                    await settle(2 * number + 1)
                for _ in range(4000):
                    attacker.sendto(b"x" * 2000, place)
                cube.sendto(signed(scan(10, time_s=1.0)), place)
                await until_accepted(receiver, 11)
            assert [got.sequence for got in scans] == list(range(11))

    asyncio.run(main())


def test_a_cube_that_comes_back_from_another_port_is_heard_as_before():
    async def main():
        async with port() as (receiver, clock, scans, settle):
            for number in range(4):
                with udp() as cube:
                    cube.sendto(signed(scan(number)), place_of(receiver))
                    await settle(number + 1)
                clock.now_s += 5.0
            assert [got.sequence for got in scans] == [0, 1, 2, 3]

    asyncio.run(main())


def test_senders_in_turn_are_all_heard_although_they_outnumber_the_connected_sockets():
    async def main():
        async with port() as (receiver, clock, scans, settle):
            with ExitStack() as stack:
                senders = [stack.enter_context(udp()) for _ in range(6)]
                for number in range(40):
                    senders[number % 6].sendto(signed(scan(number)), place_of(receiver))
                    await settle(number + 1)
                    clock.now_s += 5.0
            assert [got.sequence for got in scans] == list(range(40))

    asyncio.run(main())


def lines_on(place):
    """Return the remote ports of the sockets that are connected on this port, as the kernel lists them."""
    rows = [row.split() for row in Path("/proc/net/udp").read_text().splitlines()[1:]]
    ends = [[int(end.partition(":")[2], 16) for end in row[1:3]] for row in rows]
    return {remote for local, remote in ends if local == place[1] and remote != 0}


@only_linux
def test_the_longest_silent_sender_loses_its_connected_socket_to_a_newcomer_after_a_minute():
    async def main():
        async with port() as (receiver, clock, _, settle):
            with ExitStack() as stack:
                senders = [stack.enter_context(udp()) for _ in range(5)]
                begin_s = clock.now_s
                at_s = (0.0, 1.0, 2.0, 3.0, 30.0, 59.0, 62.0)
                having = []
                for number, sender in enumerate((0, 1, 2, 3, 0, 4, 4)):
                    clock.now_s = begin_s + at_s[number]
                    datagram = signed(scan(number, time_s=at_s[number]))
                    senders[sender].sendto(datagram, place_of(receiver))
                    await settle(number + 1)
                    having.append(lines_on(place_of(receiver)))
                own = [sender.getsockname()[1] for sender in senders]
            assert receiver.statistics.accepted == 7
            assert having[3] == having[5] == set(own[:4])
            assert having[6] == {own[0], own[2], own[3], own[4]}

    asyncio.run(main())


def test_no_other_program_can_take_the_bridge_port_while_a_cube_is_connected_to_it():
    async def main():
        async with port() as (receiver, _, _, settle):
            with udp() as cube, udp() as thief:
                cube.sendto(signed(scan(0)), place_of(receiver))
                await settle(1)
                second = BridgeReceiver(BridgeSettings(listen=receiver.address), KEY, HandClock(), print)
                with pytest.raises(BridgeError, match="in use by another program"):
                    await second.open()
                if sys.platform == "linux":
                    thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    with pytest.raises(OSError, match="in use"):
                        thief.bind(place_of(receiver))

    asyncio.run(main())


def test_a_flood_does_not_keep_the_other_tasks_of_the_loop_waiting():
    async def main():
        async with port() as (receiver, *_):
            with udp() as attacker:
                for _ in range(640):
                    attacker.sendto(b"x", place_of(receiver))
                read = [0]
                while read[-1] < 640:
                    await asyncio.sleep(0)
                    read.append(receiver.statistics.malformed)
                    assert len(read) < 10_000
            most = max(now - before for before, now in itertools.pairwise(read))
            assert most == 64, "a round of the loop takes a part of what waits, and no more"

    asyncio.run(main())


class Manager:
    """Does what systemd does with a socket that it is given: it holds a copy, and hands it to the next process."""

    def __init__(self):
        self.held = {}

    def store_socket(self, name, opened):
        self.held[name] = opened.dup()

    def take_stored_socket(self, name):
        for other in set(self.held) - {name}:
            self.held.pop(other).close()
        return self.held[name].dup() if name in self.held else None


@pytest.fixture
def stamps():
    """Have the kernel stamp arriving datagrams: it begins some time after the first socket asks for it.

    A datagram that came before is stamped when it is read. For a service that reads at once that is the same time.
    """
    with udp() as asking:
        asking.bind(("127.0.0.1", 0))
        asking.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        for wait_s in (0.02, *[0.1] * 600):
            asking.sendto(b"?", asking.getsockname())
            time.sleep(wait_s)
            read_s = time.time()
            _, [(_, _, stamp)], _, _ = asking.recvmsg(16, 64)
            seconds, nanoseconds = struct.unpack("@ll", stamp)
            if seconds + nanoseconds / 1e9 < read_s - wait_s / 2:
                break
        yield


@pytest.fixture
def manager():
    manager = Manager()
    yield manager
    for each in manager.held.values():
        each.close()


@only_linux
@pytest.mark.usefixtures("stamps")
def test_scans_that_arrive_while_the_service_restarts_are_heard_and_dated_by_their_arrival(manager):
    async def main():
        clock, scans = HandClock(), []
        before = BridgeReceiver(BridgeSettings(listen="127.0.0.1:0"), KEY, clock, scans.append, manager)
        await before.open()
        place = place_of(before)
        with udp() as cube:
            cube.sendto(signed(scan(0)), place)
            await until_accepted(before, 1)
            began_s = time.monotonic()
            # By both ways in: over the cube's own connected socket, and over the port.
            cube.sendto(signed(scan(1, time_s=0.5)), place)
            await before.close()
            cube.sendto(signed(scan(2, time_s=0.6)), place)
            time.sleep(1.0)  # noqa: ASYNC251 - there is nobody else
            clock.now_s += 2.0
            after = BridgeReceiver(BridgeSettings(listen="127.0.0.1:0"), KEY, clock, scans.append, manager)
            after.bind()
            await asyncio.sleep(0.01)
            assert [got.sequence for got in scans] == [0, 1], "heard before anybody asked"
            await after.open()
            assert [got.sequence for got in scans] == [0, 1, 2]
            waited_s = time.monotonic() - began_s
            assert clock.now_s - waited_s <= scans[2].time_monotonic_s <= clock.now_s - 1.0
            cube.sendto(signed(scan(3, time_s=2.0)), place)
            await until_accepted(after, 2)
            assert scans[3].time_monotonic_s == clock.now_s
            await after.close()

    asyncio.run(main())


@only_linux
@pytest.mark.parametrize(("set_on_s", "waited_s"), [(290.0, 290.0), (310.0, 0.0), (-10.0, 0.0)])
def test_a_scan_that_waited_290_s_is_dated_by_arrival_and_one_of_310_s_or_from_the_future_now(
    manager, monkeypatch, set_on_s, waited_s
):
    async def main():
        clock, scans, true_s = HandClock(), [], time.time
        settings = BridgeSettings(listen="127.0.0.1:0")
        before = BridgeReceiver(settings, KEY, clock, scans.append, manager)
        before.bind()
        with udp() as cube:
            cube.sendto(signed(scan(0)), place_of(before))
        await before.close()
        monkeypatch.setattr(time, "time", lambda: true_s() + set_on_s)
        clock.now_s += waited_s
        after = BridgeReceiver(settings, KEY, clock, scans.append, manager)
        await after.open()
        assert [got.time_monotonic_s for got in scans] == [pytest.approx(clock.now_s - waited_s, abs=5.0)]
        await after.close()

    asyncio.run(main())


def group_on_loopback():
    with udp() as probe:
        probe.bind(("0.0.0.0", 0))
        number = probe.getsockname()[1]
    return BridgeSettings(
        listen=f"0.0.0.0:{number}", multicast_group=f"239.255.20.71:{number}", multicast_interface="127.0.0.1"
    )


@only_linux
@pytest.mark.parametrize("restarted", [False, True])
def test_a_multicast_group_is_heard_again_after_the_kernel_has_dropped_its_membership(manager, restarted):
    loopback = socket.inet_aton("127.0.0.1")

    async def main():
        scans, settings = [], group_on_loopback()
        receiver = BridgeReceiver(settings, KEY, HandClock(), scans.append, manager)
        try:
            receiver.bind()
        except BridgeError as error:
            pytest.skip(f"multicast does not work here: {error}")
        await receiver.open()
        (held,) = manager.held.values()
        held.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, socket.inet_aton("239.255.20.71") + loopback)
        if restarted:
            await receiver.close()
            receiver = BridgeReceiver(settings, KEY, HandClock(), scans.append, manager)
            await receiver.open()
        with udp() as cube:
            cube.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            for number in range(100):
                cube.sendto(signed(scan(number, time_s=0.1 * number)), ("239.255.20.71", place_of(receiver)[1]))
                await asyncio.sleep(0.2)
                if scans:
                    break
        await receiver.close()
        assert scans
        assert number == 0 or not restarted, "the next process hears from its start"

    with asyncio.Runner(loop_factory=lambda: ScaledTimeLoop(50.0)) as runner:
        runner.run(main())


@only_linux
def test_a_kept_socket_of_other_settings_is_not_used_for_another_address(manager):
    async def main():
        first = BridgeReceiver(BridgeSettings(listen="127.0.0.1:0"), KEY, HandClock(), print, manager)
        second = BridgeReceiver(BridgeSettings(listen="0.0.0.0:0"), KEY, HandClock(), print, manager)
        first.bind()
        second.bind()
        assert len(manager.held) == 1
        assert first.address != second.address
        await first.close()
        await second.close()

    asyncio.run(main())
