import asyncio
import contextlib
import re
from functools import partial

import numpy as np
import pytest

from drivers.errors import ConnectError, DeadlineError, DeviceError, IdentityError, LinkLostError, ProtocolError
from drivers.lines.threaded import ThreadedLine
from drivers.lines.visa import VisaLine, VisaSettings
from drivers.load.agilent6063b import Agilent6063B
from drivers.load.chroma63600 import Chroma63600
from drivers.load.sweep import SweepSettings
from sim_drivers.pv_source import SourceLight
from solar.pv_module import Q_PEAK_G4_1_305, curve

MAKES = ["chroma63600", "agilent6063b"]
LEVELS = (36.0, 31.5, 10.0)
NUMBER = re.compile(rb"[+-]?\d+\.\d+(E[+-]\d\d)?")


def load_on(link, make="chroma63600", *, channel=1, deadline_s=5.0, least_v=3.0, settle_s=0.02):
    where = VisaSettings(f"ASRL{link}::INSTR", device="load", section="load")
    line = ThreadedLine("load", partial(VisaLine, where))
    settings = SweepSettings(settle_s, least_v, deadline_s)
    return Chroma63600(line, channel, settings) if make == "chroma63600" else Agilent6063B(line, settings)


def steps(*levels):
    return lambda _open_circuit_v: levels


def never():
    return None


@pytest.mark.parametrize("make", MAKES)
def test_the_load_driver_sends_the_bytes_and_reads_the_replies_of_the_transcript(transcript, play, tmp_path, make):
    pieces = transcript(f"load_{make}")
    player = play(pieces, tmp_path / "load")

    async def scene():
        load = load_on(tmp_path / "load", make, channel=3, deadline_s=5.0)
        identity = await load.open()
        swept = await load.sweep(steps(*LEVELS), never)
        await load.close()
        return identity, swept

    identity, swept = asyncio.run(scene())
    player.end()
    assert player.received == [piece.data for piece in pieces if piece.direction == ">"]
    assert "63600-5" in identity or "6063B" in identity
    assert swept.open_circuit_v == pytest.approx(37.866, abs=0.002)
    assert swept.voltage_v == pytest.approx((35.998, 31.501, 10.009), abs=0.01)
    assert swept.current_a == pytest.approx((3.312, 7.321, 7.917), abs=0.001)
    assert swept.stopped_why == ""


@pytest.mark.parametrize("make", MAKES)
def test_the_simulated_load_answers_as_in_the_transcript(transcript, load_host, make):
    async def scene():
        async with load_host(make, channel=3 if make == "chroma63600" else 1) as host:
            core, answered, expected = host.core, [], []
            core.scpi.clear()
            for piece in transcript(f"load_{make}"):
                if piece.direction == ">":
                    answered += [reply for _, reply in core.feed(piece.data, piece.time_s)]
                else:
                    expected.append(piece.data)
            return answered, expected

    answered, expected = asyncio.run(scene())
    assert [NUMBER.sub(b"#", reply) for reply in answered] == [NUMBER.sub(b"#", reply) for reply in expected]


@pytest.mark.parametrize("make", MAKES)
def test_a_sweep_measures_the_modules_curve_and_leaves_the_input_off(load_host, make):
    async def scene():
        async with load_host(make) as host:
            # Voltage and current belong to one point only once the voltage stands, on a busy machine too.
            load = load_on(host.port.link, make, settle_s=0.5)
            await load.open()
            swept = await load.sweep(lambda open_v: np.linspace(open_v - 0.5, 4.0, 15), never)
            assert not host.core.on
            await load.close()
            return swept

    swept = asyncio.run(scene())
    assert len(swept.voltage_v) == 15
    truth = curve(Q_PEAK_G4_1_305, 800.0, 40.0, np.array(swept.voltage_v))
    assert np.array(swept.current_a) == pytest.approx(truth, abs=0.1)


def test_the_settling_time_starts_only_when_the_load_has_taken_the_voltage(load_host):
    async def scene():
        async with load_host() as host:
            feed, taken_s = host.core.feed, [0.0]

            def feed_late(data, now):
                # Each voltage stays in a buffer for a while, and so does whatever comes after it.
                if data.startswith(b"VOLT:STAT:L1"):
                    taken_s[0] = now + 0.2
                return feed(data, max(now, taken_s[0]))

            host.core.feed = feed_late
            load = load_on(host.port.link, settle_s=0.05)
            await load.open()
            swept = await load.sweep(steps(*LEVELS), never)
            await load.close()
            return swept

    assert asyncio.run(scene()).voltage_v == pytest.approx(LEVELS, abs=0.02)


def test_a_load_that_answers_only_one_question_per_line_is_asked_one_at_a_time(load_host):
    async def scene():
        async with load_host(one_question=True) as host:
            load = load_on(host.port.link)
            await load.open()
            swept = await load.sweep(steps(*LEVELS), never)
            await load.close()
            return swept

    assert asyncio.run(scene()).current_a == pytest.approx((3.31, 7.32, 7.92), abs=0.03)


@pytest.mark.parametrize(
    ("identity", "make"),
    [
        ("KEITHLEY INSTRUMENTS INC.,MODEL 2000,1,A", "chroma63600"),
        ("CHROMA,62012P-80-60,1,1.0", "chroma63600"),
        ("CHROMA,63600-5,1,1.0", "agilent6063b"),
        ("HEWLETT-PACKARD,6060B,0,A", "agilent6063b"),
        ("nothing", "agilent6063b"),
    ],
)
def test_another_instrument_is_refused_before_anything_is_set(load_host, identity, make):
    async def scene():
        async with load_host(make) as host:
            host.core.identity = identity
            heard = []
            feed = host.core.feed
            host.core.feed = lambda data, now: (heard.append(data), feed(data, now))[1]
            load = load_on(host.port.link, make)
            with pytest.raises(IdentityError, match="which is not a"):
                await load.open()
            await load.close()
            return heard

    assert b"".join(asyncio.run(scene())) == b"\x03*IDN?\n"


def test_a_missing_load_channel_is_refused_with_its_number(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link, channel=2)
            with pytest.raises(ConnectError, match="has no channel 2"):
                await load.open()
            await load.close()

    asyncio.run(scene())


def test_a_reading_beyond_the_range_gives_no_point_of_the_curve(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link)
            await load.open()
            host.core.read = lambda _now: (9.9e37, 1.0)
            swept = await load.sweep(steps(*LEVELS), never)
            await load.close()
            return swept

    swept = asyncio.run(scene())
    assert swept.voltage_v == swept.current_a == ()
    assert np.isnan(swept.open_circuit_v)


@pytest.mark.parametrize("make", MAKES)
def test_a_protection_that_trips_ends_the_sweep_and_is_cleared_for_the_next(load_host, make):
    async def scene():
        async with load_host(make) as host:
            load = load_on(host.port.link, make)
            await load.open()
            calls = []

            def trip_at_the_second():
                calls.append(None)
                if len(calls) == 2:
                    host.core.trip("over-temperature")

            first = await load.sweep(steps(*LEVELS), trip_at_the_second)
            assert not host.core.on
            second = await load.sweep(steps(*LEVELS), never)
            await load.close()
            return first, second

    first, second = asyncio.run(scene())
    assert first.stopped_why.startswith("protection tripped: over-temperature")
    assert len(first.voltage_v) == 1
    assert second.stopped_why == ""
    assert len(second.voltage_v) == 3


def test_no_sweep_is_made_while_a_protection_cannot_be_cleared(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link)
            await load.open()
            host.core.latched = type("Stuck", (set,), {"clear": lambda self: None})({"over-temperature"})
            swept = await load.sweep(steps(*LEVELS), never)
            assert not host.core.on
            assert host.core.sweeps == 0
            await load.close()
            return swept

    assert asyncio.run(scene()).stopped_why == "protection is latched: over-temperature"


def test_a_voltage_below_the_minimum_ends_the_sweep(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link, least_v=12.0, settle_s=0.5)
            await load.open()
            swept = await load.sweep(steps(36.0, 20.0, 10.0, 5.0), never)
            await load.close()
            return swept, host.core.on

    swept, on = asyncio.run(scene())
    assert swept.voltage_v == pytest.approx((36.0, 20.0), abs=0.05)
    assert re.fullmatch(r"the voltage fell to \d+\.\d\d V, below 12 V", swept.stopped_why)
    assert not on


def test_a_sweep_ends_when_its_caller_gives_a_reason_to_stop(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link)
            await load.open()
            answers = iter([None, "a cloud came"])
            swept = await load.sweep(steps(*LEVELS), lambda: next(answers))
            await load.close()
            return swept, host.core.on

    swept, on = asyncio.run(scene())
    assert swept.stopped_why == "a cloud came"
    assert len(swept.voltage_v) == 1
    assert not on


class DefectError(Exception):
    pass


def test_the_input_is_off_after_the_caller_of_a_sweep_raised_an_exception(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link)
            await load.open()
            seen = []

            def fail():
                seen.append(host.core.on)
                if len(seen) == 2:
                    raise DefectError

            with pytest.raises(DefectError):
                await load.sweep(steps(*LEVELS), fail)
            assert seen == [False, True]
            assert not host.core.on
            assert len((await load.sweep(steps(*LEVELS), never)).voltage_v) == 3
            await load.close()

    asyncio.run(scene())


def test_the_input_is_off_after_a_sweep_was_cancelled(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link)
            await load.open()
            on = asyncio.Event()

            def watch():
                if host.core.on:
                    on.set()

            task = asyncio.create_task(load.sweep(steps(*[30.0] * 200), watch))
            await on.wait()
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
            assert not host.core.on
            await load.close()

    asyncio.run(scene())


@pytest.mark.parametrize("fault", ["drop", "delay", "corrupt", "level not taken"])
def test_a_missing_late_or_wrong_answer_ends_the_session_with_the_input_off(load_host, fault):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link, deadline_s=2.0)
            await load.open()
            calls = []

            def disturb():
                calls.append(None)
                if len(calls) == 2:
                    if fault == "delay":
                        host.delay_s = 5.0
                    elif fault == "drop":
                        host.core.drop_next()
                    elif fault == "corrupt":
                        # A letter in place of a digit.
                        host.core._emit = lambda text, due_s: [(due_s, b"1\n" if text == "1" else b"3x.5;1;0\n")]
                    else:
                        host.core._emit = lambda _text, due_s: [(due_s, b"0\n")]

            with pytest.raises((DeadlineError, ProtocolError)):
                await load.sweep(steps(*LEVELS), disturb)
            give_up_s = asyncio.get_running_loop().time() + 10.0
            while host.core.on:
                assert asyncio.get_running_loop().time() < give_up_s, "the input stayed on"
                await asyncio.sleep(0.01)
            with pytest.raises(LinkLostError, match="has to be opened first"):
                await load.sweep(steps(*LEVELS), never)

    asyncio.run(scene())


def test_a_late_reply_is_never_taken_for_the_next_one(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link, deadline_s=1.0)
            await load.open()
            host.delay_s = 2.0
            with pytest.raises(DeadlineError):
                await load.sweep(steps(*LEVELS), never)
            host.delay_s = 0.0
            host.core.source.now = SourceLight(400.0, 40.0)
            for _ in range(5):
                with contextlib.suppress(DeviceError):
                    await load.open()
                    break
            swept = await load.sweep(steps(20.0), never)
            assert swept.current_a[0] == pytest.approx(float(curve(Q_PEAK_G4_1_305, 400.0, 40.0, 20.0)), abs=0.03)
            await load.close()

    asyncio.run(scene())


def test_a_pulled_plug_is_a_lost_link_and_the_next_open_switches_the_input_off(load_host):
    async def scene():
        async with load_host() as host:
            load = load_on(host.port.link)
            await load.open()
            calls = []

            def pull():
                calls.append(None)
                if len(calls) == 2:
                    host.port.unplug()

            with pytest.raises((LinkLostError, DeadlineError)):
                await load.sweep(steps(*LEVELS), pull)
            assert host.core.on
            host.port.plug()
            await load.open()
            assert not host.core.on
            await load.close()

    asyncio.run(scene())


def test_a_silent_load_is_reported_with_what_to_check(load_host):
    async def scene():
        async with load_host() as host:
            host.freeze()
            load = load_on(host.port.link, deadline_s=0.2)
            with pytest.raises(ConnectError, match="is it on, and set to this interface"):
                await load.open()
            await load.close()

    asyncio.run(scene())


def test_a_load_that_was_left_on_by_a_dead_program_is_switched_off_at_once(load_host):
    async def scene():
        async with load_host() as host:
            host.core.feed(b"MODE CVH\nVOLT:STAT:L1 30\nLOAD ON\n", asyncio.get_running_loop().time())
            assert host.core.on
            load = load_on(host.port.link)
            await load.open()
            assert not host.core.on
            await load.close()

    asyncio.run(scene())
