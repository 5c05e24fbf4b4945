"""A tracker that gets a name forgets nothing of what it had kept without one."""

import asyncio
import contextlib
import os
import subprocess
import time

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Mode
from daemon.base.state import StateFolder
from daemon.service.operator import Operator
from daemon.service.state_migration import migrate_state_to_trackers
from daemon.store.records_folder import lock_folder
from daemon.tracker.wishes import WishFile
from tests.daemon.tracker.days import FEWER_SCANS
from tests.support.motion import send_foreign_b_target
from tests.support.phases import wait_for_long_rest


def test_a_stop_of_an_unnamed_tracker_holds_for_all_trackers_named_next_and_for_none_added_later(run_rig, tmp_path):
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


@pytest.mark.parametrize("later", [[{"name": "east-roof"}], [{"name": "east-roof"}, {"name": "west"}], []])
def test_a_tracker_with_a_new_name_or_none_is_held_by_the_stop_of_a_tracker_that_is_gone(run_rig, tmp_path, later):
    store = {"directory": tmp_path}

    async def stopped(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await rig.control.stop("repair", "ana")

    async def held(rig):
        stood = rig.truth()
        await asyncio.sleep(600)
        assert rig.truth() == stood
        for tracker in rig.service.trackers:
            assert tracker.control.mode is Mode.HOLD
            (alarm,) = [alarm for alarm in tracker.alarms.active if alarm.name == "release-changed"]
            assert f"in {tmp_path / 'east'} 'east' is still stopped by ana" in alarm.text
            assert "give that name back" in alarm.text
            await Operator(tracker, 1.0).auto("ana")

    async def released(rig):
        assert len(rig.service.trackers) == (len(later) or 1)
        for tracker in rig.service.trackers:
            await rig.until(lambda one=tracker: one.control.mode is Mode.TRACKING, 600, "its work")

    async def named_again(rig):
        await asyncio.sleep(60)
        assert rig.service.trackers[0].control.wishes.stop.why == "repair"

    run_rig(stopped, store=store, tracker=[{"name": "east"}])
    run_rig(held, store=store, tracker=later, **FEWER_SCANS)
    run_rig(released, store=store, tracker=later, **FEWER_SCANS)
    run_rig(named_again, store=store, tracker=[{"name": "east"}])


@pytest.mark.parametrize("what", ["stop", "storm"])
def test_trackers_named_again_are_held_by_a_stop_or_storm_kept_while_there_were_no_names(run_rig, tmp_path, what):
    store, both = {"directory": tmp_path}, [{"name": "east"}, {"name": "west"}]

    async def kept(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        rig.control.hold("a look", "ben")
        rig.control.auto()

    async def without_a_name(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        if what == "stop":
            await rig.control.stop("repair", "ana")
        else:
            rig.wind_m_s = 20.0
            await rig.until_mode(Mode.STOW, 10)

    async def named_again(rig):
        stood = rig.truth()
        await asyncio.sleep(600)
        assert rig.truth() == stood
        assert [tracker.control.mode for tracker in rig.service.trackers] == [Mode.HOLD] * 2
        east = rig.service.trackers[0]
        (alarm,) = [alarm for alarm in east.alarms.active if alarm.name == "release-changed"]
        assert ("is still stopped by ana" if what == "stop" else "wind 20") in alarm.text
        assert "give that name back" not in alarm.text
        await Operator(east, 1.0).auto("ana")
        await rig.until(lambda: east.control.mode is Mode.TRACKING, 600, "its work")

    run_rig(kept, store=store, tracker=both)
    run_rig(without_a_name, store=store)
    run_rig(named_again, store=store, tracker=both, **FEWER_SCANS)


def test_a_known_tracker_ignores_the_stop_of_another_and_a_released_stop_holds_no_new_tracker(run_rig, tmp_path):
    store, both = {"directory": tmp_path}, [{"name": "east"}, {"name": "west"}]

    async def both_stopped(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        for tracker in rig.service.trackers:
            await tracker.control.stop("repair", "ana")

    async def last_released(rig):
        rig.service.trackers[-1].control.auto()

    async def works(rig):
        await rig.until_mode(Mode.TRACKING, 120)

    run_rig(both_stopped, store=store, tracker=both)
    run_rig(last_released, store=store, tracker=both)
    run_rig(works, store=store, tracker=[{"name": "west"}])
    run_rig(last_released, store=store, tracker=[{"name": "east"}])
    run_rig(works, store=store, tracker=[{"name": "north"}])


def test_a_tracker_that_was_never_commanded_works_on_when_its_stopped_neighbour_is_removed(run_rig, tmp_path):
    store = {"directory": tmp_path}

    async def east_stopped(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await rig.service.trackers[0].control.stop("broken", "ana")

    async def works(rig):
        await rig.until_mode(Mode.TRACKING, 120)

    run_rig(east_stopped, store=store, tracker=[{"name": "east"}, {"name": "west"}])
    run_rig(works, store=store, tracker=[{"name": "west"}])


@pytest.mark.parametrize("ahead_s", [-3600.0, 0.0, 3600.0])
def test_a_return_to_an_older_name_does_not_release_a_later_stop_whatever_the_clock_was(run_rig, tmp_path, ahead_s):
    store = {"directory": tmp_path}

    async def stopped_and_released(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await rig.control.stop("repair", "ana")
        rig.control.auto()

    async def stopped(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await rig.control.stop("again", "ana")

    async def held(rig):
        await asyncio.sleep(60)
        assert rig.control.mode is Mode.HOLD
        assert "'roof' is still stopped by ana" in rig.control.why

    run_rig(stopped_and_released, store=store, tracker=[{"name": "east"}])
    then_s = time.time() + ahead_s
    os.utime(tmp_path / "east" / "started.json", (then_s, then_s))
    run_rig(stopped, store=store, tracker=[{"name": "roof"}])
    run_rig(held, store=store, tracker=[{"name": "east"}])


def test_a_stop_of_another_service_in_a_subfolder_holds_no_tracker_while_that_service_runs(run_rig, tmp_path):
    async def works(rig):
        await rig.until_mode(Mode.TRACKING, 120)

    async def held(rig):
        await rig.until_mode(Mode.HOLD, 120)
        assert "'other' is still stopped: repair" in rig.control.why

    with lock_folder(tmp_path / "other", ("tracker",)):
        (tmp_path / "other" / "operator.json").write_text('{"stop": {"why": "repair"}}')
        run_rig(works, store={"directory": tmp_path}, tracker=[{"name": "east"}])
    before_s = time.time() - 3600.0
    os.utime(tmp_path / "east" / "started.json", (before_s, before_s))
    run_rig(held, store={"directory": tmp_path}, tracker=[{"name": "east"}])


@pytest.mark.parametrize("what", ["storm", "doubt", "motion", "unreadable"])
def test_a_storm_or_doubt_kept_by_a_removed_tracker_holds_a_new_tracker_and_no_other(run_rig, tmp_path, what):
    store, safety = {"directory": tmp_path}, {"stow_at_least_s": 60.0}
    words = {"storm": "wind 20", "doubt": "has restarted", "motion": "without an order", "unreadable": "cannot be read"}

    async def both(rig):
        await wait_for_long_rest(rig)
        if what == "storm":
            rig.wind_m_s = 20.0
            await rig.until_mode(Mode.STOW, 10)
        elif what == "doubt":
            rig.unit.power_cycle(rig.clock.monotonic())
            await rig.until_mode(Mode.FAULT, 15)
        else:
            send_foreign_b_target(rig, 85.0)
            await rig.until_mode(Mode.FAULT, 15)
            await asyncio.sleep(10)

    async def renamed(rig):
        new, known = rig.service.trackers
        await rig.until(lambda: known.control.mode is Mode.TRACKING, 600, "the work of the one that is known")
        assert new.control.mode is Mode.HOLD
        assert f"{tmp_path / 'east'} keeps for 'east': " in new.control.why
        assert words[what] in new.control.why
        await Operator(new, 1.0).auto("ana")
        await rig.until(lambda: new.control.mode is Mode.TRACKING, 120, "its work")

    run_rig(both, store=store, safety=safety, tracker=[{"name": "east"}, {"name": "west"}])
    if what == "unreadable":
        (tmp_path / "east" / "motion.json").write_text("{")
    run_rig(renamed, store=store, safety=safety, tracker=[{"name": "east-roof"}, {"name": "west"}])


def test_wishes_that_a_full_disk_kept_from_being_handed_on_are_handed_on_once_there_is_room(tmp_path):
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", tmp_path], capture_output=True)
    if made.returncode:
        pytest.skip("mounting a small file system needs root")
    try:
        (tmp_path / "operator.json").write_text('{"stow": {"why": "hail", "by": "ana"}}')
        filler = tmp_path / "filler"
        with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))
        with pytest.raises(UserError, match=r"cannot be handed on to east, west: No space left"):
            migrate_state_to_trackers(tmp_path, ["east", "west"])
        filler.unlink()
        migrate_state_to_trackers(tmp_path, ["east", "west"])
        for name in ("east", "west"):
            asked = WishFile(StateFolder(tmp_path / name)).load()
            assert (asked.stow.why, asked.stop) == ("hail", None)
    finally:
        subprocess.run(["umount", "--lazy", tmp_path], check=True)
