"""A stop holds whatever else goes on: a link that comes back, a fault of one axis, a clear, a reference run."""

import asyncio

import pytest

from daemon.base.records import Event, Target
from drivers.errors import DeviceError, RefusedError
from sim_drivers.pozsol.setup import Setup
from tests.support.motion import (
    A_PACKET,
    B_PACKET,
    STOP_PACKET,
    alarms,
    clear_blocking_faults,
    commands_sent,
    motion_duration_s,
    send_foreign_b_target,
)
from tests.support.phases import wait_for_long_rest, wait_for_move


@pytest.mark.parametrize("wish", ["stop", "stow", "hold", "goto"])
@pytest.mark.parametrize("after_s", [0.0, 0.03, 0.1, 0.3, 0.6])
def test_an_order_given_while_the_link_comes_back_is_carried_out_or_refused(run_rig, wish, after_s):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(5)
        opened = rig.positioner.open
        rig.positioner.open = lambda: (setattr(rig, "opened", True), opened())[1]
        rig.opened = False
        rig.cables.positioner.link_up = True
        await rig.until(lambda: rig.opened, 10, "the connection")
        await asyncio.sleep(after_s)
        try:
            if wish == "stop":
                await rig.control.stop("a person")
            elif wish == "goto":
                rig.control.goto(-10, 80, "there")
            else:
                getattr(rig.control, wish)("a person")
        except DeviceError:
            assert wish == "goto" or not rig.motion.connected
            return
        await asyncio.sleep(3)
        stands = rig.truth()
        await asyncio.sleep(120)
        if wish in ("stop", "hold"):
            assert rig.truth() == stands
        else:
            there = (0, 90) if wish == "stow" else (-10, 80)
            assert rig.truth() == (pytest.approx(there[0], abs=1), pytest.approx(there[1], abs=1))
        assert rig.motion.unexplained_motion is None

    run_rig(scenario)


def test_overcurrent_on_one_axis_stops_the_other(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(3)
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        assert await motion_duration_s(rig, 20) <= 2.0
        assert rig.motion.unexplained_motion is None
        assert "a_overcurrent" in alarms(rig)["positioner-fault"]

    run_rig(scenario, setup=Setup(synchronous=True))


def test_the_axis_that_waits_for_its_turn_does_not_start_when_the_other_one_fails(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        began = rig.truth()
        rig.motion.order(Target(40, 15, "far"))
        await rig.until(lambda: rig.truth().a_deg > began.a_deg + 2, 20, "A on its way")
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        await asyncio.sleep(60)
        assert began.a_deg + 2 < rig.truth().a_deg < began.a_deg + 5
        assert rig.truth().b_deg == began.b_deg
        assert rig.motion.unexplained_motion is None

    run_rig(scenario)


def test_a_fault_of_one_axis_at_rest_sends_a_stop_once(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        sent = commands_sent(rig, monkeypatch)
        rig.unit.inject("b_overcurrent", rig.clock.monotonic())
        await asyncio.sleep(2)
        assert any(data.startswith(STOP_PACKET) for _, data in sent)
        stops = len(sent)
        await asyncio.sleep(600)
        assert len(sent) == stops, "once is enough"

    run_rig(scenario)


def test_while_motion_is_frozen_orders_are_refused_and_axes_that_move_are_stopped(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        await rig.control.stop("Ann works there")
        assert await motion_duration_s(rig, 10) <= 2.0
        for call in (rig.motion.home, lambda: rig.motion.order(Target(0, 60, "test"), stow=True)):
            with pytest.raises(RefusedError, match="Ann works there"):
                call()
        send_foreign_b_target(rig, 85.0)
        assert await motion_duration_s(rig, 10) <= 2.0
        assert "against a stop (" in rig.motion.unexplained_motion
        assert "Ann works there" in rig.motion.unexplained_motion
        rig.control.auto()
        await clear_blocking_faults(rig)
        rig.motion.order(Target(0, 60, "test"))
        assert await motion_duration_s(rig, 3) > 0

    run_rig(scenario)


def test_freezing_sends_a_stop_even_to_axes_that_seem_to_stand(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        sent = commands_sent(rig, monkeypatch)
        rig.motion.freeze("Ann works there")
        assert rig.motion.stands_since_s is None
        await asyncio.sleep(5)
        assert any(data.startswith(b"$9s") for _, data in sent)
        assert rig.motion.stands_since_s is not None

    run_rig(scenario)


@pytest.mark.parametrize("busy", ["clear", "home", "queued home", "queued target"])
def test_a_stop_is_never_lost_in_a_clear_a_reference_run_or_a_queued_order(run_rig, busy):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.control.hold("so that control orders nothing")
        if busy == "clear":
            rig.unit.inject("a_overcurrent", rig.clock.monotonic())
            await asyncio.sleep(1)
            rig.motion.clear_faults()
            await asyncio.sleep(0.05)
        elif busy == "queued target":
            rig.motion.order(Target(0, 60, "test"))
        else:
            rig.motion.home()
            await asyncio.sleep(3 if busy == "home" else 0)
        await rig.motion.stop()
        asked_s = rig.clock.monotonic()
        await rig.until(lambda: (rig.motion.stands_since_s or 0) > asked_s - 30 and rig.motion.is_idle, 3, "rest")
        stands = rig.truth()
        await asyncio.sleep(300)
        assert rig.truth() == stands
        assert rig.motion.connected
        assert not any("lost" in event.text for event in rig.records_of(Event) if event.subject == "positioner")
        assert not rig.motion.homing

    run_rig(scenario)


def test_a_stow_sends_the_axis_first_that_lays_the_module_flat(run_rig, monkeypatch):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        sent = commands_sent(rig, monkeypatch)
        rig.control.stow("storm")
        await asyncio.sleep(5)
        targets = [data[:2] for _, data in sent if data[:2] in (A_PACKET, B_PACKET)]
        assert targets == [B_PACKET, A_PACKET]

    run_rig(scenario)
