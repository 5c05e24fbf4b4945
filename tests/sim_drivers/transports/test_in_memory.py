"""The drivers of real instruments on lines in memory to simulated ones, under virtual time."""

import asyncio
import math
import re

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
from drivers.load.agilent6063b import Agilent6063B
from drivers.load.chroma63600 import Chroma63600
from drivers.load.sweep import SweepSettings
from drivers.meters.keithley2000 import Keithley2000
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.positioners.pozsol.wire import Field
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.load.core import LoadCore
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import AxisDrive, Setup
from sim_drivers.transports import InMemoryLine, InMemoryPort, InMemoryStream
from sim_drivers.voltmeter.core import VoltmeterCore
from solar.frames import Angles
from solar.pv_module import Q_PEAK_G4_1_305, curve
from tests.support.ports import Module

VOLTS = (0.010, 0.020, 0.030, 0.040)
NUMBER = re.compile(rb"[+-]?\d+\.\d+(E[+-]\d\d)?")
A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)


def virtually(scene):
    """Run a coroutine function, given the loop's time, in virtual time."""
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(scene(runner.get_loop().time))


class Cube:
    def __init__(self, now, inputs=lambda channel, _now: VOLTS[channel] if channel < 4 else None, **options):
        self.switch = MultiplexerCore(inputs)
        self.meter = VoltmeterCore(self.switch.output_voltage, np.random.default_rng(3))
        self.port = InMemoryPort(self.switch, now)
        self.line = InMemoryLine("voltmeter", self.meter, now)
        self.multiplexer = NiMultiplexer(self.port)
        self.voltmeter = Keithley2000(self.line, **options)

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
        assert switch == "simulated USB-6008 with the lines Dev1/port0/line0:2"
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
        core = VoltmeterCore(lambda _now: 0.0, np.random.default_rng(1), identity="KEITHLEY,MODEL 2700,1,A01")
        other = Keithley2000(InMemoryLine("voltmeter", core, now))
        with pytest.raises(IdentityError, match="2700"):
            await other.open()
        with pytest.raises(ProtocolError, match=r"did not take .*NPLC 50"):
            await Cube(now, nplc=50.0).voltmeter.open()
        with pytest.raises(LinkLostError):
            await other.read_voltage()

    virtually(scene)


def test_a_silent_meter_cannot_be_opened():
    async def scene(now):
        cube = Cube(now)
        cube.meter.mute = True
        with pytest.raises(ConnectError, match=r"did not answer .IDN.*is it on"):
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
            with pytest.raises((ProtocolError, DeadlineError)):
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
        for cable, instrument, use, gone in (
            (cube.port, cube.multiplexer, lambda: cube.multiplexer.select(1), r"unplugged \(-201003\)"),
            (cube.line, cube.voltmeter, cube.voltmeter.read_voltage, "is unplugged"),
        ):
            cable.link_up = False
            with pytest.raises(LinkLostError, match=gone):
                await use()
            with pytest.raises(ConnectError, match="plugged in"):
                await instrument.open()
            cable.link_up = True
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
        loop.call_later(0.01, setattr, cube.line, "link_up", False)
        with pytest.raises(LinkLostError):
            await cube.voltmeter.read_voltage()
        loop.call_later(0.001, setattr, cube.port, "link_up", False)
        with pytest.raises(LinkLostError):
            await cube.multiplexer.select(1)

    virtually(scene)


def test_without_its_usb_the_multiplexer_falls_back_to_its_last_input():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        await cube.multiplexer.select(2)
        cube.port.link_up = False
        assert cube.switch.selected(now()) == 7
        cube.port.link_up = True
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


def test_the_enable_line_of_the_configuration_is_that_of_the_switch():
    async def scene(now):
        switch = MultiplexerCore(lambda _channel, _now: 1.0, enable="active-low")
        for level, expected in ((True, None), (False, 3)):
            multiplexer = NiMultiplexer(InMemoryPort(switch, now), enable_line=3, enable_level=level)
            await multiplexer.open()
            await multiplexer.select(3)
            await asyncio.sleep(0.01)
            assert switch.selected(now()) == expected
        with pytest.raises(ConnectError, match=r"line0:4 cannot be used: the port has the lines 0 to 3 \(-200170\)"):
            await NiMultiplexer(InMemoryPort(switch, now), enable_line=4).open()

    virtually(scene)


class Recorded:
    """A core, and what goes over its line."""

    def __init__(self, core):
        self._core = core
        self.sent, self.answered = [], []

    def __getattr__(self, name):
        return getattr(self._core, name)

    def feed(self, data, now):
        self.sent.append(data)
        replies = self._core.feed(data, now)
        self.answered += [reply for _, reply in replies]
        return replies


def assert_same(core, pieces):
    assert core.sent == [piece.data for piece in pieces if piece.direction == ">"]
    expected = [piece.data for piece in pieces if piece.direction == "<"]
    assert [NUMBER.sub(b"#", reply) for reply in core.answered] == [NUMBER.sub(b"#", reply) for reply in expected]


def test_the_voltmeters_line_carries_what_its_port_does(transcript):
    async def scene(now):
        core = Recorded(VoltmeterCore(lambda _now: 0.0123, np.random.default_rng(3)))
        meter = Keithley2000(InMemoryLine("voltmeter", core, now))
        await meter.open()
        assert [await meter.read_voltage() for _ in range(2)] == pytest.approx([0.0123, 0.0123], abs=5e-6)
        await meter.close()
        assert_same(core, transcript("voltmeter"))

    virtually(scene)


@pytest.mark.parametrize("make", ["chroma63600", "agilent6063b"])
def test_the_loads_line_carries_what_its_port_does(transcript, make):
    async def scene(now):
        channel = 3 if make == "chroma63600" else 1
        core = Recorded(LoadCore(Module(), np.random.default_rng(3), make=make, channel=channel))
        core.scpi.clear()
        line, how = InMemoryLine("load", core, now), SweepSettings(0.02)
        load = Chroma63600(line, 3, how) if make == "chroma63600" else Agilent6063B(line, how)
        await load.open()
        swept = await load.sweep(lambda _open_circuit_v: (36.0, 31.5, 10.0), lambda: None)
        await load.close()
        truth = curve(Q_PEAK_G4_1_305, 800.0, 40.0, np.array(swept.voltage_v))
        assert swept.current_a == pytest.approx(truth, abs=0.04)
        assert_same(core, transcript(f"load_{make}"))

    virtually(scene)


def test_the_multiplexers_port_takes_the_same_values(transcript):
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        written, write = [], cube.switch.write
        cube.switch.write = lambda value, at: (written.append(value), write(value, at))
        for channel in range(8):
            await cube.multiplexer.select(channel)
        assert written == [int(piece.data) for piece in transcript("multiplexer")]

    virtually(scene)


def test_a_sweep_that_is_cancelled_leaves_the_input_off_and_the_line_closed():
    async def scene(now):
        core = LoadCore(Module(), np.random.default_rng(3))
        load = Chroma63600(InMemoryLine("load", core, now), 1, SweepSettings())
        await load.open()
        for moment_s in (0.061, 0.1, 0.113):
            sweep = asyncio.create_task(load.sweep(lambda _open_circuit_v: [30.0] * 50, lambda: None))
            await asyncio.sleep(moment_s)
            assert core.on
            sweep.cancel()
            with pytest.raises(asyncio.CancelledError):
                await sweep
            assert not core.on
            await load.open()

    virtually(scene)


def test_a_load_that_is_unplugged_during_a_sweep_is_switched_off_by_the_next_opening():
    async def scene(now):
        core = LoadCore(Module(), np.random.default_rng(3))
        line = InMemoryLine("load", core, now)
        load = Chroma63600(line, 1, SweepSettings())
        await load.open()
        asyncio.get_running_loop().call_later(0.5, setattr, line, "link_up", False)
        with pytest.raises(LinkLostError, match="is unplugged"):
            await load.sweep(lambda _open_circuit_v: [30.0] * 50, lambda: None)
        assert core.on
        line.link_up = True
        await load.open()
        assert not core.on

    virtually(scene)


class Tracker:
    def __init__(self, now, **setup):
        self.now = now
        self.core = PositionerCore(now(), Setup(**setup))
        self.cable = InMemoryStream(self.core, now)
        self.positioner = PozsolPositioner(self.cable, now, A, B)

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
        assert (seen.faults, seen.supply_v, seen.details["mode"]) == ((), 24.0, "tracker ok")

    virtually(scene)


def test_the_destination_of_a_reference_run_is_told_from_that_of_a_move_and_its_switch_is_named():
    async def scene(now):
        tracker = Tracker(now)
        await tracker.positioner.open()
        assert not (await tracker.positioner.read_telemetry()).aims_home
        await tracker.positioner.move_to(-30.0, 45.0)
        assert not (await tracker.positioner.read_telemetry()).aims_home
        await tracker.rest()
        await tracker.positioner.home("a")
        assert (await tracker.positioner.read_telemetry()).aims_home
        # The driver judges a run by its looks.
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
