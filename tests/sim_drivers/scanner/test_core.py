"""The simulated scanning meters take what programs of others send to real ones."""

import numpy as np
import pytest

from sim_drivers.scanner.core import ScannerCore

# In the order in which their authors send them; channels and ranges are ours.
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
    return ScannerCore(make, lambda channel, _now: 0.01 * (channel - first + 1), np.random.default_rng(1))


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
def test_what_a_make_does_not_know_or_cannot_do_is_an_error_of_its_queue(make, line, error):
    core = core_of(make)
    core.feed(b"*RST\n", 0.0)
    assert ask(core, line) == []
    assert ask(core, "SYST:ERR?")[0][1].startswith(error)


def test_a_new_configuration_takes_back_what_was_said_of_the_format():
    core = core_of("agilent34970a")
    for line in ("CONF:VOLT:DC 0.1,DEF,(@101:104)", "FORM:READ:CHAN ON", "CONF:VOLT:DC 0.1,DEF,(@101:104)"):
        ask(core, line)
    assert ask(core, "FORM:READ:CHAN?")[0][1] == "0"
    assert len(ask(core, "READ?", 1.0)[0][1].split(",")) == 4
    assert ask(core, "ROUT:SCAN?", 9.0)[0][1] == "#218(@101,102,103,104)"


def test_the_function_of_channels_is_told_in_quotes():
    assert ask(core_of("daq6510"), "SENS:FUNC? (@101:102)")[0][1] == '"VOLT:DC","VOLT:DC"'
