"""The simulated positioner is built from the configuration, and the driver of the same configuration moves it."""

import asyncio

import pytest
from annotated_types import Le

from daemon.base.clock import LoopClock
from daemon.base.errors import UserError
from daemon.base.records import Mode, Move, MoveOutcome
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.config.simulation import SimulationSettings
from daemon.rigs.simulated import build_simulated_positioner
from daemon.rigs.simulated_positioner import build_unit
from daemon.studies.campaign.watch.count_check import WRONG_COUNT_DEG
from tests.support.phases import wait_for_rest, wait_for_tracking

GEOMETRIES = {
    "other arms": {
        "a_axis": {"arm_1_mm": 410.0, "arm_2_mm": 280.0, "apex_deg": 85.0, "low_deg": -55.0, "holder_mm": 20.0},
        "b_axis": {"arm_1_mm": 350.0, "zero_offset": 2.5},
    },
    "the other way round": {
        "a_axis": {"sense": "lowers", "low_deg": 55.0, "apex_deg": 95.0},
        "b_axis": {"sense": "lowers", "low_deg": 90.0, "apex_deg": 140.0},
        "status_layout": "lpc",
    },
    "slew drives": {"position_unit": "deg", "a_axis": {"low_deg": -60.0}, "b_axis": {"low_deg": 10.0}},
    "impulses": {"position_unit": "impulse", "a_axis": {"impulses_per_deg": 80.0}},
    "more impulses": {
        "position_unit": "impulse",
        "a_axis": {"impulses_per_deg": 300.0},
        "b_axis": {"impulses_per_deg": 240.0, "zero_offset": 100.0},
    },
}


def settings_of(geometry):
    return Settings.model_validate({"instruments": {"positioner": geometry}})


@pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)
def test_the_simulated_positioner_moves_and_arrives_with_any_geometry(geometry):
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        clock = LoopClock(runner.get_loop().time, 1.7e9)
        truth, positioner = build_simulated_positioner(settings_of(geometry), clock)

        async def scene():
            identity = await positioner.open()
            assert identity.setup_conflicts == ()
            for target in ((-30.0, 45.0), (50.0, 15.0), (-50.0, 90.0)):
                await positioner.move_to(*target)
                await asyncio.sleep(400.0)
                assert truth(clock.monotonic()) == pytest.approx(target, abs=0.8)
                seen = await positioner.read_telemetry()
                assert (seen.a_deg, seen.b_deg) == pytest.approx(target, abs=0.8)
            await positioner.home("a")
            await asyncio.sleep(600.0)
            low_deg = geometry.get("a_axis", {}).get("low_deg", -52.0)
            assert truth(clock.monotonic()).a_deg == pytest.approx(low_deg, abs=1.1)

        runner.run(scene())


@pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)
def test_the_service_tracks_with_a_simulated_positioner_of_any_geometry(run_rig, geometry):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 300)
        await rig.until(lambda: rig.records_of(Move), 400, "the end of a move")
        assert rig.records_of(Move)[-1].outcome is MoveOutcome.ARRIVED

    run_rig(scenario, instruments={"positioner": geometry})


@pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)
def test_an_injected_slip_of_the_count_is_larger_than_the_tolerance_of_a_reference(geometry):
    unit = build_unit(settings_of(geometry), LoopClock(lambda: 0.0, 1.7e9))
    unit.inject("a_slip", 0.0)
    assert abs(unit.shown_deg("a", 0.0) - unit.truth(0.0).a_deg) > WRONG_COUNT_DEG


def test_moves_with_the_fastest_allowed_actuators_arrive_and_are_not_taken_for_a_jump_of_the_count(run_rig):
    (fastest,) = (
        bound.le for bound in SimulationSettings.model_fields["motor_speed_mm_s"].metadata if isinstance(bound, Le)
    )

    async def scenario(rig):
        await wait_for_tracking(rig)
        for corner in ((-50.0, 90.0), (50.0, 15.0), (-50.0, 15.0)):
            rig.control.goto(*corner, "a test")
            await asyncio.sleep(3)
            await wait_for_rest(rig)
            assert rig.records_of(Move)[-1].outcome is MoveOutcome.ARRIVED

    run_rig(scenario, simulation={"motor_speed_mm_s": fastest})


def test_an_axis_geometry_whose_triangle_opens_too_far_is_refused_in_either_sense():
    for sense, apex_deg in (("raises", 140.0), ("lowers", 60.0)):
        with pytest.raises(ValueError, match=r"b_axis\.apex_deg makes no triangle at some angle from 13 to 90 deg"):
            settings_of({"b_axis": {"sense": sense, "apex_deg": apex_deg}})


def test_a_geometry_that_cannot_be_simulated_is_refused_in_one_sentence():
    clock = LoopClock(lambda: 0.0, 1.7e9)
    settings = settings_of({"position_unit": "deg"})
    # The check of a file refuses such a drive: so it is put in here.
    own = settings.instruments.positioner
    own = own.model_copy(update={"a_axis": own.a_axis.model_copy(update={"low_deg": 80.0})})
    settings = settings.model_copy(update={"instruments": settings.instruments.model_copy(update={"positioner": own})})
    with pytest.raises(UserError, match=r"instruments\.positioner has a geometry that cannot be simulated: a slew"):
        build_simulated_positioner(settings, clock)
