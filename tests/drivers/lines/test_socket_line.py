"""An instrument's socket that does not open, or that belongs to another program."""

import asyncio
import contextlib
import socket
import struct

import pytest

from daemon.base.timeloop import VirtualTimeLoop
from drivers.errors import ConnectError, LinkLostError
from drivers.lines.socket_line import SocketLine
from tests.support import PATIENCE_S


def test_a_connection_attempt_without_an_answer_is_given_up_after_five_seconds(monkeypatch):
    async def never(*_where, **_keys):
        await asyncio.sleep(3600.0)

    async def opened_for_s():
        loop = asyncio.get_running_loop()
        with pytest.raises(ConnectError, match="5025 does not answer: is it on, and does its network work"):
            await SocketLine("cube", "10.0.0.9", 5025).open()
        return loop.time()

    monkeypatch.setattr(asyncio, "open_connection", never)
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        begin_s = runner.get_loop().time()
        assert runner.run(opened_for_s()) - begin_s == pytest.approx(5.0)


@pytest.mark.live
def test_draining_an_instrument_that_never_stops_sending_is_given_up_with_an_error():
    async def act():
        over = asyncio.Event()

        async def talk(_reader, writer):
            with contextlib.suppress(OSError):
                while not writer.is_closing():
                    writer.write(b"wind 3.2 m/s\n")
                    await asyncio.sleep(0.01)
            over.set()

        async with await asyncio.start_server(talk, "127.0.0.1", 0) as server:
            line = SocketLine("cube", *server.sockets[0].getsockname())
            await line.open()
            async with asyncio.timeout(PATIENCE_S):
                with pytest.raises(ConnectError, match="keeps sending unasked: is it the right instrument"):
                    await line.drain(4.0)
            await line.close()
            await over.wait()

    asyncio.run(act())


@pytest.mark.live
def test_a_connection_reset_while_the_line_is_drained_is_a_lost_link():
    async def act():
        opened = asyncio.Event()

        async def reset(_reader, writer):
            await opened.wait()
            # Without a linger time, closing sends a reset.
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            writer.transport.abort()

        async with await asyncio.start_server(reset, "127.0.0.1", 0) as server:
            line = SocketLine("cube", *server.sockets[0].getsockname())
            await line.open()
            opened.set()
            with pytest.raises(LinkLostError, match="has closed the connection"):
                await line.drain(60.0)
            await line.close()

    asyncio.run(act())


@pytest.mark.live
def test_unrequested_data_is_discarded_and_reported():
    async def act():
        said = asyncio.Queue()

        async def say(reader, writer):
            while (words := await said.get()) is not None:
                writer.write(words)
            writer.close()

        async with await asyncio.start_server(say, "127.0.0.1", 0) as server:
            line = SocketLine("cube", *server.sockets[0].getsockname())
            await line.open()
            assert not await line.discard_unsolicited()
            said.put_nowait(b"+1.0E-01\n+2.0E-01\n")
            assert await line.receive(PATIENCE_S) == "+1.0E-01"
            assert await line.discard_unsolicited()
            assert not await line.discard_unsolicited()
            said.put_nowait(b"+3.0E-01\n\r")
            assert await line.receive(PATIENCE_S) == "+3.0E-01"
            assert not await line.discard_unsolicited(), "the end of a line says nothing"
            said.put_nowait(None)
            with pytest.raises(LinkLostError, match="has closed the connection"):
                await line.receive(PATIENCE_S)
            with pytest.raises(LinkLostError, match="has closed the connection"):
                await line.discard_unsolicited()
            await line.close()

    asyncio.run(act())


def test_every_call_on_a_line_that_is_not_open_is_a_lost_link():
    async def act():
        line = SocketLine("cube", "127.0.0.1", 9)
        for call in (line.send("*IDN?"), line.receive(1.0), line.drain(0.1), line.discard_unsolicited()):
            with pytest.raises(LinkLostError, match="has to be opened first"):
                await call

    asyncio.run(act())
