"""The health that a supervisor reads: when it is bad, and what is down."""

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from daemon.base.records import Mode, Move
from daemon.service.recent import RecentRecords
from daemon.service.rig import Role
from daemon.service.status import LinkStatus
from daemon.store.store import StoreStatus
from tests.support.api import Caller, server_of
from tests.support.phases import wait_for_tracking


def test_health_names_a_disconnected_positioner_exactly_once(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        rig.cables.positioner.link_up = False
        await rig.until(lambda: rig.motion.outage.is_down, 60, "a positioner that is down")
        (down,) = (await call.get("/healthz")).json["down"]
        assert down.startswith("positioner: ")
        assert down.count("positioner") == 1

    serve(scenario)


def test_health_is_bad_when_the_control_loop_has_not_run_for_half_a_minute(serve):
    async def scenario(rig, call):
        await wait_for_tracking(rig)
        rig.control.last_tick_s -= 31
        reply = await call.get("/healthz")
        assert (reply.status, reply.json["ok"]) == (503, False)
        assert "control has not run for 3" in reply.json["troubles"][0]

    serve(scenario)


DISK_FULL = StoreStatus(Path("records"), 0, 5, 0, "the disk is full")
BAD_WORD = "mqtt.wind of weather/roof cannot be used: 200 is not a wind speed in m/s"
LINK = LinkStatus("broker:1883", True, 0.0, None, 1, 0, 0, 0, 0, None, troubles=(BAD_WORD,))


@pytest.mark.parametrize(
    ("seen", "down"),
    [({"store": DISK_FULL}, "store: the disk is full"), ({"links": {"tracker": LINK}}, f"mqtt: {BAD_WORD}")],
)
def test_health_names_a_full_disk_and_an_unusable_mqtt_message(run_rig, seen, down):
    async def scenario(rig):
        settings = rig.service.settings.api.model_copy(update={"listen": "127.0.0.1:0"})
        server = server_of(rig, settings, **seen)
        serving = asyncio.create_task(server.run())
        reply = await Caller(server).get("/healthz")
        assert (reply.status, reply.json["down"]) == (200, [down])
        serving.cancel()
        await asyncio.wait((serving,))

    run_rig(scenario)


def test_health_of_a_tracker_reports_that_no_scan_has_come_since_the_start(serve):
    async def scenario(rig, call):
        await asyncio.sleep(30)
        assert (await call.get("/healthz")).json["down"] == [], "it has only just started"
        await rig.until_mode(Mode.FALLBACK, 120)
        assert (await call.get("/healthz")).json["down"] == ["cube: no scan has come since the start of the service"]

    serve(scenario, role=Role.TRACKER)


def test_a_tracker_without_its_bridge_address_follows_the_sun_and_all_pages_report_it(serve):
    # No machine has this address (RFC 5737).
    address = "198.51.100.1:20571"

    async def scenario(rig, call):
        await rig.until_mode(Mode.FALLBACK, 120)
        why = f"bridge.listen: {address} is not an address of this machine now"
        state = (await call.get("/api/state")).json
        assert why in state["mode"]["why"]
        assert state["bridge"]["down_why"].startswith(why)
        ((name, text),) = [(alarm["name"], alarm["text"]) for alarm in state["alarms"]]
        assert (name, text) == ("bridge-down", f"the bridge hears nothing: {state['bridge']['down_why']}")
        assert (await call.get("/healthz")).json["down"] == [f"bridge: {state['bridge']['down_why']}"]
        assert b"\nheliocube_bridge_up 0.0\n" in (await call.get("/metrics")).body
        await rig.until(lambda: rig.records_of(Move), 600, "a move by the clock")

    bridge = {"listen": address, "key_file": "the-rig-has-its-own.key"}
    serve(scenario, role=Role.TRACKER, bridge=bridge, safety={"fallback_after_s": 90})


@pytest.mark.parametrize(
    ("accept_from", "mode"),
    [((), Mode.TRACKING), (("198.51.100.1",), Mode.TRACKING), (("198.51.100.2",), Mode.FALLBACK)],
)
def test_a_cube_in_the_same_process_is_heard_without_the_bridge_address_if_accept_from_allows(
    run_rig, accept_from, mode
):
    async def scenario(rig):
        await rig.until_mode(mode, 120)
        service = rig.service
        assert "not an address of this machine now" in service.receiver.down_why
        assert (service.receiver.statistics.accepted > 0) is (mode is Mode.TRACKING)

    bridge = {"listen": "198.51.100.1:20571", "accept_from": accept_from, "key_file": "the-rig-has-its-own.key"}
    run_rig(scenario, bridge=bridge, safety={"fallback_after_s": 90})


def test_a_silent_cube_in_another_process_is_reported_as_trouble(run_rig):
    async def scenario(rig):
        recent = RecentRecords()
        rig.bus.subscribe(recent.note)
        await wait_for_tracking(rig)
        seen = replace(rig.take_snapshot(recent), has_cube=False)
        assert seen.cube_trouble is None
        later = replace(seen, time_monotonic_s=seen.scan.time_monotonic_s + 60.5)
        assert later.cube_trouble == "no scan for 60 s"
        assert replace(later, has_cube=True).cube_trouble is None, "of its own cube it knows the reason"

    run_rig(scenario)
