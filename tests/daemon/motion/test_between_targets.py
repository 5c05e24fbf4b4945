"""What comes in the 0.15 s between the target of A and that of B: a stop, a lost link, a sleep of the machine."""

import asyncio

import pytest

from tests.daemon.tracker.days import operator
from tests.support.motion import A_PACKET, STOP_PACKET, commands_sent, target_packets
from tests.support.phases import wait_for_rest, wait_for_tracking


async def between(rig, monkeypatch):
    """Give a goto, and return when A has its target and B has not: with the packets sent since, and the goto's task."""
    await wait_for_tracking(rig)
    await wait_for_rest(rig)
    sent = commands_sent(rig, monkeypatch)
    giving = asyncio.create_task(operator(rig).goto(40, 30, "test"))
    await rig.until(lambda: target_packets(sent), 10.0, "the target of A", every_s=0.02)
    (target,) = target_packets(sent)
    assert target.startswith(A_PACKET)
    return sent, giving


async def stop(rig):
    await operator(rig).stop("test", "ana")


async def hang(rig):
    rig.cables.positioner.silent = True


async def sleep(rig):
    rig.clock.slept_s += 3600.0


@pytest.mark.parametrize(("what", "ends_s"), [(stop, 0.6), (hang, 3.2), (sleep, 1.5)])
def test_a_stop_a_lost_link_or_a_sleep_between_the_targets_of_a_and_b_stops_both_axes(
    run_rig, monkeypatch, what, ends_s
):
    async def scenario(rig):
        sent, giving = await between(rig, monkeypatch)
        await what(rig)
        await asyncio.wait((giving,))
        await asyncio.sleep(ends_s)
        stands = rig.truth()
        await asyncio.sleep(60.0)
        assert rig.truth() == stands
        assert sent[-1][1].startswith(STOP_PACKET)
        # A driver does not notice a sleep: its second target goes out, and the stop soon after it.
        assert len(target_packets(sent)) == (1 if what is stop else 2)

    run_rig(scenario)
