"""A contact that opens and closes all day: it is told as a bad contact, and not each time."""

import asyncio
import logging

import pytest

from daemon.base.records import Event
from tests.daemon.motion.test_outages import LONG_S, ORDINARY, SELDOM
from tests.support.phases import now, wait_for_tracking

MOST_LINES, MOST_EVENTS = 28, 20
CALM = {"cube": {"scan_every_s": 10}, "safety": {"scan_stale_s": 130, "fallback_after_s": 600}}
CALMER = CALM | {"cube": {"scan_every_s": 60}}
QUICK = {
    "cube": {"scan_every_s": 20},
    "safety": {"scan_stale_s": 65, "fallback_after_s": 130, "stow_at_least_s": 60},
}


def told(caplog):
    return [record.getMessage() for record in caplog.records if record.getMessage() not in ORDINARY]


async def flap(rig, device, *, down_s=10.0, up_s=10.0, for_s):
    end_s = now(rig) + for_s
    while now(rig) < end_s:
        device.link_up = False
        await asyncio.sleep(down_s)
        device.link_up = True
        await asyncio.sleep(up_s)


@pytest.mark.parametrize("name", ["positioner", "voltmeter", "load"])
def test_a_bad_contact_for_hours_is_reported_in_few_log_lines_and_events(run_rig, caplog, name):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.motion._polling = SELDOM
        caplog.clear()
        rig.records.clear()
        device = getattr(rig.cables, name)
        await flap(rig, device, for_s=2400.0)
        # Seldom enough for a quick simulation, too often to count as steady.
        await flap(rig, device, down_s=30.0, up_s=270.0, for_s=LONG_S - 2400.0)
        during = [event.text for event in rig.records_of(Event)]
        assert len(told(caplog)) <= MOST_LINES, "\n".join(told(caplog))
        assert len(during) <= MOST_EVENTS, "\n".join(during)

    with caplog.at_level(logging.INFO):
        load = {"driver": "chroma63600" if name == "load" else "none", "period_s": 25, "points": 10}
        # The contact is not the cube's, unless it is the voltmeter's: over hours, few scans will do.
        run_rig(scenario, **(CALM if name == "voltmeter" else CALMER), load=load)


async def wind_comes_and_goes(rig):
    end_s = now(rig) + LONG_S
    while now(rig) < end_s:
        rig.wind_m_s = None
        await asyncio.sleep(400)
        rig.wind_m_s = 20.0
        await asyncio.sleep(100)
        rig.wind_m_s = 3.0
        await asyncio.sleep(1000)


async def cube_unplugged(rig):
    rig.cables.voltmeter.link_up = False
    await asyncio.sleep(LONG_S)


async def cube_for_minutes(rig):
    await flap(rig, rig.cables.multiplexer, down_s=200.0, up_s=200.0, for_s=LONG_S)


@pytest.mark.parametrize(
    "trouble", [wind_comes_and_goes, cube_unplugged, cube_for_minutes], ids=lambda one: one.__name__
)
def test_hours_of_wind_losses_or_cube_outages_are_reported_in_few_log_lines_and_events(run_rig, caplog, trouble):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.motion._polling = SELDOM
        caplog.clear()
        rig.records.clear()
        await trouble(rig)
        assert len(told(caplog)) <= MOST_LINES, "\n".join(told(caplog))
        assert len(rig.records_of(Event)) <= MOST_EVENTS, "\n".join(event.text for event in rig.records_of(Event))

    with caplog.at_level(logging.INFO):
        run_rig(scenario, **QUICK)


def test_after_a_bad_contact_has_been_steady_again_the_next_loss_is_reported_at_once(run_rig, caplog):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.motion._polling = SELDOM
        await flap(rig, rig.cables.positioner, for_s=1200.0)
        await asyncio.sleep(1900)
        assert told(caplog)[-1].startswith("the positioner is steady again: it has worked for 30 min, after 60 outages")
        caplog.clear()
        rig.records.clear()
        rig.cables.positioner.link_up = False
        await asyncio.sleep(60)
        assert told(caplog)[0] == "the positioner is down: positioner: is unplugged"
        assert [event.text for event in rig.records_of(Event)] == ["the positioner is down: positioner: is unplugged"]

    with caplog.at_level(logging.INFO):
        run_rig(scenario, **CALMER)
