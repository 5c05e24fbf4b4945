"""The simulated scanning meters accept what other people's programs send to real ones."""

import numpy as np
import pytest

from sim_drivers.scanner.core import ScannerCore

# In the order in which the programs send them; channels and ranges are ours.
PUBLISHED = {
    "keithley2000-scan": (
        "*RST",
        "INIT:CONT OFF",
        "FUNC 'VOLT:DC'",
        "ROUT:SCAN (@1:4)",
        "TRIG:COUN 1",
        "SAMP:COUN 4",
        "ROUT:SCAN:LSEL INT",
        "FORM:ELEM READ, CHAN",
        "READ?",
    ),
    "daq6510": (
        "*RST",
        'TRAC:CLE "defbuffer1"',
        "FUNC 'VOLT:DC', (@101:104)",
        "VOLT:DC:RANG 0.1, (@101:104)",
        "VOLT:DC:NPLC 1, (@101:104)",
        "ROUT:SCAN:COUN:SCAN 1",
        "ROUT:SCAN:CRE (@101:104)",
        "INIT",
        "*OPC?",
        'TRAC:DATA? 1, 4, "defbuffer1", READ, CHAN',
    ),
    "agilent34970a": (
        "*RST",
        "CONF:VOLT:DC 0.1,DEF,(@101:104)",
        "FORM:READ:CHAN ON",
        "READ?",
    ),
}


def core_of(make):
    first = 1 if make in ("keithley2000-scan", "dmm6500") else 101
    return ScannerCore(make, lambda channel, _now: 0.01 * (channel - first + 1), rng())


def rng():
    return np.random.default_rng(1)


def ask(core, text, now_s=0.0):
    replies = core.feed(text.encode() + b"\n", now_s)
    return [(due_s, data.decode().strip()) for due_s, data in replies]


@pytest.mark.parametrize("make", PUBLISHED)
def test_a_published_scan_gives_four_readings_with_their_channels(make):
    core, now_s = core_of(make), 0.0
    for line in PUBLISHED[make]:
        answers = ask(core, line, now_s)
        now_s = answers[-1][0] if answers else now_s
    numbers = answers[-1][1].split(",")
    assert [float(text) for text in numbers[::2]] == pytest.approx([0.01, 0.02, 0.03, 0.04], abs=1e-5)
    assert [int(text) % 100 for text in numbers[1::2]] == [1, 2, 3, 4]
    assert 0.05 < now_s < 1.0
    assert ask(core, "SYST:ERR?", now_s)[0][1].startswith("0,")


@pytest.mark.parametrize(
    ("make", "line", "error"),
    [
        ("agilent34970a", "FORM:ELEM READ", "-113"),
        ("agilent34970a", "CONF:VOLT:DC 0.1,DEF,(@101:104", "-224"),
        ("agilent34970a", "CONF:VOLT:DC 0.1,DEF,(@111)", "-222"),
        ("agilent34970a", "READ?", "-221"),
        ("daq6510", "ROUT:SCAN:LSEL INT", "-113"),
        ("daq6510", 'TRAC:DATA? 1,4,"defbuffer1",READ', "-222"),
        ("daq6510", "INIT", "-221"),
        ("keithley2000-scan", "ROUT:SCAN (@1:11)", "-222"),
        ("keithley2000-scan", "ROUT:SCAN (@1:2000000000)", "-222"),
        ("keithley2000-scan", f"ROUT:SCAN (@1:{'9' * 30})", "-222"),
        ("daq6510", 'TRAC:DATA? a,b,"defbuffer1"', "-104"),
        ("keithley2000-scan", "SYST:CARD1:IDN?", "-113"),
    ],
)
def test_a_command_that_a_make_does_not_know_or_cannot_do_puts_an_error_into_its_queue(make, line, error):
    core = core_of(make)
    core.feed(b"*RST\n", 0.0)
    assert ask(core, line) == []
    assert ask(core, "SYST:ERR?")[0][1].startswith(error)


def test_configuring_an_agilent_34970a_anew_resets_its_reading_format():
    core = core_of("agilent34970a")
    for line in ("CONF:VOLT:DC 0.1,DEF,(@101:104)", "FORM:READ:CHAN ON", "CONF:VOLT:DC 0.1,DEF,(@101:104)"):
        ask(core, line)
    assert ask(core, "FORM:READ:CHAN?")[0][1] == "0"
    assert len(ask(core, "READ?", 1.0)[0][1].split(",")) == 4
    assert ask(core, "ROUT:SCAN?", 9.0)[0][1] == "#218(@101,102,103,104)"


@pytest.mark.parametrize(("between", "answers"), [("", 0), ("*WAI;", 1), ("*OPC?;", 1)])
def test_a_daq6510_scan_is_not_finished_when_read_in_the_same_line_unless_the_line_waits_for_it(between, answers):
    core = core_of("daq6510")
    for line in PUBLISHED["daq6510"][:-3]:
        ask(core, line)
    line = f':INIT;{between}:TRAC:DATA? 1,4,"defbuffer1",READ,CHAN'
    assert len(ask(core, line, 1.0)) == answers
    assert ask(core, "SYST:ERR?", 9.0)[0][1].startswith("0," if answers else "-222")


def test_a_scan_under_way_is_not_begun_again_unless_it_is_aborted():
    core = core_of("daq6510")
    for line in PUBLISHED["daq6510"][:-3]:
        ask(core, line)
    ask(core, "INIT", 1.0)
    ask(core, "INIT", 1.01)
    assert ask(core, "SYST:ERR?", 1.02)[0][1].startswith("-213")
    ask(core, "ABOR", 1.03)
    ask(core, "INIT", 1.04)
    assert ask(core, "SYST:ERR?", 1.05)[0][1].startswith("0,")


def scanning(*more):
    core = core_of("keithley2000-scan")
    for line in (*PUBLISHED["keithley2000-scan"][:-1], *more):
        ask(core, line)
    return core


@pytest.mark.parametrize(("count", "channels"), [(1, [1]), (2, [1, 2]), (6, [1, 2, 3, 4, 1, 2])])
def test_a_trigger_takes_as_many_channels_as_samples_are_asked_for(count, channels):
    answer = ask(scanning(f"SAMP:COUN {count}"), "READ?", 1.0)[0][1]
    assert [int(text) for text in answer.split(",")[1::2]] == channels


@pytest.mark.parametrize("source", ["BUS", "EXT", "MAN"])
def test_a_scan_waits_for_its_trigger_source_and_trg_starts_only_a_scan_on_bus(source):
    core = scanning(f"TRIG:SOUR {source}")
    assert ask(core, "READ?", 1.0) == []
    ask(core, "*TRG", 2.0)
    assert len(ask(core, "FETC?", 3.0)) == (source == "BUS")


def test_another_trigger_source_silences_an_agilent_until_it_is_configured_anew():
    core = core_of("agilent34970a")
    ask(core, "CONF:VOLT:DC 0.1,DEF,(@101:104)")
    ask(core, "TRIG:SOUR EXT")
    assert ask(core, "READ?", 1.0) == []
    ask(core, "CONF:VOLT:DC 0.1,DEF,(@101:104)", 2.0)
    assert ask(core, "TRIG:SOUR?", 2.0)[0][1] == "IMM"
    assert len(ask(core, "READ?", 2.0)) == 1


def test_an_open_channel_of_a_2000_keeps_about_the_voltage_of_the_channel_before_it():
    core = ScannerCore("keithley2000-scan", lambda channel, _now: {1: 0.05, 4: 0.01}.get(channel), rng())
    for line in PUBLISHED["keithley2000-scan"][:-1]:
        ask(core, line)
    _, open_v, still_open_v, _ = [float(text) for text in ask(core, "READ?", 1.0)[0][1].split(",")[::2]]
    assert 0.051 < open_v < still_open_v < 0.06


def test_an_open_channel_of_a_meter_with_10_megohm_input_resistance_reads_zero():
    core = ScannerCore("agilent34970a", lambda channel, _now: {101: 0.05}.get(channel), rng())
    ask(core, "*RST")
    ask(core, "CONF:VOLT:DC 0.1,DEF,(@101:104)")
    assert float(ask(core, "READ?", 1.0)[0][1].split(",")[1]) == pytest.approx(0.0, abs=1e-5)


def test_the_function_of_each_channel_is_answered_in_quotes():
    assert ask(core_of("daq6510"), "SENS:FUNC? (@101:102)")[0][1] == '"VOLT:DC","VOLT:DC"'
