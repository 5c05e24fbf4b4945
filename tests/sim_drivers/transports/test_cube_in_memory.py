"""Drivers of voltmeter and multiplexer on lines in memory, under virtual time: no reading is from another channel."""

import asyncio
import math

import numpy as np
import pytest

from drivers.errors import (
    ConnectError,
    DeadlineError,
    IdentityError,
    LinkLostError,
    OverRangeError,
    ProtocolError,
    RefusedError,
)
from drivers.meters.keithley2000 import Keithley2000
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.transports import InMemoryLine, InMemoryPort
from sim_drivers.voltmeter.core import VoltmeterCore
from tests.sim_drivers.transports.in_memory import VOLTS, Cube, virtually


def test_a_scan_reads_four_channels_in_the_time_of_settling_and_conversion():
    async def scene(now):
        cube = Cube(now)
        await cube.open()
        start = now()
        readings = [await cube.read(channel) for channel in range(4)]
        assert readings == pytest.approx(VOLTS, abs=5e-6)
        physical_s = 4 * (0.3 + 0.04)
        assert physical_s <= now() - start <= 1.02 * physical_s

    virtually(scene)


def test_two_runs_of_the_simulated_cube_are_identical_to_the_last_digit():
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


def test_a_meter_of_another_model_or_one_that_rejects_its_settings_is_not_opened():
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


def test_the_multiplexer_falls_back_to_input_7_when_its_usb_is_unplugged():
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


def test_a_multiplexer_port_error_ends_the_session_and_is_reported_with_its_number():
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


def test_the_multiplexer_selects_an_input_only_with_the_right_enable_level_and_an_existing_line():
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
