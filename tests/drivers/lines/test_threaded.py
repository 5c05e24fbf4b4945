"""A line of blocking calls: each exchange is a call in the instrument's thread, and a hung one is left behind."""

import asyncio
import threading

import pytest

from drivers.errors import DeadlineError, LinkLostError
from drivers.lines.threaded import ThreadedLine

pytestmark = pytest.mark.slow


class EchoingLine:
    """Answers each line with itself in capitals; hangs when a test says so."""

    transfer_s = 0.01

    def __init__(self, gate, log):
        self._gate, self._log = gate, log
        self._said = []
        log.append("open")

    def send(self, text):
        self._said.append(text.upper())

    def receive(self, within_s):
        if self._said and self._said[0] == "HANG":
            self._gate.wait()
        if not self._said:
            raise DeadlineError("voltmeter", f"nothing in {within_s:g} s")
        return self._said.pop(0)

    def interrupt(self):
        self._said.clear()

    def drain(self, quiet_s):
        self._log.append(f"drained {quiet_s:g}")

    def discard_unsolicited(self):
        return bool(self._said)

    def close(self):
        self._log.append("close")


@pytest.fixture
def gate():
    """An event that releases every hung call at the end of a test."""
    event = threading.Event()
    yield event
    event.set()


def test_exchanges_run_in_order_and_errors_of_the_blocking_line_reach_the_caller(gate):
    log = []

    async def scene():
        line = ThreadedLine("voltmeter", lambda: EchoingLine(gate, log))
        with pytest.raises(LinkLostError, match="opened first"):
            await line.send("too early")
        await line.open()
        assert await asyncio.gather(*(line.ask(text, 1.0) for text in ("one", "two"))) == ["ONE", "TWO"]
        assert not await line.discard_unsolicited()
        await line.send("three")
        assert await line.discard_unsolicited()
        await line.interrupt()
        await line.drain(0.1)
        with pytest.raises(DeadlineError, match=r"nothing in 0\.5 s"):
            await line.receive(0.5)
        await line.close()
        await line.close()

    asyncio.run(scene())
    assert log == ["open", "drained 0.1", "close"]


@pytest.mark.live
def test_a_call_that_hangs_is_a_lost_link_and_the_next_opening_gets_a_new_thread(gate):
    async def scene():
        line = ThreadedLine("voltmeter", lambda: EchoingLine(gate, []))
        await line.open()
        # One second to send, the deadline, the way there and back, and two seconds more.
        with pytest.raises(LinkLostError, match=r"did not return within 3\.03 s"):
            await line.ask("hang", 0.01)
        await line.close()
        await line.open()
        assert await line.ask("alive", 1.0) == "ALIVE"
        await line.close()

    asyncio.run(scene())
