"""A clock that is set moves nothing and changes no rhythm."""

import asyncio
import itertools
import re

import pytest

from daemon.base.records import CurveQuality, Decision, Event, IvCurve, Move
from daemon.base.state import StateFolder
from daemon.service.recent import RecentRecords
from daemon.service.rig import Role
from daemon.service.state import state_json
from daemon.service.state_migration import LastStart, last_start_file
from daemon.service.status import InputStatus, LinkStatus
from tests.support.phases import wait_for_rest, wait_for_tracking
from tests.support.rig import ManualWeather, ServiceRig

WIND = InputStatus("wind", "roof/wind", 1.0, stowing=False)
LINK = LinkStatus("broker:1883", True, 0.0, None, 1, 0, 0, 0, 0, None, (), (WIND,))


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 86400.0, -86400.0])
def test_a_step_of_the_clock_causes_no_move_and_does_not_change_the_rhythm_of_decisions(run_rig, step_s):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await asyncio.sleep(400)
        await wait_for_rest(rig)
        before = rig.clock.monotonic()
        rig.clock.step_s = step_s
        await asyncio.sleep(590)
        during = [record for record in rig.records_of(Decision) if record.time_monotonic_s > before]
        gaps = [b.time_monotonic_s - a.time_monotonic_s for a, b in itertools.pairwise(during)]
        assert gaps == pytest.approx([300.0] * len(gaps), abs=0.1)
        assert not [move for move in rig.records_of(Move) if move.time_monotonic_s > before]

    # An even sky: only the clock could make this tracker move.
    rig = run_rig(scenario, weather=ManualWeather(dni=0, dhi=200))
    assert any(re.match(r"the clock was set \w+ by .* UTC$", event.text) for event in rig.records_of(Event))


@pytest.mark.parametrize("set_back_s", [0.0, 7200.0])
def test_a_sleep_of_the_machine_is_reported_and_only_a_clock_set_back_in_it_raises_the_clock_alarm(run_rig, set_back_s):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.clock.slept_s, rig.clock.step_s = 7200.0, -set_back_s
        await asyncio.sleep(10)
        told = [event.text for event in rig.records_of(Event)]
        assert "the machine slept for 2 h: readings and wind from before the sleep no longer count" in told
        assert any(text.startswith("the clock was set back by 2 h, from ") for text in told) == bool(set_back_s)
        assert ("clock" in [alarm.name for alarm in rig.tracker.alarms.active]) == bool(set_back_s)

    run_rig(scenario)


def test_the_ages_in_the_state_include_a_sleep_of_the_machine(run_rig):
    def ages_s(rig, recent):
        state = state_json(rig.take_snapshot(recent, links={"tracker": LINK}))
        faces = [face["age_s"] for face in state["scan"]["faces"].values()]
        parts = (state["scan"], state["tracker"]["pose"], state["decision"], *state["wind"], *state["mqtt"]["inputs"])
        return [*faces, *(part["age_s"] for part in parts)], state["scan"]["stale"] and state["tracker"]["pose"][
            "stale"
        ]

    async def scenario(rig):
        recent = RecentRecords()
        rig.bus.subscribe(recent.note)
        await wait_for_tracking(rig)
        await asyncio.sleep(60)
        before_s, stale = ages_s(rig, recent)
        assert max(before_s) < 400
        assert not stale
        rig.clock.slept_s = 7200.0
        during_s, stale = ages_s(rig, recent)
        assert during_s == pytest.approx([age_s + 7200.0 for age_s in before_s])
        assert stale
        await asyncio.sleep(20)
        after_s, stale = ages_s(rig, recent)
        assert max(after_s[:6]) < 20, "what came after the sleep is as old as it is"
        assert not stale

    run_rig(scenario)


def test_a_cube_on_its_own_machine_raises_a_clock_alarm_after_a_step_until_it_is_synchronised(run_rig):
    async def scenario(rig):
        await asyncio.sleep(100)
        rig.clock.step_s = 7200.0
        await asyncio.sleep(100)
        assert "clock" in [alarm.name for alarm in rig.service.cube_alarms.active]
        rig.synchronised = True
        await asyncio.sleep(200)
        assert not rig.service.cube_alarms.active

    no_way = {"transport": "mqtt", "insecure": True}
    run_rig(scenario, role=Role.CUBE, bridge=no_way, mqtt={"enabled": True, "host": "127.0.0.1"})


def test_the_dark_correction_does_not_learn_from_daytime_that_a_wrong_clock_calls_night(run_rig):
    async def scenario(rig):
        await asyncio.sleep(300)
        before = rig.control.state.scan.zenith.irradiance_w_m2
        rig.clock.step_s = 12 * 3600.0
        await asyncio.sleep(3600)
        assert rig.control.state.scan.zenith.irradiance_w_m2 == pytest.approx(before, rel=0.1)

    run_rig(scenario, weather=ManualWeather(dni=0, dhi=4), cube={"dark_correction": True}, rest_look_s=5.0)


def test_after_a_step_the_chronometric_law_waits_until_the_clock_is_set_right(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await asyncio.sleep(10)
        rig.clock.step_s = 7200.0
        moves = len(rig.records_of(Move))
        await asyncio.sleep(1500)
        assert len(rig.records_of(Move)) == moves
        rig.clock.step_s = 0.0
        await asyncio.sleep(400)
        assert len(rig.records_of(Move)) > moves

    run_rig(scenario, law={"name": "chronometric"})


WRONG_START = (
    "by the clock this start of the service was at 2022-10-12 10:00 UTC, before the last one at 2023-11-14 22:13 UTC,"
    " and nothing confirms its time: the sun's position is not used until the clock is synchronised (see"
    " 'timedatectl'); where nothing synchronises it, set it right and restart the service"
)


@pytest.mark.parametrize("lasts", [True, False])
def test_a_start_dated_before_the_last_one_puts_a_lasting_clock_in_doubt_but_not_at_the_next_start(
    run_rig, tmp_path, monkeypatch, lasts
):
    """So starts a machine without a clock battery until the network is there. Simulated time may begin at will."""
    monkeypatch.setattr(ServiceRig, "has_persistent_clock", lasts)
    year_later = LastStart(started_utc_s=1.7e9)
    last_start_file(StateFolder(tmp_path)).save(year_later)

    async def doubts(rig):
        await asyncio.sleep(1500)
        told = [alarm.text for alarm in rig.tracker.alarms.active if alarm.name == "clock"]
        assert told == ([WRONG_START] if lasts else [])
        assert bool(rig.records_of(Move)) != lasts
        # A clock that is set by hand shows neither the time of this start nor that of the last one.
        rig.clock.step_s = 3.5e7
        await asyncio.sleep(60)
        assert [alarm.text for alarm in rig.tracker.alarms.active if alarm.name == "clock"] == told or not lasts
        rig.synchronised = True
        await asyncio.sleep(600)
        assert rig.records_of(Move)
        assert "clock" not in [alarm.name for alarm in rig.tracker.alarms.active]

    async def believes(rig):
        await asyncio.sleep(1500)
        assert rig.records_of(Move)

    kept = {"law": {"name": "chronometric"}, "store": {"directory": tmp_path}}
    run_rig(doubts, **kept)
    run_rig(believes, **kept)


@pytest.mark.parametrize("step_s", [3600.0, 12 * 3600.0])
def test_iv_curves_go_on_while_the_clock_is_in_doubt_and_are_marked_as_of_uncertain_time(run_rig, step_s):
    def begun_since(rig, begin_s):
        return [curve for curve in rig.records_of(IvCurve) if curve.time_monotonic_s > begin_s]

    async def scenario(rig):
        await wait_for_tracking(rig)
        assert {curve.quality for curve in rig.records_of(IvCurve)} == {CurveQuality.OK}
        rig.clock.step_s, set_s = step_s, rig.clock.monotonic()
        await asyncio.sleep(200)
        curves = begun_since(rig, set_s)
        assert len(curves) == pytest.approx(40, abs=2)
        assert {curve.quality for curve in curves} == {CurveQuality.CLOCK}
        assert all(curve.pmpp_w > 0.0 for curve in curves)
        rig.clock.step_s, right_s = 0.0, rig.clock.monotonic()
        await asyncio.sleep(60)
        assert {curve.quality for curve in begun_since(rig, right_s + 5.0)} == {CurveQuality.OK}

    run_rig(scenario, weather=ManualWeather(dni=0, dhi=200), load={"driver": "simulated"})
