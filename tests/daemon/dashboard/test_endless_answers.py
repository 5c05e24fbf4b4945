"""The answer of an impostor in place of a service may have no end: the dashboard reads little of it."""

import asyncio

import httpx

from daemon.base.addresses import parse_address
from daemon.base.clock import SystemClock
from daemon.base.timeloop import VirtualTimeLoop
from daemon.dashboard.app import Dashboard
from daemon.dashboard.upstream import Fleet
from tests.daemon.dashboard.house import PAGE, TOKEN
from tests.support import PATIENCE_S
from tests.support.endless import ACCEPTED, MOST_BYTES_SENT, ask_endless_server


def test_an_endless_event_stream_is_read_no_further_than_the_length_that_a_state_may_have():
    async def ask(address):
        async with httpx.AsyncClient(trust_env=False) as client:
            fleet = Fleet([parse_address(address)], client, SystemClock())
            following = asyncio.create_task(fleet.run())
            with fleet.listening() as listener:
                while '"up": false' not in "".join(await listener.next()):
                    pass
            following.cancel()
            await asyncio.wait((following,))

    assert asyncio.run(ask_endless_server(ask, "text/event-stream"))[1] < MOST_BYTES_SENT


def test_any_other_endless_answer_is_read_no_further_than_the_length_that_an_answer_may_have():
    async def ask(address):
        async with httpx.AsyncClient(trust_env=False) as client:
            app = Dashboard(Fleet([parse_address(address)], client, SystemClock()), SystemClock(), ["dash.lab"]).app
            transport = httpx.ASGITransport(app)
            async with httpx.AsyncClient(transport=transport, base_url=PAGE, headers={"Origin": PAGE}) as browser:
                assert (await browser.post("/login", json={"token": TOKEN, "by": "ana"})).status_code == 200
                order = {"name": "stop", "service": address}
                return [
                    await browser.post("/command", json=order),
                    await browser.post("/stow-all", json={}),
                    await browser.get("/read/days", params={"service": address}),
                ]

    (order, to_all, read), taken = asyncio.run(ask_endless_server(ask))
    sentence = "the program that answers is not a service of heliocube: see dashboard.services"
    assert [(reply.status_code, reply.json()) for reply in (order, read)] == [(502, {"error": sentence})] * 2
    assert to_all.json()["results"][0]["text"] == sentence
    assert taken < 2 * MOST_BYTES_SENT


def test_an_order_is_given_up_though_its_answer_trickles_on_for_ever():
    async def scenario():
        answering = set()

        async def answer(reader, writer):
            answering.add(asyncio.current_task())
            if b"/api/authorised" in await reader.readuntil(b"\r\n\r\n"):
                writer.write(ACCEPTED)
            else:
                writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n")
                while not writer.is_closing():
                    writer.write(b" ")
                    await asyncio.sleep(1.0)
            writer.close()

        async with await asyncio.start_server(answer, "127.0.0.1", 0) as server, httpx.AsyncClient() as client:
            address = "{}:{}".format(*server.sockets[0].getsockname())
            app = Dashboard(Fleet([parse_address(address)], client, SystemClock()), SystemClock(), ["dash.lab"]).app
            transport = httpx.ASGITransport(app)
            async with httpx.AsyncClient(transport=transport, base_url=PAGE, headers={"Origin": PAGE}) as browser:
                assert (await browser.post("/login", json={"token": TOKEN, "by": "ana"})).status_code == 200
                async with asyncio.timeout(PATIENCE_S):
                    found = (await browser.post("/stow-all", json={})).json()["results"]
            await asyncio.gather(*answering)
            assert [(each["status"], each["text"]) for each in found] == [(502, "the service does not answer")]

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())
