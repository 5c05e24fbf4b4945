"""The driver of the positioner on a line in memory to the simulated unit, under virtual time."""

import asyncio
import math

import pytest

from drivers.errors import ConnectError, IdentityError, LinkLostError, RefusedError
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.positioners.pozsol.wire import Field
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import AxisDrive, Setup
from sim_drivers.transports import InMemoryStream
from solar.frames import Angles
from tests.sim_drivers.transports.in_memory import virtually

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)


class Tracker:
    def __init__(self, now, **setup):
        self.now = now
        self.core = PositionerCore(now(), Setup(**setup))
        self.cable = InMemoryStream(self.core, now)
        self.positioner = PozsolPositioner(self.cable, now, A, B)

    async def rest(self):
        await asyncio.sleep(300.0)
        return self.core.truth(self.now())


def test_opening_returns_the_identity_of_the_positioner_and_that_it_is_simulated():
    async def scene(now):
        identity = await Tracker(now).positioner.open()
        assert identity.board == "36A1"
        assert identity.simulated
        assert identity.firmware
        assert len(identity.serial.split("-")) == 4

    virtually(scene)


def test_a_unit_with_another_board_is_not_opened():
    async def scene(now):
        tracker = Tracker(now)
        tracker.core.parameters[Field.BOARD] = "29C3"
        with pytest.raises(IdentityError, match="29C3"):
            await tracker.positioner.open()
        with pytest.raises(LinkLostError):
            await tracker.positioner.read_telemetry()

    virtually(scene)


def test_a_move_returns_once_the_unit_has_taken_both_targets():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        start = now()
        await tracker.positioner.move_to(-30.0, 45.0)
        assert 0.06 <= now() - start <= 0.3
        seen = await tracker.positioner.read_telemetry()
        assert seen.position_a != seen.destination_a
        assert await tracker.rest() == pytest.approx((-30.0, 45.0), abs=0.5)
        seen = await tracker.positioner.read_telemetry()
        assert (seen.a_deg, seen.b_deg) == pytest.approx((-30.0, 45.0), abs=0.5)
        assert seen.time_monotonic_s == now()
        assert (seen.faults, seen.supply_v, seen.details["mode"]) == ((), 24.0, "tracker ok")

    virtually(scene)


def test_telemetry_distinguishes_a_reference_run_from_a_move_and_names_its_end_switch():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        assert not (await tracker.positioner.read_telemetry()).aims_home
        await tracker.positioner.move_to(-30.0, 45.0)
        assert not (await tracker.positioner.read_telemetry()).aims_home
        await tracker.rest()
        await tracker.positioner.home("a")
        assert (await tracker.positioner.read_telemetry()).aims_home
        # The driver judges a reference run only when it is read.
        for _ in range(240):
            await asyncio.sleep(0.5)
            seen = await tracker.positioner.read_telemetry()
        assert (seen.homing, seen.aims_home, seen.details["end_switches"]) == (False, False, "a_low")
        assert abs(seen.details["a_count_at_switch"]) < 1.0

    virtually(scene)


@pytest.mark.parametrize("target", [(50.1, 45.0), (-50.1, 45.0), (0.0, 14.9), (0.0, 90.1), (math.nan, 45.0)])
def test_targets_outside_the_limits_are_refused_before_anything_is_sent(target):
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        before = tracker.core.screens(now())
        with pytest.raises(ValueError, match="limits"):
            await tracker.positioner.move_to(*target)
        assert tracker.core.screens(now()) == before

    virtually(scene)


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("a_overcurrent", "a_overcurrent"),
        ("b_cable", "b_cable"),
        ("undervoltage", "15 V"),
        ("own_tracking", "Micro tracking"),
        ("deaf", "no reason"),
    ],
)
def test_a_target_that_the_unit_silently_ignores_is_refused_with_its_likely_cause(fault, cause):
    async def scene(now):
        tracker = Tracker(now, own_target=lambda _now: Angles(5.0, 80.0))
        await tracker.positioner.open()
        tracker.core.inject(fault, now())
        start = now()
        with pytest.raises(RefusedError, match=cause):
            await tracker.positioner.move_to(-30.0, 45.0)
        assert now() - start < 1.3

    virtually(scene)


def test_stop_is_sent_at_once_and_the_move_it_interrupts_sends_no_more():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        moving = asyncio.create_task(tracker.positioner.move_to(-30.0, 45.0))
        await asyncio.sleep(0.03)
        before = now()
        await tracker.positioner.stop()
        assert now() == before
        with pytest.raises(RefusedError, match="stop"):
            await moving
        end = await tracker.rest()
        assert end == pytest.approx((0.0, 90.0), abs=0.1)

    virtually(scene)


def test_stop_in_the_middle_of_a_move_ends_it_on_the_ramp():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        await tracker.positioner.move_to(-30.0, 45.0)
        await asyncio.sleep(5.0)
        await tracker.positioner.stop()
        await asyncio.sleep(0.6)
        here = tracker.core.truth(now())
        assert -10.0 < here.a_deg < -1.0
        assert await tracker.rest() == here

    virtually(scene)


def test_a_stop_right_after_a_move_command_replaces_it():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        await tracker.positioner.move_to(-30.0, 45.0)
        moving = asyncio.create_task(tracker.positioner.move_to(30.0, 45.0))
        await asyncio.sleep(0)
        await tracker.positioner.stop()
        with pytest.raises(RefusedError):
            await moving
        assert (await tracker.rest()).a_deg == pytest.approx(0.0, abs=0.5)

    virtually(scene)


@pytest.mark.parametrize(("axis", "end"), [("a", (-52.0, 90.0)), ("b", (0.0, 13.0))])
def test_home_returns_once_telemetry_shows_the_run_and_the_axis_ends_at_its_low_switch(axis, end):
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        await tracker.positioner.home(axis)
        assert (await tracker.positioner.read_telemetry()).homing
        # It runs out past its switch by some tenths of a millimetre.
        assert await tracker.rest() == pytest.approx(end, abs=0.2)
        # It takes two readings to see that it stands.
        await tracker.positioner.read_telemetry()
        await asyncio.sleep(1.0)
        assert not (await tracker.positioner.read_telemetry()).homing
        await tracker.positioner.home(axis)
        tracker.core.inject("undervoltage", now())
        await tracker.positioner.home(axis)

    virtually(scene)


def test_homing_that_does_not_begin_is_refused():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        tracker.core.inject("undervoltage", now())
        with pytest.raises(RefusedError, match="15 V"):
            await tracker.positioner.home("a")

    virtually(scene)


def test_clearing_faults_clears_the_reset_mark_and_starts_nothing():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        await tracker.positioner.move_to(-30.0, 45.0)
        tracker.core.inject("a_overcurrent", now())
        assert (await tracker.positioner.read_telemetry()).faults == ("a_overcurrent",)
        await tracker.positioner.clear_faults()
        assert (await tracker.positioner.read_telemetry()).faults == ()
        assert (await tracker.rest()).a_deg == pytest.approx(0.0, abs=0.5)
        tracker.core.power_cycle(now())
        assert (await tracker.positioner.read_telemetry()).was_reset
        await tracker.positioner.clear_faults()
        assert not (await tracker.positioner.read_telemetry()).was_reset
        tracker.core.inject("a_cable", now())
        with pytest.raises(RefusedError, match="a_cable"):
            await tracker.positioner.clear_faults()

    virtually(scene)


def test_autonomy_is_switched_off_and_a_slave_in_standby_is_left_alone():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        for mode in ("own_tracking", "slave_mode"):
            tracker.core.inject(mode, now())
            assert (await tracker.positioner.read_telemetry()).autonomous
            for _ in range(2):
                await tracker.positioner.disable_autonomy()
                assert not (await tracker.positioner.read_telemetry()).autonomous
        tracker.core.inject("own_tracking", now())
        tracker.core.inject("deaf", now())
        with pytest.raises(RefusedError, match="tracking"):
            await tracker.positioner.disable_autonomy()

    virtually(scene)


def test_a_move_goes_on_with_the_link_pulled():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        await tracker.positioner.move_to(-30.0, 45.0)
        tracker.cable.link_up = False
        for use in (tracker.positioner.read_telemetry, tracker.positioner.stop, tracker.positioner.clear_faults):
            with pytest.raises(LinkLostError):
                await use()
        with pytest.raises(ConnectError):
            await tracker.positioner.open()
        assert await tracker.rest() == pytest.approx((-30.0, 45.0), abs=0.5)
        tracker.cable.link_up = True
        with pytest.raises(LinkLostError, match="opened first"):
            await tracker.positioner.read_telemetry()
        await tracker.positioner.open()
        await tracker.positioner.close()
        with pytest.raises(LinkLostError):
            await tracker.positioner.move_to(0.0, 90.0)

    virtually(scene)


def test_the_configured_drive_speed_determines_how_fast_the_axis_moves():
    async def scene(now):
        reached = []
        for speed in (1.6, 3.2):
            tracker = Tracker(now, drive=AxisDrive(speed_mm_s=speed))
            await tracker.positioner.open()
            await tracker.positioner.move_to(40.0, 90.0)
            await asyncio.sleep(20.0)
            reached.append(tracker.core.truth(now()).a_deg)
        assert reached[1] == pytest.approx(2.1 * reached[0], rel=0.1)

    virtually(scene)
