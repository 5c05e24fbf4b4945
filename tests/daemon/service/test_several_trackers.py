"""Two trackers in one process: what happens to one, and what is asked of one, leaves the other alone."""

import asyncio
import json
import logging
import re

import pytest

from daemon.base.process import LineFormatter
from daemon.base.records import Event, Mode, ModeChange, Move, Pose, Scan
from daemon.config.file import _MOST_TRACKERS
from daemon.service.operator import CommandError
from daemon.service.operator_commands import Operators, parse
from daemon.service.recent import RecentRecords
from daemon.service.snapshot import snapshot
from daemon.service.state import state_json, tracker_state_json
from drivers.errors import DriverHungError
from tests.support import ROOT

TWO = [{"name": "east"}, {"name": "west", "limits": {"a_max_deg": 20.0}}]


def modes(rig):
    return [tracker.control.mode for tracker in rig.service.trackers]


async def both_track(rig):
    await rig.until(lambda: modes(rig) == [Mode.TRACKING] * 2, 120, "tracking of both")


async def give(rig, name, **body):
    command = parse(name, json.dumps(body).encode(), "test")
    return await Operators(rig.service.trackers, 1.0).carry_out(command)


def test_an_unplugged_tracker_is_in_fault_and_the_other_goes_on_tracking(run_rig):
    async def scenario(rig):
        await both_track(rig)
        rig.cables.others[0].link_up = False
        await rig.until(lambda: modes(rig)[1] is Mode.FAULT, 120, "the fault of one")
        moved = len(rig.records_of(Move))
        await asyncio.sleep(1800)
        assert modes(rig) == [Mode.TRACKING, Mode.FAULT]
        later = rig.records_of(Move)[moved:]
        assert later
        assert {move.tracker for move in later} == {"east"}
        rig.cables.others[0].link_up = True
        await rig.until(lambda: modes(rig) == [Mode.TRACKING] * 2, 120, "the way back")

    run_rig(scenario, tracker=TWO)


def test_log_lines_name_the_tracker_that_they_are_about(run_rig, caplog):
    lines = []
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(LineFormatter(journal=True).format(record))
    logging.getLogger("heliocube").addHandler(handler)
    caplog.set_level(logging.INFO, "heliocube")

    async def scenario(rig):
        await both_track(rig)
        rig.cables.others[0].link_up = False
        await rig.until(lambda: modes(rig)[1] is Mode.FAULT, 120, "the fault of one")
        await give(rig, "hold", tracker="east", why="test")
        await give(rig, "auto", tracker="east", why="go on")
        with pytest.raises(CommandError, match="NOT done by 1 of 2 trackers, west:"):
            await give(rig, "stop", why="both")

    try:
        # Instruments that a file calls a bench's may be real, so it is told that nothing is kept.
        run_rig(scenario, tracker=TWO, instruments={"bench": True})
    finally:
        logging.getLogger("heliocube").removeHandler(handler)
    assert next(line for line in lines if "is down" in line).count("tracker=west") == 1, "\n".join(lines)
    assert next(line for line in lines if "hold: test" in line).count("tracker=east") == 1
    assert [
        line for line in lines if "tracker=" not in line and ("both" in line or " -> " in line or "go on" in line)
    ] == []
    for name in ("east", "west"):
        for part in ("starting -> tracking", "store.directory is not set"):
            assert any(part in line and f"tracker={name}" in line for line in lines), part


def test_a_stop_of_one_tracker_leaves_the_other_moving_and_each_wish_survives_a_restart(run_rig, tmp_path):
    async def before(rig):
        await both_track(rig)
        answer = await give(rig, "stop", tracker="west", why="repair")
        assert answer["done"]
        await asyncio.sleep(1800)
        assert modes(rig) == [Mode.TRACKING, Mode.HOLD]
        assert (await give(rig, "snow", tracker="east", why="hail"))["state"] in ("done", "under-way")

    async def after(rig):
        east, west = rig.service.trackers
        assert (east.control.wishes.snow.why, east.control.wishes.stop) == ("hail", None)
        assert (west.control.wishes.stop.why, west.control.wishes.snow) == ("repair", None)

    options = {"tracker": TWO, "store": {"directory": tmp_path}}
    run_rig(before, **options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["east", "west"]
    run_rig(after, **options)


def test_a_stop_without_a_tracker_name_stops_all_and_other_commands_require_a_name(run_rig):
    async def scenario(rig):
        await both_track(rig)
        found = await give(rig, "stop", why="fire")
        head, *lines = found["text"].split("\n")
        assert head == "all 2 trackers:"
        assert [line[:17] for line in lines] == ["  east:  stopped ", "  west:  stopped "]
        assert modes(rig) == [Mode.HOLD] * 2
        with pytest.raises(CommandError, match="'heliocube auto --tracker NAME', where NAME is one of east, west"):
            await give(rig, "auto")
        with pytest.raises(CommandError, match="there is no tracker 'north'; the trackers are east, west"):
            await give(rig, "auto", tracker="north")
        await give(rig, "auto", tracker="east")
        await rig.until(lambda: modes(rig) == [Mode.TRACKING, Mode.HOLD], 120, "the release of one")

    run_rig(scenario, tracker=TWO)


def test_a_stop_for_an_unknown_tracker_name_stops_all_and_says_so(run_rig):
    async def scenario(rig):
        await both_track(rig)
        sentence = "there is no tracker 'nroth'; the trackers are east, west; so the stop is for all: all 2 trackers:\n"
        with pytest.raises(CommandError, match=sentence) as caught:
            await give(rig, "stop", tracker="nroth", why="fire")
        assert caught.value.wrong
        assert modes(rig) == [Mode.HOLD] * 2
        rig.cables.positioner.link_up = False
        await asyncio.sleep(1)
        with pytest.raises(CommandError, match="is for all: NOT done by 1 of 2 trackers, east:\n  east:  stop "):
            await give(rig, "stop", tracker="nroth", why="fire")

    run_rig(scenario, tracker=TWO)


def test_the_answer_to_a_stop_of_all_has_a_line_for_each_tracker_with_unreached_ones_first(run_rig):
    async def scenario(rig):
        await rig.until(lambda: modes(rig) == [Mode.TRACKING] * 3, 120, "tracking of all")
        rig.cables.others[1].link_up = False
        with pytest.raises(CommandError) as caught:
            await give(rig, "stop", why="fire")
        head, *lines = str(caught.value).split("\n")
        assert head == "NOT done by 1 of 3 trackers, north-west:"
        assert [line[:14] for line in lines] == ["  north-west: ", "  east:       ", "  west:       "]
        assert lines[0][14:].startswith(" stop could not be sent")
        assert rig.control.wishes.stop.why == "fire"
        assert not rig.motion.moving

    run_rig(scenario, tracker=[*TWO, {"name": "north-west"}])


def test_each_tracker_keeps_within_its_own_limits(run_rig):
    async def scenario(rig):
        await both_track(rig)
        await give(rig, "goto", tracker="east", a_deg=30, b_deg=60)
        with pytest.raises(CommandError, match="outside the limits"):
            await give(rig, "goto", tracker="west", a_deg=30, b_deg=60)

    run_rig(scenario, tracker=TWO)


def test_records_bear_the_name_of_their_tracker_and_scans_come_once(run_rig):
    async def scenario(rig):
        await both_track(rig)
        await asyncio.sleep(600)
        for kind in (Pose, ModeChange, Move):
            assert {record.tracker for record in rig.records_of(kind)} == {"east", "west"}
        scans = rig.records_of(Scan)
        assert len(scans) == len({scan.sequence for scan in scans}) > 5

    run_rig(scenario, tracker=TWO)


def test_the_state_lists_each_tracker_by_name_and_a_single_tracker_at_the_top_level_too(run_rig):
    async def two(rig):
        await both_track(rig)
        found = state_json(rig.take_snapshot())
        assert list(found["trackers"]) == ["east", "west"]
        assert found["mode"] is found["tracker"] is None
        assert found["trackers"]["west"]["tracker"]["limits"]["a_max_deg"] == 20.0
        # By then it has left the stow position.
        await asyncio.sleep(60)
        rig.wind_m_s = 20.0
        await give(rig, "stop", tracker="west", why="repair")
        await asyncio.sleep(20)
        assert [(alarm["name"], alarm["tracker"]) for alarm in state_json(rig.take_snapshot())["alarms"]] == [
            ("stow-wanted", "west")
        ]
        west = tracker_state_json(rig.take_snapshot(), "west")
        assert (west["mode"]["name"], west["tracker"]["name"]) == ("hold", "west")
        assert tracker_state_json(rig.take_snapshot(), "east")["alarms"] == []

    async def one(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        found = state_json(rig.take_snapshot())
        assert found["trackers"]["tracker"] == {name: found[name] for name in found["trackers"]["tracker"]}
        assert found["mode"]["name"] == "tracking"

    run_rig(two, tracker=TWO)
    run_rig(one)


def test_maintenance_mutes_only_the_alarms_of_its_tracker_and_those_of_the_cube_if_all_are_in_it(run_rig):
    async def scenario(rig):
        await both_track(rig)
        await give(rig, "maintenance", tracker="west", why="belts")
        assert [tracker.alarms.muted for tracker in rig.service.trackers] == [False, True]
        assert not rig.service.cube_alarms.muted
        await give(rig, "maintenance", tracker="east", why="belts")
        assert rig.service.cube_alarms.muted
        await give(rig, "auto", tracker="east")
        assert not rig.service.cube_alarms.muted

    run_rig(scenario, tracker=TWO)


def test_a_driver_that_hangs_for_good_disables_its_own_tracker_and_not_the_service(run_rig):
    async def scenario(rig):
        await both_track(rig)

        async def hang():
            raise DriverHungError("positioner", "8 calls of its driver never returned")

        rig.others[0].open = hang
        rig.cables.others[0].link_up = False
        await rig.until(lambda: rig.service.trackers[1].alarms.active, 120, "the alarm")
        (alarm,) = rig.service.trackers[1].alarms.active
        assert alarm.name == "driver-hung"
        assert "the tracker west is neither moved nor stowed until the service is restarted" in alarm.text
        await asyncio.sleep(900)
        assert modes(rig) == [Mode.TRACKING, Mode.FAULT]
        assert [event.tracker for event in rig.records_of(Event) if event.subject == "service"] == ["west"]

    run_rig(scenario, tracker=TWO)


def test_the_systemd_unit_allows_threads_for_as_many_trackers_as_a_file_may_have():
    unit = (ROOT / "deploy" / "heliocube-tracker.service").read_text()
    allowed = int(re.search(r"^TasksMax=(\d+)$", unit, re.MULTILINE)[1])
    # For each tracker two of its positioner, one each for its load, files and broker's name; and those that they share.
    assert allowed >= 5 * _MOST_TRACKERS + 32


def test_in_a_flood_a_stop_for_an_unknown_tracker_is_skipped_only_once_all_trackers_are_stopped(run_rig):
    async def scenario(rig):
        await both_track(rig)
        operators, stop = Operators(rig.service.trackers, 1.0), parse("stop", b'{"tracker": "nroth"}', "test")
        await give(rig, "stop", tracker="east")
        assert operators.answer_if_stopped(stop) is None
        await give(rig, "stop", tracker="west")
        with pytest.raises(CommandError, match="so the stop is for all: all are stopped"):
            operators.answer_if_stopped(stop)

    run_rig(scenario, tracker=TWO)


def test_in_a_flood_a_repeated_stop_for_all_is_answered_for_all_trackers(run_rig):
    async def scenario(rig):
        await both_track(rig)
        await give(rig, "stop", why="fire")
        operators = Operators(rig.service.trackers, 1.0)
        of_all, of_one = (
            operators.answer_if_stopped(parse("stop", body, "test")) for body in (b"", b'{"tracker": "west"}')
        )
        assert of_all["text"].startswith("all 2 trackers are stopped; so many stops wait")
        assert re.match("the tracker is stopped by .*: fire; so many stops wait", of_one["text"])

    run_rig(scenario, tracker=TWO)


def test_refusals_of_commands_name_the_remedy_command_with_the_option_of_their_tracker(run_rig):
    async def scenario(rig):
        await both_track(rig)
        await give(rig, "stop", why="fire")
        with pytest.raises(CommandError, match="only 'heliocube auto --tracker west' releases it"):
            await give(rig, "hold", tracker="west")
        told = r"any of 2 trackers:\n  east:  no stow.*auto --tracker east'.*\n  west:  no stow.*auto --tracker west'"
        with pytest.raises(CommandError, match=told):
            await give(rig, "stow")
        await give(rig, "auto", tracker="east")
        await give(rig, "stow", tracker="east")
        with pytest.raises(
            CommandError, match="'heliocube auto --tracker east' ends a stow that was asked for"
        ) as found:
            await give(rig, "goto", tracker="east", a_deg=0.0, b_deg=60.0)
        assert not found.value.wrong

    run_rig(scenario, tracker=TWO)


def test_every_remedy_command_shown_for_one_of_several_trackers_has_its_tracker_option(run_rig, caplog, monkeypatch):
    lines, recent = [], RecentRecords()
    written = LineFormatter(journal=True).format
    monkeypatch.setattr(caplog.handler, "emit", lambda record: lines.append(written(record)))

    async def scenario(rig):
        rig.bus.subscribe(recent.note)
        await both_track(rig)
        await asyncio.sleep(60)
        await give(rig, "stop", tracker="east", why="repair")
        rig.wind_m_s = 20.0
        rig.unit.inject("re_reference", rig.clock.monotonic())
        await rig.until(lambda: len(rig.tracker.alarms.active) == 2, 60, "both alarms")
        await asyncio.sleep(10)
        shown = {
            "state": state_json(rig.take_snapshot(recent)),
            "over MQTT": tracker_state_json(snapshot(rig.service, recent, 1.0, None, {}, tracker="east"), "east"),
            "records": [record.text for record in rig.records_of(Event)]
            + [change.why for change in rig.records_of(ModeChange)],
            "log": [line for line in lines if "tracker=east" in line],
        }
        for where, found in shown.items():
            commands = set(re.findall(r"(?<=[`']heliocube )\w+[^`']*", json.dumps(found, default=str)))
            assert {"auto --tracker east", "clear --tracker east"} <= commands, where
            assert [command for command in commands if not command.endswith(" --tracker east")] == [], where

    run_rig(scenario, tracker=TWO)
