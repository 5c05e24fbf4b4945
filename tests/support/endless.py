"""A service, or an impostor in its place, whose answer is far too long."""

import asyncio

MUCH, PIECE = 200 << 20, 1 << 20
ACCEPTED = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\nConnection: close\r\n\r\n{}"
MOST_BYTES_SENT = 64 << 20


async def ask_endless_server(ask, content_type="application/json"):
    """Return what `ask` returns for an address that answers with `MUCH` bytes, and how many were sent.

    Questions about a token get a short answer.
    """
    sent, answering = 0, set()

    async def answer(reader, writer):
        nonlocal sent
        answering.add(asyncio.current_task())
        if b"/api/authorised" in await reader.readuntil(b"\r\n\r\n"):
            writer.write(ACCEPTED)
            writer.close()
            return
        head = f"HTTP/1.1 200 OK\r\nContent-Type: {content_type}\r\nContent-Length: {MUCH}\r\n\r\n"
        writer.write(head.encode())
        try:
            for _ in range(MUCH // PIECE):
                writer.write(b" " * PIECE)
                await writer.drain()
                sent += PIECE
        except ConnectionError:
            pass
        writer.close()

    server = await asyncio.start_server(answer, "127.0.0.1", 0)
    async with server:
        host, port = server.sockets[0].getsockname()
        found = await ask(f"{host}:{port}")
        await asyncio.gather(*answering)
    return found, sent
