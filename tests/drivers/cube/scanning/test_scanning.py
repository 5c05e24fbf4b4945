"""Scanning meters as a cube, on simulated ones in virtual time."""

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest

from daemon.base.timeloop import VirtualTimeLoop
from drivers.cube.scanning.dialects import DIALECTS
from drivers.cube.scanning.driver import ScanningMeterSettings, build
from drivers.cube.scanning.meter import DEVICE
from drivers.errors import ConnectError, IdentityError, LinkLostError, ProtocolError
from drivers.settings import CubeSurroundings
from sim_drivers.scanner.core import ScannerCore
from sim_drivers.scanner.instrument import NO_CARD
from sim_drivers.transports import InMemoryLine

SENSORS_V = (0.010, 0.025, 0.005, 0.060)
EPOCH_S = 1.7e9


class Bench:
    """A driver on a simulated meter, with a sensor at each of its channels."""

    def __init__(self, loop, meter, **settings):
        self.settings = ScanningMeterSettings(driver="scanning-meter", meter=meter, **settings)
        self.channels = self.settings.channels or DIALECTS[meter].channels
        self.volts = dict(zip(self.channels, SENSORS_V, strict=True))
        self.core = ScannerCore(meter, lambda channel, _now: self.volts.get(channel), np.random.default_rng(1))
        self.line = InMemoryLine(DEVICE, self.core, loop.time)
        self.now = loop.time
        self.around = CubeSurroundings(
            utc_s=lambda: EPOCH_S + loop.time(), monotonic_s=loop.time, deadline_s=1.0, switched_meter=None
        )
        self.cube = build(self.settings, self.around, self.line)


@pytest.fixture
def run():
    def outer(meter, act, **settings):
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            bench = Bench(runner.get_loop(), meter, **settings)

            async def inner():
                try:
                    return await act(bench)
                finally:
                    await bench.cube.close()

            return runner.run(inner())

    return outer


every_make = pytest.mark.parametrize("meter", DIALECTS)


@every_make
def test_one_trigger_reads_four_channels_and_stamps_each(run, meter):
    async def act(bench):
        identity = await bench.cube.open()
        begin_s = bench.now()
        reading = await bench.cube.read()
        took_s = bench.now() - begin_s
        assert [face.value for face in reading.faces] == pytest.approx(SENSORS_V, abs=3e-6)
        assert reading.unit == "V"
        assert {face.flaw for face in reading.faces} == {None}
        stamps = [face.time_monotonic_s - begin_s for face in reading.faces]
        assert stamps == pytest.approx([took_s * share for share in (0.125, 0.375, 0.625, 0.875)])
        assert [face.time_utc_s - EPOCH_S - begin_s for face in reading.faces] == pytest.approx(stamps, abs=1e-6)
        # Four conversions of one mains period with autozero, and the relays' switching.
        assert 0.1 < took_s < 0.4
        return identity

    assert run(meter, act).startswith("KEITHLEY" if "agilent" not in meter else "HEWLETT")


@every_make
def test_a_reading_begins_only_after_it_was_requested(run, meter):
    async def act(bench):
        await bench.cube.open()
        await bench.cube.read()
        bench.volts = dict.fromkeys(bench.channels, 0.001)
        after = await bench.cube.read()
        assert [face.value for face in after.faces] == pytest.approx([0.001] * 4, abs=3e-6)

    run(meter, act)


def test_channels_in_any_order_go_to_their_faces(run):
    async def act(bench):
        await bench.cube.open()
        reading = await bench.cube.read()
        assert [face.value for face in reading.faces] == pytest.approx(SENSORS_V, abs=3e-6)
        # This make scans in ascending order, and the stamps follow that order.
        order = sorted(range(4), key=lambda face: reading.faces[face].time_monotonic_s)
        assert order == [1, 3, 0, 2]

    run("agilent34970a", act, channels=[105, 101, 110, 103])


@every_make
def test_an_irradiance_of_1500_w_m2_at_the_edge_of_a_cloud_is_read(run, meter):
    async def act(bench):
        await bench.cube.open()
        # 1500 W/m2.
        bench.volts[bench.channels[1]] = 0.15
        reading = await bench.cube.read()
        assert (reading.south.value, reading.south.flaw) == (pytest.approx(0.15, abs=1e-5), None)

    run(meter, act)


@every_make
@pytest.mark.parametrize("volts", [1.3, -5.0, 200.0])
def test_an_overload_flaws_its_face_alone(run, meter, volts):
    async def act(bench):
        await bench.cube.open()
        bench.volts[bench.channels[2]] = volts
        reading = await bench.cube.read()
        assert [face.flaw for face in reading.faces] == [None, None, "over-range", None]
        assert math.isnan(reading.west.value)

    run(meter, act)


@every_make
def test_a_meter_without_a_card_is_refused_in_a_sentence(run, meter):
    async def act(bench):
        bench.core.card = ""
        with pytest.raises(IdentityError) as caught:
            await bench.cube.open()
        return caught.value.message

    sentence = run(meter, act)
    if meter == "keithley2000-scan":
        assert sentence == (
            'did not take :ROUT:SCAN (@1,2,3,4): -241,"Hardware missing"; does it have a scanner card with'
            " these channels?"
        )
    else:
        said = f"answers {NO_CARD[meter]!r} for" if meter in NO_CARD else "has no card in"
        channel = DIALECTS[meter].channels[0]
        assert sentence.startswith(f"{said} slot 1, where instruments.cube.channels has channel ")
        assert sentence.endswith(
            f"{'10' if channel > 100 else ''}4: a multiplexer card that switches DC voltages is needed there"
        )


@pytest.mark.parametrize(
    ("meter", "card"),
    [
        ("agilent34970a", "HEWLETT-PACKARD,34903A,0,1.0"),
        ("daq6510", "7705,40Ch Control Module,0.0.0a,1"),
        ("dmm6500", "0.0.0"),
    ],
)
def test_a_wrong_card_is_refused_in_a_sentence(run, meter, card):
    async def act(bench):
        bench.core.card = card
        with pytest.raises(IdentityError, match="a multiplexer card that switches DC voltages is needed there"):
            await bench.cube.open()

    run(meter, act)


def test_channels_that_the_card_does_not_have_are_refused_in_a_sentence(run):
    async def act(bench):
        with pytest.raises((IdentityError, ProtocolError), match="did not take"):
            await bench.cube.open()

    for meter, channels in (("keithley2000-scan", [1, 2, 3, 11]), ("agilent34970a", [101, 102, 103, 140])):
        run(meter, act, channels=channels)


@every_make
def test_another_instrument_is_refused(run, meter):
    async def act(bench):
        bench.core.identity = "ACME,MODEL 1,0,0"
        with pytest.raises(IdentityError, match=f"which is no {DIALECTS[meter].name.split(' ')[0]}"):
            await bench.cube.open()

    run(meter, act)


@every_make
def test_a_late_reply_is_never_taken_for_the_next_scan(run, meter):
    async def act(bench):
        await bench.cube.open()
        bench.core.reply_delay_s = 4.5
        late = await bench.cube.read()
        assert {face.flaw for face in late.faces} == {"late"}
        interrupted, interrupt = [], bench.line.interrupt

        async def counted():
            interrupted.append(bench.now())
            await interrupt()

        bench.line.interrupt = counted
        bench.core.reply_delay_s = 0.0
        bench.volts = dict.fromkeys(bench.channels, 0.002)
        after = await bench.cube.read()
        assert [face.value for face in after.faces] == pytest.approx([0.002] * 4, abs=3e-6)
        assert len(interrupted) == 1, "it is told to drop what it had to say"

    run(meter, act)


@every_make
def test_a_meter_restart_between_two_scans_is_a_lost_link_and_reopening_repairs_it(run, meter):
    async def act(bench):
        await bench.cube.open()
        bench.core.power_cycle(bench.now())
        flawed = None
        for _ in range(3):
            try:
                flawed = await bench.cube.read()
            except LinkLostError:
                break
            # A reading before the loss is noticed is flawed.
            assert {face.flaw for face in flawed.faces} <= {"late", "missing"}
        else:
            pytest.fail("it was never noticed")
        await bench.cube.open()
        reading = await bench.cube.read()
        assert {face.flaw for face in reading.faces} == {None}

    run(meter, act)


@pytest.mark.parametrize("meter", ["keithley2000-scan", "agilent34970a"])
def test_a_trigger_source_changed_at_the_meter_ends_the_readings_and_reopening_repairs_it(run, meter):
    async def act(bench):
        await bench.cube.open()
        bench.core.change(bench.now(), trigger_source="EXT")
        assert {face.flaw for face in (await bench.cube.read()).faces} == {"late"}
        with pytest.raises(LinkLostError, match=r"TRIG:SOUR\? is answered by EXT, not IMM"):
            await bench.cube.read()
        await bench.cube.open()
        assert {face.flaw for face in (await bench.cube.read()).faces} == {None}

    run(meter, act)


@every_make
def test_a_range_changed_at_the_meter_ends_the_readings_within_20_scans(run, meter):
    async def act(bench):
        await bench.cube.open()
        bench.core.press_range(10.0, bench.now())
        with pytest.raises(LinkLostError, match=r"RANG\?.* is answered by"):
            await read_often(bench.cube)
        await bench.cube.open()
        await read_often(bench.cube)

    run(meter, act)


@pytest.mark.parametrize(
    ("meter", "pressed", "question"),
    [
        ("keithley2000-scan", {"reference_v": 0.01, "reference_on": True}, r"REF:STAT\?"),
        ("keithley2000-scan", {"math_factor": 100.0, "math_on": True}, r"CALC1:STAT\?"),
        ("agilent34970a", {"math_factor": 100.0, "math_on": True}, r"CALC:SCAL:STAT\?.*"),
    ],
)
def test_a_reference_or_math_setting_made_at_the_meter_ends_the_readings_within_20_scans(run, meter, pressed, question):
    async def act(bench):
        await bench.cube.open()
        bench.core.change(bench.now(), **pressed)
        with pytest.raises(LinkLostError, match=f"{question} is answered by"):
            await read_often(bench.cube)
        await bench.cube.open()
        await read_often(bench.cube)

    run(meter, act)


async def read_often(cube):
    for _ in range(20):
        await cube.read()


@every_make
def test_a_garbled_reply_gives_no_wrong_value_and_the_next_scan_has_no_flaw(run, meter):
    async def act(bench):
        await bench.cube.open()
        for _ in range(20):
            bench.core.corrupt_next()
            reading = await bench.cube.read()
            for face, truth in zip(reading.faces, SENSORS_V, strict=True):
                # A flipped bit that turns a digit into a letter spoils the number; it never makes another number.
                assert face.flaw is not None or face.value == pytest.approx(truth, abs=3e-6)
            reading = await bench.cube.read()
            assert {face.flaw for face in reading.faces} == {None}

    run(meter, act)


@every_make
def test_an_unplugged_cable_is_a_lost_link_and_the_meter_is_read_again_after_reopening(run, meter):
    async def act(bench):
        await bench.cube.open()
        bench.line.link_up = False
        with pytest.raises(LinkLostError):
            await bench.cube.read()
        with pytest.raises(ConnectError):
            await bench.cube.open()
        bench.line.link_up = True
        await bench.cube.open()
        assert (await bench.cube.read()).east.flaw is None

    run(meter, act)


def test_a_scan_of_four_faces_may_take_four_times_the_deadline_of_one_answer(run):
    async def act(bench):
        cube = build(bench.settings, replace(bench.around, deadline_s=0.5), bench.line)
        await cube.open()
        bench.core.reply_delay_s = 1.5
        assert {face.flaw for face in (await cube.read()).faces} == {None}
        bench.core.reply_delay_s = 2.5
        begin_s = bench.now()
        assert {face.flaw for face in (await cube.read()).faces} == {"late"}
        assert bench.now() - begin_s == pytest.approx(2.0, abs=0.1)
        await cube.close()

    run("daq6510", act)


@pytest.mark.parametrize(("channels", "found"), [(None, 0), ((1, 2, 3, 4), 0), ((1, 2, 3, 1), 1)])
def test_a_channel_given_twice_is_a_conflict_and_omitted_channels_are_none(channels, found):
    assert len(list(ScanningMeterSettings(driver="scanning-meter", channels=channels).conflicts())) == found
