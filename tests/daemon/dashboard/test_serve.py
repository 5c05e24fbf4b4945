"""The dashboard's port: what does not get on is closed, and keeps nobody out."""

import asyncio
import os
import signal
from contextlib import suppress

import pytest

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.base.process import Notifier
from daemon.base.timeloop import VirtualTimeLoop
from daemon.dashboard.serve import bind, serve

PAGE = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
HALF_A_BODY = b"POST /login HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\nContent-Length: 100\r\n\r\n{"


async def until_its_end(reader):
    with suppress(ConnectionError):
        await reader.read()


@pytest.mark.parametrize("content", [b"", PAGE, HALF_A_BODY], ids=["nothing", "half a head", "half a body"])
def test_a_flood_of_connections_that_say_nothing_keeps_out_neither_who_comes_nor_who_listens(content):
    async def scenario():
        bound = bind("127.0.0.1:0")
        address = bound.getsockname()
        serving = asyncio.create_task(
            serve(bound, [parse_address("127.0.0.1:9")], [], SystemClock(), Notifier({}, os.getpid()))
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


@pytest.mark.parametrize(
    ("first", "content"),
    [(b"", b""), (b"", PAGE), (b"", HALF_A_BODY), (PAGE + b"\r\n", PAGE)],
    ids=["nothing", "half a head", "half a body", "half a second head"],
)
def test_connections_on_which_no_whole_request_comes_keep_nobody_out_for_long(first, content):
    async def scenario():
        bound = bind("127.0.0.1:0")
        address = bound.getsockname()
        serving = asyncio.create_task(
            serve(bound, [parse_address("127.0.0.1:9")], [], SystemClock(), Notifier({}, os.getpid()))
        )
        held = [await asyncio.open_connection(*address) for _ in range(250)]
        for reader, writer in held:
            writer.write(first)
            if first:
                await reader.readuntil(b"\r\n\r\n")
            writer.write(content)
        async with asyncio.timeout(20.0):
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
