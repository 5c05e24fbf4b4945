"""The language of the simulated voltmeter: spellings, paths, and an error for each mistake."""

import pytest

from sim_drivers.scpi import spellings, split_commands
from tests.sim_drivers.voltmeter.exchange import ask, errors, idle, meter


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
def test_other_spellings_of_a_header_are_undefined(header):
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


def test_semicolons_and_commas_inside_quotes_do_not_split_a_command():
    found, error = split_commands(":A 'x;y,z',2;B?")
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
def test_each_mistake_in_a_command_gives_its_own_error_code(line, code):
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


def test_the_words_max_min_and_inf_are_taken_as_numbers():
    core = idle(meter())
    core.feed(b":VOLT:NPLC MAX;AVER:COUN MIN;:TRIG:COUN INF\n", 0.5)
    assert ask(core, ":VOLT:NPLC?;AVER:COUN?;:TRIG:COUN?") == "10;1;9999"
