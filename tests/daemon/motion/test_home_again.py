"""Count and end switch contradict each other: the next reference run leaves the switch, and finds the wrong one."""

import asyncio

import pytest

from daemon.base.records import Mode, Target
from daemon.service.operator import CommandError, Operator
from drivers.positioners.pozsol.wire import Field
from tests.support.motion import commands_sent, motion_duration_s, send_foreign_command, target_packets
from tests.support.phases import positioner_events, wait_for_long_rest, wait_for_rest

MET = "met its end switch where its count was"


async def ended(rig):
    await rig.until(lambda: not rig.motion.homing, 400, "the end of the run")
    await asyncio.sleep(2)


async def homed(rig):
    rig.motion.home()
    await rig.until(lambda: rig.motion.homing, 10, "the beginning of the run")
    await ended(rig)


async def knows_where_it_stands(rig):
    await wait_for_rest(rig)
    await asyncio.sleep(5)
    told = rig.motion.telemetry
    assert (told.a_deg, told.b_deg) == pytest.approx(tuple(rig.truth()), abs=0.3)


async def slipped_on_its_way(rig, axis):
    """Let an axis slip when it has gone five degrees towards its end switch."""
    began = getattr(rig.truth(), f"{axis}_deg")
    rig.motion.home()
    await rig.until(lambda: getattr(rig.truth(), f"{axis}_deg") < began - 5.0, 200, "the axis on its way")
    rig.unit.inject(f"{axis}_slip", rig.clock.monotonic())
    await ended(rig)


async def stuck_on_its_way(rig):
    """Let B's end switch stick closed when B has gone a degree towards it; return B's true angle afterwards."""
    began_deg = rig.truth().b_deg
    rig.motion.home()
    await rig.until(lambda: rig.truth().b_deg < began_deg - 1.0, 200, "axis B on its way")
    rig.unit.inject("b_switch_closed", rig.clock.monotonic())
    await ended(rig)
    assert f"axis B {MET}" in rig.motion.doubt
    return rig.truth().b_deg


@pytest.mark.parametrize("axis", ["a", "b"])
def test_a_count_that_slipped_is_right_again_after_two_reference_runs(run_rig, axis):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        await slipped_on_its_way(rig, axis)
        assert f"axis {axis.upper()} {MET}" in rig.motion.doubt
        await homed(rig)
        assert rig.motion.doubt is None
        await knows_where_it_stands(rig)

    run_rig(scenario, motion={"rehome": "operator"})


@pytest.mark.parametrize("drives", ["its own tracking", "another program"])
def test_foreign_motion_of_an_axis_on_its_way_off_the_end_switch_is_stopped_and_reported(run_rig, drives):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        await slipped_on_its_way(rig, "a")
        home_deg = rig.truth().a_deg
        rig.motion.home()
        await rig.until(lambda: rig.truth().a_deg > home_deg + 0.5, 60, "the way off the switch")
        if drives == "its own tracking":
            rig.unit.inject("own_tracking", rig.clock.monotonic())
        else:
            send_foreign_command(rig, Field.A_ANGLE, 200.0)
        assert await motion_duration_s(rig, 20.0) < 2.0
        assert rig.truth().a_deg < home_deg + 3.0
        (refusal,) = [text for text in positioner_events(rig) if text.startswith("homing refused")]
        assert "did not leave the end switch of axis A: it" in refusal
        rig.unit.repair("own_tracking", rig.clock.monotonic())
        await asyncio.sleep(10)
        await homed(rig)
        await homed(rig)
        assert rig.motion.doubt is None

    run_rig(scenario, motion={"rehome": "operator"})


@pytest.mark.parametrize("offset", [0.0, 8.0])
def test_an_end_switch_that_sticks_during_a_reference_run_is_never_believed(run_rig, offset):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        stood = await stuck_on_its_way(rig)
        await homed(rig)
        assert 4.0 < rig.truth().b_deg - stood < 7.0, "it was driven off the switch"
        assert "may be stuck" in rig.motion.doubt
        rig.unit.repair("b_switch_closed", rig.clock.monotonic())
        for _ in range(2):
            assert rig.motion.doubt
            await homed(rig)
        assert rig.motion.doubt is None
        await knows_where_it_stands(rig)

    positioner = {"b_axis": {"zero_offset": offset}}
    run_rig(scenario, motion={"rehome": "operator"}, instruments={"positioner": positioner})


def test_a_clear_given_before_count_and_switch_contradict_does_not_forgive_the_contradiction(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(rig.clock.monotonic())
        await rig.until(lambda: rig.motion.doubt, 15, "the mark of the restart")
        began_deg = rig.truth().b_deg
        rig.motion.home()
        await rig.until(lambda: rig.truth().b_deg < began_deg - 1.0, 200, "axis B on its way")
        rig.unit.inject("b_switch_closed", rig.clock.monotonic())
        rig.motion.clear_faults()
        await ended(rig)
        await asyncio.sleep(5)
        assert f"axis B {MET}" in rig.motion.doubt
        stood = rig.truth().b_deg
        await homed(rig)
        assert 4.0 < rig.truth().b_deg - stood < 7.0, "it was driven off the switch"
        assert "may be stuck" in rig.motion.doubt

    run_rig(scenario, motion={"rehome": "operator"})


def test_near_its_upper_limit_an_axis_does_not_leave_a_switch_that_may_be_stuck(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        await rig.control.stop("a test")
        rig.control.auto()
        rig.motion.order(Target(0.0, 90.0, "flat"), stow=True)
        await rig.until(lambda: rig.truth().b_deg > 89.5, 200, "it lies flat")
        await wait_for_rest(rig)
        stood = await stuck_on_its_way(rig)
        assert stood > 86.0
        await homed(rig)
        assert rig.truth().b_deg == pytest.approx(stood, abs=0.1)
        assert rig.motion.doubt, "without a way the run has shown nothing"

    run_rig(scenario, motion={"rehome": "operator"})


def test_a_count_that_slipped_at_rest_is_homed_before_anything_moves_by_it(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("b_slip", rig.clock.monotonic())
        await rig.until(lambda: rig.motion.unexplained_motion, 10, "what shows of it")
        person = Operator(rig.tracker, 1.0)
        with pytest.raises(
            CommandError, match=r"'heliocube clear'; give 'heliocube hold' first, so that the tracker waits"
        ):
            await person.home("the angles are not those of the arms")
        await person.hold("the angles are not those of the arms")
        assert (await person.clear("nobody is there")).done
        assert await motion_duration_s(rig, 400) == 0.0, "it would have been moved by the wrong count"
        for _ in range(2):
            await homed(rig)
        assert rig.motion.doubt is None
        await knows_where_it_stands(rig)
        assert rig.mode is Mode.HOLD
        await person.auto("done")
        await rig.until_mode(Mode.TRACKING, 30)

    run_rig(scenario, motion={"rehome": "operator"})


def test_a_fault_while_an_axis_leaves_its_switch_ends_the_run_as_soon_as_it_shows(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        stood = await stuck_on_its_way(rig)
        rig.motion.home()
        await rig.until(lambda: rig.truth().b_deg > stood + 0.5, 120, "axis B leaving its switch")
        rig.unit.inject("b_overcurrent", rig.clock.monotonic())
        await rig.until(lambda: not rig.motion.homing, 8, "the end of the run")
        assert "it reports b_overcurrent" in positioner_events(rig)[-1]
        assert "homing was not finished" in rig.motion.doubt

    run_rig(scenario, motion={"rehome": "operator"})


def test_a_stow_does_not_wait_for_an_axis_to_leave_its_switch(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        stood = await stuck_on_its_way(rig)
        rig.motion.home()
        await rig.until(lambda: rig.truth().b_deg > stood + 0.5, 120, "axis B leaving its switch")
        sent = commands_sent(rig, monkeypatch)
        rig.wind_m_s = 25.0
        await rig.until(lambda: target_packets(sent), 2.5, "the way to the stow position")
        assert "homing was stopped before its end" in positioner_events(rig)

    run_rig(scenario, motion={"rehome": "operator"})
