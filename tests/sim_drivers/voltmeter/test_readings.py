"""How the simulated voltmeter measures: duration, noise, zero, filters and ranges."""

import numpy as np
import pytest

from tests.sim_drivers.voltmeter.exchange import READING, ask, errors, idle, meter


def test_a_reading_has_the_documented_form_and_the_voltage_within_the_noise():
    core = idle(meter(0.05))
    [(due, reply)] = core.feed(b":READ?\n", 1.0)
    assert READING.fullmatch(reply)
    assert float(reply) == pytest.approx(0.05, abs=3e-6)
    assert due == pytest.approx(1.04)


def test_a_frozen_meter_gives_its_last_reading_to_the_digit_until_it_thaws():
    core = idle(meter(lambda now: 0.001 * now))
    first = ask(core, ":READ?", 1.0)
    core.freeze()
    assert ask(core, ":READ?", 5.0) == ask(core, ":READ?", 9.0) == first
    core.freeze(is_frozen=False)
    assert float(ask(core, ":READ?", 20.0)) == pytest.approx(0.02, abs=1e-4)


def test_a_reference_is_subtracted_from_every_reading_until_it_is_switched_off_or_reset():
    core = idle(meter(0.05))
    core.feed(b":SENS:VOLT:DC:REF 0.02;REF:STAT ON\n", 0.5)
    assert float(ask(core, ":READ?", 1.0)) == pytest.approx(0.03, abs=3e-6)
    assert ask(core, ":SENS:VOLT:REF:STAT?;:SENS:VOLT:REF?", 2.0) == "1;0.02"
    core.feed(b":SENS:VOLT:REF:STAT OFF\n", 2.5)
    assert float(ask(core, ":READ?", 3.0)) == pytest.approx(0.05, abs=3e-6)
    core.feed(b":SENS:VOLT:REF:STAT ON\n*RST\n", 3.5)
    assert float(ask(core, ":READ?", 4.0)) == pytest.approx(0.05, abs=3e-6)
    assert errors(core) == []


def test_a_scale_factor_multiplies_every_reading_until_it_is_switched_off_or_reset():
    core = idle(meter(0.05))
    core.feed(b":CALC1:KMAT:MMF 10;:CALC1:STAT ON\n", 0.5)
    assert float(ask(core, ":READ?", 1.0)) == pytest.approx(0.5, abs=3e-5)
    assert ask(core, ":CALC:STAT?;:CALC:KMAT:MMF?", 2.0) == "1;10"
    core.feed(b":CALC1:STAT OFF\n", 2.5)
    assert float(ask(core, ":READ?", 3.0)) == pytest.approx(0.05, abs=3e-6)
    core.feed(b":CALC1:STAT ON\n*RST\n", 3.5)
    assert float(ask(core, ":READ?", 4.0)) == pytest.approx(0.05, abs=3e-6)
    assert errors(core) == []


@pytest.mark.parametrize(
    ("settings", "line_frequency_hz", "expected_s"),
    [
        ("", 50.0, 0.04),
        ("", 60.0, 1 / 30),
        (":SYST:AZER:STAT OFF", 60.0, 0.02),
        (":SYST:AZER:STAT OFF;:SENS:VOLT:NPLC 10", 60.0, 0.2),
        (":SENS:VOLT:NPLC 0.01;:SYST:AZER:STAT 0", 60.0, 0.0005),
        (":SENS:VOLT:AVER:TCON REP;COUN 5;STAT ON", 50.0, 0.2),
        (":SENS:VOLT:AVER:TCON MOV;COUN 5;STAT ON", 50.0, 0.04),
        (":TRIG:DEL 0.5", 50.0, 0.54),
        (":SAMP:COUN 3", 50.0, 0.12),
    ],
)
def test_a_reading_takes_the_time_of_integration_autozero_filter_delay_and_count(
    settings, line_frequency_hz, expected_s
):
    core = idle(meter(line_frequency_hz=line_frequency_hz))
    core.feed(settings.encode() + b"\n", 0.5)
    [(due, _)] = core.feed(b":READ?\n", 1.0)
    assert due - 1.0 == pytest.approx(expected_s)
    assert errors(core) == []


def test_the_voltage_is_that_of_the_middle_of_the_conversion():
    core = idle(meter(lambda now: now / 100.0))
    [(due, reply)] = core.feed(b":READ?\n", 10.0)
    assert float(reply) == pytest.approx((10.0 + due) / 2 / 100.0, abs=3e-6)


@pytest.mark.parametrize(("nplc", "typical_v"), [(10, 1.5e-7), (1, 4e-7), (0.1, 2.2e-6), (0.01, 1.5e-5)])
def test_noise_falls_with_integration_time(nplc, typical_v):
    core = idle(meter(0.05))
    core.feed(f":SENS:VOLT:NPLC {nplc}\n".encode(), 0.5)
    values = [float(core.feed(b":READ?\n", float(now))[0][1]) for now in range(1, 400)]
    assert np.std(values) == pytest.approx(typical_v, rel=0.2)
    assert np.mean(values) == pytest.approx(0.05, abs=3 * typical_v / 15)


def test_noise_falls_with_the_range_and_with_a_repeating_filter():
    core = idle(meter(0.05))
    core.feed(b":SENS:VOLT:RANG 10\n", 0.5)
    wide = np.std([float(core.feed(b":READ?\n", float(now))[0][1]) for now in range(1, 400)])
    core.feed(b":SENS:VOLT:AVER:TCON REP;COUN 25;STAT ON\n", 500.0)
    filtered = np.std([float(core.feed(b":READ?\n", float(now))[0][1]) for now in range(501, 900)])
    assert wide == pytest.approx(4e-6, rel=0.2)
    assert filtered == pytest.approx(4e-6 / 5, rel=0.2)


def test_two_meters_with_the_same_seed_give_the_same_readings():
    first, second = (idle(meter()) for _ in range(2))
    for now in range(1, 2000):
        assert first.feed(b":READ?\n", float(now)) == second.feed(b":READ?\n", float(now))


def test_without_autozero_the_zero_wanders():
    core = idle(meter(0.0))
    core.feed(b":SYST:AZER:STAT OFF\n", 0.0)
    early = float(core.feed(b":READ?\n", 1.0)[0][1])
    late = float(core.feed(b":READ?\n", 2000.0)[0][1])
    assert late - early == pytest.approx(7e-6, abs=2e-6)


@pytest.mark.parametrize(("voltage", "range_v"), [(0.13, 0.1), (1.25, 1.0), (-1.25, 1.0), (1200.0, 1000.0)])
def test_a_voltage_beyond_120_percent_of_the_range_overflows(voltage, range_v):
    core = idle(meter(voltage))
    core.feed(f":SENS:VOLT:RANG {range_v}\n".encode(), 0.5)
    assert core.feed(b":READ?\n", 1.0)[0][1] == (b"+9.9E37\n" if voltage > 0 else b"-9.9E37\n")


def test_a_voltage_that_is_not_a_number_overflows():
    assert ask(idle(meter(float("nan"))), ":READ?") == "+9.9E37"


def test_a_voltage_just_below_120_percent_of_the_range_is_read():
    core = idle(meter(0.119))
    core.feed(b":SENS:VOLT:RANG 0.1\n", 0.5)
    assert float(ask(core, ":READ?")) == pytest.approx(0.119, abs=1e-5)


def test_autorange_goes_up_at_120_and_down_at_10_percent_and_takes_time():
    level = [0.05]
    core = meter(lambda _now: level[0])
    core.feed(b"*RST\n", 0.0)
    [(due, _)] = core.feed(b":READ?\n", 1.0)
    assert core.range_v == 0.1
    assert due - 1.0 == pytest.approx(0.07)
    for volts, expected in ((0.119, 0.1), (0.121, 1.0), (0.101, 1.0), (0.099, 0.1), (150.0, 1000.0)):
        level[0] = volts
        ask(core, ":READ?", 2.0)
        assert core.range_v == expected
    assert float(ask(core, ":SENS:VOLT:RANG?")) == 1000.0


def test_setting_a_range_switches_autorange_off():
    core = meter()
    assert ask(core, ":SENS:VOLT:DC:RANG:AUTO?") == "1"
    core.feed(b":SENS:VOLT:DC:RANG 0.5\n", 1.0)
    assert ask(core, ":SENS:VOLT:DC:RANG:AUTO?") == "0"
    assert float(ask(core, ":SENS:VOLT:DC:RANG?")) == 1.0


def test_an_overflow_is_sent_without_unit():
    core = meter(5000.0)
    assert ask(core, ":FETC?") == "+9.9E37,0INTCHAN"


def test_the_moving_filter_mixes_voltages_across_a_switch_and_the_repeating_filter_does_not():
    level = [0.0]
    core = idle(meter(lambda _now: level[0]))
    core.feed(b":SENS:VOLT:AVER:TCON MOV;COUN 10;STAT ON\n", 0.5)
    assert float(ask(core, ":READ?", 1.0)) == pytest.approx(0.0, abs=1e-5)
    level[0] = 0.1
    assert float(ask(core, ":READ?", 2.0)) == pytest.approx(0.01, abs=1e-5)
    core.feed(b":SENS:VOLT:AVER:TCON REP\n", 3.0)
    assert float(ask(core, ":READ?", 4.0)) == pytest.approx(0.1, abs=1e-5)
