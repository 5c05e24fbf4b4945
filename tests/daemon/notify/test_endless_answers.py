"""The answer of an impostor in place of a service or the heartbeat may have no end: little of it is read."""

import asyncio

import httpx

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.config.links import NotifySettings
from daemon.notify.courier import Courier, send_heartbeat
from tests.support.endless import MOST_BYTES_SENT, ask_endless_server


def test_of_an_endless_state_answer_no_more_is_read_than_the_longest_state():
    async def ask(address):
        async with httpx.AsyncClient(trust_env=False) as client:
            courier = Courier(NotifySettings(), [parse_address(address)], [], SystemClock(), client)
            await asyncio.gather(*await courier.step())

    assert asyncio.run(ask_endless_server(ask))[1] < MOST_BYTES_SENT


def test_an_endless_answer_to_a_heartbeat_is_not_read():
    async def ask(address):
        return await send_heartbeat(f"http://{address}/beat")

    trouble, sent = asyncio.run(ask_endless_server(ask))
    assert trouble is None
    assert sent < MOST_BYTES_SENT
