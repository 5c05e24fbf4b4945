"""Stored days, the sun's path and the check of a token, over the interface."""

import asyncio
import gzip
import json

import pvlib
import pytest

from daemon.api.models import DaysPage, LinesPage
from daemon.base.clock import SystemClock
from daemon.base.records import Event, Pose, Scan
from daemon.store.store import Store
from tests.daemon.store.test_history import ORIGIN
from tests.daemon.store.test_tables import ALL, T0
from tests.support.api import BEARER, Caller, server_of
from tests.support.phases import wait_for_move

SPAN = "from=2022-10-14T05:00Z&to=2022-10-15T05:00Z"


def test_stored_days_and_records_can_be_read_over_http(run_rig, tmp_path):
    store = Store(tmp_path, 60.0, 400, ORIGIN, SystemClock(), lambda event: None)
    # The event is on this evening by UTC, and on the next day by the sun 2 degrees east of Greenwich.
    for record in (*ALL, Event(T0 + 17.9 * 3600.0, 1.0, "x", "")):
        store.keep(record)
    store.close()

    async def scenario(rig):
        settings = rig.service.settings.api.model_copy(update={"listen": "127.0.0.1:0"})
        server = server_of(rig, settings, store=store.status)
        serving = asyncio.create_task(server.run())
        call = Caller(server)
        try:
            assert (await call.get("/api/days")).json == {"days": ["2022-10-14", "2022-10-15"]}
            DaysPage.model_validate((await call.get("/api/days")).json)
            LinesPage.model_validate((await call.get(f"/api/history/moves?{SPAN}")).json)
            reply = await call.get(f"/api/history/scans?{SPAN}")
            assert "content-encoding: gzip" in reply.head.lower()
            assert json.loads(gzip.decompress(reply.body).partition(b"\n")[0])["rows"] == 2
            rows = (await call.get(f"/api/history/modes?{SPAN}&tracker=")).json["rows"]
            assert [row["after"] for row in rows] == [ALL[6].after]
            for path, status, words in [
                ("/api/history/scans", 400, "from='' is not a UTC time"),
                (f"/api/history/secrets?{SPAN}", 400, "there are no records of the kind 'secrets'; there are scans"),
                ("/api/history/scans?from=2022-10-14&to=2022-10-14", 422, "from must be before to"),
                ("/api/history/scans?from=2022-10-14&to=2023-10-14", 422, "at most 7 days"),
                (
                    f"/api/history/modes?{SPAN}&tracker=west",
                    422,
                    "there is no tracker 'west'; the trackers are tracker",
                ),
            ]:
                reply = await call.get(path)
                assert (reply.status, words in reply.json["error"]) == (status, True), reply.json
        finally:
            serving.cancel()
            await asyncio.wait((serving,))

    run_rig(scenario)


def test_a_request_for_stored_days_without_a_store_is_refused_naming_store_directory(serve):
    async def scenario(rig, call):
        reply = await call.get("/api/days")
        assert (reply.status, reply.json) == (409, {"error": "no records are kept here: set store.directory"})

    serve(scenario)


def test_the_suns_path_over_http_covers_the_solar_day_and_matches_pvlib(serve):
    async def scenario(rig, call):
        found = (await call.get("/api/sun?at=2022-06-21T10:00:00Z")).json
        assert len(found["path"]) == 145
        site = rig.service.settings.site
        times = [point["time"] for point in found["path"]]
        truth = pvlib.solarposition.get_solarposition(
            times, site.latitude_deg, site.longitude_deg, altitude=site.altitude_m
        )
        azimuths = [point["azimuth_deg"] for point in found["path"]]
        assert azimuths == pytest.approx(truth["azimuth"].to_list(), abs=0.01)
        assert times[0] < found["sunrise"] < found["noon"] < found["sunset"] < times[-1]
        noon = (await call.get("/api/sun")).json["noon"]
        assert noon[:10] == (await call.get("/api/state")).json["time"][:10]
        assert (await call.get("/api/sun?at=noon")).status == 400
        for year in (1970, 2199):
            assert (await call.get(f"/api/sun?at={year}-12-31T23:59:59Z")).status == 200
        for year in (1, 1969, 2200, 9999):
            refused = await call.get(f"/api/sun?at={year:04}-12-31T23:59:59Z")
            assert (refused.status, refused.json["error"].endswith("is not a time from 1970 to 2199")) == (422, True)

    serve(scenario)


def test_a_right_and_a_wrong_token_can_be_tried_without_any_effect_on_a_move_under_way(serve):
    async def scenario(rig, call):
        def seen():
            told = [record for record in rig.records if not isinstance(record, Pose | Scan)]
            return rig.mode, rig.control.why, rig.motion.target, told

        await wait_for_move(rig)
        before = seen()
        assert (await call.post("authorised")).json == {"ok": True}
        wrong = await call.post("authorised", headers=BEARER | {"Authorization": "Bearer " + "x" * 43})
        assert (wrong.status, wrong.json["error"]) == (
            401,
            "the token is not the service's: restart the service after a change of api.token_file",
        )
        await asyncio.sleep(0.5)
        assert seen() == before

    serve(scenario)
