"""When the simulated voltmeter reads: by itself after power-up, and otherwise when it is asked, told or triggered."""

import re

import pytest

from tests.sim_drivers.voltmeter.exchange import READING, ask, errors, idle, meter


def test_after_power_up_the_meter_measures_freely_and_refuses_a_read_without_an_answer():
    core = meter()
    assert core.feed(b":READ?\n", 1.0) == []
    assert core.feed(b":INIT\n", 1.0) == []
    assert errors(core) == [-213, -213]
    assert ask(core, ":INIT:CONT?") == "1"
    assert int(ask(core, "*ESR?")) & 128
    assert not int(ask(core, "*ESR?")) & 128


def test_free_running_readings_repeat_until_the_next_one_is_done():
    core = meter(lambda now: now / 1000.0)
    core.feed(b":SENS:VOLT:RANG 10;AVER:STAT OFF;:FORM:ELEM READ\n", 0.0)
    [(due, first)] = core.feed(b":FETC?\n", 0.001)
    assert due == pytest.approx(0.04)
    assert core.feed(b":FETC?\n", 10.001)[0][1] != first
    again = core.feed(b":FETC?\n", 10.002)[0][1]
    assert core.feed(b":SENS:DATA?\n", 10.003)[0][1] == again
    assert float(again) == pytest.approx(0.00998, abs=3e-5)


def test_the_power_up_format_has_units_and_channel_until_another_format_is_set():
    core = meter(0.05)
    assert re.fullmatch(r"[+]\d\.\d{8}E-02VDC,0INTCHAN", ask(core, ":FETC?"))
    core.feed(b":FORM:ELEM READ,UNIT\n", 1.0)
    assert ask(core, ":FETC?").endswith("E-02VDC")
    core.feed(b":FORM:ELEM CHAN, READ\n", 1.0)
    assert ask(core, ":FORM:ELEM?") == "READ,CHAN"
    assert ask(core, ":FETC?").endswith("E-02,0")


def test_init_then_fetch_waits_for_the_reading_and_fetch_repeats_it():
    core = idle(meter())
    assert core.feed(b":FETC?\n", 0.5) == []
    assert errors(core, 0.5) == [-230]
    core.feed(b":INIT\n", 1.0)
    [(due, first)] = core.feed(b":FETC?\n", 1.001)
    assert due == pytest.approx(1.04)
    assert core.feed(b":FETC?\n", 5.0)[0][1] == first


def test_a_command_during_a_measurement_waits_until_it_is_done():
    core = idle(meter())
    core.feed(b":READ?\n", 1.0)
    assert core.feed(b"*OPC?\n", 1.001)[0][0] == pytest.approx(1.04)
    assert core.feed(b":READ?\n", 1.002)[0][0] == pytest.approx(1.08)


def test_a_reading_with_bus_trigger_starts_only_at_the_trigger():
    core = idle(meter())
    core.feed(b":TRIG:SOUR BUS\n", 0.5)
    assert core.feed(b":READ?\n", 1.0) == []
    core.feed(b"*TRG\n", 2.0)
    assert core.feed(b":FETC?\n", 2.0)[0][0] == pytest.approx(2.04)
    core.feed(b":TRIG:SOUR EXT;:INIT\n", 3.0)
    assert core.feed(b":FETC?\n", 4.0) == []
    core.feed(b":ABOR;:TRIG:SOUR IMM\n", 5.0)
    assert READING.fullmatch(core.feed(b":READ?\n", 6.0)[0][1])


def test_several_samples_come_in_one_answer():
    core = idle(meter())
    core.feed(b":SAMP:COUN 3;:TRIG:COUN 2\n", 0.5)
    assert len(ask(core, ":READ?").split(",")) == 6


def test_configure_and_measure_leave_free_running():
    core = meter(0.05)
    core.feed(b":CONF:VOLT:DC 0.1\n", 0.5)
    assert ask(core, ":INIT:CONT?;:VOLT:RANG?;RANG:AUTO?") == "0;0.1;0"
    other = meter(0.05)
    assert ask(other, ":FORM:ELEM READ;:MEAS:VOLT:DC?", 0.5).startswith(("+5.000", "+4.999"))
    assert other.range_v == 0.1


def test_reset_and_preset_differ_in_free_running():
    core = meter()
    core.feed(b"*RST\n", 0.5)
    assert ask(core, ":INIT:CONT?;:VOLT:AVER:STAT?;:FORM:ELEM?") == "0;0;READ"
    core.feed(b":SYST:PRES\n", 0.5)
    assert ask(core, ":INIT:CONT?;:VOLT:AVER:STAT?;:FORM:ELEM?") == "1;1;READ,CHAN,UNIT"
    assert ask(core, "*TST?;:SYST:VERS?;:SYST:BEEP:STAT?;:FORM:DATA?;*OPC?") == "0;1991.0;1;ASC;1"
    core.feed(b"*WAI;:STAT:PRES\n", 0.5)
    assert errors(core) == []
