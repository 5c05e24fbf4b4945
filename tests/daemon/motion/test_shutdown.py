"""At its end the service halts what moves, and says that it stands only if telemetry has shown it."""

import asyncio

import pytest

from daemon.base.records import Target
from daemon.motion.shutdown import stop_and_confirm
from tests.support.fake_positioner import FakePositioner, run_motion

SENT = "stop was sent, and no telemetry has shown the axes standing since"


async def ended(rig, within_s=3.0):
    return await stop_and_confirm(rig.motion, rig.clock, within_s)


async def under_way(rig):
    rig.motion.order(Target(40.0, 60.0, "far"))
    await asyncio.sleep(3.0)


def test_the_end_stops_a_moving_axis_and_waits_until_it_is_seen_to_stand():
    async def scenario(rig):
        await under_way(rig)
        start_s = rig.clock.monotonic()
        assert await ended(rig) is None
        assert rig.motion.telemetry.time_monotonic_s >= start_s
        assert rig.motion.is_idle
        assert rig.motion.stands_since_s is not None
        assert 3.0 < rig.unit.place()[0] < 9.0
        assert rig.motion._guard.frozen == "the service ends"

    run_motion(scenario)


def test_the_end_looks_once_more_at_a_standing_positioner():
    async def scenario(rig):
        await asyncio.sleep(20.1)
        start_s = rig.clock.monotonic()
        assert await ended(rig) is None
        assert rig.clock.monotonic() - start_s > 0.2, "the look of before the stop is none"
        assert rig.motion.telemetry.time_monotonic_s >= start_s

    run_motion(scenario)


class SlowPositioner(FakePositioner):
    """The same, but each reading of telemetry takes a while."""

    async def read_telemetry(self):
        await asyncio.sleep(0.2)
        return await super().read_telemetry()


def test_the_end_accepts_a_stop_that_was_already_under_way_with_a_look_after_it():
    async def scenario(rig):
        await rig.motion.stop()
        await asyncio.sleep(0.35)
        start_s = rig.clock.monotonic()
        assert await ended(rig) is None
        assert rig.motion.telemetry.time_monotonic_s >= start_s

    run_motion(scenario, make=SlowPositioner)


def test_the_end_reports_the_age_of_the_last_look_at_a_positioner_that_does_not_obey():
    async def scenario(rig):
        await under_way(rig)
        rig.unit.is_deaf = True
        start_s = rig.clock.monotonic()
        said = await ended(rig, 4.0)
        assert rig.clock.monotonic() - start_s == pytest.approx(4.0, abs=0.1)
        assert said.startswith(f"{SENT}; last seen 1 s ago at A +1")
        assert said.endswith(", B 60.0 deg: look at the tracker")

    run_motion(scenario)


def test_the_end_reports_a_stop_that_cannot_be_sent_with_the_last_look():
    async def scenario(rig):
        await asyncio.sleep(20.0)
        rig.unit.is_lost = True
        await asyncio.sleep(30.0)
        said = await ended(rig)
        assert said.startswith(
            "stop could not be sent (hand: does not answer); last seen 30 s ago at A +0.0, B 60.0 deg"
        ), "at once, for nothing was under way"

    run_motion(scenario)


def test_a_move_that_goes_on_while_the_link_is_down_is_stopped_when_it_is_back():
    async def scenario(rig):
        await under_way(rig)
        rig.unit.is_lost = True
        asyncio.get_running_loop().call_later(1.0, setattr, rig.unit, "is_lost", False)
        assert await ended(rig, 8.0) is None
        assert rig.unit.place()[0] < 20.0
        assert rig.motion.stands_since_s is not None

    run_motion(scenario)


def test_a_move_that_goes_on_while_the_link_is_down_for_long_is_reported_as_not_stopped():
    async def scenario(rig):
        await under_way(rig)
        rig.unit.is_lost = True
        start_s = rig.clock.monotonic()
        said = await ended(rig, 8.0)
        assert rig.clock.monotonic() - start_s == pytest.approx(8.0, abs=0.1)
        assert said.startswith("stop could not be sent (hand: does not answer); last seen 9 s ago at A +")

    run_motion(scenario)


def test_the_end_reports_unknown_motion_of_a_positioner_that_was_never_seen():
    async def scenario(rig):
        said = await ended(rig, 0.1)
        assert said == f"{SENT}; whether anything moves is not known: look at the tracker"

    run_motion(scenario, connects=False)


def test_at_the_end_a_moving_axis_is_halted_and_the_unit_is_closed():
    async def scenario(rig):
        await under_way(rig)

    rig = run_motion(scenario)
    assert rig.unit.sent[-2:] == ["halt", "close"]

    async def at_rest(rig):
        await asyncio.sleep(30.0)
        rig.halts = rig.unit.sent.count("halt")

    rig = run_motion(at_rest)
    assert rig.unit.sent.count("halt") == rig.halts
    assert rig.unit.sent[-1] == "close"


def test_at_the_end_a_halt_that_hangs_is_waited_for_three_seconds():
    async def scenario(rig):
        await under_way(rig)
        rig.unit.halt = lambda: asyncio.sleep(1e6)
        rig.end_s = rig.clock.monotonic()

    rig = run_motion(scenario)
    assert rig.unit.sent[-1] == "close"
    assert 2.9 <= rig.clock.monotonic() - rig.end_s <= 3.5


def test_at_the_end_a_target_that_was_only_just_sent_is_halted_too():
    async def scenario(rig):
        rig.motion.order(Target(40.0, 60.0, "far"))
        await rig.until(lambda: rig.unit.sent[-1] == ("move", 40.0, 60.0, "a"), 1.0)
        assert rig.motion.stands_since_s is not None

    rig = run_motion(scenario)
    assert rig.unit.sent[-2:] == ["halt", "close"]


def test_at_the_end_a_stop_that_is_broken_off_is_sent_again():
    async def scenario(rig):
        await asyncio.sleep(30.0)
        rig.halts = rig.unit.sent.count("halt")
        rig.motion.freeze("ana")
        await rig.until(lambda: rig.unit.sent.count("halt") > rig.halts)

    rig = run_motion(scenario)
    assert rig.unit.sent.count("halt") == rig.halts + 2


def test_at_the_end_a_unit_that_does_not_answer_is_not_waited_for():
    async def scenario(rig):
        rig.unit.is_lost = True
        await asyncio.sleep(3.0)
        rig.halts = rig.unit.sent.count("halt")

    rig = run_motion(scenario)
    assert rig.unit.sent.count("halt") == rig.halts
