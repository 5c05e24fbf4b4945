"""No decision on readings that are too old or too few, in mode tracking either."""

import asyncio

import pytest

from daemon.base.records import Decision, Mode


async def just_before_a_decision(rig, lead_s):
    await rig.until_mode(Mode.TRACKING, 60)
    await asyncio.sleep(5)
    await rig.until(lambda: rig.control.state.next_decision_s < lead_s, 400, "the time before a decision")
    return len(rig.records_of(Decision))


def blind(rig, *, yes):
    for face in range(4):
        if yes:
            rig.scene.break_sensor(face, 5.0)
        else:
            rig.scene.repair_sensor(face)


@pytest.mark.parametrize("law", ["mu-prime", "chronometric", "optimal"])
def test_a_decision_that_falls_due_on_stale_readings_waits_for_fresh_ones(run_rig, law):
    async def scenario(rig):
        decided = await just_before_a_decision(rig, 20)
        blind(rig, yes=True)
        await asyncio.sleep(55)
        assert rig.mode is Mode.TRACKING
        assert len(rig.records_of(Decision)) == decided
        blind(rig, yes=False)
        await rig.until(lambda: len(rig.records_of(Decision)) == decided + 1, 12, "the decision")

    run_rig(scenario, law={"name": law})


def test_a_decision_below_the_minimum_coverage_waits_until_it_is_reached(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 200)
        decided = await just_before_a_decision(rig, 20)
        blind(rig, yes=True)
        await asyncio.sleep(40)
        blind(rig, yes=False)
        await asyncio.sleep(30)
        assert rig.mode is Mode.TRACKING
        assert len(rig.records_of(Decision)) == decided
        await rig.until(lambda: len(rig.records_of(Decision)) > decided, 120, "the decision")
        assert rig.records_of(Decision)[decided].irradiances.coverage >= 0.9

    run_rig(scenario, windows={"minimum_coverage": 0.9})


@pytest.mark.parametrize(
    ("slept_s", "step_s", "renewed"),
    [(28_800.0, 0.0, True), (16.0, -16.0, True), (14.0, 0.0, False), (0.0, 600.0, False), (0.0, -600.0, False)],
)
def test_a_machine_sleep_over_scan_stale_s_discards_earlier_readings_and_a_clock_step_does_not(
    run_rig, slept_s, step_s, renewed
):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 200)
        await asyncio.sleep(120)
        decided = await just_before_a_decision(rig, 8)
        # The steady clock stands still while a machine sleeps.
        rig.clock.slept_s, rig.clock.step_s = slept_s, step_s
        await rig.until(lambda: len(rig.records_of(Decision)) > decided, 130, "the decision")
        assert (rig.records_of(Decision)[decided].irradiances.coverage < 0.9) is renewed
        assert rig.mode is Mode.TRACKING

    run_rig(scenario)
