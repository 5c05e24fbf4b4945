"""A reference run at the bounds of what begins, ends and contradicts it, and whole runs on a simulated unit."""

import asyncio
import math

import pytest

from drivers.errors import RefusedError
from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.homing import AxisObservation, HomingRun
from drivers.positioners.pozsol.wire import parse_status
from sim_drivers.pozsol.setup import AxisDrive, Setup
from tests.drivers.positioners.pozsol.test_positioner_protocol import positioner_on, until
from tests.drivers.positioners.pozsol.test_standstill import HOMING, LOW, QUIET, UNDER_WAY, A, run

COAST, SLIP = A.units(0.4), A.units(0.5)
A_HIGH_TOO, B_HOMING = parse_status(str(1 << 19 | 1 << 20)), parse_status(str(1 << 17), 15)
# Four times as fast as the other units on ports: a reference run goes through all of the travel.
HURRIED = Setup(drive=AxisDrive(speed_mm_s=160.0, acceleration_mm_s2=1600.0, run_out_s=0.002))


def ended(place, aim=None, remain=0.0, status=LOW, rest_s=0.5, **how):
    at = place if aim is None else aim
    return run(*UNDER_WAY, (40.0, place, at, remain, status), (40.0 + rest_s, place, at, remain, status), **how)


@pytest.mark.parametrize(("look", "begun"), [
    ((1.2, 100.0, 100.0, 0.0, QUIET), False),
    ((1.2, 100.0, 100.0, 0.0, HOMING), True),
    ((1.0, 100.0, 90.0, 0.0, HOMING), False),
    ((1.2, 100.0, 98.1, 0.0, QUIET), False),
    ((1.2, 100.0, 97.9, 0.0, QUIET), True),
    ((1.2, 99.1, 99.1, 0.0, QUIET), False),
    ((1.2, 98.9, 98.9, 0.0, QUIET), True),
    ((1.2, 101.1, 101.1, 0.0, QUIET), True),
    ((1.2, 100.0, 110.0, 0.0, QUIET), False),
    ((1.2, 100.0, 100.0, 0.0, B_HOMING), False),
])  # fmt: skip
def test_a_reference_run_has_begun_once_homing_bit_destination_or_position_shows_it(look, begun):
    assert run(look).begun == begun


def test_a_reference_run_of_an_axis_on_its_switch_counts_as_begun_at_the_first_look():
    for place, home in ((0.99 * COAST, True), (1.01 * COAST, False)):
        assert run((1.2, place, place, 0.0, LOW), before=place).begun == home


@pytest.mark.parametrize(("rest_s", "over"), [(0.49, False), (0.5, True)])
def test_a_reference_run_is_over_after_half_a_second_at_rest(rest_s, over):
    assert ended(0.0, rest_s=rest_s).over == over


@pytest.mark.parametrize(("aim", "over"), [(0.99, True), (1.01, False), (-1.01, False)])
def test_a_reference_run_is_not_over_while_its_destination_is_elsewhere(aim, over):
    assert ended(0.0, aim=aim).over == over


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_reference_run_fails_if_it_ends_further_from_zero_than_the_axis_coasts(side):
    assert ended(side * 0.99 * COAST).failure == ""
    place = side * 1.01 * COAST
    assert ended(place).failure == f"the reference run of A ended at {place:g}, not on its end switch"


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_trusted_count_may_be_off_by_half_a_degree_at_the_switch_without_a_mismatch(side):
    assert ended(0.0, remain=side * 0.99 * SLIP).mismatch == ""
    told = ended(0.0, remain=side * 1.01 * SLIP).mismatch
    assert told.startswith(f"axis A met its end switch where its count was {side * 1.01 * SLIP:g}, not 0")
    assert ended(0.0, remain=side * 1.01 * SLIP).position_if_switch_wrong == pytest.approx(side * 1.01 * SLIP)
    assert ended(0.0, remain=side * 0.99 * SLIP).position_if_switch_wrong is None


@pytest.mark.parametrize("how", [{}, {"trusted": False, "stood": 100.0}])
def test_a_count_at_the_switch_that_is_not_a_number_is_a_mismatch(how):
    told = ended(0.0, remain=math.nan, **how)
    assert told.mismatch.startswith("axis A met its end switch where its count was nan, not ")
    assert told.position_if_switch_wrong is None


def test_a_run_without_motion_is_a_mismatch_if_the_former_position_is_not_a_number():
    looks = ((1.2, 0.0, 0.0, 0.0, LOW), (2.0, 0.0, 0.0, 0.0, LOW))
    assert "did not move" in run(*looks, before=0.0, trusted=False, stood=math.nan).mismatch


def test_a_run_without_motion_is_a_mismatch_only_if_the_count_was_over_half_a_degree_from_zero():
    for place, suspicious in ((0.99 * SLIP, False), (1.01 * SLIP, True), (-1.01 * SLIP, True)):
        looks = ((1.2, 0.0, 0.0, 0.0, LOW), (2.0, 0.0, 0.0, 0.0, LOW))
        assert ("did not move" in run(*looks, before=place).mismatch) == suspicious


def test_a_run_without_motion_after_a_lost_count_is_judged_by_where_the_axis_stood_before():
    stands = ((1.2, 0.0, 0.0, 0.0, LOW), (2.0, 0.0, 0.0, 0.0, LOW))
    for stood, suspicious in ((1.01 * SLIP, True), (0.99 * SLIP, False), (None, False)):
        assert ("did not move" in run(*stands, before=0.0, trusted=False, stood=stood).mismatch) == suspicious


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_lost_count_may_be_off_by_five_degrees_from_where_the_axis_stood_before(side):
    # Its count is 0 where it had been 60: the way to the switch is 60 long.
    for off, told in ((0.99, ""), (1.01, "not -60: home it again")):
        remain = -60.0 + side * off * A.units(5.0)
        assert told in run(*AFTER_RESTART, remain_at(remain), before=0.0, trusted=False, stood=60.0).mismatch
    assert not run(*AFTER_RESTART, remain_at(-90.0), before=0.0, trusted=False, stood=None).mismatch


AFTER_RESTART = ((1.2, -1.5, -11.5, 0.0, HOMING), (20.0, -59.0, -69.0, 0.0, HOMING), (40.0, 0.0, 0.0, 0.0, LOW))


def remain_at(count):
    return 41.0, 0.0, 0.0, count, LOW


def test_a_finished_reference_run_keeps_its_verdict_whatever_comes_later():
    good = ended(0.0)
    assert (good.over, good.travelled) == (True, True)
    again = run(*UNDER_WAY, *((at_s, 0.0, 0.0, 0.0, LOW) for at_s in (40.0, 41.0)), (50.0, 80.0, 70.0, 9.0, HOMING))
    assert (again.over, again.failure, again.mismatch) == (True, "", "")
    assert run(*UNDER_WAY, *((at_s, 0.0, 0.0, 0.0, LOW) for at_s in (40.0, 41.0)), *STANDS_ABROAD).failure == ""


STANDS_ABROAD = ((50.0, 80.0, 80.0, 0.0, QUIET), (51.0, 80.0, 80.0, 0.0, QUIET))


def test_a_run_that_never_began_is_not_over_and_one_that_stopped_where_it_began_has_failed():
    quiet = run((1.2, 100.0, 100.0, 0.0, QUIET), (2.0, 100.0, 100.0, 0.0, QUIET))
    assert (quiet.begun, quiet.over) == (False, False)
    stopped = run((1.2, 100.0, 100.0, 0.0, HOMING), (5.0, 100.0, 100.0, 0.0, QUIET), (6.0, 100.0, 100.0, 0.0, QUIET))
    assert stopped.failure == "the reference run of A ended at 100, not on its end switch"


def late(status_s, place, aim, status, time_s, homing):
    homing.update(AxisObservation(place, aim, 0.0, time_s, status, status_s))
    return homing


def test_a_status_from_before_the_homing_command_or_before_the_axis_stood_is_ignored():
    homing = HomingRun("a", A, 100.0, 1.0, trusted=True, last_trusted_position=100.0)
    assert not late(0.9, 100.0, 100.0, HOMING, 1.2, homing).begun
    assert not late(1.0, 100.0, 100.0, HOMING, 1.2, homing).begun
    assert late(1.1, 100.0, 100.0, HOMING, 1.3, homing).begun
    late(40.0, 0.0, 0.0, LOW, 40.1, homing)
    assert not late(40.0, 0.0, 0.0, LOW, 41.0, homing).over
    assert late(40.1, 0.0, 0.0, LOW, 41.0, homing).over


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("place", "aim"), [(1.05, 0.95), (0.95, 1.05)])
def test_a_reference_run_fails_unless_position_and_destination_are_both_on_the_switch(side, place, aim):
    assert ended(side * place * COAST, aim=side * aim * COAST).failure.startswith("the reference run of A ended at")


def test_a_reference_run_on_the_switch_with_another_destination_has_not_begun():
    assert not run((1.2, 0.0, 50.0, 0.0, LOW), before=0.0).begun


def test_a_fault_of_the_other_axis_does_not_fail_a_reference_run():
    status = parse_status(str(1 << 19 | 1 << 5))
    assert [fault[0] for fault in status.faults] == ["b"]
    assert ended(0.0, status=status).failure == ""


@pytest.mark.parametrize("b_out_bit", [None, wire.B_OUT_BIT_STM])
def test_a_reference_run_of_each_axis_shows_as_homing_and_ends_at_its_low_end(positioner_host, b_out_bit):
    async def scene():
        async with positioner_host(HURRIED) as host:
            positioner = positioner_on(host.port.link, b_out_bit=b_out_bit)
            await positioner.open()
            for axis, low_deg in (("a", -52.0), ("b", 13.0)):
                await positioner.home(axis)
                assert (await positioner.read_telemetry()).homing

                async def over():
                    return not (await positioner.read_telemetry()).homing

                await until(over)
                truth = host.core.truth(host._now())
                assert (truth.a_deg if axis == "a" else truth.b_deg) == pytest.approx(low_deg, abs=0.1)
            assert not (await positioner.read_telemetry()).reference_doubt
            await positioner.close()

    asyncio.run(scene())


@pytest.mark.parametrize("b_out_bit", [None, wire.B_OUT_BIT_STM])
def test_a_lost_count_is_in_doubt_until_cleared_and_homing_then_reports_the_wrong_count(positioner_host, b_out_bit):
    async def scene():
        async with positioner_host(HURRIED) as host:
            positioner = positioner_on(host.port.link, b_out_bit=b_out_bit)
            await positioner.open()
            assert (await positioner.read_telemetry()).reference_doubt == ""
            host.core.inject("reset_position_lost", host._now())

            async def doubtful():
                # A reader that a busy machine held up sees no jump, only a count that nothing explains.
                told = (await positioner.read_telemetry()).reference_doubt
                return "count has jumped" in told or "its count is lost" in told

            await until(doubtful)
            assert (await positioner.clear_faults()).reference_doubt
            assert not (await positioner.read_telemetry()).reference_doubt
            # The count says 0, but the axis stands elsewhere: that is not home.
            await positioner.home("b")

            async def over():
                return not (await positioner.read_telemetry()).homing

            await until(over)
            assert host.core.truth(host._now()).b_deg == pytest.approx(13.0, abs=0.1)
            seen = await positioner.read_telemetry()
            assert "axis B met its end switch where its count was -" in seen.reference_doubt
            await positioner.close()

    asyncio.run(scene())


def test_a_reference_run_that_the_unit_does_not_begin_is_refused(positioner_host):
    async def scene():
        async with positioner_host() as host:
            positioner = positioner_on(host.port.link)
            await positioner.open()
            host.core.inject("undervoltage", host._now())
            with pytest.raises(RefusedError, match=r"home axis B: its motor supply is 15 V"):
                await positioner.home("b")
            assert not (await positioner.read_telemetry()).homing
            await positioner.close()

    asyncio.run(scene())
