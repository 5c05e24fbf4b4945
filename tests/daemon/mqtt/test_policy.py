"""What the link does about losses, in virtual time and against a broker that a test scripts byte by byte."""

import asyncio
import contextlib
import gc
import logging
import socket
import tracemalloc
from random import Random

import pytest

from daemon.base.clock import LoopClock
from daemon.base.records import Bus, Decision
from daemon.base.timeloop import VirtualTimeLoop
from daemon.mqtt.link import Link
from daemon.mqtt.outbox import Message
from daemon.mqtt.topics import Topics
from tests.support.mqtt import BrokerRig, settings_for, until

pytestmark = pytest.mark.slow

CONNECT, PUBLISH, SUBSCRIBE, PING = 1, 3, 8, 12


class ScriptedBroker:
    """Answers as MQTT 3.1.1 asks for, and ends each connection after as long as the test wants."""

    def __init__(self, lifetimes_s, says_at_birth=b""):
        self._lifetimes_s = iter(lifetimes_s)
        self._says = says_at_birth
        self.connected_s = []
        self.ended_s = []

    async def serve(self, bound):
        self._server = await asyncio.start_server(self._talk, sock=bound)

    async def close(self):
        self._server.close()
        await self._server.wait_closed()

    async def _talk(self, reader, writer):
        loop, known = asyncio.get_running_loop(), False
        try:
            async with asyncio.timeout(None) as limit:
                while True:
                    kind, body = await _packet(reader)
                    if kind == CONNECT and body[6] == 5:
                        # As MQTT 3.1.1 demands for a protocol version that the broker does not know.
                        writer.write(b"\x20\x02\x00\x01")
                        return
                    if kind == CONNECT:
                        known = True
                        self.connected_s.append(loop.time())
                        limit.reschedule(loop.time() + next(self._lifetimes_s))
                        writer.write(b"\x20\x02\x00\x00")
                    elif kind == SUBSCRIBE:
                        writer.write(b"\x90\x03" + body[:2] + b"\x01")
                    elif kind == PING:
                        writer.write(b"\xd0\x00")
                    elif kind & 0x0F == PUBLISH and body is not None:
                        length = int.from_bytes(body[:2], "big")
                        writer.write(b"\x40\x02" + body[2 + length : 4 + length])
                        writer.write(self._says)
                        self._says = b""
        except (TimeoutError, asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            if known:
                self.ended_s.append(loop.time())
            writer.close()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()


async def _packet(reader):
    first = (await reader.readexactly(1))[0]
    length, shift = 0, 0
    while True:
        byte = (await reader.readexactly(1))[0]
        length |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            break
    body = await reader.readexactly(length)
    return first >> 4, body if first >> 4 != PUBLISH or first & 6 else None


def bound_socket():
    bound = socket.socket()
    bound.bind(("127.0.0.1", 0))
    bound.listen()
    return bound


def link_to(port, bus, loop, **mqtt):
    settings = settings_for(port, mqtt=mqtt).mqtt
    clock = LoopClock(loop.time, 1.6e9)
    return Link(settings, Topics("heliocube", "tracker"), clock, Random(1), bus.publish, 1.0)


def delays_after(lifetimes_s):
    """Return the delays between the end of each connection and the next one."""
    bound = bound_socket()

    async def scenario():
        loop = asyncio.get_running_loop()
        broker = ScriptedBroker(lifetimes_s)
        await broker.serve(bound)
        link = link_to(bound.getsockname()[1], Bus(), loop)
        running = asyncio.create_task(link.run())
        await until(lambda: len(broker.connected_s) == len(lifetimes_s), "all connections", within_s=86400)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        await broker.close()
        await until(lambda: len(broker.ended_s) == len(lifetimes_s), "their ends")
        return [begun - ended for ended, begun in zip(broker.ended_s, broker.connected_s[1:], strict=False)]

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(scenario())


def test_the_reconnect_delay_grows_with_jitter_to_a_minute_when_the_broker_ends_young_connections():
    delays_s = delays_after([5.0] * 10)
    for count, delay_s in enumerate(delays_s):
        longest_s = min(2.0**count, 60.0)
        assert 0.8 * longest_s <= delay_s <= longest_s + 0.5
    assert len({round(delay_s / 60, 4) for delay_s in delays_s[-3:]}) == 3


@pytest.mark.parametrize(("lifetime_s", "short"), [(25.0, False), (35.0, True)])
def test_the_reconnect_delay_is_short_again_only_after_a_connection_has_worked_for_30_s(lifetime_s, short):
    *_, last_s = delays_after([5.0] * 5 + [lifetime_s, 5.0])
    assert (last_s <= 1.5) is short
    assert last_s >= (0.8 if short else 25.0)


def test_hours_without_a_broker_use_bounded_memory_and_few_log_lines(caplog):
    caplog.set_level(logging.INFO, "heliocube")
    bound = bound_socket()
    port = bound.getsockname()[1]
    bound.close()

    async def scenario():
        loop = asyncio.get_running_loop()
        bus = Bus()
        link = link_to(port, bus, loop, queue_messages=100)
        running = asyncio.create_task(link.run())
        await asyncio.sleep(3600)
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(3 * 60):
            for _ in range(12):
                link.send(Message("heliocube/tracker/scan", b"x" * 700))
            await asyncio.sleep(60)
        # Garbage that waits to be collected does not count.
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
        assert link.status.waiting == 100
        assert link.status.dropped == 3 * 60 * 12 - 100
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        return grown

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        grown = runner.run(scenario())
    assert grown < 500_000
    lines = [record.getMessage() for record in caplog.records if record.levelno >= logging.INFO]
    assert 1 <= len(lines) <= 10
    assert f"nothing listens at 127.0.0.1:{port}" in lines[0]


def test_an_unforeseen_failure_counts_as_a_lost_link_and_is_logged_once(caplog):
    caplog.set_level(logging.INFO, "heliocube")

    async def scenario():
        # The resolver raises a UnicodeError for such a name; the configuration refuses it.
        settings = settings_for(1).mqtt.model_copy(update={"host": "broker..lan"})
        clock = LoopClock(asyncio.get_running_loop().time, 1.6e9)
        link = Link(settings, Topics("heliocube", "tracker"), clock, Random(1), Bus().publish, 1.0)
        running = asyncio.create_task(link.run())
        await asyncio.sleep(300)
        assert not running.done()
        assert link.status.down_why.startswith("broker..lan:1 cannot be used: Unicode")
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())
    (line,) = [record.getMessage() for record in caplog.records if record.levelno >= logging.INFO]
    assert line.startswith("the MQTT broker is down: broker..lan:1 cannot be used: Unicode")


def test_control_decides_in_the_same_rhythm_with_a_dead_broker_as_without_mqtt(caplog):
    caplog.set_level(logging.INFO, "heliocube.mqtt")
    bound = bound_socket()
    port = bound.getsockname()[1]
    bound.close()
    # With fewer scans, hours are simulated quickly.
    settings = settings_for(port, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130})

    def decisions(enabled):
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:

            async def scenario():
                rig = BrokerRig(asyncio.get_running_loop(), settings, 1.0)
                stop = asyncio.Event()
                serving = asyncio.create_task(rig.run_until(stop) if enabled else rig.service.run(stop))
                await asyncio.sleep(2400)
                stop.set()
                await serving
                return [record.time_monotonic_s for record in rig.records_of(Decision)]

            return runner.run(scenario())

    without, with_a_dead_one = decisions(enabled=False), decisions(enabled=True)
    assert len(without) >= 7
    assert with_a_dead_one == pytest.approx(without, abs=0.1)
    assert 1 <= sum(record.name == "heliocube.mqtt" for record in caplog.records) <= 10


def test_a_link_that_comes_and_goes_is_logged_as_few_outages(caplog):
    caplog.set_level(logging.INFO, "heliocube")
    delays_after([40.0] * 30)
    lines = [record.getMessage() for record in caplog.records if record.levelno >= logging.INFO]
    assert 2 <= len(lines) <= 10


def test_a_link_that_lasts_after_coming_and_going_is_reported_once_as_steady_again(caplog):
    caplog.set_level(logging.INFO, "heliocube")
    bound, bus, told = bound_socket(), Bus(), []
    bus.subscribe(lambda record: told.append(record.text))

    async def scenario():
        broker = ScriptedBroker([700.0] * 8 + [1e6])
        await broker.serve(bound)
        link = link_to(bound.getsockname()[1], bus, asyncio.get_running_loop())
        running = asyncio.create_task(link.run())
        for _ in range(150):
            link.send(Message("heliocube/tracker/state", b"{}"))
            await asyncio.sleep(60)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        await broker.close()
        await until(lambda: len(broker.ended_s) == 9, "their ends")

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())
    assert told[-1].startswith("the MQTT broker is steady again: it has worked for 3")
    assert told[-1] == caplog.records[-1].getMessage()
    assert sum("is steady" in text for text in told) == 1


def test_no_message_from_the_broker_is_lost_when_20000_come_at_once():
    topic, heard, many = "heliocube/tracker/command/hold", [], 20_000
    bound = bound_socket()

    async def scenario():
        packets = []
        for number in range(many):
            packet = len(topic).to_bytes(2, "big") + topic.encode() + b"%05d" % number
            packets.append(bytes((PUBLISH << 4, len(packet))) + packet)
        broker = ScriptedBroker([100.0], b"".join(packets))
        await broker.serve(bound)
        link = link_to(bound.getsockname()[1], Bus(), asyncio.get_running_loop())
        link.listen(topic, lambda message: heard.append(int(message.payload)))
        running = asyncio.create_task(link.run())
        await until(lambda: heard[-1:] == [many - 1], "the last message")
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        await broker.close()

    asyncio.run(scenario())
    assert heard == list(range(many))
