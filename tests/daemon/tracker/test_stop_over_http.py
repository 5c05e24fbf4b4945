"""The interface's answers and state while a person keeps the tracker still, or before it has begun."""

import asyncio
import json

import pytest

from daemon.base.records import Mode
from daemon.service.operator import CommandError
from daemon.tracker.wishes import Wishes
from tests.daemon.tracker.test_stop import OTHERS, call
from tests.support.api import serve
from tests.support.phases import wait_for_move, wait_for_tracking

__all__ = ["serve"]


def test_goto_in_mode_starting_is_refused_with_a_remedy_that_works(serve):
    async def scenario(rig, call_http):
        await rig.until(lambda: rig.motion.connected, 10, "the positioner")
        assert rig.mode is Mode.STARTING
        reply = await call_http.post("goto", b'{"a_deg": 10, "b_deg": 60}')
        assert (reply.status, reply.json) == (
            409,
            {
                "error": "no goto in mode starting: waiting for the cube's readings; give it again in a minute,"
                " or after 'heliocube hold'"
            },
        )
        assert rig.control.wishes == Wishes()
        assert (await call_http.post("hold")).status == 200
        assert (await call_http.post("goto", b'{"a_deg": 10, "b_deg": 60}')).json["state"] == "under-way"

    serve(scenario)


def test_the_state_shows_stop_and_hold_apart_with_who_gave_them_and_since_when(serve):
    async def scenario(rig, call_http):
        await wait_for_move(rig)
        await call_http.post("hold", b'{"why": "measuring", "by": "bob"}')
        await call_http.post("stop", b'{"why": "repair", "by": "ana"}')
        found = (await call_http.get("/api/state")).json
        wishes = found["wishes"]
        assert (wishes["stop"]["by"], wishes["stop"]["why"]) == ("ana", "repair")
        assert wishes["stop"]["since"].startswith("2022-10-12T10:0")
        assert (wishes["stop"]["latest"], wishes["stop"]["also"]) == (wishes["stop"]["since"], [])
        assert wishes["hold"]["by"] == "bob"
        await call_http.post("stop", b'{"why": "a noise", "by": "bob"}')
        stop = (await call_http.get("/api/state")).json["wishes"]["stop"]
        assert (stop["by"], stop["why"], stop["since"]) == ("ana", "repair", wishes["stop"]["since"])
        assert stop["also"] == [{"why": "a noise", "by": "bob", "since": stop["latest"]}]
        assert {name for name, wish in wishes.items() if wish is None} == {"maintenance", "buttons", "stow", "snow"}
        assert found["mode"]["name"] == "hold"
        assert found["alarms"] == []
        rig.wind_m_s = 20.0
        await asyncio.sleep(6)
        (alarm,) = (await call_http.get("/api/state")).json["alarms"]
        assert (alarm["name"], alarm["since"][:14]) == ("stow-wanted", "2022-10-12T10:")
        lines = (await call_http.get("/metrics")).body.decode().splitlines()
        assert 'heliocube_alarms{tracker="tracker"} 1.0' in lines
        assert 'heliocube_alarm{name="stow-wanted",severity="critical",tracker="tracker"} 1.0' in lines

    serve(scenario)


@pytest.mark.parametrize("name", OTHERS)
def test_over_http_a_command_refused_under_a_stop_gets_409_and_the_same_sentence_as_elsewhere(serve, name):
    async def scenario(rig, call_http):
        await wait_for_tracking(rig)
        await call_http.post("stop", b'{"why": "repair", "by": "ana"}')
        body = {"a_deg": 10, "b_deg": 60} if name == "goto" else {}
        reply = await call_http.post(name, json.dumps(body).encode())
        assert reply.status == 409
        with pytest.raises(CommandError) as refused:
            await call(rig, name)
        assert reply.json == {"error": str(refused.value)}

    serve(scenario)
