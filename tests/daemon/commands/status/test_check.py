"""What a script learns about the state of a running service."""

import asyncio
import re

import pytest

from daemon.base.errors import ExitCode
from daemon.base.records import Mode
from daemon.commands.status.check import page, verdict
from daemon.commands.status.screen import alarm_state
from daemon.commands.status.times import local_and_utc_time
from tests.daemon.commands.status.test_times import place
from tests.support.api import serve
from tests.support.phases import wait_for_move

__all__ = ["place", "serve"]


async def both(call):
    # A page of the interface may be a second old.
    await asyncio.sleep(2)
    return (await call.get("/api/state")).json, (await call.get("/healthz")).json


def test_status_check_is_good_during_a_persons_stop_and_reports_alarms_and_a_lost_cube(serve):
    async def scenario(rig, call):
        await rig.until_mode(Mode.TRACKING, 120)
        assert verdict(*await both(call)) == (["works: SIMULATED, tracking"], ExitCode.GOOD)

        await rig.control.stop("repair", "ana")
        await rig.until_mode(Mode.HOLD, 20)
        assert verdict(*await both(call)) == (["works: SIMULATED, hold, STOPPED by a person"], ExitCode.GOOD)

        rig.control.auto()
        await rig.until_mode(Mode.TRACKING, 60)
        rig.control.hold("look", "ana")
        await rig.until_mode(Mode.HOLD, 20)
        assert verdict(*await both(call)) == (["works: SIMULATED, hold"], ExitCode.GOOD)

        await rig.control.stop("repair", "ana")
        rig.wind_m_s = 20.0
        rig.cables.voltmeter.link_up = False
        await rig.until(lambda: rig.service.trackers[0].alarms.active, 60, "an alarm")
        await rig.until(lambda: rig.service.acquisition.outage.is_down, 60, "a cube that is down")
        found = await both(call)
        lines, code = verdict(*found)
        assert code == ExitCode.ALARMS
        assert lines[0] == "works, but 2 to look at: SIMULATED, hold, STOPPED by a person"
        cube = next(line for line in lines if line.startswith("cube: voltmeter"))
        assert (
            f"; the last scan is of {local_and_utc_time(found[0]['scan']['time'])}; check supply, cables and adapters"
            in cube
        )
        (alarm,) = (
            line
            for line in lines
            if re.match(r"stow-wanted \(raised, since [-0-9]+ [0-9:]+ (\([-0-9: ]+ )?UTC\)?\): stow is wanted", line)
        )
        assert found[0]["alarms"][0]["remedy"] in alarm
        assert page(*found)["alarms"] == ["stow-wanted"]
        assert page(*found)["modes"]["tracker"]["asked"] == "stop"

    serve(scenario)


def test_status_check_lists_the_most_urgent_alarm_first_and_cleared_ones_last(serve):
    async def scenario(rig, call):
        await wait_for_move(rig)
        rig.tracker.alarms.set("move-failed", "a move failed")
        rig.tracker.alarms.set("move-failed", None)
        await rig.control.stop("repair", "ana")
        for name in ("day-budget", "store-down", "api-down"):
            rig.service.cube_alarms.set(name, "of the process")
            await asyncio.sleep(1)
        rig.wind_m_s = 20.0
        await asyncio.sleep(20)
        found = await both(call)
        told = [line.partition(" (")[0] for line in verdict(*found)[0][1:]]
        assert told == ["stow-wanted", "store-down", "api-down", "day-budget", "move-failed"]
        assert page(*found)["alarms"] == told

    serve(scenario)


@pytest.mark.parametrize("place", ["Europe/Paris"], indirect=True)
@pytest.mark.usefixtures("place")
def test_status_check_names_a_cause_once_in_local_time_and_also_a_stop_during_a_fault(serve):
    async def scenario(rig, call):
        await wait_for_move(rig)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(120)
        lines, _ = verdict(*await both(call))
        assert lines[0] == "works, but 1 to look at: SIMULATED, fault"
        assert re.match(r"positioner-down \(raised, since 2022-10-12 12:01:\d\d \(10:01:\d\d UTC\)\): ", lines[1])
        await call.post("stop")
        await asyncio.sleep(20)
        lines, _ = verdict(*await both(call))
        assert lines[0] == "works, but 2 to look at: SIMULATED, fault, STOPPED by a person"
        stopped = r"stopped by HTTP since 2022-10-12 12:0\d:\d\d \(10:0\d:\d\d UTC\)"
        assert re.match(rf"fault: positioner: .* plugged.*; {stopped}", lines[1])
        assert "\n".join(lines).count("positioner-down") == 1
        assert not any(line.startswith("positioner: ") for line in lines)

    serve(scenario)


@pytest.mark.parametrize("place", ["Europe/Paris"], indirect=True)
@pytest.mark.usefixtures("place")
def test_a_cleared_latched_alarm_shows_from_when_to_when_it_lasted_and_how_to_acknowledge_it(serve):
    async def scenario(rig, call):
        await rig.until_mode(Mode.TRACKING, 120)
        rig.tracker.alarms.set("motor-current", "axis A draws 5 A")
        await asyncio.sleep(7200)
        rig.tracker.alarms.set("motor-current", None)
        await asyncio.sleep(60)
        state, health = await both(call)
        raised, over = r"12:0\d:\d\d \(10:0\d:\d\d UTC\)", r"14:0\d:\d\d \(12:0\d:\d\d UTC\)"
        (line,) = verdict(state, health)[0][1:]
        assert re.fullmatch(
            rf"motor-current \(raised 2022-10-12 {raised}, over since 2022-10-12 {over}\): axis A draws 5 A;"
            r" see what it was, then `heliocube alarms ack motor-current`",
            line,
        )
        assert re.fullmatch(
            rf"since {raised}; over since {over}: acknowledge it with 'heliocube alarms ack motor-current'",
            alarm_state(state["alarms"][0], state),
        )

    serve(scenario, rest_look_s=60.0)
