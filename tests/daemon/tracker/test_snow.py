"""Snow: the tracker stands steep and stays so, and what takes precedence over it."""

import asyncio

import pytest

from daemon.base.records import Mode, Move
from daemon.service.operator import CommandError
from tests.daemon.tracker.days import at, operator
from tests.support.phases import wait_for_rest, wait_for_tracking


def test_snow_keeps_the_tracker_steep_over_a_restart_and_a_wind_stow_takes_precedence(run_rig, tmp_path):
    async def first(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        answer = await operator(rig).snow("hail is coming", "ana")
        assert (answer.seen, rig.mode) == ("under-way", Mode.SNOW)
        assert answer.text.startswith("moving to A +0.0, B 15.0 deg, now at A ")
        await wait_for_rest(rig)
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


def test_after_a_restart_the_tracker_goes_to_the_snow_position_only_after_a_wind_message(run_rig, tmp_path):
    async def before(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).snow("hail is coming", "ana")

    async def after(rig):
        rig.wind_m_s = None
        await asyncio.sleep(120)
        assert (rig.mode, rig.control.why) == (Mode.STARTING, "waiting for the first message of wind")
        assert not rig.records_of(Move)
        assert rig.control.wishes.snow.by == "ana"
        rig.wind_m_s = 3.0
        await rig.until_mode(Mode.SNOW, 10)
        await asyncio.sleep(300)
        assert rig.truth() == at(0, 15)

    for scenario in (before, after):
        run_rig(scenario, store={"directory": tmp_path})


def test_snow_is_refused_during_a_persons_stow_and_its_answer_names_a_hold_that_it_replaces(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await operator(rig).hold("test", "bob")
        answer = await operator(rig).snow("hail", "ana")
        assert "; this replaces: held by bob since " in answer.text
        await operator(rig).stow("storm", "ana")
        with pytest.raises(CommandError, match="no snow: the tracker is stowed by ana since"):
            await operator(rig).snow("hail", "eve")

    run_rig(scenario)


def test_limits_cut_the_default_snow_position(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await operator(rig).snow("hail")
        await asyncio.sleep(300)
        assert rig.truth() == at(0, 30)

    run_rig(scenario, limits={"b_min_deg": 30})
