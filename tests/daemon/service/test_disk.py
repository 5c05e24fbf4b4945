"""A disk that is slow, full or gone: motion does not wait for it, and who gives a command is told what is not kept."""

import asyncio
import itertools
import threading
from functools import partial

import pytest

from daemon.base.files import replace_file
from daemon.base.records import Mode
from daemon.base.state import StateFolder
from daemon.service.operator import CommandError, Effect, Operator
from daemon.tracker.wishes import WishFile
from tests.daemon.store.test_full_disk import fill, small_disk
from tests.support import PATIENCE_S
from tests.support.api import serve
from tests.support.phases import wait_for_move
from tests.support.rig import ServiceRig

__all__ = ["serve", "small_disk"]


def operator(rig):
    return Operator(rig.tracker, 1.0)


def kept(directory):
    return WishFile(StateFolder(directory)).load()


@pytest.fixture
def stuck_disk(monkeypatch):
    """Let the service's disk take nothing until the returned event is set."""
    released = threading.Event()

    def replace(path, text):
        assert released.wait(PATIENCE_S)
        replace_file(path, text)

    hours_s = itertools.count(0.0, 3600.0)
    made = partial(StateFolder, behind=True, replace=replace, now_s=lambda: next(hours_s))
    monkeypatch.setattr(ServiceRig, "kept_in", staticmethod(made))
    yield released
    released.set()


@pytest.mark.parametrize("name", ["stop", "maintenance", "stow"])
def test_stop_maintenance_and_stow_do_not_wait_for_a_disk_that_hangs(run_rig, stuck_disk, tmp_path, name):
    async def scenario(rig):
        await wait_for_move(rig)
        commands = operator(rig)
        # A later command would have to wait until this hold is written.
        await commands.hold("first", "ana")
        asked_s = rig.clock.monotonic()
        answer = await getattr(commands, name)("a hand near the actuator", "ana")
        assert answer.seen in (Effect.DONE, Effect.UNDER_WAY)
        assert rig.clock.monotonic() - asked_s < 7.0
        unsaved = answer.text.partition("; not kept yet: a restart would forget ")[2]
        assert "what was asked" in unsaved
        assert unsaved.endswith(" cannot be written (the disk has not answered yet)")
        assert not (tmp_path / "operator.json").exists()
        await asyncio.sleep(20)
        assert any("the disk has not answered yet" in alarm.text for alarm in rig.tracker.alarms.active) is (
            name != "maintenance"
        )
        stuck_disk.set()
        assert rig.tracker.folder.wait_for_writes(60)
        assert getattr(kept(tmp_path), name).why == "a hand near the actuator"
        await asyncio.sleep(10)
        assert "not-kept" not in {alarm.name for alarm in rig.tracker.alarms.active}

    run_rig(scenario, store={"directory": tmp_path})


def test_a_stop_is_kept_on_a_disk_that_has_become_full(serve, small_disk):
    async def scenario(rig, call):
        await rig.until_mode(Mode.TRACKING, 120)
        fill(small_disk / "filler")
        for command in ("stop", "auto", "stop"):
            answer = (await call.post(command)).json
            assert "not kept" not in answer["text"]
            assert (kept(small_disk).stop is not None) == (command == "stop")
        assert "not-kept" not in {one["name"] for one in (await call.get("/api/state")).json["alarms"]}

    serve(scenario, store={"directory": small_disk})


def test_a_stop_that_a_full_disk_cannot_take_says_so_and_is_kept_when_there_is_room(serve, small_disk):
    filler = small_disk / "filler"
    # Full before the service could reserve any room.
    fill(filler)

    async def scenario(rig, call):
        await rig.until_mode(Mode.TRACKING, 120)
        answer = (await call.post("stop")).json
        assert answer["done"] is True
        unsaved = answer["text"].partition("; not kept yet: a restart would forget ")[2]
        assert "what was asked" in unsaved
        assert unsaved.endswith(" cannot be written (No space left on device)")
        await asyncio.sleep(10)
        (alarm,) = [one for one in (await call.get("/api/state")).json["alarms"] if one["name"] == "not-kept"]
        assert alarm["text"] == answer["text"].partition("not kept yet: ")[2]
        filler.unlink()
        await asyncio.sleep(10)
        assert kept(small_disk).stop is not None
        assert "not-kept" not in {one["name"] for one in (await call.get("/api/state")).json["alarms"]}
        assert "not kept" not in (await call.post("stop")).json["text"]

    serve(scenario, store={"directory": small_disk})


def test_a_stop_that_neither_reaches_the_positioner_nor_the_disk_says_both(run_rig, tmp_path):
    (tmp_path / "file").touch()

    async def scenario(rig):
        await wait_for_move(rig)
        rig.cables.positioner.link_up = False
        with pytest.raises(CommandError, match=r"stop could not be sent, .*; not kept yet: a restart would forget"):
            await operator(rig).stop("a hand", "ana")

    run_rig(scenario, store={"directory": tmp_path / "file" / "folder"})
