import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_drivers.scpi import messages, spellings
from sim_drivers.voltmeter.core import VoltmeterCore

READING = re.compile(rb"[+-]\d\.\d{8}E[+-]\d\d\n")


def meter(voltage=0.05, **options):
    source = voltage if callable(voltage) else lambda _now: voltage
    return VoltmeterCore(source, np.random.default_rng(7), **options)


def idle(core, now=0.0):
    assert core.feed(b"*RST\n*CLS\n:SENS:VOLT:RANG 1\n", now) == []
    return core


def ask(core, text, now=1.0):
    replies = core.feed(text.encode() + b"\n", now)
    assert len(replies) == 1, f"{text} was not answered"
    return replies[0][1].decode().strip()


def errors(core, now=1000.0):
    found = []
    while (error := ask(core, ":SYST:ERR?", now)) != '0,"No error"':
        found.append(int(error.split(",")[0]))
    return found


def test_it_says_who_it_is_with_two_blanks_in_the_revision():
    fields = ask(meter(), "*IDN?").split(",")
    assert fields[1] == "MODEL 2000"
    assert fields[3] == "A20  /A02"


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
def test_a_reading_takes_its_integration_autozero_filter_delay_and_count(settings, line_frequency_hz, expected_s):
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


def test_the_same_seed_reads_the_same():
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
def test_beyond_120_percent_of_the_range_it_overflows(voltage, range_v):
    core = idle(meter(voltage))
    core.feed(f":SENS:VOLT:RANG {range_v}\n".encode(), 0.5)
    assert core.feed(b":READ?\n", 1.0)[0][1] == (b"+9.9E37\n" if voltage > 0 else b"-9.9E37\n")


def test_what_cannot_be_measured_overflows():
    assert ask(idle(meter(float("nan"))), ":READ?") == "+9.9E37"


def test_just_below_120_percent_it_reads():
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


def test_after_power_up_it_measures_freely_and_refuses_a_read_in_silence():
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


def test_the_power_up_format_has_units_and_channel_until_it_is_told_otherwise():
    core = meter(0.05)
    assert re.fullmatch(r"[+]\d\.\d{8}E-02VDC,0INTCHAN", ask(core, ":FETC?"))
    core.feed(b":FORM:ELEM READ,UNIT\n", 1.0)
    assert ask(core, ":FETC?").endswith("E-02VDC")
    core.feed(b":FORM:ELEM CHAN, READ\n", 1.0)
    assert ask(core, ":FORM:ELEM?") == "READ,CHAN"
    assert ask(core, ":FETC?").endswith("E-02,0")


def test_an_overflow_is_sent_without_unit():
    core = meter(5000.0)
    assert ask(core, ":FETC?") == "+9.9E37,0INTCHAN"


def test_the_moving_filter_mixes_what_was_switched_and_the_repeating_one_does_not():
    level = [0.0]
    core = idle(meter(lambda _now: level[0]))
    core.feed(b":SENS:VOLT:AVER:TCON MOV;COUN 10;STAT ON\n", 0.5)
    assert float(ask(core, ":READ?", 1.0)) == pytest.approx(0.0, abs=1e-5)
    level[0] = 0.1
    assert float(ask(core, ":READ?", 2.0)) == pytest.approx(0.01, abs=1e-5)
    core.feed(b":SENS:VOLT:AVER:TCON REP\n", 3.0)
    assert float(ask(core, ":READ?", 4.0)) == pytest.approx(0.1, abs=1e-5)


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


def test_control_c_empties_the_input_and_the_output():
    core = idle(meter())
    core.feed(b":SENS:VOLT:NPLC 10\n:READ?\n", 1.0)
    before = core.aborts
    assert core.feed(b":SYST:GARB\x03*OPC?\n", 1.1) == [(1.1, b"1\n")]
    assert core.aborts == before + 1
    assert errors(core) == []


def test_a_bus_trigger_lets_the_reading_go():
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


@pytest.mark.parametrize(
    "header",
    [":SENS:VOLT:DC:NPLC", "sense:voltage:nplcycles", ":VOLT:NPLC", "SENS1:VOLTage:DC:NPLCycles", ":Voltage:dc:nplc"],
)
def test_long_and_short_forms_and_optional_nodes_mean_the_same(header):
    core = idle(meter())
    core.feed(f"{header} 5\n".encode(), 0.5)
    assert ask(core, f"{header}?") == "5"
    assert errors(core) == []


@pytest.mark.parametrize(
    "header", [":SENSE:VOLTA:NPLC", ":SENS:NPLC", "SENS2:VOLT:NPLC", ":VOLT:DC:DC:NPLC", "*IDNN", "@"]
)
def test_other_spellings_are_undefined(header):
    core = idle(meter())
    assert core.feed(f"{header} 5\n".encode(), 0.5) == []
    assert errors(core) == [-113]


def test_a_pattern_stands_for_all_its_spellings():
    assert spellings("[:SENSe[1]]:DATA") == ["DATA", "SENS1:DATA", "SENS:DATA", "SENSE1:DATA", "SENSE:DATA"]
    assert spellings("*IDN") == ["*IDN"]


def test_the_path_is_kept_after_a_semicolon_and_left_with_a_colon():
    core = idle(meter())
    core.feed(b":SENS:VOLT:NPLC 2;DIG 6;*OPC;RANG:AUTO 1;:FORM:ELEM READ\n", 0.5)
    assert ask(core, ":SENS:VOLT:NPLC?;DIG?;:SENS:VOLT:RANG:AUTO?") == "2;6;1"
    assert errors(core) == []
    core.feed(b":SENS:VOLT:NPLC 3;SENS:VOLT:DIG 5\n", 0.5)
    assert errors(core) == [-113]
    assert ask(core, ":VOLT:NPLC?;DIG?") == "3;6"


def test_semicolons_and_commas_inside_quotes_do_not_cut():
    found, error = messages(":A 'x;y,z',2;B?")
    assert [tuple(message) for message in found] == [("A", False, ("'x;y,z'", "2")), ("B", True, ())]
    assert error == 0


def test_the_rest_of_a_line_is_dropped_at_its_first_error_and_a_bad_query_is_silent():
    core = idle(meter())
    assert ask(core, "*OPC?;:NONSENSE?;:SENS:VOLT:NPLC 9") == "1"
    assert core.feed(b":NONSENSE?\n", 2.0) == []
    assert errors(core) == [-113, -113]
    assert ask(core, ":SENS:VOLT:NPLC?") == "1"


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (":SENS:VOLT:NPLC", -109),
        (":SENS:VOLT:NPLC 1,2", -108),
        (":SENS:VOLT:NPLC fast", -104),
        (":SENS:VOLT:NPLC 11", -222),
        (":SENS:VOLT:NPLC nan", -222),
        (":SENS:VOLT:RANG 2000", -222),
        (":SENS:VOLT:AVER:TCON SOME", -224),
        (":SYST:AZER:STAT MAYBE", -224),
        (":SENS:FUNC VOLT:DC", -104),
        (":SENS:FUNC 'LUX'", -224),
        (":FORM:ELEM", -109),
        (":FORM:ELEM UNIT", -224),
        (":FORM:DATA SRE", -224),
        (":CONF:VOLT:DC 1,2,3", -108),
        (":READ", -113),
        (":INIT? ", -113),
        ("*IDN? 3", -108),
    ],
)
def test_each_mistake_has_its_error(line, code):
    core = idle(meter())
    assert core.feed(line.encode() + b"\n", 0.5) == []
    assert errors(core) == [code]


def test_the_error_queue_is_ten_deep_and_says_when_it_overflowed():
    core = idle(meter())
    core.feed(b":NONSENSE\n" * 15, 0.5)
    assert errors(core) == [-113] * 9 + [-350]
    core.feed(b":NONSENSE\n", 0.5)
    core.feed(b":STAT:QUE:CLE\n", 0.5)
    assert ask(core, ":STAT:QUE?") == '0,"No error"'


def test_the_status_byte_and_the_event_register_tell_of_errors():
    core = idle(meter())
    assert ask(core, "*STB?") == "0"
    core.feed(b"*ESE 32;*SRE 32\n:NONSENSE\n", 0.5)
    assert ask(core, "*STB?") == str(4 + 32 + 64)
    assert ask(core, "*ESR?") == "32"
    core.feed(b":SENS:VOLT:NPLC 99\n*OPC\n", 0.5)
    assert ask(core, "*ESR?") == str(16 + 1)
    core.feed(b"*CLS\n", 0.5)
    assert ask(core, "*STB?;*ESR?") == "0;0"


def test_the_function_is_answered_in_quotes():
    core = idle(meter())
    assert ask(core, ":SENS:FUNC?") == '"VOLT:DC"'
    core.feed(b':SENS:FUNC "CURRent:DC"\n', 0.5)
    assert ask(core, ":FUNC?") == '"CURR:DC"'
    assert abs(float(ask(core, ":READ?"))) < 1e-5
    core.feed(b":CONF:VOLT:DC 1\n", 0.5)
    assert ask(core, ":SENS:FUNC?;:CONF?") == '"VOLT:DC";"VOLT:DC"'


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


def test_named_limits_are_taken_for_numbers():
    core = idle(meter())
    core.feed(b":VOLT:NPLC MAX;AVER:COUN MIN;:TRIG:COUN INF\n", 0.5)
    assert ask(core, ":VOLT:NPLC?;AVER:COUN?;:TRIG:COUN?") == "10;1;9999"


@pytest.mark.parametrize(("terminator", "end"), [("LF", b"\n"), ("CR", b"\r"), ("LFCR", b"\n\r")])
def test_replies_end_as_chosen_on_the_front_panel(terminator, end):
    core = meter(terminator=terminator)
    for command in (b"*OPC?\n", b"*OPC?\r", b"*OPC?\r\n"):
        assert core.feed(command, 1.0) == [(1.0, b"1" + end)]


def test_a_command_may_come_in_pieces_and_several_at_once():
    core = meter()
    assert core.feed(b"*OP", 1.0) == []
    assert core.feed(b"C?\n*OPC?\n*O", 1.0) == [(1.0, b"1\n")] * 2
    assert core.feed(b"PC?\n", 1.0) == [(1.0, b"1\n")]


def test_more_than_2048_characters_without_an_end_are_lost():
    core = idle(meter())
    assert core.feed(b"*OPC?;" * 400 + b"\n", 0.5) == []
    assert errors(core) == [-363]
    assert core.feed(b"*OPC?;" * 300 + b"\n", 0.5) != []


def test_a_mute_a_late_a_lossy_and_a_noisy_line():
    core = idle(meter())
    core.mute = True
    assert core.feed(b"*OPC?\n", 1.0) == []
    core.mute, core.reply_delay_s = False, 3.0
    assert core.feed(b"*OPC?\n", 1.0) == [(4.0, b"1\n")]
    core.reply_delay_s = 0.0
    core.drop_next(2)
    assert [len(core.feed(b"*OPC?\n", 1.0)) for _ in range(3)] == [0, 0, 1]
    core.corrupt_next()
    [(_, garbled)] = core.feed(b":READ?\n", 1.0)
    assert len(garbled) == 16
    assert not READING.fullmatch(garbled)
    assert READING.fullmatch(core.feed(b":READ?\n", 2.0)[0][1])


def test_a_power_cycle_brings_back_free_running_and_the_power_on_mark():
    core = idle(meter())
    core.feed(b"*ESR?\n:SENS:VOLT:NPLC 10\n:READ?\n:NONS", 1.0)
    before = core.aborts
    core.power_cycle(2.0)
    assert core.aborts == before + 1
    assert int(ask(core, "*ESR?", 2.0)) & 128
    assert ask(core, ":VOLT:NPLC?;:INIT:CONT?", 2.0) == "1;1"


def test_the_range_key_works_unless_the_panel_is_locked_out():
    core = idle(meter())
    core.press_range(10.0, 1.0)
    assert ask(core, ":VOLT:RANG?") == "10"
    core.feed(b":SYST:RWL\n", 1.0)
    core.press_range(100.0, 1.0)
    assert ask(core, ":VOLT:RANG?") == "10"
    core.feed(b":SYST:LOC\n", 1.0)
    core.press_range(100.0, 1.0)
    assert ask(core, ":VOLT:RANG?") == "100"
    with pytest.raises(ValueError, match="ranges"):
        core.press_range(3.0, 1.0)


def test_a_line_frequency_that_no_grid_has_is_refused():
    with pytest.raises(ValueError, match="line frequency"):
        meter(line_frequency_hz=float("nan"))


@given(st.lists(st.binary(max_size=60), max_size=20))
def test_no_bytes_whatever_upset_it(pieces):
    core = meter()
    for index, piece in enumerate(pieces):
        core.feed(piece, float(index))
    core.feed(b"\x03", 100.0)
    assert core.feed(b"*IDN?\n", 100.0)[0][1].startswith(b"KEITHLEY")


COMMANDS = st.sampled_from(
    [b":READ?", b":FETC?", b":INIT", b":ABOR", b"*RST", b":SYST:PRES", b":INIT:CONT ON", b"*TRG", b":TRIG:SOUR BUS"]
)


@given(st.lists(st.tuples(COMMANDS, st.floats(0, 1)), max_size=30))
def test_replies_are_never_due_in_the_past_nor_out_of_order(commands):
    core, now, last = meter(), 0.0, 0.0
    for command, wait in commands:
        now += wait
        for due, _ in core.feed(command + b"\n", now):
            assert due >= now
            assert due >= last or b"ABOR" in command or b"RST" in command or b"PRES" in command
            last = due
        if command in (b":ABOR", b"*RST", b":SYST:PRES"):
            last = now
