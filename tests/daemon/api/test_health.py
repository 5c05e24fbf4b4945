"""The health that a supervisor reads: when it is bad, and what is down."""

import asyncio
from pathlib import Path

from daemon.store.store import StoreStatus
from tests.support.api import Caller, server_of
from tests.support.phases import tracking


def test_health_is_bad_when_control_no_longer_looks(serve):
    async def scenario(rig, call):
        await tracking(rig)
        rig.control.last_tick_s -= 31
        reply = await call.get("/healthz")
        assert (reply.status, reply.json["ok"]) == (503, False)
        assert "control has not run for 3" in reply.json["troubles"][0]

    serve(scenario)


def test_health_names_a_store_that_is_down(run_rig):
    async def scenario(rig):
        down = StoreStatus(Path("records"), 0, 5, 0, "the disk is full")
        settings = rig.service.settings.api.model_copy(update={"listen": "127.0.0.1:0"})
        server = server_of(rig, settings, store=down)
        serving = asyncio.create_task(server.run())
        reply = await Caller(server).get("/healthz")
        assert (reply.status, reply.json["down"]) == (200, ["store: the disk is full"])
        serving.cancel()
        await asyncio.wait((serving,))

    run_rig(scenario)
