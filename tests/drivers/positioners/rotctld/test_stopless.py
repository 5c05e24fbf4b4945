"""A rotator without a stop is sent to where it is: that must end its move, and may not begin one."""

import asyncio

import pytest

from sim_drivers.rotctld.core import RotatorRange
from tests.drivers.positioners.rotctld.told import ends_with, on_rotator, told


@pytest.mark.parametrize("error", [-4, -11])
def test_a_rotator_without_a_stop_command_is_sent_its_present_position_instead(error):
    _, line = told(lambda driver, _: driver.stop(), stop=ends_with("stop", error))
    assert line.sent == ["stop", "get_pos", "set_pos 180.00 45.00"]


@pytest.mark.parametrize("place", [(20.0, 45.0), (180.0, 5.0), (20.0, 5.0), (300.0, 45.0)])
@pytest.mark.parametrize("how", ["stop", "halt"])
def test_a_rotator_without_a_stop_that_stands_outside_the_configured_range_stays_there(place, how):
    async def scenario(driver, rotator, now):
        rotator.faults.add("stopless")
        # As if somebody had turned it by hand at its controller, or another program had, before the service was there.
        rotator.turn(*place, now())
        await asyncio.sleep(60)
        await getattr(driver, how)()
        await asyncio.sleep(60)
        assert rotator.position(now()) == place

    on_rotator(scenario, azimuth_min_deg=90.0, azimuth_max_deg=270.0, elevation_min_deg=20.0)


@pytest.mark.parametrize(("place", "stays_at"), [
    ((270.4, 45.0), (270.0, 45.0)), ((180.0, 19.0), (180.0, 20.0)), ((86.0, 92.0), (90.0, 90.0)),
    # So far outside it has not run out: whoever turned it there should not see it turn at a stop.
    ((276.0, 45.0), (276.0, 45.0)), ((180.0, 14.0), (180.0, 14.0)),
])  # fmt: skip
def test_a_rotator_without_a_stop_that_has_run_slightly_past_its_range_is_sent_to_its_end(place, stays_at):
    async def scenario(driver, rotator, now):
        rotator.faults.add("stopless")
        rotator.rotator_range = RotatorRange(90.0, 270.0, 20.0, 90.0)
        rotator.turn(*place, now())
        await asyncio.sleep(60)
        await driver.halt()
        await asyncio.sleep(5)
        assert rotator.position(now()) == stays_at

    on_rotator(scenario, azimuth_min_deg=90.0, azimuth_max_deg=270.0, elevation_min_deg=20.0)


def test_a_rotator_without_a_stop_on_its_way_back_into_the_range_is_stopped_outside_of_it():
    async def scenario(driver, rotator, now):
        rotator.faults.add("stopless")
        rotator.turn(20.0, 45.0, now())
        await asyncio.sleep(60)
        rotator.turn(180.0, 45.0, now())
        await asyncio.sleep(2)
        await driver.halt()
        azimuth_deg, _ = rotator.position(now())
        assert 30.0 < azimuth_deg < 40.0
        await asyncio.sleep(60)
        assert rotator.position(now())[0] == azimuth_deg

    on_rotator(scenario, azimuth_min_deg=90.0, azimuth_max_deg=270.0)
