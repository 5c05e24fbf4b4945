"""The simulated voltmeter on its line: identity, bytes in and out, and what disturbs neither meter nor replies."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.sim_drivers.voltmeter.exchange import READING, ask, errors, idle, meter


def test_the_identity_of_the_voltmeter_has_two_blanks_in_its_revision():
    fields = ask(meter(), "*IDN?").split(",")
    assert fields[1] == "MODEL 2000"
    assert fields[3] == "A20  /A02"


def test_control_c_empties_the_input_and_the_output():
    core = idle(meter())
    core.feed(b":SENS:VOLT:NPLC 10\n:READ?\n", 1.0)
    before = core.aborts
    assert core.feed(b":SYST:GARB\x03*OPC?\n", 1.1) == [(1.1, b"1\n")]
    assert core.aborts == before + 1
    assert errors(core) == []


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


def test_the_line_of_the_voltmeter_can_be_made_mute_late_lossy_or_noisy():
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
def test_random_bytes_never_break_the_simulated_voltmeter(pieces):
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
