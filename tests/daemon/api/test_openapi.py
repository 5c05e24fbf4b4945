"""The description of the interface agrees with the interface: its routes, its answers, and the file in docs."""

import asyncio
import json

from starlette.routing import Route

from daemon.api.models import AuthorisedPage, CommandPage, ErrorPage, HealthPage, ScansPage, StatePage, SunPage
from daemon.api.openapi import description
from daemon.service.command_bodies import CommandBody, body_model
from daemon.service.operator_commands import COMMAND_NAMES
from tests.support import ROOT
from tests.support.api import server_of
from tests.support.phases import wait_for_tracking

KEPT = ROOT / "docs" / "openapi.json"


def test_openapi_file_in_docs_equals_the_served_description(serve):
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    assert kept == json.loads(json.dumps(description())), "run: python -m daemon.api.openapi"

    async def scenario(rig, call):
        assert (await call.get("/api/openapi.json")).json == kept

    serve(scenario)


def test_every_route_is_described_with_its_method(run_rig):
    async def scenario(rig):
        server = server_of(rig, rig.service.settings.api.model_copy(update={"listen": "127.0.0.1:0"}))
        server.close()
        routes = [route for route in server._api.routes if isinstance(route, Route)]
        served = {(route.path, method.lower()) for route in routes for method in route.methods - {"HEAD"}}
        assert served == {(path, method) for path, ways in description()["paths"].items() for method in ways}

    run_rig(scenario)


def test_http_answers_match_their_models(serve):
    async def scenario(rig, call):
        StatePage.model_validate((await call.get("/api/state")).json)
        await wait_for_tracking(rig)
        await asyncio.sleep(10)
        state = StatePage.model_validate((await call.get("/api/state")).json)
        assert state.mode.name == "tracking"
        assert state.scan.faces["zenith"].quality == "ok"
        assert len(ScansPage.model_validate((await call.get("/api/scans")).json).scans) > 5
        assert len(SunPage.model_validate((await call.get("/api/sun")).json).path) == 145
        assert AuthorisedPage.model_validate((await call.post("authorised")).json).ok
        assert HealthPage.model_validate((await call.get("/healthz")).json).ok
        done = CommandPage.model_validate((await call.post("hold", b'{"id": "7"}')).json)
        assert (done.command, done.id) == ("hold", "7")
        ErrorPage.model_validate((await call.post("hold", b"[]")).json)
        rig.cables.positioner.link_up = False
        await rig.until(lambda: not rig.motion.connected, 15, "the loss")
        await asyncio.sleep(1)
        assert StatePage.model_validate((await call.get("/api/state")).json).alarms is not None

    serve(scenario)


def test_the_state_of_several_trackers_matches_its_model(serve):
    async def scenario(rig, call):
        await asyncio.sleep(60)
        state = StatePage.model_validate((await call.get("/api/state")).json)
        assert state.mode is None
        assert set(state.trackers) == {"east", "west"}

    serve(scenario, tracker=[{"name": "east"}, {"name": "west"}])


def test_command_bodies_are_described_by_the_models_that_check_them():
    schemas = description()["components"]["schemas"]
    for name in COMMAND_NAMES:
        model = body_model(name)
        found = schemas[model.__name__]
        assert set(found["properties"]) == set(model.model_fields)
        assert found["additionalProperties"] is False
        assert found.get("required", []) == [key for key, field in model.model_fields.items() if field.is_required()]
        own = set(model.model_fields) - set(CommandBody.model_fields)
        assert set(found.get("required", [])) == own - {"alarm", "shown"}
