"""What a person asked for before the machine slept does not go on hours later, when nobody stands there any more.

A clock that is set meanwhile is not a sleep, and hides none.
"""

import asyncio

import pytest

from daemon.base.records import Event, Mode
from drivers.interfaces import Telemetry
from tests.daemon.tracker.days import at, operator
from tests.support.motion import commands_sent, target_packets
from tests.support.phases import positioner_events, wait_for_rest, wait_for_tracking

ENDED = "test; a sleep of the machine has ended the goto to A 40, B 30 deg"


def sleep(rig, clock_set_s=0.0):
    """Let the machine sleep; the unit has no supply meanwhile, so it is still under way afterwards."""
    rig.clock.slept_s += 3600.0
    rig.clock.step_s += clock_set_s


def there(rig):
    return tuple(rig.truth()) == at(40, 30)


def has_homed(rig):
    return "homing finished" in positioner_events(rig)


async def on_its_way(rig):
    await wait_for_tracking(rig)
    await wait_for_rest(rig)
    await operator(rig).goto(40, 30, "test")
    await asyncio.sleep(5.0)
    assert rig.motion.moving


@pytest.mark.parametrize("clock_set_s", [0.0, -3600.0])
def test_a_goto_under_way_does_not_go_on_after_the_machine_has_slept(run_rig, clock_set_s):
    async def scenario(rig):
        await on_its_way(rig)
        sleep(rig, clock_set_s)
        await rig.until(lambda: not rig.motion.moving, 1.5, "the stop")
        stands = rig.truth()
        await asyncio.sleep(400.0)
        assert rig.truth() == stands, "nobody stands there any more"
        assert rig.mode is Mode.HOLD
        assert rig.control.why.startswith(ENDED)
        assert sum(event.text.startswith(ENDED) for event in rig.records_of(Event)) == 1
        await operator(rig).goto(40, 30, "test")
        await rig.until(lambda: there(rig), 120, "the goto that was given again")

    run_rig(scenario)


def test_a_goto_that_has_arrived_stays_in_force_after_the_machine_has_slept(run_rig):
    async def scenario(rig):
        await on_its_way(rig)
        await rig.until(lambda: there(rig) and not rig.motion.moving, 120, "the goto")
        sleep(rig)
        await asyncio.sleep(60.0)
        assert rig.control.why == "test"
        assert not any(ENDED in event.text for event in rig.records_of(Event))

    run_rig(scenario)


def test_a_wind_stow_goes_on_after_the_machine_has_slept_and_the_goto_before_it_does_not(run_rig):
    async def scenario(rig):
        await on_its_way(rig)
        rig.wind_m_s = 20.0
        await rig.until_mode(Mode.STOW, 30)
        await rig.until(lambda: rig.motion.moving, 10, "the stow")
        sleep(rig)
        await rig.until(lambda: rig.control.at_stow, 300, "the stow after the sleep")
        rig.wind_m_s = 3.0
        await rig.until_mode(Mode.HOLD, 3600)
        await asyncio.sleep(120.0)
        assert not there(rig)

    run_rig(scenario)


async def homing(rig):
    await wait_for_tracking(rig)
    await wait_for_rest(rig)
    await operator(rig).hold("test")
    await operator(rig).home("test")
    await asyncio.sleep(5.0)
    assert rig.motion.homing


def test_a_reference_run_does_not_go_on_after_the_machine_has_slept(run_rig, monkeypatch):
    async def scenario(rig):
        await homing(rig)
        sent = commands_sent(rig, monkeypatch)
        sleep(rig)
        await rig.until(lambda: not rig.motion.homing, 1.5, "the stop")
        stands = rig.truth()
        await asyncio.sleep(120.0)
        assert rig.truth() == stands
        assert "homing was stopped before its end: the machine slept; give 'heliocube home' again" in positioner_events(
            rig
        )
        assert not target_packets(sent)
        telemetry = rig.motion.telemetry
        assert isinstance(telemetry, Telemetry)
        assert not telemetry.homing

    run_rig(scenario)


@pytest.mark.parametrize(("begun", "ended"), [(on_its_way, there), (homing, has_homed)])
def test_a_clock_that_is_set_forward_ends_neither_a_goto_nor_a_reference_run(run_rig, begun, ended):
    async def scenario(rig):
        await begun(rig)
        rig.clock.step_s = 60.0
        await rig.until(lambda: ended(rig), 600, "the end")

    run_rig(scenario)
