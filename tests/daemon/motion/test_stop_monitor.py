"""A stop that is not obeyed: when it is tried again, after which time it is told, and what is not deafness."""

import asyncio
import itertools
from dataclasses import replace

import pytest

from daemon.base.records import Target
from drivers.settings import PositionerSettings
from tests.support.fake_positioner import DEAF_S, FakePositioner, run_motion


def test_a_positioner_that_does_not_obey_stop_is_reported_after_five_seconds_and_stopped_repeatedly():
    async def scenario(rig):
        rig.motion.order(Target(50.0, 60.0, "go"))
        await asyncio.sleep(3.0)
        rig.unit.is_deaf = True
        asked_s = rig.clock.monotonic()
        await rig.motion.stop()
        await rig.until(lambda: "deaf-to-stop" in rig.active_alarms, 12.0)
        assert 5.0 < rig.clock.monotonic() - asked_s < 9.0
        assert rig.active_alarms["deaf-to-stop"].startswith(
            "the positioner does not obey stop: switch off the supply of its motors; nothing moves until"
        )
        halts = [rig.unit.sent.count("halt")]
        for _ in range(3):
            await asyncio.sleep(6.05)
            halts.append(rig.unit.sent.count("halt"))
        assert [after - before for before, after in itertools.pairwise(halts)] == [1, 1, 1]
        rig.unit.is_deaf = False
        await asyncio.sleep(8.0)
        assert rig.motion.stands_since_s is not None
        assert "deaf-to-stop" in rig.active_alarms, "until a person has looked"

    run_motion(scenario)


def test_tries_to_stop_come_at_once_and_then_ever_more_slowly():
    async def scenario(rig):
        at_s, halt = [], rig.unit.halt

        async def timed():
            at_s.append(rig.clock.monotonic())
            await halt()

        rig.unit.halt = timed
        rig.unit.is_deaf = True
        rig.motion.freeze("ana")
        await asyncio.sleep(30.0)
        pauses_s = [after - before - DEAF_S for before, after in itertools.pairwise(at_s)]
        assert pauses_s[:6] == pytest.approx([0.5, 1.0, 2.0, 4.0, 4.0, 4.0])
        assert "deaf-to-stop" not in rig.active_alarms, "nothing moves"
        assert rig.motion.stands_since_s is None, "a stop is on its way"

    run_motion(scenario)


def test_motion_under_a_pressed_button_does_not_count_as_deafness_to_stop():
    async def scenario(rig):
        rig.unit.is_deaf = True
        rig.unit.telemetry_overrides["button_pressed"] = True
        rig.unit.drive(40.0, 60.0)
        rig.motion.freeze("ana")
        await asyncio.sleep(12.0)
        assert "deaf-to-stop" not in rig.active_alarms
        rig.unit.telemetry_overrides.clear()
        await asyncio.sleep(4.0)
        assert "deaf-to-stop" not in rig.active_alarms
        await rig.until(lambda: "deaf-to-stop" in rig.active_alarms, 6.0)

    run_motion(scenario)


def test_a_single_look_that_shows_motion_late_does_not_count_as_deafness_to_stop():
    async def scenario(rig):
        rig.motion.order(Target(50.0, 60.0, "go"))
        await asyncio.sleep(3.0)
        rig.unit.is_deaf = True
        looks, read = [], rig.unit.read_telemetry

        async def counted():
            seen = await read()
            looks.append(rig.clock.monotonic())
            return seen

        rig.unit.read_telemetry = counted
        await rig.motion.stop()
        asked_s = rig.clock.monotonic()
        await rig.until(lambda: len(looks) > 1 and looks[-2] > asked_s + 5.6, 12.0)
        rig.unit.put(*rig.unit.place())
        await asyncio.sleep(12.0)
        assert "deaf-to-stop" not in rig.active_alarms

    run_motion(scenario)


class CoarseSettings(PositionerSettings):
    def resolution(self):
        return 1.0


class CoarsePositioner(FakePositioner):
    """Turns at 2 deg/s like the other, but reports whole degrees: between two looks it may seem to stand."""

    async def read_telemetry(self):
        seen = await super().read_telemetry()
        whole = {name: float(round(getattr(seen, name))) for name in ("a_deg", "b_deg", "position_a", "position_b")}
        return replace(seen, **whole)


def test_a_slow_axis_whose_position_is_coarse_is_found_deaf_too():
    async def scenario(rig):
        rig.unit.is_deaf = True
        rig.unit.drive(45.0, 60.0)
        rig.motion.freeze("ana")
        await rig.until(lambda: "deaf-to-stop" in rig.active_alarms, 14.0)

    run_motion(scenario, expected=CoarseSettings(), make=CoarsePositioner)


def test_a_standing_positioner_that_is_shaken_now_and_then_does_not_count_as_deaf_to_stop():
    async def scenario(rig):
        rig.unit.is_deaf = True
        rig.motion.freeze("ana")
        for place in range(4):
            await asyncio.sleep(16.0)
            rig.unit.put(place % 2 * 3.0, 60.0)
        assert "deaf-to-stop" not in rig.active_alarms, "shaken once in a while"

    run_motion(scenario, expected=CoarseSettings(), make=CoarsePositioner)
