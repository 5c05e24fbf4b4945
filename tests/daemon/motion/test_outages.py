"""Hours with a broken positioner: what is logged, and that nothing runs away."""

import asyncio
import logging

import pytest

from daemon.motion.polling import Polling
from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.wire import Field
from tests.support.motion import A_PACKET, B_PACKET, commands_sent, lose_packets, send_foreign_command
from tests.support.phases import now, wait_for_long_rest

# Longer than the report after an hour; the next comes after six (tests/daemon/base/test_recurrence.py has a whole day).
LONG_S = 1.5 * 3600.0
# Fewer lines than one for each decision.
MOST = 16
# The log of a healthy day: one line per decision, and one per mode.
ORDINARY = ("moving", "staying")


# So that hours of looks at rest are soon over; the lines do not depend on it.
SELDOM = Polling(idle_s=5.0)


async def flapping(rig):
    end_s = now(rig) + LONG_S
    while now(rig) < end_s:
        rig.unit.inject("a_overcurrent", now(rig))
        await asyncio.sleep(120)
        send_foreign_command(rig, Field.STATUS, wire.CLEAR)
        await asyncio.sleep(120)


async def unplugged(rig):
    rig.cables.positioner.link_up = False


async def deaf(rig):
    rig.unit.inject("deaf", now(rig))


async def undervoltage(rig):
    rig.unit.inject("undervoltage", now(rig))


async def stuck(rig):
    rig.unit.inject("a_hall_loss", now(rig))


async def storm_without_supply(rig):
    rig.unit.inject("undervoltage", now(rig))
    rig.wind_m_s = 20.0


async def tracking_by_itself(rig):
    rig.unit.inject("own_tracking", now(rig))
    await asyncio.sleep(1800)
    rig.motion.clear_faults()
    await asyncio.sleep(1800)
    rig.unit.inject("own_tracking", now(rig))


async def brown_out(rig):
    while rig.mode != "night":
        rig.unit.power_cycle(now(rig))
        await asyncio.sleep(600)


@pytest.mark.parametrize(
    "trouble",
    [unplugged, deaf, undervoltage, stuck, flapping, storm_without_supply, tracking_by_itself, brown_out],
    ids=lambda trouble: trouble.__name__,
)
def test_hours_of_trouble_with_the_positioner_are_logged_in_few_lines(run_rig, caplog, trouble):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion._polling = SELDOM
        caplog.clear()
        end_s = now(rig) + LONG_S
        try:
            async with asyncio.timeout(LONG_S):
                await trouble(rig)
        except TimeoutError:
            pass
        await asyncio.sleep(max(end_s - now(rig), 0))

    with caplog.at_level(logging.INFO):
        run_rig(scenario, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130, "fallback_after_s": 600})
    lines = [record.getMessage() for record in caplog.records if record.getMessage() not in ORDINARY]
    assert len(lines) <= MOST, "\n".join(lines)


def test_hours_of_refused_moves_are_logged_in_few_lines(run_rig, caplog, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion._polling = SELDOM
        lose_packets(rig, monkeypatch, A_PACKET, B_PACKET)
        sent = commands_sent(rig, monkeypatch)
        caplog.clear()
        await asyncio.sleep(LONG_S)
        assert len([data for _, data in sent if data[:2] == B_PACKET]) < 100

    with caplog.at_level(logging.INFO):
        run_rig(scenario, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130, "fallback_after_s": 600})
    lines = [record.getMessage() for record in caplog.records if record.getMessage() not in ORDINARY]
    assert len(lines) <= MOST, "\n".join(lines)
