"""A contact that opens and closes all day: it is told as that, and not each time."""

import asyncio
import logging

import pytest

from daemon.records import Event

from .test_faults import tracking
from .test_motion_outages import ORDINARY, SELDOM, now

DAY_S = 24 * 3600.0
MOST = 50
CALM = {"cube": {"scan_every_s": 5}, "safety": {"scan_stale_s": 130, "fallback_after_s": 600}}


def told(caplog):
    return [record.getMessage() for record in caplog.records if record.getMessage() not in ORDINARY]


async def flap(bench, device, *, down_s=10.0, up_s=10.0, for_s=DAY_S):
    end_s = now(bench) + for_s
    while now(bench) < end_s:
        device.link_up = False
        await asyncio.sleep(down_s)
        device.link_up = True
        await asyncio.sleep(up_s)


@pytest.mark.parametrize("name", ["positioner", "voltmeter", "multiplexer", "load"])
def test_a_day_of_a_bad_contact_is_told_in_at_most_50_lines_and_50_events(run_rig, caplog, name):
    async def scenario(bench):
        await tracking(bench)
        bench.motion._polling = SELDOM
        caplog.clear()
        bench.records.clear()
        await flap(bench, getattr(bench, name))
        during = [event.text for event in bench.of(Event)]
        assert len(told(caplog)) <= MOST, "\n".join(told(caplog))
        assert len(during) <= MOST, "\n".join(during)

    with caplog.at_level(logging.INFO):
        run_rig(scenario, **CALM, load={"driver": "chroma63600", "period_s": 5})
    print(len(told(caplog)), *told(caplog), sep="\n")
