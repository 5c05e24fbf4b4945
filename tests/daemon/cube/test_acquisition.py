"""The cube's role on simulated instruments: settling, self-test, qualities, rhythm."""

import asyncio
import logging
import re
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest

from daemon.base.clock import LoopClock
from daemon.base.records import Quality
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.cube.acquisition import Acquisition
from daemon.rigs.real import build_multiplexed_cube
from drivers.errors import LinkLostError
from drivers.meters.keithley2000 import Keithley2000
from drivers.switches.digital_port import DaqError
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.transports import InMemoryLine, InMemoryPort
from sim_drivers.voltmeter.core import VoltmeterCore

DAY, NIGHT = 30.0, -20.0


class Rig:
    """An acquisition whose instruments a test can reach; voltages [mV] by input."""

    def __init__(self, loop, settings, latency_s, sun_deg):
        self.mv = {0: 30.0, 1: 41.0, 2: 6.0, 3: 47.0, 7: 0.0}
        self.sun_deg = sun_deg
        self.on_input = lambda _channel: None
        self.switch = MultiplexerCore(inputs=self._input, latency_s=latency_s)
        self.core = VoltmeterCore(input_voltage=self.switch.output_voltage, random=np.random.default_rng(1))
        self.cables = SimpleNamespace(
            multiplexer=InMemoryPort(self.switch, loop.time), voltmeter=InMemoryLine("voltmeter", self.core, loop.time)
        )
        self.multiplexer = NiMultiplexer(self.cables.multiplexer)
        self.voltmeter = Keithley2000(self.cables.voltmeter)
        self.events = []
        self.scans, self.at, self.loop, self.scanned = [], [], loop, asyncio.Event()
        clock = LoopClock(loop.time, 1.7e9)
        self.acquisition = Acquisition(
            settings.cube,
            build_multiplexed_cube(settings, clock, self.multiplexer, self.voltmeter),
            clock,
            Random(1),
            self._keep,
            self.events.append,
            lambda _utc_s: self.sun_deg,
            simulated=True,
        )

    def _input(self, channel, _now):
        self.on_input(channel)
        found = self.mv.get(channel)
        return None if found is None else 1e-3 * found

    def _keep(self, scan):
        self.scans.append(scan)
        self.at.append(self.loop.time())
        self.scanned.set()

    @property
    def qualities(self):
        return [face.quality for face in self.scans[-1].faces]


@pytest.fixture
def run():
    def runs(scenario, *, settle_s=0.3, latency_s=0.0, sun_deg=DAY, **cube):
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            loop = runner.get_loop()
            multiplexer = {"settle_s": settle_s}
            settings = Settings.model_validate({"cube": cube, "instruments": {"multiplexer": multiplexer}})
            rig = Rig(loop, settings, latency_s, sun_deg)

            async def beside():
                working = asyncio.create_task(rig.acquisition.run())
                try:
                    # In virtual time an event that never comes is known at once.
                    async with asyncio.timeout(6000):
                        await scenario(rig)
                finally:
                    working.cancel()
                    await asyncio.gather(working, return_exceptions=True)

            runner.run(beside())
        return rig

    return runs


async def scans(rig, count):
    for _ in range(count):
        await rig.scanned.wait()
        rig.scanned.clear()


def test_a_conversion_begins_only_after_the_multiplexer_has_settled(run):
    begun = []

    async def scenario(rig):
        selected_s = rig.loop.time()
        write = rig.switch.write

        def noted(value, now):
            nonlocal selected_s
            selected_s = now
            write(value, now)

        rig.switch.write = noted
        rig.on_input = lambda _channel: begun.append(rig.loop.time() - selected_s)
        await scans(rig, 2)

    run(scenario, settle_s=0.3)
    assert len(begun) >= 8
    assert min(begun) >= 0.299


@pytest.mark.parametrize(("mv", "passes"), [(0.4, True), (0.6, False), (2.0, False), (-0.6, False), (5000.0, False)])
def test_the_self_test_fails_beyond_its_limit_in_millivolts_and_when_its_reading_fails(run, mv, passes):
    async def scenario(rig):
        rig.mv[7] = mv
        await scans(rig, 1)

    rig = run(scenario, self_test_channel=7, self_test_limit_mv=0.5)
    assert rig.qualities == [Quality.OK if passes else Quality.SELF_TEST_FAILED] * 4


def test_a_multiplexer_lost_during_the_last_reading_of_a_scan_spoils_that_scan(run):
    async def scenario(rig):
        await scans(rig, 1)

        def lose(channel):
            if channel == 3:
                rig.on_input = lambda _channel: None
                rig.switch.fail_next()

        rig.on_input = lose
        delivered = len(rig.scans)
        await asyncio.sleep(6)
        assert len(rig.scans) == delivered
        assert rig.acquisition.outage.is_down
        (event,) = rig.events
        assert event.subject == "cube"
        assert "multiplexer" in event.text

    run(scenario)


@pytest.mark.parametrize(
    ("mv", "quality"),
    [
        (-3.0, Quality.IMPLAUSIBLE),
        (-1.0, Quality.OK),
        (151.0, Quality.IMPLAUSIBLE),
        (149.0, Quality.OK),
        (2000.0, Quality.OVER_RANGE),
    ],
)
def test_a_voltage_that_no_light_can_give_is_implausible(run, mv, quality):
    async def scenario(rig):
        rig.mv[1] = mv
        await scans(rig, 1)

    assert run(scenario).qualities[1] is quality


def test_the_dark_offset_is_learnt_at_night_and_subtracted(run):
    async def scenario(rig):
        rig.mv |= dict.fromkeys(range(4), 0.2)
        await scans(rig, 900)
        rig.sun_deg = DAY
        rig.mv[0] = 30.2
        await scans(rig, 1)

    assert run(scenario, sun_deg=NIGHT).scans[-1].east.irradiance_w_m2 == pytest.approx(300.0, abs=0.3)


def test_no_dark_offset_is_learnt_when_the_dark_correction_is_off(run):
    async def scenario(rig):
        rig.mv |= dict.fromkeys(range(4), 0.2)
        await scans(rig, 300)

    rig = run(scenario, sun_deg=NIGHT, dark_correction=False)
    # With the correction, 1/e of these 2 W/m2 would be left.
    assert rig.scans[-1].east.irradiance_w_m2 == pytest.approx(2.0, abs=0.1)


def test_scans_are_numbered_from_0_in_one_session_and_the_cube_is_ready_with_the_first_scan(run):
    async def scenario(rig):
        began_s = rig.loop.time()
        assert not rig.acquisition.ready
        assert rig.acquisition.last_scan_s == began_s
        await scans(rig, 1)
        assert rig.acquisition.ready
        await scans(rig, 2)
        assert rig.acquisition.last_scan_s == rig.at[-1]
        rig.cables.voltmeter.link_up = False
        await asyncio.sleep(10)
        assert not rig.acquisition.ready

    rig = run(scenario)
    assert [scan.sequence for scan in rig.scans] == [0, 1, 2]
    (session,) = {scan.session for scan in rig.scans}
    assert re.fullmatch("[0-9a-f]{16}", session)
    assert {(scan.source, scan.simulated, scan.calibration) for scan in rig.scans} == {("cube", True, "")}


def test_the_opening_of_the_instruments_is_logged_once_and_each_loss_and_return_is_reported_once(run, caplog):
    async def scenario(rig):
        await scans(rig, 1)
        for _ in range(2):
            rig.cables.voltmeter.link_up = False
            await asyncio.sleep(30)
            rig.cables.voltmeter.link_up = True
            rig.scanned.clear()
            await scans(rig, 2)

    caplog.set_level(logging.INFO)
    rig = run(scenario)
    assert caplog.messages.count("instruments of the cube are open") == 1
    told = [event.text.split(":")[0] for event in rig.events]
    assert told == ["the cube is down", "the cube is back"] * 2


def test_an_acquisition_that_is_ended_closes_its_instruments(run):
    cables = run(lambda rig: scans(rig, 1)).cables
    with pytest.raises(DaqError, match="unplugged"):
        asyncio.run(cables.multiplexer.write(0))
    with pytest.raises(LinkLostError, match="has to be opened first"):
        asyncio.run(cables.voltmeter.send("*IDN?"))


def test_missed_scans_are_left_out_and_the_rhythm_stays(run):
    async def scenario(rig):
        await scans(rig, 2)
        rig.core.reply_delay_s = 1.4
        await scans(rig, 1)
        rig.core.reply_delay_s = 0.0
        await scans(rig, 5)

    rig = run(scenario)
    steps = np.diff(rig.at)
    assert rig.acquisition.skipped == 1
    assert steps[-3:] == pytest.approx(5.0, abs=0.01)
    assert min(steps) > 2.0


def test_a_sensor_of_exactly_0_v_at_night_is_not_frozen(run):
    async def scenario(rig):
        rig.voltmeter.read_voltage = lambda: asyncio.sleep(0.04, 0.0)
        await scans(rig, 12)
        assert rig.qualities == [Quality.OK] * 4
        rig.voltmeter.read_voltage = lambda: asyncio.sleep(0.04, 1e-5)
        await scans(rig, 12)
        assert rig.qualities == [Quality.STALE] * 4

    run(scenario, sun_deg=NIGHT)


@pytest.mark.parametrize("unplugged", [False, True], ids=["plugged", "unplugged"])
def test_the_multiplexer_is_not_touched_while_the_voltmeter_cannot_be_opened(run, unplugged):
    async def scenario(rig):
        await scans(rig, 1)
        rig.cables.voltmeter.link_up = False
        rig.cables.multiplexer.link_up = not unplugged
        # The scan that is on may still select an input before its reading shows the loss.
        await asyncio.sleep(30)
        open_port, write, touched = rig.cables.multiplexer.open, rig.switch.write, []
        rig.cables.multiplexer.open = lambda *lines: touched.append("open") or open_port(*lines)
        rig.switch.write = lambda *value: touched.append("write") or write(*value)
        await asyncio.sleep(600)
        assert "voltmeter" in rig.acquisition.outage.reason
        assert touched == []
        rig.cables.voltmeter.link_up = rig.cables.multiplexer.link_up = True
        rig.scanned.clear()
        await scans(rig, 1)
        assert touched[:2] == ["open", "write"]

    run(scenario)
