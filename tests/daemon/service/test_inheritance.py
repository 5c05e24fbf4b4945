"""A tracker that gets a name forgets nothing of what it had kept without one."""

import asyncio

from daemon.base.records import Mode


def test_a_stop_holds_for_every_tracker_that_is_named_later_and_for_none_after_that(run_rig, tmp_path):
    async def unnamed(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await rig.control.stop("repair", "ana")

    async def named(rig):
        await asyncio.sleep(60)
        assert [tracker.control.wishes.stop.why for tracker in rig.service.trackers] == ["repair"] * 2
        assert [tracker.control.mode for tracker in rig.service.trackers] == [Mode.HOLD] * 2
        rig.service.trackers[0].control.auto()

    async def again(rig):
        east, west, north = rig.service.trackers
        assert east.control.wishes.stop is None
        assert west.control.wishes.stop.why == "repair"
        assert north.control.wishes.stop is None

    store = {"directory": tmp_path}
    run_rig(unnamed, store=store)
    run_rig(named, store=store, tracker=[{"name": "east"}, {"name": "west"}])
    assert (tmp_path / "operator.json.before").is_file()
    run_rig(again, store=store, tracker=[{"name": "east"}, {"name": "west"}, {"name": "north"}])
