import asyncio
import contextlib
import re
import time
from functools import partial

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
)
from drivers.lines.threaded import ThreadedLine
from drivers.lines.visa import VisaLine, VisaSettings
from drivers.meters.keithley2000 import Keithley2000, require_model
from sim_drivers.transports import InMemoryLine
from sim_drivers.voltmeter.core import VoltmeterCore
from tests.support.prologix import Prologix

PRESSED = [
    {"filter_on": True},
    {"range_v": 10.0},
    {"nplc": 0.1},
    {"function": "RES"},
    {"reference_v": 0.01, "reference_on": True},
    {"math_factor": 10.0, "math_on": True},
]
READING = re.compile(rb"[+-]\d\.\d{8}E[+-]\d\d\n")


def visa(settings):
    return ThreadedLine("voltmeter", partial(VisaLine, settings))


def meter_on(link, *, terminator="LF", **options):
    settings = VisaSettings(f"ASRL{link}::INSTR", terminator=terminator)
    return Keithley2000(visa(settings), deadline_s=options.pop("deadline_s", 5.0), **options)


def test_the_voltmeter_driver_sends_the_bytes_and_reads_the_replies_of_the_transcript(transcript, play, tmp_path):
    pieces = transcript("voltmeter")
    player = play(pieces, tmp_path / "voltmeter")

    async def scene():
        meter = meter_on(tmp_path / "voltmeter", deadline_s=5.0)
        identity = await meter.open()
        readings = [await meter.read_voltage(), await meter.read_voltage()]
        await meter.close()
        return identity, readings

    identity, readings = asyncio.run(scene())
    player.end()
    assert player.received == [piece.data for piece in pieces if piece.direction == ">"]
    assert identity == "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02"
    assert readings == [0.0123000591, 0.0122998847]


def test_the_simulated_voltmeter_answers_as_in_the_transcript(transcript):
    core = VoltmeterCore(lambda _now: 0.0123, np.random.default_rng(3))
    expected, answered = [], []
    for piece in transcript("voltmeter"):
        if piece.direction == ">":
            answered += [reply for _, reply in core.feed(piece.data, piece.time_s)]
        else:
            expected.append(piece.data)
    assert len(answered) == len(expected)
    for answer, wanted in zip(answered, expected, strict=True):
        assert answer == wanted or (READING.fullmatch(answer) and READING.fullmatch(wanted))


@pytest.mark.parametrize("terminator", ["LF", "CR", "LFCR"])
def test_each_line_ending_of_the_front_panel_works(voltmeter_host, terminator):
    async def scene():
        async with voltmeter_host(terminator=terminator) as host:
            meter = meter_on(host.port.link, terminator=terminator)
            await meter.open()
            assert await meter.read_voltage() == pytest.approx(0.0123, abs=5e-6)
            await meter.close()

    asyncio.run(scene())


def test_a_reply_that_comes_after_its_deadline_is_never_taken_for_the_next_one(voltmeter_host):
    async def scene():
        volts = [0.010]
        async with voltmeter_host() as host:
            host.core._converter._input_voltage = lambda _now: volts[0]
            meter = meter_on(host.port.link, deadline_s=2.0)
            await meter.open()
            for _ in range(2):
                volts[0] = 0.010
                host.delay_s = 3.6
                with pytest.raises(DeadlineError, match="READ"):
                    await meter.read_voltage()
                host.delay_s = 0.0
                volts[0] = 0.020
                assert await meter.read_voltage() == pytest.approx(0.020, abs=1e-5)
            await meter.close()

    asyncio.run(scene())


@pytest.mark.parametrize("volts", [1.3, -1.3, float("nan")])
def test_a_voltage_beyond_the_range_is_an_error_and_never_a_number(voltmeter_host, volts):
    async def scene():
        async with voltmeter_host(volts) as host:
            meter = meter_on(host.port.link)
            await meter.open()
            with pytest.raises(OverRangeError):
                await meter.read_voltage()
            await meter.close()

    asyncio.run(scene())


class Telling(InMemoryLine):
    """The line of a meter whose conversions a test writes."""

    told = ""

    async def receive(self, within_s):
        reply = await super().receive(within_s)
        return self.told if READING.fullmatch(f"{reply}\n".encode()) else reply


@pytest.mark.computes
@pytest.mark.parametrize("told", ["+1.2201E+00", "-1.2201E+00", "+9.9E37", "-9.9E37"])
def test_a_reading_beyond_120_percent_of_the_range_is_refused_as_over_range(told):
    async def scene():
        core = VoltmeterCore(lambda _now: 0.0123, np.random.default_rng(3))
        line = Telling("voltmeter", core, asyncio.get_running_loop().time)
        meter = Keithley2000(line, range_v=1.0)
        await meter.open()
        line.told = "+1.1999E+00"
        assert await meter.read_voltage() == 1.1999
        line.told = told
        with pytest.raises(OverRangeError, match="beyond the 1 V range"):
            await meter.read_voltage()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


@pytest.mark.computes
@pytest.mark.parametrize("told", [
    "+1", "1", "+0.0123", "+1.0", "+1.0E-0", "+1.0E-02OHM", "+1,0E-02", "1_0E-02", "NAN", "INF", "",
    "+1.0E-02,+1.0E-02",
])  # fmt: skip
def test_an_answer_that_is_not_written_like_a_reading_is_refused(told):
    """A line that noise has broken in two, or the late answer to another question, may look like a number too."""

    async def scene():
        core = VoltmeterCore(lambda _now: 0.0123, np.random.default_rng(3))
        line = Telling("voltmeter", core, asyncio.get_running_loop().time)
        meter = Keithley2000(line, range_v=1.0)
        line.told = "+1.0E-02VDC"
        await meter.open()
        assert await meter.read_voltage() == 0.01
        line.told = told
        with pytest.raises(ProtocolError, match="where a reading was expected"):
            await meter.read_voltage()

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


class Twice(VoltmeterCore):
    """A meter that sends a reading twice when a test wants it."""

    twice = False

    def feed(self, data, now):
        replies = super().feed(data, now)
        return replies * 2 if self.twice and b":READ?" in data else replies


@pytest.mark.computes
def test_a_reading_that_is_sent_twice_is_not_taken_for_that_of_the_next_face():
    async def scene():
        volts = [0.010]
        core = Twice(lambda _now: volts[0], np.random.default_rng(3))
        meter = Keithley2000(InMemoryLine("voltmeter", core, asyncio.get_running_loop().time))
        await meter.open()
        for number in range(8):
            core.twice = number % 3 < 2
            volts[0] = 0.010 * (1 + number % 4)
            assert await meter.read_voltage() == pytest.approx(volts[0], abs=1e-5)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


class Saying(InMemoryLine):
    """The line of a meter that gives a test's own answers to some questions."""

    async def ask(self, text, within_s):
        return self.says.get(text, await super().ask(text, within_s))


def opened(says, **settings):
    """Open a meter with these answers, open it again, and return the error of reading it meanwhile."""

    async def scene():
        line = Saying("voltmeter", VoltmeterCore(lambda _now: 0.0123, np.random.default_rng(3)), loop.time)
        line.says = says
        meter = Keithley2000(line, **settings)
        await meter.open()
        again = asyncio.create_task(meter.open())
        await asyncio.sleep(0.01)
        with pytest.raises(LinkLostError) as closed:
            await meter.read_voltage()
        await again
        return closed.value.message

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        loop = runner.get_loop()
        return runner.run(scene())


@pytest.mark.computes
def test_a_range_counts_as_kept_within_a_millionth_and_a_meter_is_not_read_while_it_is_reopened():
    asked = ":SENS:VOLT:DC:RANG?"
    assert opened({asked: "1.00000005E-01"}, range_v=0.1) == "has to be opened first"
    with pytest.raises(ProtocolError, match=r"did not keep its configuration: :SENS:VOLT:DC:RANG\? is answered by"):
        opened({asked: "1.000005E-01"}, range_v=0.1)


@pytest.mark.computes
def test_opening_the_voltmeter_fails_if_an_answer_is_not_a_number():
    with pytest.raises(ConnectError, match="is it on"):
        opened({"*ESE?": "noise"})
    with pytest.raises(ProtocolError, match=r":SENS:VOLT:DC:RANG\? is answered by noise"):
        opened({":SENS:VOLT:DC:RANG?": "noise"}, range_v=0.1)


@pytest.mark.parametrize(("identity", "right"), [
    ("KEITHLEY INSTRUMENTS INC.,MODEL 2000,1,A01", True), ("KEITHLEY, MODEL 2000", True), ("MODEL 2000", False),
    ("KEITHLEY,MODEL 2001,1,A01", False), ("", False),
])  # fmt: skip
def test_the_model_of_a_voltmeter_is_the_second_field_of_its_identity(identity, right):
    with contextlib.nullcontext() if right else pytest.raises(IdentityError, match="not a Keithley MODEL 2000"):
        require_model(identity)


def test_a_garbled_reply_is_no_reading_and_the_next_one_is_right(voltmeter_host):
    async def scene():
        async with voltmeter_host() as host:
            meter = meter_on(host.port.link)
            await meter.open()
            for _ in range(5):
                host.core.corrupt_next()
                with pytest.raises((ProtocolError, DeadlineError)):
                    await meter.read_voltage()
                assert await meter.read_voltage() == pytest.approx(0.0123, abs=5e-6)
            await meter.close()

    asyncio.run(scene())


def test_a_voltmeter_that_was_restarted_or_set_by_hand_is_a_lost_link_until_it_is_reopened(voltmeter_host):
    async def scene():
        async with voltmeter_host() as host:
            meter = meter_on(host.port.link, deadline_s=1.5)
            for upset in (
                host.power_cycle,
                lambda: host.core.change(host._now(), elements=("READ", "CHAN")),
                lambda: host.core.change(host._now(), trigger_source="EXT"),
            ):
                await meter.open()
                upset()
                with pytest.raises((DeadlineError, ProtocolError)):
                    await meter.read_voltage()
                with pytest.raises(LinkLostError, match=r"restarted|answered by"):
                    await meter.read_voltage()
            await meter.open()
            assert await meter.read_voltage() == pytest.approx(0.0123, abs=5e-6)
            await meter.close()

    asyncio.run(scene())


@pytest.mark.parametrize("pressed", PRESSED)
def test_a_setting_changed_at_the_front_panel_is_noticed_within_two_minutes(pressed):
    async def scene():
        now = asyncio.get_running_loop().time
        core = VoltmeterCore(lambda _now: 0.0123, np.random.default_rng(3))
        meter = Keithley2000(InMemoryLine("voltmeter", core, now))
        await meter.open()
        core.change(now(), **pressed)
        begun_s = now()
        with pytest.raises(LinkLostError, match="is answered by"):
            await read_at_the_default_rhythm(meter)
        assert now() - begun_s < 120.0
        await meter.open()
        await read_at_the_default_rhythm(meter)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


async def read_at_the_default_rhythm(meter):
    for _ in range(100):
        await meter.read_voltage()
        await asyncio.sleep(1.25)


def test_a_missing_silent_held_or_different_voltmeter_is_refused_in_one_sentence(voltmeter_host, tmp_path):
    async def scene():
        with pytest.raises(ConnectError, match=r"there is no .*nowhere"):
            await meter_on(tmp_path / "nowhere").open()
        async with voltmeter_host(identity="KEITHLEY INSTRUMENTS INC.,MODEL 2700,1,A01") as host:
            with pytest.raises(IdentityError, match=r"MODEL 2700.*not a Keithley MODEL 2000"):
                await meter_on(host.port.link).open()
        async with voltmeter_host() as host:
            first = meter_on(host.port.link)
            await first.open()
            with pytest.raises(ConnectError, match="held by another program"):
                await meter_on(host.port.link).open()
            await first.close()
            host.core.mute = True
            with pytest.raises(ConnectError, match=r"did not answer .IDN.*is it on"):
                await meter_on(host.port.link).open()

    asyncio.run(scene())


def test_an_unplugged_cable_is_a_lost_link_and_the_same_port_name_works_after_a_replug(voltmeter_host):
    async def scene():
        async with voltmeter_host() as host:
            meter = meter_on(host.port.link)
            await meter.open()
            host.port.unplug()
            with pytest.raises(LinkLostError, match="has it been unplugged"):
                await meter.read_voltage()
            with pytest.raises(LinkLostError, match="opened first"):
                await meter.read_voltage()
            with pytest.raises(ConnectError, match="there is no"):
                await meter.open()
            host.port.plug()
            await meter.open()
            assert await meter.read_voltage() == pytest.approx(0.0123, abs=5e-6)
            await meter.close()

    asyncio.run(scene())


@pytest.mark.live
def test_a_meter_on_gpib_behind_a_prologix_adapter_is_read(tmp_path):
    core = VoltmeterCore(lambda _now: 0.0123, np.random.default_rng(3), now=time.monotonic())
    adapter = Prologix(core, tmp_path / "prologix")

    async def scene():
        settings = VisaSettings("GPIB0::16::INSTR", prologix_port=str(tmp_path / "prologix"))
        # Ten periods of the mains take longer than the 50 ms that PyVISA-py lets the adapter wait.
        meter = Keithley2000(visa(settings), nplc=10.0, deadline_s=4.0)
        for _ in range(2):
            assert "MODEL 2000" in await meter.open()
            for _ in range(3):
                assert await meter.read_voltage() == pytest.approx(0.0123, abs=5e-6)
        core.drop_next()
        with pytest.raises(DeadlineError):
            await meter.read_voltage()
        assert await meter.read_voltage() == pytest.approx(0.0123, abs=5e-6)
        await meter.close()

    try:
        asyncio.run(scene())
    finally:
        adapter.end()
    assert adapter.settings.items() >= {"mode": "1", "auto": "0", "addr": "16", "eoi": "1"}.items()
    # One device clear at each of the two openings, and one after the lost reply.
    assert (adapter.clears, adapter.stuck) == (3, 0)


def test_a_missing_gpib_bus_or_visa_library_is_reported_with_the_remedy():
    async def scene():
        meter = Keithley2000(visa(VisaSettings("GPIB0::16::INSTR")))
        with pytest.raises(ConnectError, match="prologix_port"):
            await meter.open()
        ni = Keithley2000(visa(VisaSettings("GPIB0::16::INSTR", library="ni")))
        with pytest.raises(ConnectError, match="NI-VISA is not installed"):
            await ni.open()

    asyncio.run(scene())
