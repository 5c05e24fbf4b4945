"""What the service concludes from a standing unit's telemetry: its setup, its pose, its motor currents."""

import asyncio
from dataclasses import replace

import pytest

from daemon.base.records import Mode, Move, Pose, Target
from drivers.errors import RefusedError
from tests.daemon.motion.test_outages import SELDOM
from tests.support.motion import alarms, override_telemetry, send_foreign_b_target
from tests.support.phases import now, wait_for_long_rest


def test_a_positioner_whose_setup_contradicts_the_configuration_is_not_moved(run_rig):
    conflict = "field 74 (holder) says 39.6 mm and the configuration 0: correct instruments.positioner.a_axis"

    async def scenario(rig):
        opened = rig.positioner.open

        async def contradicting():
            return replace(await opened(), setup_conflicts=(conflict,))

        rig.positioner.open = contradicting
        await rig.until_mode(Mode.FAULT, 10)
        assert rig.motion.blocked == conflict
        assert alarms(rig)["positioner-setup"] == conflict
        with pytest.raises(RefusedError, match="holder"):
            rig.motion.order(Target(0, 90, "storm"), stow=True)
        with pytest.raises(RefusedError, match="holder"):
            rig.motion.home()
        assert not rig.records_of(Move)

    run_rig(scenario)


def test_poses_at_rest_are_recorded_every_5_s_and_motion_at_once(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        before = len(rig.records_of(Pose))
        await asyncio.sleep(100)
        assert 19 <= len(rig.records_of(Pose)) - before <= 22
        send_foreign_b_target(rig, 80.0)
        start_s = rig.clock.monotonic()
        await rig.until(lambda: rig.records_of(Pose)[-1].time_monotonic_s > start_s, 1.1, "a pose")

    run_rig(scenario)


def test_a_resting_positioner_is_read_seldom_although_its_telemetry_is_never_older_than_0_6_s(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        await asyncio.sleep(10)
        read, reads = rig.positioner.read_telemetry, []

        def counted():
            reads.append(rig.clock.monotonic())
            return read()

        rig.positioner.read_telemetry = counted
        ages_s = []
        for _ in range(100):
            await asyncio.sleep(0.97)
            now_s = rig.clock.monotonic()
            ages_s += [now_s - rig.motion.telemetry.time_monotonic_s, now_s - rig.motion.pose.time_monotonic_s]
        assert len(reads) < 25
        assert max(ages_s) < 0.6
        send_foreign_b_target(rig, 80.0)
        start_s = rig.clock.monotonic()
        await rig.until(lambda: rig.motion.unexplained_motion, 1.1, "that it moved")
        assert rig.motion.telemetry.time_monotonic_s >= start_s

    run_rig(scenario)


@pytest.mark.parametrize(
    ("fields", "words"),
    [({"a_motor_current_a": 1.9}, "draws more than 1.6 A"), ({"b_motor_current_a": 0.7}, "although it stands")],
)
def test_motor_currents_that_last_are_an_alarm(run_rig, fields, words):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        override_telemetry(rig, **fields)
        await asyncio.sleep(1)
        assert not alarms(rig)
        await asyncio.sleep(3)
        assert words in alarms(rig)["motor-current"]
        rig.tracker.alarms.acknowledge("ana")
        override_telemetry(rig, a_motor_current_a=2.2, b_motor_current_a=2.2)
        await asyncio.sleep(3)
        (alarm,) = rig.tracker.alarms.active
        assert alarm.text.count("draws more than 1.6 A") == 2
        assert alarm.state == "raised", "of the other axis nobody has heard"
        del rig.positioner.read_telemetry
        rig.motion._polling = SELDOM
        await asyncio.sleep(3700)
        assert not alarms(rig)

    # Motors do not depend on scans: over an hour, few will do.
    run_rig(scenario, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130, "fallback_after_s": 600})


def test_stands_since_tells_when_telemetry_saw_both_axes_come_to_rest(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        before_s = rig.motion.stands_since_s
        assert before_s < now(rig) - 15
        await rig.motion.stop()
        assert rig.motion.stands_since_s is None, "whether it stood is not known before the next look"
        await rig.until(lambda: rig.motion.stands_since_s, 3, "standstill")
        rig.motion.order(Target(0, 60, "test"))
        await asyncio.sleep(3)
        assert rig.motion.stands_since_s is None
        await rig.motion.stop()
        stopped_s = now(rig)
        assert rig.motion.stands_since_s is None, "a stop that was sent is not yet a standstill"
        await rig.until(lambda: rig.motion.stands_since_s, 3, "standstill")
        assert rig.motion.stands_since_s > stopped_s
        rig.cables.positioner.link_up = False
        await asyncio.sleep(2)
        assert rig.motion.stands_since_s is None

    run_rig(scenario, motion={"deadband_deg": 30})
