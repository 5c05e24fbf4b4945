"""What a person sees in the terminal."""

import asyncio
import errno
import io
import json
import math
import re
from dataclasses import replace

import pytest
from rich.console import Console

from daemon.base.errors import UserError
from daemon.base.records import Event, Mode
from daemon.commands.status.command import select_tracker
from daemon.commands.status.live import LiveView
from daemon.commands.status.screen import live_screen, render, status_line
from daemon.commands.status.times import local_and_utc_time
from daemon.service.recent import RecentRecords
from daemon.service.state import state_json
from tests.daemon.commands.status.test_times import place
from tests.support.phases import wait_for_move

__all__ = ["place"]


def view_of(rig, console):
    recent = RecentRecords()
    rig.bus.subscribe(recent.note)
    # As on a rig at ten times real speed: drawing a screen takes longer than everything else here.
    return LiveView(lambda: state_json(rig.take_snapshot(recent)), console, speed=10.0 if console.is_terminal else 1.0)


def shown(run_rig, *, terminal, faults=(), why=None):
    out = io.StringIO()

    async def scenario(rig):
        console = Console(file=out, force_terminal=terminal, width=110, height=40)
        viewing = asyncio.create_task(view_of(rig, console).run())
        await rig.until_mode(Mode.TRACKING, 120)
        await asyncio.sleep(30)
        for name in faults:
            getattr(rig.cables, name).link_up = False
        if why is not None:
            await rig.control.stop(why, "ana")
        await asyncio.sleep(90)
        viewing.cancel()
        await asyncio.gather(viewing, return_exceptions=True)

    run_rig(scenario)
    return out.getvalue()


def test_a_terminal_shows_mode_readings_target_and_pose_and_that_it_is_simulated(run_rig):
    text = shown(run_rig, terminal=True)
    for expected in (
        "SIMULATED",
        "tracking",
        "zenith",
        "W/m2",
        "by mu-prime",
        "most light comes",
        "scans accepted",
        "moved to A",
    ):
        assert expected in text


def test_a_terminal_shows_a_fault_and_the_unplugged_devices(run_rig):
    text = shown(run_rig, terminal=True, faults=("positioner", "voltmeter"))
    assert "fault" in text
    assert "positioner: is unplugged" in text
    assert "voltmeter: is unplugged" in text


def test_the_status_line_marks_an_implausible_face_and_a_stale_pose(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        await asyncio.sleep(600)
        rig.scene.break_sensor(1, 0.0)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(600)
        told = status_line(state_json(rig.take_snapshot(rig.recent)))
        assert re.search(r"E \d+\.\d S 0\.0 implausible W \d+\.\d Z \d+\.\d \|", told)
        assert re.search(r"A [-+]\d+\.\d, B \d+\.\d deg  STALE, 10 min old \|", told)

    def prepare(rig):
        rig.recent = RecentRecords()
        rig.bus.subscribe(rig.recent.note)
        return scenario(rig)

    run_rig(prepare)


def test_alarms_are_shown_on_a_terminal_and_in_plain_lines(run_rig):
    async def scenario(rig):
        out, plain = io.StringIO(), io.StringIO()
        await wait_for_move(rig)
        screens = [
            Console(file=out, force_terminal=True, width=200, height=40),
            Console(file=plain, force_terminal=False, width=200),
        ]
        viewing = [asyncio.create_task(view_of(rig, screen).run()) for screen in screens]
        await rig.control.stop("repair", "ana")
        rig.wind_m_s = 20.0
        await asyncio.sleep(20)
        for task in viewing:
            task.cancel()
        await asyncio.gather(*viewing, return_exceptions=True)
        assert "stow is wanted (wind 20.0 m/s" in out.getvalue()
        assert "ALARM stow-wanted" in plain.getvalue().splitlines()[-1]

    run_rig(scenario)


def test_details_of_a_positioner_make_are_shown_and_cannot_control_the_terminal(run_rig):
    async def scenario(rig):
        read = rig.positioner.read_telemetry

        async def of_another_make():
            return replace(await read(), details={"oil_degc": 41.5, "brake_state": "\x1b[2Joff", "tilt_deg": math.nan})

        rig.positioner.read_telemetry = of_another_make
        await rig.until_mode(Mode.TRACKING, 120)
        console = Console(file=io.StringIO(), width=160)
        console.print(render(state_json(rig.take_snapshot())))
        assert "oil degc 41.5, brake state ?[2Joff, tilt deg -" in console.file.getvalue()

    run_rig(scenario)


@pytest.mark.parametrize(("mqtt", "heading"), [
    ({}, "heliocube SIMULATED both at SIRTA"),
    ({"name": "north"}, "heliocube SIMULATED north, both at SIRTA"),
])  # fmt: skip
def test_the_heading_names_the_tracker_that_has_a_name(run_rig, mqtt, heading):
    async def scenario(rig):
        console = Console(file=io.StringIO(), width=160)
        console.print(render(state_json(rig.take_snapshot())))
        assert console.file.getvalue().splitlines()[0] == heading

    run_rig(scenario, mqtt=mqtt)


def test_the_status_screen_names_each_of_several_sources_of_stow(run_rig):
    async def scenario(rig):
        rig.wind_m_s = 5.2
        await asyncio.sleep(10)
        state = state_json(rig.take_snapshot())
        (source,) = state["wind"]
        state["wind"].append(source | {"name": "the wind on lab/mast", "speed_m_s": None, "age_s": None})
        console = Console(file=io.StringIO(), width=80)
        console.print(render(state))
        assert re.search(r"wind +wind: 5\.2 m/s, stow from 15 m/s, \d\.\d s old", console.file.getvalue())
        assert "the wind on lab/mast: - m/s, stow from 15 m/s, not heard yet" in console.file.getvalue()

    run_rig(scenario)


def test_without_a_terminal_a_plain_status_line_is_printed_now_and_then(run_rig):
    lines = shown(run_rig, terminal=False).splitlines()
    assert len(lines) > 10
    assert all("SIMULATED" in status_line and "\x1b" not in status_line for status_line in lines)
    assert "tracking: the cube's readings are good" in lines[-1]


def test_the_reason_that_a_person_gave_for_a_stop_is_shown_exactly_as_written(run_rig):
    why = "module [bold]7[/bold], see [/log]"
    assert why in shown(run_rig, terminal=False, why=why)


def test_the_status_screen_has_a_block_per_tracker_and_alarms_with_tracker_names(run_rig):
    async def scenario(rig):
        east, west = rig.service.trackers
        rig.wind_m_s = 3.2
        await rig.until(lambda: west.control.mode is east.control.mode is Mode.TRACKING, 120, "tracking of both")
        # By then it has left the stow position.
        await asyncio.sleep(60)
        await west.control.stop("repair", "ana")
        await west.control.stop("a noise", "bob")
        console = Console(file=io.StringIO(), width=160)
        console.print(render(state_json(rig.take_snapshot())))
        assert re.search(r"wind +3\.2 m/s, stow from 15 m/s, \d\.\d s old", console.file.getvalue())
        rig.wind_m_s = 20.0
        await asyncio.sleep(20)
        console = Console(file=io.StringIO(), width=160)
        console.print(render(state_json(rig.take_snapshot())))
        stowing = r"wind +20\.0 m/s, .* STOWS: wind 20\.0 m/s, stow from 15 m/s; ends after \d+ min more of calm"
        assert re.search(stowing, console.file.getvalue())
        lines = [status_line.strip() for status_line in console.file.getvalue().splitlines()]
        assert lines.index("east") < lines.index("west")
        own = lines[lines.index("west") :]
        assert next(status_line for status_line in own if status_line.startswith("mode")).split()[1] == "hold"
        assert re.match(
            r"mode +hold STOPPED since ", next(status_line for status_line in own if status_line.startswith("mode"))
        )
        stops = [status_line for status_line in own if status_line.startswith("stop")]
        assert [re.sub(r"\d.* UTC\)?", "T", status_line).split(maxsplit=1)[1] for status_line in stops] == [
            "by ana since T: repair",
            "also by bob since T: a noise",
        ]
        alarm = next(number for number, status_line in enumerate(lines) if status_line.startswith("alarm"))
        assert "west: stow is wanted" in lines[alarm]
        remedy = next(status_line for status_line in lines[alarm:] if status_line.startswith("remedy  "))
        assert remedy.endswith("then 'heliocube auto --tracker west'")
        assert next(status_line for status_line in own if status_line.startswith("mode")).endswith(
            "'heliocube auto --tracker west'"
        )
        console = Console(file=io.StringIO(), width=160)
        console.print(render(select_tracker(state_json(rig.take_snapshot()), "east")))
        alone = console.file.getvalue()
        assert re.search(r"^east\s*$", alone, re.MULTILINE)
        assert "west: " not in alone
        assert not re.search(r"^west\s*$", alone, re.MULTILINE)
        assert re.search(r"^scan ", alone, re.MULTILINE)
        one = select_tracker(state_json(rig.take_snapshot()), "west")
        assert list(one["trackers"]) == ["west"]
        assert [alarm["name"] for alarm in one["alarms"]] == ["stow-wanted"]
        console.print(render(one))
        assert "'heliocube auto --tracker west'" in console.file.getvalue()
        with pytest.raises(UserError, match="there is no tracker 'wset'; the trackers are east, west"):
            select_tracker(one | {"trackers": {"east": {}, "west": {}}}, "wset")

    run_rig(scenario, tracker=[{"name": "east"}, {"name": "west"}])


def test_a_stop_from_the_day_before_is_shown_with_its_date_after_a_restart_too(run_rig, tmp_path):
    wish = {"why": "grease the joint", "by": "ana@lab", "since_utc_s": 1665504720.0}
    (tmp_path / "operator.json").write_text(json.dumps({"stop": wish}))

    async def scenario(rig):
        await rig.until_mode(Mode.HOLD, 60)
        console = Console(file=io.StringIO(), width=160)
        console.print(render(state_json(rig.take_snapshot())))
        rows = [
            status_line
            for status_line in console.file.getvalue().splitlines()
            if status_line.startswith(("mode", "stop"))
        ]
        assert len(rows) == 2
        assert all(local_and_utc_time("2022-10-11T16:12:00.000Z", "2022-10-12T10:00:00.000Z") in row for row in rows)

    run_rig(scenario, store={"directory": tmp_path})


@pytest.mark.parametrize("screen", [render, live_screen])
@pytest.mark.parametrize("place", ["Europe/Paris"], indirect=True)
@pytest.mark.usefixtures("place")
def test_times_in_the_sentences_of_a_service_are_shown_in_local_time_too(run_rig, screen):
    async def scenario(rig):
        recent = RecentRecords()
        rig.bus.subscribe(recent.note)
        await wait_for_move(rig)
        await rig.control.stop("repair", "ana")
        rig.cables.positioner.link_up = False
        await asyncio.sleep(120)
        console = Console(file=io.StringIO(), width=200, height=60)
        console.print(screen(state_json(rig.take_snapshot(recent))))
        text = console.file.getvalue()
        told = r"stopped by ana since 12:0\d:\d\d \(10:0\d:\d\d UTC\): repair"
        assert re.search(rf"mode +fault since .*{told}", text)
        assert re.search(rf"\d  [^\n]*{told}", text)

    run_rig(scenario)


def test_a_small_terminal_shows_the_newest_news_and_leaves_out_the_oldest(run_rig):
    out = io.StringIO()

    async def scenario(rig):
        recent = RecentRecords()
        rig.bus.subscribe(recent.note)
        await rig.until_mode(Mode.TRACKING, 120)
        for text in [f"event {number}" for number in range(9)]:
            rig.bus.publish(Event(rig.clock.utc(), rig.clock.monotonic(), "operator", text))
        for height in (24, 60):
            console = Console(file=out, force_terminal=False, width=80, height=height)
            console.print(live_screen(state_json(rig.take_snapshot(recent))))
            out.write("END")

    run_rig(scenario)
    small, tall, _ = out.getvalue().split("END")
    assert len(small.splitlines()) <= 24
    assert "event 8" in small
    assert "event 2" not in small
    assert "event 2" in tall


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), SystemExit(1)])
@pytest.mark.parametrize("terminal", [True, False])
def test_a_display_that_cannot_write_ends_without_the_service_and_is_logged_once(run_rig, caplog, terminal, error):
    class Full(io.StringIO):
        def write(self, text):
            raise error

    async def scenario(rig):
        console = Console(file=Full(), force_terminal=terminal, width=110, height=40)
        async with asyncio.timeout(60):
            await view_of(rig, console).run()
        console.print("the service has ended")

    run_rig(scenario)
    told = [record.getMessage() for record in caplog.records if "display" in record.getMessage()]
    why = "nobody reads it any more" if isinstance(error, SystemExit) else "No space left on device"
    assert told == [f"the display has ended, and the service goes on without it: {why}"]
