import asyncio
import math

import numpy as np
import pytest

from daemon.base.timeloop import VirtualTimeLoop
from drivers.errors import (
    ConnectError,
    DeadlineError,
    IdentityError,
    LinkLostError,
    OverRangeError,
    ProtocolError,
    RefusedError,
)
from drivers.positioners.pozsol.wire import Field
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import AxisDrive, Setup
from sim_drivers.transports import InMemoryMultiplexer, InMemoryPositioner, InMemoryVoltmeter
from sim_drivers.voltmeter.core import VoltmeterCore
from solar.frames import Angles, Limits

VOLTS = (0.010, 0.020, 0.030, 0.040)


def virtually(scene):
    """Run a coroutine function, given the loop's time, in virtual time."""
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(scene(runner.get_loop().time))


class Cube:
    def __init__(self, now, inputs=lambda channel, _now: VOLTS[channel] if channel < 4 else None, **options):
        self.switch = MultiplexerCore(inputs)
        self.meter = VoltmeterCore(self.switch.output_voltage, np.random.default_rng(3))
        self.multiplexer = InMemoryMultiplexer(self.switch, now)
        self.voltmeter = InMemoryVoltmeter(self.meter, now, **options)

    async def open(self):
        return await self.multiplexer.open(), await self.voltmeter.open()

    async def read(self, channel):
        await self.multiplexer.select(channel)
        await asyncio.sleep(0.3)
        return await self.voltmeter.read_voltage()


def test_a_scan_reads_each_channel_in_its_physical_time():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        start = now()
        readings = [await cube.read(channel) for channel in range(4)]
        assert readings == pytest.approx(VOLTS, abs=5e-6)
        physical_s = 4 * (0.3 + 0.04)
        assert physical_s <= now() - start <= 1.02 * physical_s

    virtually(scene)


def test_two_runs_are_alike_to_the_last_digit():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        return [(await cube.read(i % 4), now()) for i in range(50)]

    assert virtually(scene) == virtually(scene)


def test_opening_identifies_configures_and_reads_the_configuration_back():
    async def scene(now):
        cube = Cube(now, range_v=0.1, nplc=10.0)
        switch, meter = await cube.open()
        assert "8 inputs" in switch
        assert "MODEL 2000" in meter
        settings = cube.meter.settings
        assert (settings.range_v, settings.nplc, settings.autorange, settings.continuous) == (0.1, 10.0, False, False)
        assert not settings.filter_on
        start = now()
        await cube.voltmeter.read_voltage()
        assert now() - start == pytest.approx(0.4)

    virtually(scene)


def test_a_meter_that_is_something_else_or_cannot_be_set_is_not_opened():
    async def scene(now):
        other = InMemoryVoltmeter(
            VoltmeterCore(lambda _now: 0.0, np.random.default_rng(1), identity="KEITHLEY,MODEL 2700,1,A01"), now
        )
        with pytest.raises(IdentityError, match="2700"):
            await other.open()
        with pytest.raises(ProtocolError, match="configuration"):
            await Cube(now, nplc=50.0).voltmeter.open()
        with pytest.raises(LinkLostError):
            await other.read_voltage()

    virtually(scene)


def test_a_silent_meter_cannot_be_opened():
    async def scene(now):
        cube = Cube(now)
        cube.meter.mute = True
        with pytest.raises(ConnectError, match="does not answer"):
            await cube.voltmeter.open()

    virtually(scene)


@pytest.mark.parametrize("volts", [1.3, -1.3, math.nan])
def test_a_voltage_beyond_the_range_is_an_error_and_never_a_number(volts):
    async def scene(now):
        cube = Cube(now, lambda _channel, _now: volts)
        await cube.open()
        with pytest.raises(OverRangeError):
            await cube.read(0)

    virtually(scene)


def test_a_late_reply_is_never_taken_for_that_of_another_channel():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        cube.meter.reply_delay_s = 2.5
        start = now()
        with pytest.raises(DeadlineError):
            await cube.read(0)
        assert now() - start == pytest.approx(2.302)
        cube.meter.reply_delay_s = 0.0
        assert await cube.read(1) == pytest.approx(VOLTS[1], abs=5e-6)
        assert await cube.read(2) == pytest.approx(VOLTS[2], abs=5e-6)

    virtually(scene)


def test_a_reading_that_was_given_up_half_way_does_not_spoil_the_next_one():
    async def scene(now):
        cube = Cube(now, nplc=10.0)
        await cube.open()
        await cube.multiplexer.select(0)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await cube.voltmeter.read_voltage()
        assert await cube.read(3) == pytest.approx(VOLTS[3], abs=5e-6)

    virtually(scene)


def test_a_lost_reply_costs_its_deadline_and_the_next_reading_is_good():
    async def scene(now):
        cube = Cube(now, deadline_s=1.0)
        await cube.open()
        cube.meter.drop_next()
        start = now()
        with pytest.raises(DeadlineError, match="1 s"):
            await cube.voltmeter.read_voltage()
        assert now() - start == pytest.approx(1.0)
        assert await cube.read(2) == pytest.approx(VOLTS[2], abs=5e-6)

    virtually(scene)


def test_a_garbled_reply_is_refused_and_the_next_reading_is_good():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        for _ in range(30):
            cube.meter.corrupt_next()
            with pytest.raises(ProtocolError):
                await cube.read(0)
            assert await cube.read(2) == pytest.approx(VOLTS[2], abs=5e-6)

    virtually(scene)


def test_a_meter_that_stays_silent_is_lost_at_the_second_question():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        cube.meter.mute = True
        with pytest.raises(DeadlineError):
            await cube.voltmeter.read_voltage()
        with pytest.raises(LinkLostError, match="silent"):
            await cube.voltmeter.read_voltage()
        cube.meter.mute = False
        with pytest.raises(LinkLostError):
            await cube.voltmeter.read_voltage()
        await cube.voltmeter.open()
        await cube.voltmeter.read_voltage()

    virtually(scene)


def test_a_restarted_meter_is_noticed_and_configured_anew_by_opening_it():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        cube.meter.power_cycle(now())
        with pytest.raises(DeadlineError):
            await cube.voltmeter.read_voltage()
        with pytest.raises(LinkLostError, match="restarted"):
            await cube.voltmeter.read_voltage()
        await cube.voltmeter.open()
        assert await cube.read(1) == pytest.approx(VOLTS[1], abs=5e-6)

    virtually(scene)


def test_a_meter_that_restarts_during_a_conversion_gives_no_reading():
    async def scene(now):
        cube = Cube(now, nplc=10.0)
        await cube.open()
        asyncio.get_running_loop().call_later(0.1, lambda: cube.meter.power_cycle(now()))
        with pytest.raises(DeadlineError):
            await cube.voltmeter.read_voltage()

    virtually(scene)


def test_pulled_cables_are_lost_until_they_are_plugged_in_and_opened_again():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        await cube.read(2)
        for instrument, use in (
            (cube.multiplexer, lambda: cube.multiplexer.select(1)),
            (cube.voltmeter, cube.voltmeter.read_voltage),
        ):
            instrument.link_up = False
            with pytest.raises(LinkLostError, match="unplugged"):
                await use()
            with pytest.raises(ConnectError):
                await instrument.open()
            instrument.link_up = True
            with pytest.raises(LinkLostError, match="opened first"):
                await use()
            await instrument.open()
            await use()

    virtually(scene)


def test_a_cable_pulled_during_an_exchange_is_noticed_in_it():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        loop = asyncio.get_running_loop()
        loop.call_later(0.01, setattr, cube.voltmeter, "link_up", False)
        with pytest.raises(LinkLostError):
            await cube.voltmeter.read_voltage()
        loop.call_later(0.001, setattr, cube.multiplexer, "link_up", False)
        with pytest.raises(LinkLostError):
            await cube.multiplexer.select(1)

    virtually(scene)


def test_without_its_usb_the_multiplexer_falls_back_to_its_last_input():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        await cube.multiplexer.select(2)
        cube.multiplexer.link_up = False
        assert cube.switch.selected(now()) == 7
        cube.multiplexer.link_up = True
        await cube.multiplexer.open()
        assert cube.switch.selected(now()) == 7

    virtually(scene)


def test_an_error_of_the_port_ends_the_session_and_names_its_number():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        cube.switch.fail_next(-200587)
        with pytest.raises(LinkLostError, match="-200587"):
            await cube.multiplexer.select(1)
        with pytest.raises(LinkLostError):
            await cube.multiplexer.select(1)
        await cube.multiplexer.open()
        await cube.multiplexer.select(1)
        with pytest.raises(RefusedError, match="0 to 7"):
            await cube.multiplexer.select(8)

    virtually(scene)


def test_an_enable_of_the_other_polarity_leaves_every_input_off():
    async def scene(now):
        switch = MultiplexerCore(lambda _channel, _now: 1.0, enable="active-low")
        wrong, right = InMemoryMultiplexer(switch, now), InMemoryMultiplexer(switch, now, enable_high=False)
        for host, expected in ((wrong, None), (right, 3)):
            await host.open()
            await host.select(3)
            assert switch.selected(now()) == expected

    virtually(scene)


class Tracker:
    def __init__(self, now, limits=Limits(), **setup):  # noqa: B008 - frozen
        self.now = now
        self.core = PositionerCore(now(), Setup(**setup))
        self.positioner = InMemoryPositioner(self.core, now, limits)

    async def rest(self):
        await asyncio.sleep(300.0)
        return self.core.truth(self.now())


def test_the_positioner_says_who_it_is_and_that_it_is_simulated():
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
        assert (seen.faults, seen.supply_v, seen.mode_text) == ((), 24.0, "tracker ok")

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
def test_a_silent_refusal_is_told_with_its_likely_cause(fault, cause):
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


def test_a_stop_right_after_a_command_takes_its_place():
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
def test_homing_returns_once_it_shows_and_ends_at_the_low_switch(axis, end):
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        await tracker.positioner.home(axis)
        assert (await tracker.positioner.read_telemetry()).homing
        # It runs out past its switch by some tenths of a millimetre.
        assert await tracker.rest() == pytest.approx(end, abs=0.2)
        # That it stands takes two looks.
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
        tracker.positioner.link_up = False
        for use in (tracker.positioner.read_telemetry, tracker.positioner.stop, tracker.positioner.clear_faults):
            with pytest.raises(LinkLostError):
                await use()
        with pytest.raises(ConnectError):
            await tracker.positioner.open()
        assert await tracker.rest() == pytest.approx((-30.0, 45.0), abs=0.5)
        tracker.positioner.link_up = True
        with pytest.raises(LinkLostError, match="opened first"):
            await tracker.positioner.read_telemetry()
        await tracker.positioner.open()
        await tracker.positioner.close()
        with pytest.raises(LinkLostError):
            await tracker.positioner.move_to(0.0, 90.0)

    virtually(scene)


def test_the_drive_of_the_setup_sets_the_pace():
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
