"""Where the tracker is kept: snow, a forgotten hold, and what the laws may move in a day."""

import asyncio
import json
from datetime import datetime

import numpy as np
import pytest

from daemon.base.records import Decision, Event, Mode, Move, Scan
from daemon.base.state import StateFolder
from daemon.motion.motion import Polling
from daemon.service.operator import CommandError, Operator
from daemon.tracker.budget import DayBudget
from solar.frames import Limits
from tests.daemon.tracker.test_optimal import ClearDays
from tests.daemon.tracker.test_stop import alarms
from tests.support.api import serve
from tests.support.phases import at_rest, tracking, under_way
from tests.support.rig import HandWeather

__all__ = ["serve"]

FEWER_SCANS = {"cube": {"scan_every_s": 20}, "safety": {"scan_stale_s": 65, "fallback_after_s": 130}}
SLOW = {"cube": {"scan_every_s": 60}, "safety": {"scan_stale_s": 130, "fallback_after_s": 600}}


def operator(rig):
    return Operator(rig.tracker, 1.0)


def pass_quietly(rig, until):
    """Let time jump to this instant: hours in which nothing happens are no test's business."""
    # Nobody misses the looks at the positioner that are left out with them.
    rig.motion._polling = Polling(idle_s=86400.0)
    asyncio.get_running_loop().skip(datetime.fromisoformat(f"{until}Z").timestamp() - rig.clock.utc())


def at(a_deg, b_deg):
    return pytest.approx(a_deg, abs=0.9), pytest.approx(b_deg, abs=0.9)


# Snow


def test_snow_goes_steep_and_stays_and_wind_goes_before_it(run_rig, tmp_path):
    async def first(rig):
        await tracking(rig)
        await at_rest(rig)
        answer = await operator(rig).snow("hail is coming", "ana")
        assert (answer.seen, rig.mode) == ("under-way", Mode.SNOW)
        assert answer.text.startswith("moving to A +0.0, B 15.0 deg, now at A ")
        await at_rest(rig)
        assert rig.truth() == at(0, 15)
        await asyncio.sleep(11)
        assert (await operator(rig).snow("again", "ana")).done
        rig.wind_m_s = 20.0
        await rig.until_mode(Mode.STOW, 10)
        await asyncio.sleep(300)
        assert rig.truth() == at(0, 90)
        rig.wind_m_s = 3.0
        await rig.until_mode(Mode.SNOW, 1000)
        await asyncio.sleep(300)
        assert rig.truth() == at(0, 15)

    async def second(rig):
        await rig.until_mode(Mode.SNOW, 60)
        await asyncio.sleep(300)
        assert rig.truth() == at(0, 15)
        answer = await operator(rig).hold("enough", "bob")
        assert "; this replaces: in the snow position by ana since " in answer.text
        assert rig.mode is Mode.HOLD
        await operator(rig).auto("x")
        await rig.until_mode(Mode.TRACKING, 30)

    for scenario in (first, second):
        run_rig(scenario, store={"directory": tmp_path})


def test_snow_under_a_persons_stow_is_refused_and_in_place_of_a_hold_says_so(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await operator(rig).hold("test", "bob")
        answer = await operator(rig).snow("hail", "ana")
        assert "; this replaces: held by bob since " in answer.text
        await operator(rig).stow("storm", "ana")
        with pytest.raises(CommandError, match="no snow: the tracker is stowed by ana since"):
            await operator(rig).snow("hail", "eve")

    run_rig(scenario)


def test_limits_cut_the_default_snow_position(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await operator(rig).snow("hail")
        await asyncio.sleep(300)
        assert rig.truth() == at(0, 30)

    run_rig(scenario, limits={"b_min_deg": 30})


# Reminders


@pytest.mark.parametrize("command", ["hold", "goto", "snow"])
def test_a_hold_that_outlasts_the_night_is_an_alarm_from_sunrise_on(run_rig, command):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        place = (10.0, 60.0) if command == "goto" else ()
        await getattr(operator(rig), command)(*place, "measuring", "ana")
        await asyncio.sleep(300)
        pass_quietly(rig, "2022-10-13T05:50")
        await asyncio.sleep(600)
        assert not alarms(rig), "the sun is not up before 6:03"
        await asyncio.sleep(1800)
        text = alarms(rig)["hold-forgotten"]
        assert "by ana since 2022-10-12 14:0" in text
        await operator(rig).auto("oh")
        assert not alarms(rig)

    run_rig(scenario, start="2022-10-12T14:00", weather=ClearDays(), **SLOW)


def test_a_hold_of_this_morning_is_not_forgotten_this_evening(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await operator(rig).hold("measuring", "ana")
        for hour in (14, 16, 18):
            pass_quietly(rig, f"2022-10-12T{hour}:50")
            await asyncio.sleep(600)
            assert not alarms(rig)

    run_rig(scenario, start="2022-10-12T11:00", weather=ClearDays(), **SLOW)


# What the laws may move in a day


def _distance_deg(move):
    return abs(move.end_a_deg - move.from_a_deg) + abs(move.end_b_deg - move.from_b_deg)


def test_no_law_moves_more_often_than_the_day_allows_and_that_is_told_once(run_rig):
    async def scenario(rig):
        await asyncio.sleep(3600)
        assert len(rig.of(Move)) == 3
        assert alarms(rig)["day-budget"].startswith("the laws have used up what they may move in a day: 3 moves of 3")
        await operator(rig).goto(10, 60, "people are not limited")
        await at_rest(rig)
        assert rig.truth() == at(10, 60)
        await operator(rig).auto("done")
        await operator(rig).stow("storm")
        await asyncio.sleep(200)
        assert rig.truth() == at(0, 90)

    rig = run_rig(scenario, motion={"moves_per_day": 3})
    assert [event.subject for event in rig.of(Event)].count("alarm") == 1
    assert not rig.of(Decision)[-1].moved


def test_the_last_quarter_of_the_day_s_travel_follows_the_sun_by_the_clock(run_rig):
    async def scenario(rig):
        await asyncio.sleep(5 * 3600)
        assert alarms(rig)["day-budget"].startswith("the sun is followed by the clock for the rest of the day")
        assert rig.mode is Mode.TRACKING

    rig = run_rig(scenario, law={"name": "sun-vector"}, motion={"travel_per_day_deg": 160.0}, **FEWER_SCANS)
    laws = [decision.law for decision in rig.of(Decision)]
    assert laws == sorted(laws, reverse=True)
    assert {*laws} == {"sun-vector", "chronometric"}
    assert any(decision.moved for decision in rig.of(Decision) if decision.law == "chronometric")
    *_, last = (decision for decision in rig.of(Decision) if decision.law == "sun-vector" and decision.moved)
    used_deg = sum(_distance_deg(move) for move in rig.of(Move) if move.time_utc_s <= last.time_utc_s + 60.0)
    assert used_deg > 0.75 * 160.0, "the move that begins the last quarter is the law's own"


def test_no_law_travels_further_than_the_day_allows_in_fallback_either(run_rig):
    async def scenario(rig):
        await tracking(rig)
        rig.cables.voltmeter.link_up = False
        await asyncio.sleep(3 * 3600)
        assert rig.mode is Mode.FALLBACK
        assert "day-budget" in alarms(rig)

    rig = run_rig(scenario, motion={"travel_per_day_deg": 80.0}, **FEWER_SCANS)
    moves = rig.of(Move)
    travelled = sum(abs(m.end_a_deg - m.from_a_deg) + abs(m.end_b_deg - m.from_b_deg) for m in moves)
    assert 60.0 < travelled <= 80.0 + 0.2 * len(moves)


def test_the_count_survives_a_restart_and_ends_with_the_solar_day(run_rig, serve, tmp_path):
    options = {"motion": {"moves_per_day": 4}, "store": {"directory": tmp_path}, "weather": ClearDays()}

    async def first(rig):
        await asyncio.sleep(1800)
        assert len(rig.of(Move)) == 4

    async def second(rig, call):
        await asyncio.sleep(1800)
        assert not rig.of(Move)
        today = (await call.get("/api/state")).json["today"]
        assert (today["moves"], today["left"]["moves"]) == (4, 0)
        assert today["travelled_deg"] == json.loads((tmp_path / "day.json").read_text())["travelled_deg"] > 20
        assert today["left"]["travel_deg"] == pytest.approx(2000 - today["travelled_deg"])
        lines = (await call.get("/metrics")).body.decode().splitlines()
        assert 'heliocube_day_moves{tracker="tracker"} 4.0' in lines

    async def third(rig):
        await asyncio.sleep(1800)
        assert len(rig.of(Move)) == 4
        assert [alarm.name for alarm in rig.tracker.alarms.active] == ["day-budget"]
        pass_quietly(rig, "2022-10-14T00:00")
        await asyncio.sleep(600)
        assert not rig.tracker.alarms.active

    run_rig(first, **options)
    serve(second, start="2022-10-12T14:00", **options)
    run_rig(third, start="2022-10-13T14:00", **options, **SLOW)


@pytest.mark.parametrize("text", ['{"day": 1, "moves": -3}', "\x00", "[]"])
def test_a_damaged_count_begins_anew(run_rig, tmp_path, text):
    (tmp_path / "day.json").write_text(text)

    async def scenario(rig):
        assert rig.control.budget.used.moves == 0

    run_rig(scenario, store={"directory": tmp_path})


@pytest.mark.parametrize("law", ["mu-prime", "optimal"])
def test_a_step_of_the_clock_opens_no_new_days_budget(run_rig, law):
    async def scenario(rig):
        await rig.until(lambda: len(rig.of(Move)) == 2, 3600, "all moves of the day")
        rig.clock.step_s = 86400.0
        await asyncio.sleep(850)
        assert len(rig.of(Move)) == 2
        assert rig.control.budget.used.moves == 2
        if law == "optimal":
            assert rig.control.pointing.law.to_dict()["moves"] == 2

    run_rig(scenario, motion={"moves_per_day": 2}, law={"name": law, "moves_per_day": 2})


def test_a_day_is_the_suns_and_not_utcs(run_rig):
    async def scenario(rig):
        settings, alarms_ = rig.service.settings.motion, rig.tracker.alarms
        budget = DayBudget(settings, 150.0, StateFolder(None), alarms_, 0.0)
        budget.book(10.0)
        budget.turn(13.9 * 3600)
        assert budget.used.moves == 1
        budget.turn(14.1 * 3600)
        assert budget.used.moves == 0

    run_rig(scenario)


# Control


def test_a_good_scan_wakes_whoever_waits_for_it(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await asyncio.sleep(130)
        for wait_s in (0.0, 1.3, 2.9):
            rig.cables.voltmeter.link_up = False
            await rig.until_mode(Mode.FALLBACK, 90)
            await asyncio.sleep(wait_s)
            rig.cables.voltmeter.link_up = True
            scans = len(rig.of(Scan))
            await rig.until(lambda scans=scans: any(scan.ok for scan in rig.of(Scan)[scans:]), 60, "a good scan")
            await asyncio.sleep(0.1)
            assert rig.mode is Mode.TRACKING
            await asyncio.sleep(130)

    run_rig(scenario)


def test_hold_in_the_middle_of_a_goto_stays_there(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        await operator(rig).goto(40, 30, "test")
        answer = await operator(rig).hold("no further", "ana")
        assert answer.done
        stands = rig.truth()
        await asyncio.sleep(900)
        assert rig.truth() == stands

    run_rig(scenario)


def test_a_hold_that_came_past_the_operators_desk_stops_a_move_too(run_rig):
    async def scenario(rig):
        await under_way(rig)
        rig.control.hold("from elsewhere")
        await rig.until(lambda: not rig.motion.moving, 2, "the stop")
        stands = rig.truth()
        await asyncio.sleep(60)
        assert rig.mode is Mode.HOLD
        assert rig.truth() == stands

    run_rig(scenario)


def test_goto_is_refused_behind_the_operators_desk_while_stowed(run_rig):
    async def scenario(rig):
        await tracking(rig)
        rig.wind_m_s = 20.0
        await rig.until_mode(Mode.STOW, 10)
        with pytest.raises(CommandError, match="no goto while the tracker is stowed"):
            await operator(rig).goto(10, 60, "x")
        assert rig.control.wishes.hold is None

    run_rig(scenario)


def test_a_second_goto_does_not_wait_for_the_first(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        await operator(rig).goto(40, 30, "test")
        await asyncio.sleep(2)
        assert (await operator(rig).goto(-10, 70, "rather there")).text.startswith("moving to A -10.0, B 70.0 deg")
        await asyncio.sleep(2)
        assert rig.motion.target.a_deg == -10.0

    run_rig(scenario)


def test_a_stow_that_was_refused_at_first_is_ordered_again(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        rig.unit.inject("undervoltage", rig.clock.monotonic())
        await operator(rig).stow("storm")
        await asyncio.sleep(120)
        assert rig.truth().b_deg < 80
        rig.unit.repair("undervoltage", rig.clock.monotonic())
        await asyncio.sleep(1800)
        assert rig.truth() == at(0, 90)

    run_rig(scenario)


def test_a_stow_at_the_stow_position_ends_a_reference_run_that_has_just_begun(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await operator(rig).goto(0, 90, "test")
        await at_rest(rig)
        await operator(rig).auto("x")
        rig.control.home()
        await rig.until(lambda: rig.motion.homing, 10, "homing")
        rig.control.stow("storm")
        await rig.until(lambda: not rig.motion.homing, 5, "the end of homing")
        await asyncio.sleep(200)
        assert rig.truth() == at(0, 90)

    run_rig(scenario)


def test_two_moves_of_a_law_are_no_closer_than_the_minimum_interval(run_rig):
    async def scenario(rig):
        for turn in range(12):
            rig.weather.dni = 700.0 if turn % 2 else 0.0
            await asyncio.sleep(600)

    fast = {"windows": {"decide_every_s": 120.0}, "motion": {"minimum_interval_s": 900.0, "deadband_deg": 0.0}}
    begins = [move.time_monotonic_s for move in run_rig(scenario, **fast, **FEWER_SCANS).of(Move)]
    assert len(begins) > 3
    assert np.diff(begins).min() >= 899.9


def test_a_refusal_that_lasts_is_told_once(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        rig.motion._limits = Limits(-1.0, 1.0, 15.0, 50.0)
        await operator(rig).stow("storm")
        await asyncio.sleep(1800)
        told = [event.text for event in rig.of(Event) if event.text.startswith("no move: ")]
        assert len(told) == 1

    run_rig(scenario)


def test_the_law_learns_nothing_while_the_time_of_day_is_in_doubt(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        received = []
        law = rig.control.pointing.law
        observe = law.observe
        law.observe = lambda reading: (received.append(reading.utc_s), observe(reading))
        rig.clock.step_s = 7200.0
        await asyncio.sleep(10)
        received.clear()
        await asyncio.sleep(600)
        assert not received
        await asyncio.sleep(400)
        assert received

    run_rig(scenario, law={"name": "optimal"}, weather=HandWeather())


def test_where_an_operator_wanted_to_go_before_a_fault_is_forgotten_with_it(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        rig.control.goto(-40.0, 60.0, "look")
        await asyncio.sleep(5)
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 15)
        await at_rest(rig)
        stands = tuple(rig.truth())
        rig.control.clear_faults()
        await rig.until_mode(Mode.HOLD, 30)
        await asyncio.sleep(60)
        assert tuple(rig.truth()) == pytest.approx(stands, abs=0.1)

    run_rig(scenario)
