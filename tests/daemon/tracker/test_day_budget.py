"""How far the laws may move in a day, on the whole rig: it is told, survives a restart, and limits nobody else."""

import asyncio
import json

import numpy as np
import pytest

from daemon.base.records import Decision, Event, Mode, Move
from daemon.base.state import StateFolder
from daemon.tracker.budget import DayBudget
from solar.ephemeris import Site
from tests.daemon.tracker.days import FEWER_SCANS, SLOW, at, operator, pass_quietly
from tests.daemon.tracker.test_optimal import ClearDays
from tests.support.api import serve
from tests.support.motion import alarms
from tests.support.phases import wait_for_rest, wait_for_tracking

__all__ = ["serve"]


def _distance_deg(move):
    return abs(move.end_a_deg - move.from_a_deg) + abs(move.end_b_deg - move.from_b_deg)


def test_the_law_stops_at_the_moves_per_day_with_one_alarm_and_operators_are_not_limited(run_rig):
    async def scenario(rig):
        await asyncio.sleep(1500)
        assert len(rig.records_of(Move)) == 3
        assert alarms(rig)["day-budget"].startswith("the laws have used up the day's budget of motion: 3 moves of 3")
        await operator(rig).goto(10, 60, "people are not limited")
        await wait_for_rest(rig)
        assert rig.truth() == at(10, 60)
        await operator(rig).auto("done")
        await operator(rig).stow("storm")
        await asyncio.sleep(200)
        assert rig.truth() == at(0, 90)

    rig = run_rig(scenario, motion={"moves_per_day": 3}, start="2022-10-12T15:00", **FEWER_SCANS)
    assert [event.subject for event in rig.records_of(Event)].count("alarm") == 1
    assert not rig.records_of(Decision)[-1].moved


def test_a_move_of_the_law_too_early_for_the_moves_per_day_waits_and_its_decision_says_why(run_rig):
    async def scenario(rig):
        await asyncio.sleep(1500)
        assert len(rig.records_of(Move)) == 3
        assert not alarms(rig)
        assert not rig.control.preview_decision().moves

    waiting = run_rig(scenario, motion={"moves_per_day": 6}, **FEWER_SCANS).records_of(Decision)[-1]
    assert waiting.target.why.endswith("; waits, because the day's 6 moves are to last until sunset")
    assert not waiting.moved


def test_the_last_quarter_of_the_travel_per_day_is_left_to_the_chronometric_law(run_rig):
    async def scenario(rig):
        await asyncio.sleep(4000)
        said = alarms(rig)["day-budget"]
        assert said.startswith("three quarters of the day's budget of travel are used (")
        assert "of 110): the rest is kept for following the sun by the clock; see motion.moves_per_day" in said
        assert rig.mode is Mode.TRACKING

    rig = run_rig(scenario, law={"name": "sun-vector"}, motion={"travel_per_day_deg": 110.0}, **FEWER_SCANS)
    laws = [decision.law for decision in rig.records_of(Decision)]
    assert laws == sorted(laws, reverse=True)
    assert {*laws} == {"sun-vector", "chronometric"}
    assert any(decision.moved for decision in rig.records_of(Decision) if decision.law == "chronometric")
    *_, last = (decision for decision in rig.records_of(Decision) if decision.law == "sun-vector" and decision.moved)
    used_deg = sum(_distance_deg(move) for move in rig.records_of(Move) if move.time_utc_s <= last.time_utc_s + 60.0)
    assert used_deg > 0.75 * 110.0, "the move that begins the last quarter is the law's own"


def test_the_travel_per_day_also_limits_the_moves_in_fallback(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.cables.voltmeter.link_up = False
        await asyncio.sleep(1.5 * 3600)
        assert rig.mode is Mode.FALLBACK
        assert "day-budget" in alarms(rig)

    rig = run_rig(scenario, motion={"travel_per_day_deg": 80.0}, **FEWER_SCANS)
    moves = rig.records_of(Move)
    travelled = sum(abs(m.end_a_deg - m.from_a_deg) + abs(m.end_b_deg - m.from_b_deg) for m in moves)
    assert 60.0 < travelled <= 80.0 + 0.2 * len(moves)


def test_the_count_of_moves_survives_a_restart_and_ends_with_the_solar_day(run_rig, serve, tmp_path):
    options = {"motion": {"moves_per_day": 4}, "store": {"directory": tmp_path}, "weather": ClearDays()}

    async def first(rig):
        await asyncio.sleep(1800)
        assert len(rig.records_of(Move)) == 4

    async def second(rig, call):
        await asyncio.sleep(1800)
        assert not rig.records_of(Move)
        today = (await call.get("/api/state")).json["today"]
        assert (today["moves"], today["left"]["moves"]) == (4, 0)
        assert today["travelled_deg"] == json.loads((tmp_path / "day.json").read_text())["travelled_deg"] > 20
        assert today["left"]["travel_deg"] == pytest.approx(2000 - today["travelled_deg"])
        lines = (await call.get("/metrics")).body.decode().splitlines()
        assert 'heliocube_day_moves{tracker="tracker"} 4.0' in lines

    async def third(rig):
        await asyncio.sleep(1800)
        assert len(rig.records_of(Move)) == 4
        assert [alarm.name for alarm in rig.tracker.alarms.active] == ["day-budget"]
        pass_quietly(rig, "2022-10-14T00:00")
        await asyncio.sleep(600)
        assert not rig.tracker.alarms.active

    run_rig(first, start="2022-10-12T14:30", **options)
    serve(second, start="2022-10-12T15:00", **options)
    run_rig(third, start="2022-10-13T14:30", **options, **SLOW)


@pytest.mark.parametrize("text", ['{"day": 1, "moves": -3}', "\x00", "[]"])
def test_the_count_of_moves_begins_at_zero_if_its_file_is_damaged(run_rig, tmp_path, text):
    (tmp_path / "day.json").write_text(text)

    async def scenario(rig):
        assert rig.control.budget.used.moves == 0

    run_rig(scenario, store={"directory": tmp_path})


@pytest.mark.parametrize("law", ["mu-prime", "optimal"])
def test_a_clock_step_of_a_day_does_not_open_the_budget_of_a_new_day(run_rig, law):
    async def scenario(rig):
        await rig.until(lambda: len(rig.records_of(Move)) == 2, 3600, "all moves of the day")
        rig.clock.step_s = 86400.0
        await asyncio.sleep(850)
        assert len(rig.records_of(Move)) == 2
        assert rig.control.budget.used.moves == 2
        if law == "optimal":
            assert rig.control.pointing.law.to_dict()["moves"] == 2

    afternoon = "2022-10-12T14:00"
    run_rig(scenario, start=afternoon, motion={"moves_per_day": 2}, law={"name": law, "moves_per_day": 2})


def test_while_the_clock_is_in_doubt_the_day_of_the_budget_ends_by_the_time_believed_before(run_rig):
    async def scenario(rig):
        await asyncio.sleep(30)
        rig.clock.step_s = -5 * 3600.0
        rig.control.budget.book(10.0)
        await asyncio.sleep(300)
        assert rig.control.budget.used.moves == 1
        await asyncio.sleep(900)
        assert rig.control.budget.used.moves == 0

    # Midnight of the mean sun is at 23:51 here.
    run_rig(scenario, start="2022-10-12T23:40")


def test_the_day_of_the_budget_begins_at_solar_midnight_and_not_at_midnight_utc(run_rig):
    async def scenario(rig):
        settings, alarms_ = rig.service.settings.motion, rig.tracker.alarms
        budget = DayBudget(settings, Site(0.0, 150.0, 0.0), StateFolder(None), alarms_, 0.0)
        budget.book(10.0)
        budget.begin_day_if_due(13.9 * 3600)
        assert budget.used.moves == 1
        budget.begin_day_if_due(14.1 * 3600)
        assert budget.used.moves == 0

    run_rig(scenario)


def test_two_moves_of_a_law_are_no_closer_than_the_minimum_interval(run_rig):
    async def scenario(rig):
        for turn in range(7):
            rig.weather.dni = 700.0 if turn % 2 else 0.0
            await asyncio.sleep(600)

    fast = {"windows": {"decide_every_s": 120.0}, "motion": {"minimum_interval_s": 900.0, "deadband_deg": 0.0}}
    begins = [move.time_monotonic_s for move in run_rig(scenario, **fast, **FEWER_SCANS).records_of(Move)]
    assert len(begins) > 3
    assert np.diff(begins).min() >= 899.9
