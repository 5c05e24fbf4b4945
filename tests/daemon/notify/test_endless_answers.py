"""The answer of an impostor in place of a service or the heartbeat may have no end: little of it is read."""

import asyncio

import httpx

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.config.links import NotifySettings
from daemon.notify.courier import Courier, beat
from tests.support.endless import TAKEN, sent_to


def test_of_an_endless_state_answer_no_more_is_read_than_the_longest_state():
    async def ask(address):
        async with httpx.AsyncClient(trust_env=False) as client:
            courier = Courier(NotifySettings(), [parse_address(address)], [], SystemClock(), client)
            await asyncio.gather(*await courier.step())

    assert asyncio.run(sent_to(ask))[1] < TAKEN


def test_an_endless_answer_to_a_heartbeat_is_not_read():
    async def ask(address):
        return await beat(f"http://{address}/beat")

    trouble, sent = asyncio.run(sent_to(ask))
    assert trouble is None
    assert sent < TAKEN
