"""What outsiders may cost: silent connections, floods, garbage, other hosts; and a stop beside all of it."""

import asyncio
import logging
import re
import socket
from dataclasses import dataclass

import h11
import pytest

from daemon.api.gate import Token
from daemon.api.port.connections import Connections
from daemon.api.refusals import ApiRefusals
from daemon.api.turns import CrowdedError, ReadThrottle
from daemon.base.records import Event, Mode
from daemon.base.timeloop import VirtualTimeLoop
from tests.support.api import BEARER
from tests.support.motion import commands_sent
from tests.support.phases import wait_for_move

HALF_A_HEAD = b"GET /api/state HTTP/1.1\r\nHost: loc"
HALF_A_BODY = b"POST /api/stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{"


async def connect(call, content=b""):
    host, port = call.server.url.removeprefix("http://").split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    writer.write(content)
    return reader, writer


async def closed(reader):
    """Return what was still sent before the end of a connection."""
    try:
        return await reader.read()
    except ConnectionError:
        return b""


def lines_of(caplog):
    return [record.getMessage() for record in caplog.records if record.name == "heliocube.api"]


async def metric(call, name):
    lines = (await call.get("/metrics")).body.decode().splitlines()
    return next(float(line.split()[-1]) for line in lines if line.startswith(f"heliocube_{name} "))


@pytest.mark.parametrize("contents", [(b"", HALF_A_HEAD, HALF_A_BODY), (HALF_A_BODY,)], ids=["all kinds", "bodies"])
def test_idle_and_half_sent_connections_block_neither_a_stop_nor_a_reader(serve, monkeypatch, caplog, contents):
    async def scenario(rig, call):
        await wait_for_move(rig)
        reader, writer = await connect(call, b"GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await reader.readuntil(b"event: state")
        reading = asyncio.create_task(closed(reader))
        held = []
        for turn in range(450):
            held.append(await connect(call, contents[turn % len(contents)]))
            # Not faster than they are let in.
            await asyncio.sleep(0.005)
        sent, asked_s = commands_sent(rig, monkeypatch), rig.clock.monotonic()
        assert (await call.post("stop")).status == 200
        assert next(at_s for at_s, data in sent if data.startswith(b"$9s")) - asked_s < 0.2
        assert (await call.get("/healthz")).status == 200
        assert not reading.done()
        for _, one in [*held, (reader, writer)]:
            one.close()
        await reading

    serve(scenario)
    assert 0 < len(lines_of(caplog)) <= 18


@pytest.mark.parametrize(
    "body", [b"halt!", b'{"why": "%s"}' % (b"x" * 5000), b"x" * 10_000_000], ids=["no JSON", "too long", "megabytes"]
)
def test_a_stop_is_obeyed_whatever_its_body_is(serve, body):
    async def scenario(rig, call):
        await wait_for_move(rig)
        reply = await call.post("stop", body)
        assert (reply.status, reply.json["done"]) == (200, True)
        assert rig.control.wishes.stop.why == "an operator asked"

    serve(scenario)


def test_a_stop_with_an_incomplete_body_is_obeyed_only_with_the_token(serve):
    async def scenario(rig, call):
        await wait_for_move(rig)
        for headers in ({}, BEARER):
            assert rig.control.wishes.stop is None
            _, writer = await call.open("POST", "/api/stop", b"{", headers, length=100)
            await asyncio.sleep(1)
            writer.close()
            await asyncio.sleep(1)
        assert rig.control.wishes.stop is not None

    serve(scenario)


@pytest.mark.parametrize("content", [b"", HALF_A_HEAD, HALF_A_BODY], ids=["nothing", "half a head", "half a body"])
def test_a_connection_without_a_whole_request_is_closed_after_5_to_8_seconds(serve, content):
    async def scenario(rig, call):
        reader, writer = await connect(call, content)
        begun_s = rig.clock.monotonic()
        await closed(reader)
        assert 5 <= rig.clock.monotonic() - begun_s <= 8
        writer.close()

    serve(scenario)


def test_a_request_head_sent_byte_by_byte_gets_no_more_time_nor_does_a_second_one(serve):
    async def scenario(rig, call):
        for first, within_s in ((b"", 8), (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n", 13)):
            reader, writer = await connect(call, first)
            begun_s = rig.clock.monotonic()
            closing = asyncio.create_task(closed(reader))
            for byte in HALF_A_HEAD * 20:
                writer.write(bytes([byte]))
                await asyncio.sleep(0.5)
                if closing.done():
                    break
            await closing
            assert rig.clock.monotonic() - begun_s <= within_s
            writer.close()

    serve(scenario)


def test_an_event_listener_that_does_not_read_is_cut_off_and_one_that_reads_is_not(serve):
    async def scenario(rig, call):
        deaf = socket.socket()
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.setblocking(False)
        host, port = call.server.url.removeprefix("http://").split(":")
        await asyncio.get_running_loop().sock_connect(deaf, (host, int(port)))
        await asyncio.get_running_loop().sock_sendall(deaf, b"GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        reader, writer = await connect(call, b"GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await reader.readuntil(b"event: state")
        reading = asyncio.create_task(closed(reader))
        for _ in range(100):
            for _ in range(100):
                rig.bus.publish(Event(rig.clock.utc(), rig.clock.monotonic(), "test", "x" * 1000))
            await asyncio.sleep(1)
        assert await metric(call, 'api_refused_total{kind="slow"}') == 1.0
        assert not reading.done()
        writer.close()
        await reading
        deaf.close()

    serve(scenario)


def test_requests_that_are_not_http_get_a_clear_400_and_do_not_flood_the_log(serve, caplog):
    async def scenario(rig, call):
        for _ in range(60):
            reader, writer = await connect(call, b"\x16\x03\x01 nonsense\r\n\r\n")
            reply = await closed(reader)
            assert reply.startswith(b"HTTP/1.1 400 ")
            assert reply.endswith(b'{"error":"this is not HTTP"}')
            writer.close()
        assert await metric(call, 'api_refused_total{kind="garbage"}') == 60.0

    serve(scenario)
    assert 5 <= len(lines_of(caplog)) <= 6
    assert "requests that are not HTTP: 1 more" in lines_of(caplog)[-1]


def test_commands_with_a_wrong_token_do_not_flood_the_log(serve, caplog):
    async def scenario(rig, call):
        for _ in range(30):
            assert (await call.post("stop", headers={"Authorization": "Bearer guess"})).status == 401

    serve(scenario)
    assert lines_of(caplog)[0] == (
        "a command from 127.0.0.1 is refused: "
        "the token is not the service's: restart the service after a change of api.token_file"
    )
    assert len(lines_of(caplog)) <= 6


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost", 200),
        ("LOCALHOST:20572", 200),
        ("127.0.0.1:1", 200),
        ("127.1.2.3", 200),
        ("[::1]:20572", 200),
        ("tracker.example.org", 200),
        ("Tracker.Example.org.:443", 200),
        ("rebound.example", 421),
        ("rebound.example:20572", 421),
        ("localhost.rebound.example", 421),
        ("10.1.2.3", 421),
        ("[fd00::1]", 421),
        ("", 421),
    ],
)
def test_only_host_headers_of_this_machine_or_from_api_hosts_are_served(serve, host, status):
    async def scenario(rig, call):
        for method, path in (("GET", "/api/state"), ("POST", "/api/hold")):
            reply = await call(method, path, headers=BEARER | {"Host": host})
            assert reply.status == status
            if status == 421:
                assert reply.json["error"].endswith("is not served here: add it to api.hosts if it is this machine's")
        assert (rig.mode is Mode.HOLD) is (status == 200)

    serve(scenario, hosts=("tracker.example.org:443",))


def test_an_http_1_0_request_without_a_host_is_answered_and_its_commands_need_the_token(serve):
    async def scenario(rig, call):
        authorised = f"Authorization: {BEARER['Authorization']}\r\n".encode()
        for asked, status in (
            (b"GET /healthz HTTP/1.0\r\n\r\n", b"200"),
            (b"GET /healthz HTTP/1.1\r\n\r\n", b"400"),
            (b"POST /api/hold HTTP/1.0\r\n\r\n", b"401"),
            (b"POST /api/hold HTTP/1.0\r\n" + authorised + b"\r\n", b"200"),
        ):
            reader, writer = await connect(call, asked)
            assert (await reader.read()).split()[1] == status, asked
            writer.close()

    serve(scenario)


def test_state_readers_wait_for_their_turn_and_a_stop_does_not(serve, monkeypatch):
    async def scenario(rig, call):
        await wait_for_move(rig)
        readers = [asyncio.create_task(call.get("/api/state")) for _ in range(300)]
        await asyncio.wait(readers, return_when=asyncio.FIRST_COMPLETED)
        sent, asked_s = commands_sent(rig, monkeypatch), rig.clock.monotonic()
        stopped = await call.post("stop")
        replies = await asyncio.gather(*readers)
        assert {reply.status for reply in replies} <= {200, 503}
        assert any("retry-after: 1" in reply.head for reply in replies)
        assert stopped.status == 200
        assert next(at_s for at_s, data in sent if data.startswith(b"$9s")) - asked_s < 0.2

    serve(scenario)


def test_read_requests_take_about_a_quarter_of_the_time_whatever_a_page_costs():
    async def scenario():
        loop = asyncio.get_running_loop()
        turns, spent_s = ReadThrottle(loop.time, 1.0), 0.0

        async def reader():
            nonlocal spent_s
            while True:
                await turns.take()
                turns.charge(0.009)
                spent_s += 0.01

        readers = [asyncio.create_task(reader()) for _ in range(64)]
        await asyncio.sleep(100)
        assert 20 <= spent_s <= 25.5
        with pytest.raises(CrowdedError):
            await turns.take()
        for one in readers:
            one.cancel()
        await asyncio.gather(*readers, return_exceptions=True)
        await turns.take()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


def test_readers_waiting_for_a_turn_are_sent_away_when_the_service_ends():
    async def scenario():
        turns = ReadThrottle(asyncio.get_running_loop().time, 1.0)
        turns.charge(1.0)
        for _ in range(10):
            turns.charge(1.0)
        waiting = asyncio.create_task(turns.take())
        await asyncio.sleep(0)
        turns.close()
        with pytest.raises(CrowdedError):
            await waiting

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


@dataclass(eq=False)
class Held:
    """A connection as the limits see it."""

    address: str
    from_loopback: bool = False
    is_idle: bool = True
    bears_the_token: bool = False
    aborted: bool = False

    def abort(self):
        self.aborted = True


def test_a_far_address_keeps_at_most_32_connections_and_loopback_may_keep_more():
    refusals = ApiRefusals(lambda: 0.0)
    connections = Connections(Token("any"), refusals, 1.0)
    far = [Held("192.0.2.7") for _ in range(40)]
    near = [Held("127.0.0.1", from_loopback=True) for _ in range(150)]
    assert all(connections.admit(one) for one in [*far, *near])
    assert [one.aborted for one in far] == [True] * 8 + [False] * 32
    assert not any(one.aborted for one in near)
    assert refusals.counts["crowded"] == 8


def test_with_no_idle_connection_the_oldest_without_the_token_is_dropped_never_one_with_it():
    connections = Connections(Token("any"), ApiRefusals(lambda: 0.0), 1.0)
    served = [
        Held("127.0.0.1", from_loopback=True, is_idle=False, bears_the_token=number not in (5, 6))
        for number in range(384)
    ]
    assert all(connections.admit(one) for one in served)
    for number in (5, 6):
        assert connections.admit(Held("127.0.0.1", from_loopback=True, is_idle=False, bears_the_token=True))
        assert [one for one in served if one.aborted] == served[5 : number + 1]
    assert not connections.admit(Held("192.0.2.7"))
    connections.drop(served[0])
    assert connections.admit(Held("192.0.2.7"))


def test_pipelined_requests_are_answered_in_order_and_an_upgrade_as_an_ordinary_request(serve, caplog):
    async def scenario(rig, call):
        upgrade = b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        one = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
        # An answer that is made in a thread stands between those that are made at once and name their requests.
        paths = [b"/%d" % number if number % 3 else b"/api/state" for number in range(100)]
        many = b"".join(b"GET " + path + b" HTTP/1.1\r\nHost: localhost\r\n\r\n" for path in paths)
        reader, writer = await connect(call, many + one + upgrade + b"\r\n")
        writer.write(one + b"Connection: close\r\n\r\n")
        reply = await closed(reader)
        statuses = [404 if number % 3 else 200 for number in range(100)] + [200] * 2
        assert [int(found) for found in re.findall(rb"HTTP/1\.1 (\d+)", reply)] == statuses
        numbers = [number for number in range(100) if number % 3]
        assert [int(found) for found in re.findall(rb"there is no /(\d+) here", reply)] == numbers
        writer.close()

    serve(scenario)
    assert [record for record in caplog.records if record.levelno >= logging.WARNING and "api" in record.name] == []


def test_callers_with_ipv4_mapped_ipv6_addresses_are_treated_as_ipv4_callers(serve, monkeypatch):
    own = "uvicorn.protocols.http.h11_impl"
    monkeypatch.setattr(f"{own}.get_local_addr", lambda transport: ("::ffff:192.0.2.2", 20572))
    monkeypatch.setattr(f"{own}.get_remote_addr", lambda transport: ("::ffff:127.0.0.1", 40000))

    async def scenario(rig, call):
        held = [await connect(call, HALF_A_HEAD) for _ in range(40)]
        assert (await call("GET", "/healthz", headers={"Host": "192.0.2.2:20572"})).status == 200
        assert await metric(call, 'api_refused_total{kind="crowded"}') == 0.0
        for _, writer in held:
            writer.close()

    serve(scenario)


@pytest.mark.parametrize(
    "before", [b"", b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"], ids=["alone", "behind another"]
)
@pytest.mark.parametrize("end", [b"", b"\r\n\r\n"], ids=["half", "whole"])
def test_an_overlong_request_head_is_refused_even_when_sent_in_one_piece(serve, caplog, before, end):
    async def scenario(rig, call):
        reader, writer = await connect(call, before + HALF_A_HEAD + b"alhost" + b"\r\ny: 1" * 8_000 + end)
        reply = await closed(reader)
        assert reply.count(b"HTTP/1.1 200 OK") <= bool(before)
        assert before or reply.startswith(b"HTTP/1.1 431 ")
        assert before or b'{"error":"the head of this request is longer than 16384 bytes' in reply
        writer.close()

    serve(scenario)
    assert lines_of(caplog) == ["what 127.0.0.1 sends is a head that is too long"]


def test_tiny_chunks_of_a_body_without_the_token_are_parsed_only_a_few_at_a_time(serve, monkeypatch):
    taken, take = [], h11.Connection.receive_data
    monkeypatch.setattr(h11.Connection, "receive_data", lambda conn, data: [taken.append(len(data)), take(conn, data)])

    async def scenario(rig, call):
        head = b"POST /api/stow HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
        reader, writer = await connect(call, head + b"1\r\nx\r\n" * 10_000 + b"0\r\n\r\n")
        await asyncio.sleep(0.02)
        assert 0 < sum(taken) < 16_000
        assert (await reader.readline()).startswith(b"HTTP/1.1 401 ")
        writer.close()

    serve(scenario)
