"""Who gets through the door: whoever sends something, at a bounded rate, and the bearer of the token at once."""

import asyncio
import errno
import socket
from contextlib import suppress

import pytest

from daemon.api.gate import Token
from daemon.api.port.doorkeeper import Doorkeeper
from daemon.api.refusals import ApiRefusals
from daemon.base.timeloop import VirtualTimeLoop

TOKEN = "t" * 43
PAGE = b"GET /api/state HTTP/1.1\r\nHost: localhost\r\n\r\n"
STOP = b"POST /api/stop HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer %s\r\n\r\n"


class FromElsewhere(socket.socket):
    """A bound socket whose callers may seem to have another address, and which may fail once."""

    whence: str | None = None
    fails: OSError | None = None

    def accept(self):
        failure, self.fails = self.fails, None
        if failure is not None:
            raise failure
        accepted, address = super().accept()
        return accepted, (self.whence or address[0], *address[1:])


class Doorstep:
    """A door on loopback, and those who came through it."""

    def __init__(self):
        self.bound = FromElsewhere()
        self.bound.bind(("127.0.0.1", 0))
        self.refusals = ApiRefusals(lambda: 0.0)
        self.inside = []
        self.came_in = asyncio.Condition()
        self._outside = []

    async def serve(self, caller):
        said = caller.recv(4096)
        caller.close()
        async with self.came_in:
            self.inside.append(said)
            self.came_in.notify_all()

    async def until(self, holds):
        async with self.came_in:
            await asyncio.wait_for(self.came_in.wait_for(holds), 3600)

    def call(self, said=b""):
        caller = socket.create_connection(self.bound.getsockname())
        caller.setblocking(False)
        self._outside.append(caller)
        caller.send(said)
        return caller

    def door(self):
        return Doorkeeper(Token(TOKEN), self.refusals, 1.0).open(self.bound, self.serve)

    def close(self):
        for one in (self.bound, *self._outside):
            one.close()


def in_house(scenario):
    async def run():
        house = Doorstep()
        try:
            with house.door():
                await asyncio.wait_for(scenario(house), 7200)
        finally:
            house.close()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(run())


async def answer(caller):
    """Return what is sent to a caller before the end; a reset counts as an end."""
    with suppress(ConnectionError):
        return await asyncio.get_running_loop().sock_recv(caller, 4096)
    return b""


def test_callers_that_hang_up_without_sending_are_not_admitted_and_delay_nobody():
    async def scenario(house):
        for _ in range(1000):
            house.call().close()
        house.call(PAGE)
        asked_s = asyncio.get_running_loop().time()
        await house.until(lambda: house.inside)
        assert asyncio.get_running_loop().time() - asked_s < 0.1
        assert house.inside == [PAGE]

    in_house(scenario)


@pytest.mark.parametrize(("token", "at_once"), [(TOKEN, True), ("wrong", False)])
def test_only_a_caller_with_the_right_token_overtakes_waiting_callers(token, at_once):
    stop = STOP % token.encode()

    async def scenario(house):
        for _ in range(200):
            house.call(PAGE)
        await house.until(lambda: len(house.inside) == 101)
        house.call(stop)
        await house.until(lambda: stop in house.inside)
        assert (len(house.inside) < 110) is at_once
        assert len(house.inside) == 201 or at_once

    in_house(scenario)


def test_callers_beyond_the_waiting_limit_get_http_503_with_retry_after():
    async def scenario(house):
        callers = [house.call(PAGE) for _ in range(300)]
        told = await answer(callers[-1])
        assert told.startswith(b"HTTP/1.1 503 ")
        head, _, content = told.partition(b"\r\n\r\n")
        assert b"retry-after: 1\r\n" in head
        assert b"content-length: %d" % len(content) in head
        await house.until(lambda: len(house.inside) >= 228)
        assert house.refusals.counts["crowded"] == 300 - len(house.inside)

    in_house(scenario)


@pytest.mark.parametrize(("whence", "most"), [("192.0.2.7", 32), ("127.9.9.9", 192), ("::ffff:127.9.9.9", 192)])
def test_too_many_silent_callers_drop_the_longest_silent_and_a_far_address_only_its_own(whence, most):
    async def scenario(house):
        near = house.call()
        await asyncio.sleep(0.1)
        house.bound.whence = whence
        callers = [house.call() for _ in range(most)]
        await asyncio.sleep(0.1)
        callers.append(house.call())
        first = near if most == 192 else callers[0]
        assert await answer(first) == b""
        house.call(STOP % TOKEN.encode())
        callers[-1].send(PAGE)
        await house.until(lambda: len(house.inside) == 2)
        assert house.refusals.counts["crowded"] == 1

    in_house(scenario)


def test_one_far_address_cannot_take_all_waiting_places():
    async def scenario(house):
        house.bound.whence = "192.0.2.7"
        for _ in range(200):
            house.call(PAGE)
        await house.until(lambda: len(house.inside) == 132)
        assert house.refusals.counts["crowded"] == 200 - 132

    in_house(scenario)


def test_a_silent_caller_is_dropped_after_some_seconds_and_one_that_sends_late_is_served():
    async def scenario(house):
        silent, late = house.call(), house.call()
        await asyncio.sleep(4)
        late.send(PAGE)
        await house.until(lambda: house.inside == [PAGE])
        begun_s = asyncio.get_running_loop().time()
        assert await answer(silent) == b""
        assert asyncio.get_running_loop().time() - begun_s < 3
        assert house.refusals.counts["slow"] == 1

    in_house(scenario)


def test_callers_are_still_served_after_accept_fails_for_lack_of_file_descriptors():
    async def scenario(house):
        house.bound.fails = OSError(errno.EMFILE, "Too many open files")
        house.call(PAGE)
        await house.until(lambda: house.inside)
        assert house.refusals.counts["crowded"] == 1

    in_house(scenario)
