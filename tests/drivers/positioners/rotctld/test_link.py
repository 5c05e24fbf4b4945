"""The connection to a rotctld, byte by byte: whose answer is whose, and what is reported of a peer that is gone."""

import asyncio
import errno
import socket

import pytest

from drivers.errors import ConnectError, DeadlineError, LinkLostError, ProtocolError
from drivers.positioners.rotctld.link import TcpLine
from tests.support import PATIENCE_S

# Long enough for an answer that comes; an answer that does not come is waited for so long.
MISSED_S = 0.05
POSITION = b"get_pos:\nAzimuth: 12.50\nElevation: 30.00\nRPRT 0\n"


class Peer:
    """Answers as a test wants, and keeps the commands that it receives."""

    def __init__(self):
        self.told = b""
        self.tapped = []
        self.is_there = asyncio.Event()

    async def serve(self, reader, writer):
        self.writer = writer
        self.is_there.set()
        while data := await reader.read(1000):
            self.told += data
        writer.close()

    async def until_told(self, text):
        await self.until(lambda: text in self.told)

    async def until(self, true):
        async with asyncio.timeout(PATIENCE_S):
            while not true():  # noqa: ASYNC110 - the stream tells nobody
                await asyncio.sleep(0.001)


def with_peer(test):
    """Run the decorated test at once, with an open line and the peer behind it."""

    async def both():
        peer = Peer()
        server = await asyncio.start_server(peer.serve, "127.0.0.1", 0)
        line = TcpLine("127.0.0.1", server.sockets[0].getsockname()[1], lambda *piece: peer.tapped.append(piece))
        async with server:
            with pytest.raises(LinkLostError, match="has to be opened first"):
                await line.ask(b"+\\get_pos\n", PATIENCE_S)
            await line.open()
            await peer.is_there.wait()
            try:
                await test(line, peer)
            finally:
                await line.close()
                await peer.writer.wait_closed()
        with pytest.raises(LinkLostError, match="has to be opened first"):
            await line.ask(b"+\\get_pos\n", PATIENCE_S)
        await line.close()

    asyncio.run(both())


def test_replies_go_to_their_callers_in_command_order_and_the_tap_records_both_directions():
    @with_peer
    async def _(line, peer):
        assert not line.simulated
        first = asyncio.ensure_future(line.ask(b"+\\get_pos\n", PATIENCE_S))
        second = asyncio.ensure_future(line.ask(b"+\\stop\n", PATIENCE_S))
        await peer.until_told(b"stop\n")
        peer.writer.write(POSITION[:9])
        await asyncio.sleep(0)
        peer.writer.write(POSITION[9:] + b"stop:\nRPRT -6\n")
        assert (await first).number("Azimuth") == 12.5
        assert ((await second).command, (await second).error) == ("stop", 6)
        assert peer.tapped[:2] == [(">", b"+\\get_pos\n"), (">", b"+\\stop\n")]
        assert b"".join(data for way, data in peer.tapped if way == "<") == POSITION + b"stop:\nRPRT -6\n"


def test_a_missing_reply_is_reported_with_command_and_deadline_and_a_late_reply_is_dropped():
    @with_peer
    async def _(line, peer):
        with pytest.raises(DeadlineError, match=r"did not answer set_pos within 0\.05 s"):
            await line.ask(b"+\\set_pos 1.00 2.00\n", MISSED_S)
        waiting = asyncio.ensure_future(line.ask(b"+\\stop\n", PATIENCE_S))
        await peer.until_told(b"stop\n")
        peer.writer.write(b"set_pos: 1.00 2.00\nRPRT 0\nstop:\nRPRT 0\n")
        assert (await waiting).command == "stop"


def test_an_answer_that_nobody_asked_for_is_a_protocol_error():
    @with_peer
    async def _(line, peer):
        peer.writer.write(POSITION)
        await peer.until(lambda: ("<", POSITION) in peer.tapped)
        with pytest.raises(ProtocolError, match=r"127\.0\.0\.1:\d+ sent an answer that nobody asked for"):
            await line.ask(b"+\\stop\n", PATIENCE_S)


def test_a_peer_that_sends_without_end_is_refused_as_not_a_rotctld():
    @with_peer
    async def _(line, peer):
        waiting = asyncio.ensure_future(line.ask(b"+\\stop\n", PATIENCE_S))
        await peer.until_told(b"stop\n")
        peer.writer.write(b"SSH-2.0\r\n" * 4000)
        for asked in (waiting, line.ask(b"+\\stop\n", PATIENCE_S)):
            with pytest.raises(ProtocolError, match=r"127\.0\.0\.1:\d+ is not a rotctld: it sends without end"):
                await asked


def test_a_closed_connection_is_reported_to_waiting_and_to_later_callers():
    @with_peer
    async def _(line, peer):
        waiting = asyncio.ensure_future(line.ask(b"+\\get_pos\n", PATIENCE_S))
        await peer.until_told(b"get_pos\n")
        peer.writer.close()
        for asked in (waiting, line.ask(b"+\\stop\n", PATIENCE_S)):
            with pytest.raises(LinkLostError, match=r"rotctld at 127\.0\.0\.1:\d+ has closed the connection$"):
                await asked


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (ConnectionRefusedError(errno.ECONNREFUSED, "refused"), "nothing listens at there:1: is rotctld running there"),
        (OSError(errno.ENETUNREACH, "Network is unreachable"), "there:1 cannot be reached: Network is unreachable"),
        (socket.gaierror(socket.EAI_NONAME, "unknown"), "there is no host there: is the name right"),
        (TimeoutError(), "there:1 does not answer: is the machine on, and does its network work"),
    ],
)
def test_a_rotctld_that_cannot_be_reached_is_reported_with_the_reason(fault, sentence, monkeypatch):
    async def opened():
        async def refuse(*_):
            raise fault

        monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", refuse)
        with pytest.raises(ConnectError, match=sentence):
            await TcpLine("there", 1).open()

    asyncio.run(opened())
