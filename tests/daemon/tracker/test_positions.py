"""Where people keep the tracker: a hold, a goto or a stow lasts, is not forgotten, and ends the move under way."""

import asyncio

import pytest

from daemon.base.records import Event, Mode, Move
from daemon.service.operator import CommandError, Effect
from solar.frames import Limits
from tests.daemon.tracker.days import SLOW, at, operator, pass_quietly
from tests.daemon.tracker.test_optimal import ClearDays
from tests.support.motion import alarms, motion_duration_s
from tests.support.phases import wait_for_homing, wait_for_long_rest, wait_for_move, wait_for_rest, wait_for_tracking


@pytest.mark.parametrize("command", ["hold", "goto", "snow"])
def test_a_hold_a_goto_or_a_snow_that_outlasts_the_night_raises_an_alarm_after_sunrise(run_rig, command):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
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


def test_a_hold_of_the_morning_raises_no_alarm_of_a_forgotten_hold_in_the_evening(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await operator(rig).hold("measuring", "ana")
        for hour in (14, 16, 18):
            pass_quietly(rig, f"2022-10-12T{hour}:50")
            await asyncio.sleep(600)
            assert not alarms(rig)

    run_rig(scenario, start="2022-10-12T11:00", weather=ClearDays(), **SLOW)


def test_a_hold_in_the_middle_of_a_goto_keeps_the_tracker_where_it_stopped(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).goto(40, 30, "test")
        answer = await operator(rig).hold("no further", "ana")
        assert answer.done
        stands = rig.truth()
        await asyncio.sleep(900)
        assert rig.truth() == stands

    run_rig(scenario)


def test_a_hold_given_directly_to_the_control_stops_a_move_too(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.control.hold("from elsewhere")
        await rig.until(lambda: not rig.motion.moving, 2, "the stop")
        stands = rig.truth()
        await asyncio.sleep(60)
        assert rig.mode is Mode.HOLD
        assert rig.truth() == stands

    run_rig(scenario)


def test_a_goto_is_refused_while_the_tracker_is_stowed_for_wind(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.wind_m_s = 20.0
        await rig.until_mode(Mode.STOW, 10)
        with pytest.raises(CommandError, match="no goto while the tracker is stowed"):
            await operator(rig).goto(10, 60, "x")
        assert rig.control.wishes.hold is None

    run_rig(scenario)


def test_a_second_goto_does_not_wait_for_the_first(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        await operator(rig).goto(40, 30, "test")
        await asyncio.sleep(2)
        assert (await operator(rig).goto(-10, 70, "rather there")).text.startswith("moving to A -10.0, B 70.0 deg")
        await asyncio.sleep(2)
        assert rig.motion.target.a_deg == -10.0

    run_rig(scenario)


def test_a_stow_that_was_refused_at_first_is_ordered_again(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
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
        await wait_for_tracking(rig)
        await operator(rig).goto(0, 90, "test")
        await wait_for_rest(rig)
        await operator(rig).auto("x")
        rig.control.home()
        await rig.until(lambda: rig.motion.homing, 10, "homing")
        rig.control.stow("storm")
        await rig.until(lambda: not rig.motion.homing, 5, "the end of homing")
        await asyncio.sleep(200)
        assert rig.truth() == at(0, 90)

    run_rig(scenario)


def test_a_move_that_is_refused_for_half_an_hour_is_reported_once(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.motion._limits = Limits(-1.0, 1.0, 15.0, 50.0)
        await operator(rig).stow("storm")
        await asyncio.sleep(1800)
        told = [event.text for event in rig.records_of(Event) if event.text.startswith("no move: ")]
        assert len(told) == 1

    run_rig(scenario)


def test_a_goto_that_a_fault_has_ended_does_not_go_on_after_the_fault_is_cleared(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.control.goto(-40.0, 60.0, "look")
        await asyncio.sleep(5)
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 15)
        await wait_for_rest(rig)
        stands = tuple(rig.truth())
        rig.control.clear_faults()
        await rig.until_mode(Mode.HOLD, 30)
        await asyncio.sleep(60)
        assert tuple(rig.truth()) == pytest.approx(stands, abs=0.1)
        assert rig.control.why == "look; a fault has ended the goto to A -40, B 60 deg: give it again to go there"

    run_rig(scenario)


@pytest.mark.parametrize("command", ["goto", "snow"])
@pytest.mark.parametrize("decided_s", [0.0, 600.0])
def test_auto_ends_the_move_of_a_goto_or_a_snow_even_while_no_decision_of_the_law_is_due(run_rig, command, decided_s):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        if not decided_s:
            rig.cables.voltmeter.link_up = False
            await asyncio.sleep(20)
        person = operator(rig)
        answer = await (person.goto(30, 60, "a look") if command == "goto" else person.snow("it snows"))
        assert answer.seen is Effect.UNDER_WAY
        answer = await person.auto("enough")
        assert "moving to" not in answer.text
        assert await motion_duration_s(rig, 20) < 2.0
        assert rig.mode is (Mode.TRACKING if decided_s else Mode.STARTING)

    run_rig(scenario, motion={"minimum_interval_s": decided_s})


def test_a_goto_that_another_one_replaces_before_it_has_begun_is_not_begun(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        await operator(rig).goto(40.0, 40.0, "a look", "ana")
        # The move under way takes half a second to end; the goto that ends it waits for that.
        elsewhere = asyncio.create_task(operator(rig).goto(-40.0, 80.0, "a look", "ben"))
        await asyncio.sleep(0.1)
        await operator(rig).goto(40.0, 40.0, "a look", "ana")
        await elsewhere
        await wait_for_rest(rig)
        assert (-40.0, 80.0) not in [(move.target_a_deg, move.target_b_deg) for move in rig.records_of(Move)]
        assert rig.truth() == (pytest.approx(40.0, abs=1.0), pytest.approx(40.0, abs=1.0))

    run_rig(scenario)


@pytest.mark.parametrize("command", ["stow", "goto"])
def test_a_stow_or_goto_repeated_during_a_clear_keeps_the_tracker_at_its_place_afterwards(run_rig, command):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        person, place = operator(rig), (0.0, 90.0) if command == "goto" else ()
        await getattr(person, command)(*place, "a look", "ana")
        await wait_for_rest(rig)
        await asyncio.sleep(20)
        moves = len(rig.records_of(Move))
        # The unit takes some time to show that its marks are cleared.
        clearing = asyncio.create_task(person.clear("all is well", "ana"))
        await asyncio.sleep(0.1)
        if command == "goto":
            await asyncio.wait((asyncio.create_task(person.goto(40.0, 40.0, "a look", "ben")),), timeout=0.1)
        else:
            await person.auto("it is calm", "ben")
        assert (await getattr(person, command)(*place, "not yet", "ana")).seen is Effect.DONE
        await clearing
        await asyncio.sleep(15)
        assert len(rig.records_of(Move)) == moves

    run_rig(scenario)


def test_a_reference_run_that_was_asked_for_during_a_goto_is_made_after_auto(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.control.goto(30, 60, "a look")
        rig.control.tick()
        await asyncio.sleep(3)
        rig.control.home()
        rig.control.auto()
        await wait_for_homing(rig)
        assert rig.motion.doubt is None

    run_rig(scenario)


@pytest.mark.parametrize("look_s", [0.0, 0.1])
def test_a_reference_run_asked_for_late_in_a_long_move_is_made_before_the_rest_of_the_move(run_rig, look_s):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.control.goto(48, 80, "a look")
        rig.control.tick()
        await asyncio.sleep(70)
        read = rig.positioner.read_telemetry

        async def looked():
            await asyncio.sleep(look_s)
            return await read()

        rig.positioner.read_telemetry = looked
        assert rig.motion.target is not None
        rig.control.home()
        rig.control.tick()
        await wait_for_homing(rig)
        await rig.until(lambda: rig.motion.target is not None, 10, "the rest of the way")

    run_rig(scenario)


def test_a_reference_run_is_made_even_if_asked_for_while_a_hold_is_stopping_a_move(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.control.hold("stay")
        rig.control.tick()
        await asyncio.sleep(0.1)
        assert rig.motion.target is not None
        assert (await operator(rig).home("and home")).seen is Effect.UNDER_WAY
        await wait_for_homing(rig)
        await rig.until_mode(Mode.HOLD, 5)

    run_rig(scenario)


@pytest.mark.parametrize("more_deg", [0.2, 0.3])
def test_no_axis_moves_after_a_goto_has_arrived_for_which_one_axis_was_near_from_the_start(run_rig, more_deg):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        for a_deg, b_deg in ((-20.0, 45.0), (-17.0, 45.1), (-14.0, 45.1 + more_deg)):
            await operator(rig).goto(a_deg, b_deg, "a look")
            await wait_for_rest(rig)
        assert await motion_duration_s(rig, 15) == 0.0

    run_rig(scenario)
