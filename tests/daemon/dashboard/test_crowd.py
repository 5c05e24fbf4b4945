"""The dashboard's places: clients that do not read, or wait for a service that hangs, keep nobody out."""

import asyncio
import socket
from contextlib import AsyncExitStack, asynccontextmanager, suppress

import pytest

from daemon.base.timeloop import VirtualTimeLoop
from tests.daemon.dashboard.served import served

PLACES = 16
PAGE = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
STREAM = "GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n"
READ = "GET /read/sun?service={0} HTTP/1.1\r\nHost: localhost\r\n"
# More than fits into the buffers of both ends.
ANSWER = b" " * (5 << 20)


@pytest.fixture
def _few_places(monkeypatch):
    monkeypatch.setattr("daemon.dashboard.serve._CONNECTIONS", PLACES)


@asynccontextmanager
async def answering(answer):
    """Give the address of a service that answers so; its last answers end with the context."""
    answers = set()

    async def noted(reader, writer):
        answers.add(asyncio.current_task())
        try:
            await answer(reader, writer)
        finally:
            writer.close()

    async with await asyncio.start_server(noted, "127.0.0.1", 0) as server:
        yield "{}:{}".format(*server.sockets[0].getsockname())
    # A connection that the dashboard closed before asking has nothing to read.
    await asyncio.gather(*answers, return_exceptions=True)


@asynccontextmanager
async def crowded(content, answer):
    """Give the address of a dashboard full of clients that send something and read nothing."""
    async with AsyncExitStack() as crowd:
        service = await crowd.enter_async_context(answering(answer))
        address = await crowd.enter_async_context(served(service))
        loop = asyncio.get_running_loop()
        for _ in range(PLACES + 2):
            silent = crowd.enter_context(socket.socket())
            silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
            silent.setblocking(False)
            await loop.sock_connect(silent, address)
            with suppress(ConnectionError):
                await loop.sock_sendall(silent, content.format(service).encode())
            # Until its answer fills the buffers.
            await asyncio.sleep(0.05)
        yield address


async def ask(address, content):
    reader, writer = await asyncio.open_connection(*address)
    writer.write(content.encode())
    return reader, writer


async def page(address):
    reader, writer = await ask(address, PAGE)
    answer = await reader.read()
    writer.close()
    return answer


async def much(reader, writer):
    """Answer at once, with more than fits into the buffers."""
    if b"/api/sun" in await reader.readuntil(b"\r\n\r\n"):
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % len(ANSWER) + ANSWER)
    with suppress(ConnectionError):
        await writer.drain()


async def nothing(reader, _writer):
    """Never answer."""
    await reader.read()


@pytest.mark.usefixtures("_few_places")
@pytest.mark.parametrize(
    ("content", "answer"),
    [
        (2 * f"{READ}\r\n", much),
        (f"{READ}Connection: close\r\n\r\n", much),
        (f"{READ}\r\n", nothing),
    ],
    ids=["unread", "unread at the end", "a service that hangs"],
)
def test_clients_that_wait_for_answers_or_read_none_do_not_keep_others_out(content, answer):
    async def scenario():
        async with crowded(content, answer) as address:
            pages = [page(address) for _ in range(PLACES // 2)]
            assert {answer[:13] for answer in await asyncio.gather(*pages)} == {b"HTTP/1.1 200 "}

    asyncio.run(scenario())


def test_an_answer_that_is_read_slowly_is_read_to_its_end():
    async def scenario():
        async with answering(much) as service, served(service) as address:
            with socket.socket() as slow:
                slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
                slow.setblocking(False)
                loop = asyncio.get_running_loop()
                await loop.sock_connect(slow, address)
                await loop.sock_sendall(slow, f"{READ}\r\n".format(service).encode())
                taken = 0
                while part := await loop.sock_recv(slow, 1 << 18):
                    taken += len(part)
                    await asyncio.sleep(1.0)
        assert taken > len(ANSWER)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


def test_of_100_pages_opened_at_once_only_64_are_kept_up_to_date_and_the_others_are_refused():
    async def scenario():
        async with served() as address:
            connections = await asyncio.gather(*(ask(address, STREAM) for _ in range(100)))
            statuses = [int((await reader.readline()).split()[1]) for reader, _ in connections]
            assert (statuses.count(200), statuses.count(503)) == (64, 36)
            for _, writer in connections:
                writer.close()

    asyncio.run(scenario())
