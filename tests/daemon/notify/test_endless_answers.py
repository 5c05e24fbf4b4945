"""What answers in the place of a service, or of the heartbeat, may have no end: little of it is read."""

import asyncio

import httpx

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.config.links import NotifySettings
from daemon.notify.courier import Courier, beat

MUCH, PIECE = 200 << 20, 1 << 20
TAKEN = 64 << 20


async def sent_to(ask):
    """Return what `ask` returns for an address that says much, and how much of that was taken."""
    sent, ended = 0, asyncio.Event()

    async def answer(reader, writer):
        nonlocal sent
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % MUCH)
        try:
            for _ in range(MUCH // PIECE):
                writer.write(b" " * PIECE)
                await writer.drain()
                sent += PIECE
        except ConnectionError:
            pass
        writer.close()
        ended.set()

    server = await asyncio.start_server(answer, "127.0.0.1", 0)
    async with server:
        host, port = server.sockets[0].getsockname()
        found = await ask(f"{host}:{port}")
        await ended.wait()
    return found, sent


def test_of_a_state_without_end_no_more_is_read_than_a_state_may_have():
    async def ask(address):
        async with httpx.AsyncClient(trust_env=False) as client:
            courier = Courier(NotifySettings(), [parse_address(address)], [], SystemClock(), client)
            await asyncio.gather(*await courier.step())

    assert asyncio.run(sent_to(ask))[1] < TAKEN


def test_of_the_answer_to_a_heartbeat_nothing_is_read():
    async def ask(address):
        return await beat(f"http://{address}/beat")

    trouble, sent = asyncio.run(sent_to(ask))
    assert trouble is None
    assert sent < TAKEN
