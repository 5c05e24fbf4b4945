"""The dashboard's port: connections that do not get on are closed, and keep nobody out."""

import asyncio
import json
import os
import re
import shutil
import signal
import socket
import threading
from contextlib import suppress

import h11
import httpx
import pytest

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.base.process import SystemdNotifier
from daemon.base.timeloop import VirtualTimeLoop
from daemon.dashboard.app import STATIC
from daemon.dashboard.serve import bind, serve
from tests.daemon.dashboard.served import served
from tests.support import PATIENCE_S, ROOT
from tests.support.addresses import SocketWithoutIpv6
from tests.support.endless import ACCEPTED

PAGE = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
HALF_A_BODY = b"POST /login HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\nContent-Length: 100\r\n\r\n{"
KEPT = b'HTTP/1.1 200 OK\r\nContent-Length: 16\r\n\r\n{"text": "done"}'


async def statuses(answer, name, times=1):
    """Return the status codes of an order that is given some times, to a service that `answer` plays."""
    async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
        service = "{}:{}".format(*server.sockets[0].getsockname())
        async with served(service) as address:
            page = "http://{}:{}".format(*address)
            async with httpx.AsyncClient(base_url=page, headers={"Origin": page}, timeout=PATIENCE_S) as browser:
                await browser.post("/login", json={"token": "t" * 43, "by": "ana"})
                order = {"name": name, "service": service, "why": "a test"}
                return [(await browser.post("/command", json=order)).status_code for _ in range(times)]


async def until_its_end(reader):
    with suppress(ConnectionError):
        await reader.read()


@pytest.mark.parametrize("content", [b"", PAGE, HALF_A_BODY], ids=["nothing", "half a head", "half a body"])
def test_a_flood_of_silent_connections_keeps_out_neither_new_requests_nor_open_pages(content):
    async def scenario():
        bound = bind("127.0.0.1:0")
        address = bound.getsockname()
        serving = asyncio.create_task(
            serve(bound, [parse_address("127.0.0.1:9")], [], SystemClock(), SystemdNotifier({}, os.getpid()))
        )
        listening = await asyncio.open_connection(*address)
        listening[1].write(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await listening[0].readuntil(b"event: hello")
        reading = asyncio.create_task(until_its_end(listening[0]))
        held = []
        for _ in range(300):
            held.append(await asyncio.open_connection(*address))
            held[-1][1].write(content)
        came_s = asyncio.get_running_loop().time()
        reader, writer = await asyncio.open_connection(*address)
        writer.write(PAGE + b"Connection: close\r\n\r\n")
        assert (await reader.read()).startswith(b"HTTP/1.1 200 ")
        assert asyncio.get_running_loop().time() - came_s < 1.0
        assert not reading.done()
        for _, one in [*held, (reader, writer), listening]:
            one.close()
        signal.raise_signal(signal.SIGTERM)
        await asyncio.gather(serving, reading)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


def test_a_very_long_request_head_is_refused_even_when_it_comes_in_one_piece():
    async def scenario():
        async with served() as address:
            reader, writer = await asyncio.open_connection(*address)
            writer.write(PAGE + b"y: 1\r\n" * 8_000 + b"\r\n")
            with suppress(ConnectionError):
                assert b"HTTP/1.1 200 " not in await reader.read(4096)
            writer.close()

    asyncio.run(scenario())


def test_the_small_chunks_of_a_body_that_no_handler_reads_are_not_parsed(monkeypatch):
    taken, take = [], h11.Connection.receive_data
    monkeypatch.setattr(h11.Connection, "receive_data", lambda conn, data: [taken.append(len(data)), take(conn, data)])

    async def scenario():
        async with served() as address:
            reader, writer = await asyncio.open_connection(*address)
            writer.write(b"POST /none HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n")
            writer.write(b"1\r\nx\r\n" * 10_000)
            await asyncio.wait_for(until_its_end(reader), PATIENCE_S)
            writer.close()

    asyncio.run(scenario())
    assert sum(taken) < 10_000


@pytest.mark.parametrize(
    ("first", "content"),
    [(b"", b""), (b"", PAGE), (b"", HALF_A_BODY), (PAGE + b"\r\n", PAGE)],
    ids=["nothing", "half a head", "half a body", "half a second head"],
)
def test_connections_without_a_whole_request_are_closed_and_keep_nobody_out_for_long(first, content):
    async def scenario():
        bound = bind("127.0.0.1:0")
        address = bound.getsockname()
        serving = asyncio.create_task(
            serve(bound, [parse_address("127.0.0.1:9")], [], SystemClock(), SystemdNotifier({}, os.getpid()))
        )
        held = [await asyncio.open_connection(*address) for _ in range(250)]
        for reader, writer in held:
            writer.write(first)
            if first:
                await reader.readuntil(b"\r\n\r\n")
            writer.write(content)
        async with asyncio.timeout(PATIENCE_S):
            await asyncio.gather(*(until_its_end(reader) for reader, _ in held))
        reader, writer = await asyncio.open_connection(*address)
        writer.write(PAGE + b"Connection: close\r\n\r\n")
        assert (await reader.read()).startswith(b"HTTP/1.1 200 ")
        for _, one in [*held, (reader, writer)]:
            one.close()
        signal.raise_signal(signal.SIGTERM)
        await serving

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


def test_one_remote_address_gets_at_most_half_of_the_places_for_pages():
    async def scenario():
        async def listen(host, method="GET"):
            connection = await asyncio.open_connection(*address)
            head = f"{method} /events HTTP/1.1\r\nHost: localhost\r\nX-Forwarded-For: {host}\r\n\r\n"
            connection[1].write(head.encode())
            answer = await connection[0].readuntil(b"\r\n\r\n")
            held.append(connection[1])
            return int(answer.split()[1])

        held = []
        async with served() as address:
            # A request for the head alone opens no page.
            assert [await listen("127.0.0.1", "HEAD") for _ in range(64)] == [200] * 64
            assert [await listen("192.0.2.7") for _ in range(32)] == [200] * 32
            assert await listen("192.0.2.7") == 503
            assert await listen("no number") == 200
            assert [await listen("127.0.0.1") for _ in range(31)] == [200] * 31
            assert await listen("127.0.0.1") == 503
            held[64].close()
            await asyncio.sleep(5.0)
            assert await listen("192.0.2.7") == 200
            for one in held:
                one.close()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


def test_a_connection_whose_client_does_not_read_its_answer_is_closed():
    async def answer(reader, writer):
        head = await reader.readuntil(b"\r\n\r\n")
        # More than fits into the buffers of both ends.
        content = b" " * (16 << 20) if b"/api/sun" in head else b""
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % len(content) + content)
        with suppress(ConnectionError):
            await writer.drain()
        writer.close()

    async def scenario():
        async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
            service = "{}:{}".format(*server.sockets[0].getsockname())
            async with served(service) as address:
                with socket.socket() as silent:
                    silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                    silent.settimeout(30.0)
                    silent.connect(address)
                    silent.sendall(f"GET /read/sun?service={service} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
                    # In a thread: virtual time waits until the answer has begun.
                    assert await asyncio.to_thread(silent.recv, 15) == b"HTTP/1.1 200 OK"
                    silent.setblocking(False)
                    await asyncio.sleep(60.0)
                    reader, writer = await asyncio.open_connection(sock=silent)
                    taken = 0
                    with suppress(ConnectionError):
                        while part := await reader.read(1 << 20):
                            taken += len(part)
                    writer.close()
                assert taken < 8 << 20

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


@pytest.mark.parametrize("content", [b"\x16\x03\x01\r\n\r\n", HALF_A_BODY], ids=["not HTTP", "half a body"])
def test_an_invalid_or_incomplete_request_is_not_logged(caplog, content):
    async def scenario():
        async with served() as address:
            for _ in range(20):
                reader, writer = await asyncio.open_connection(*address)
                writer.write(content)
                writer.write_eof()
                await until_its_end(reader)
                writer.close()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())
    assert [record for record in caplog.records if record.name.startswith("uvicorn")] == []


def test_a_request_head_that_is_too_long_is_answered_with_a_clear_sentence():
    async def scenario():
        async with served() as address:
            reader, writer = await asyncio.open_connection(*address)
            writer.write(b"GET / HTTP/1.1\r\nHost: localhost\r\nCookie: a=" + b"1" * 40_000 + b"\r\n\r\n")
            assert b"longer than 16384 bytes" in await reader.read()
            writer.close()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


@pytest.mark.parametrize(("name", "is_dropped"), [("auto", True), ("stop", False)])
def test_an_order_that_was_given_up_is_not_sent_on_once_the_network_is_back_unless_it_is_a_stop(name, is_dropped):
    async def scenario():
        ended = asyncio.get_running_loop().create_future()

        async def answer(reader, writer):
            head = await reader.readuntil(b"\r\n\r\n")
            if f"/api/{name}".encode() in head:
                try:
                    while await reader.read(4096):
                        pass
                    ended.set_result("to the end")
                except ConnectionResetError:
                    ended.set_result("dropped")
            elif b"/api/authorised" in head:
                writer.write(ACCEPTED)
            writer.close()

        assert await statuses(answer, name) == [502]
        assert (await ended == "dropped") is is_dropped

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


@pytest.mark.parametrize("name", ["auto", "stop"])
def test_no_order_fails_because_the_service_closes_a_kept_connection(name):
    async def scenario():
        async def answer(reader, writer):
            """Keep the connection for a while, as HTTP allows, and close it while the next request is under way."""
            with suppress(asyncio.IncompleteReadError):
                await reader.readuntil(b"\r\n\r\n")
                writer.write(KEPT)
                await reader.readuntil(b"\r\n\r\n")
            writer.close()

        assert await statuses(answer, name, times=3) == [200] * 3

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


def test_when_the_dashboard_ends_requests_that_wait_for_a_service_get_a_clear_answer(caplog):
    async def scenario():
        asked, ended = asyncio.Semaphore(0), asyncio.Event()

        async def answer(reader, writer):
            # A connection that the dashboard closed before asking has nothing to read.
            with suppress(asyncio.IncompleteReadError):
                head = await reader.readuntil(b"\r\n\r\n")
                if b"/api/authorised" in head:
                    writer.write(ACCEPTED)
                elif b"/api/events" not in head:
                    asked.release()
                    await ended.wait()
            writer.close()

        async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
            service = "{}:{}".format(*server.sockets[0].getsockname())
            async with served(service) as address:
                page = "http://{}:{}".format(*address)
                browser = httpx.AsyncClient(base_url=page, headers={"Origin": page}, timeout=PATIENCE_S)
                await browser.post("/login", json={"token": "t" * 43, "by": "ana"})
                waiting = [
                    asyncio.create_task(browser.get("/read/sun", params={"service": service})),
                    asyncio.create_task(browser.post("/command", json={"name": "stow", "service": service})),
                ]
                for _ in waiting:
                    await asyncio.wait_for(asked.acquire(), PATIENCE_S)
            answers = await asyncio.gather(*waiting)
            await browser.aclose()
            ended.set()
        sentence = "the dashboard was told to end before the service answered: look at the tracker"
        assert [(each.status_code, each.json()) for each in answers] == [(503, {"error": sentence})] * 2

    asyncio.run(scenario())
    assert [record for record in caplog.records if record.name.startswith("uvicorn")] == []


def test_many_browsers_at_once_take_no_more_threads_of_the_dashboard_than_its_unit_allows():
    unit = (ROOT / "deploy" / "heliocube-dashboard.service").read_text()
    allowed = int(re.search(r"^TasksMax=(\d+)$", unit, re.MULTILINE)[1])
    files = [str(path.relative_to(STATIC)) for path in STATIC.rglob("*") if path.is_file()]
    before, most = threading.active_count(), 0

    async def browse(page):
        nonlocal most
        # As many connections as a browser has.
        limits = httpx.Limits(max_connections=6)
        async with httpx.AsyncClient(base_url=page, limits=limits, timeout=PATIENCE_S) as browser:
            for answer in asyncio.as_completed([browser.get(f"/static/{name}") for name in files]):
                assert (await answer).status_code == 200
                most = max(most, threading.active_count() - before)

    async def scenario():
        async with served() as address:
            await asyncio.gather(*(browse("http://{}:{}".format(*address)) for _ in range(8)))

    asyncio.run(scenario())
    # The six are the process itself, the thread that waits for its parent's end, and those that look up names.
    assert most <= allowed - 6


async def page_told():
    """Return what the first message of the stream says of the page."""
    async with served() as address:
        reader, writer = await asyncio.open_connection(*address)
        writer.write(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await reader.readuntil(b"event: hello")
        await reader.readuntil(b"data: ")
        writer.close()
        return json.loads(await reader.readline())["page"]


def test_an_open_page_learns_that_its_files_have_changed_although_the_release_name_is_the_same(tmp_path, monkeypatch):
    before = asyncio.run(page_told())
    assert asyncio.run(page_told()) == before
    shutil.copytree(STATIC, tmp_path / "static")
    (tmp_path / "static" / "js" / "live.js").write_text("// another\n")
    monkeypatch.setattr("daemon.dashboard.app.STATIC", tmp_path / "static")
    assert asyncio.run(page_told()) != before


@pytest.mark.parametrize(
    ("listen", "why"),
    [
        # RFC 5737: no machine has this address.
        (
            "192.0.2.1:20574",
            "it is not an address of this machine now; if it will be one later, start the dashboard again then",
        ),
        (
            "[::1]:20574",
            "this system has no IPv6: set dashboard.listen or --listen to an address such as 127.0.0.1:20574",
        ),
    ],
)
def test_an_address_that_cannot_be_listened_on_ends_the_dashboard_with_one_sentence(
    heliocube, monkeypatch, listen, why
):
    monkeypatch.setattr(socket, "socket", SocketWithoutIpv6)
    code, out, err = heliocube("dashboard", "--listen", listen)
    assert (code, out) == (2, "")
    assert err.startswith(f"heliocube: cannot listen on {listen}: ")
    assert why in err
    assert err.count("\n") == 1
