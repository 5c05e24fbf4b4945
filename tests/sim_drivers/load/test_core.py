import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_drivers.load.core import LoadCore
from sim_drivers.pv_source import SourceLight
from solar.pv_module import Q_PEAK_G4_1_305, curve, maximum_power, single_diode


class Module:
    """A module in light that a test sets; `scale` makes it a string of that many."""

    def __init__(self, irradiance=800.0, cell_c=40.0, scale=1.0):
        self.now, self.scale = SourceLight(irradiance, cell_c), scale

    def light(self, _now):
        return self.now

    def current(self, light, voltage_v):
        return single_diode(Q_PEAK_G4_1_305, *light).current(voltage_v / self.scale)

    def voltage(self, light, current_a):
        return single_diode(Q_PEAK_G4_1_305, *light).voltage(current_a) * self.scale


class Talk:
    """A load that receives lines one after the other, 50 ms apart."""

    def __init__(self, make="chroma63600", source=None, **options):
        self.source = source or Module()
        self.core = LoadCore(self.source, np.random.default_rng(1), make=make, **options)
        self.now = 1.0

    def say(self, line, wait_s=0.05):
        self.now += wait_s
        replies = self.core.feed(line.encode() + b"\n", self.now)
        return [data.decode().strip() for _, data in replies]

    def ask(self, line, wait_s=0.05):
        (answer,) = self.say(line, wait_s)
        return answer

    def numbers(self, line, wait_s=0.05):
        return [float(part) for part in self.ask(line, wait_s).split(";")]


def chroma(**options):
    talk = Talk(**options)
    talk.say("MODE CVH")
    return talk


def agilent(**options):
    talk = Talk("agilent6063b", **options)
    talk.say("MODE:VOLT")
    return talk


def test_each_make_of_load_answers_its_identity_with_its_own_line_end():
    assert Talk().core.feed(b"*IDN?\n", 0.0)[0][1] == b"CHROMA,63600-5,636000001234,1.20\n"
    assert Talk("agilent6063b").core.feed(b"*IDN?\n", 0.0)[0][1] == b"HEWLETT-PACKARD,6063B,0,A.02.01\r\n"


def test_with_the_input_off_the_module_is_in_open_circuit():
    talk = chroma()
    open_v = float(maximum_power(Q_PEAK_G4_1_305, 800.0, 40.0).voc_v)
    assert talk.numbers("MEAS:VOLT?;CURR?") == pytest.approx([open_v, 0.0], abs=0.03)


@given(st.floats(5.0, 37.0))
def test_the_load_keeps_the_set_voltage_and_draws_the_current_of_the_module_at_it(level_v):
    talk = chroma()
    talk.say(f"VOLT:STAT:L1 {level_v:.3f};:LOAD ON")
    expected = float(curve(Q_PEAK_G4_1_305, 800.0, 40.0, level_v))
    assert talk.numbers("MEAS:VOLT?;CURR?;:LOAD:PROT?") == pytest.approx([level_v, max(expected, 0.0), 0], abs=0.05)


def test_a_voltage_above_open_circuit_draws_nothing_and_the_6063b_says_it_is_not_regulated():
    talk = agilent()
    talk.say("VOLT 60;:INP ON")
    voltage_v, current_a, status = talk.numbers("MEAS:VOLT?;CURR?;:STAT:CHAN:COND?")
    assert voltage_v < 40.0
    assert current_a == pytest.approx(0.0, abs=0.03)
    assert status == 1024


def test_the_voltage_does_not_go_below_what_the_transistors_can_hold():
    talk = agilent()
    talk.say("VOLT 1;:INP ON")
    voltage_v, _, status = talk.numbers("MEAS:VOLT?;CURR?;:STAT:CHAN:COND?")
    assert voltage_v == pytest.approx(3.0, abs=0.05)
    assert status == 1024
    # This asks for the setting, not for the real voltage.
    assert float(talk.ask("VOLT?")) == 1.0


def test_a_measurement_too_early_after_a_change_of_voltage_reads_a_voltage_that_still_settles():
    talk = chroma()
    talk.say("VOLT:STAT:L1 30;:LOAD ON")
    assert talk.numbers("MEAS:VOLT?", wait_s=0.001)[0] > 31.0
    assert talk.numbers("MEAS:VOLT?")[0] == pytest.approx(30.0, abs=0.03)


@pytest.mark.parametrize(("make", "mode"), [(chroma, "MODE CCH;:MODE CVH"), (agilent, "MODE:CURR;:MODE:VOLT")])
def test_a_change_of_mode_drops_the_input_for_a_moment_and_leaves_it_on(make, mode):
    talk = make()
    on, ask = ("LOAD ON", "LOAD?") if make is chroma else ("INP ON", "INP?")
    talk.say(f"VOLT{':STAT:L1' if make is chroma else ''} 30;:{on}")
    assert talk.numbers("MEAS:CURR?")[0] > 5.0
    talk.say(mode)
    assert talk.numbers("MEAS:CURR?", wait_s=0.005)[0] == pytest.approx(0.0, abs=0.03)
    assert talk.ask(ask) in ("ON", "1")
    assert talk.numbers("MEAS:CURR?")[0] > 5.0


def test_the_overpower_protection_latches_until_it_is_cleared():
    talk = agilent(source=Module(1000.0, 20.0))
    talk.say("VOLT 32;:INP ON")
    talk.ask("MEAS:CURR?")
    assert int(talk.ask("STAT:CHAN:COND?")) == 8 | 8192
    assert talk.numbers("MEAS:CURR?")[0] == pytest.approx(0.0, abs=0.03)
    talk.say("VOLT 5")
    assert int(talk.ask("STAT:CHAN:COND?")) == 8 | 8192
    talk.say("INP:PROT:CLE")
    assert int(talk.ask("STAT:CHAN:COND?")) == 0
    assert talk.numbers("MEAS:CURR?")[0] > 9.0


def test_the_6063b_draws_no_more_than_its_rated_current_and_the_module_voltage_rises():
    talk = agilent(source=Module(1150.0, 25.0, scale=0.5))
    talk.say("VOLT 5;:INP ON")
    voltage_v, current_a = talk.numbers("MEAS:VOLT?;CURR?")
    assert current_a == pytest.approx(10.2, abs=0.05)
    assert voltage_v > 12.0


def test_a_voltage_beyond_the_range_of_the_load_reads_9_9e37_and_trips_its_protection():
    talk = chroma(source=Module(scale=4.0))
    assert talk.ask("MEAS:VOLT?") == "9.9E+37"
    assert int(talk.ask("LOAD:PROT?")) == 2


def test_single_input_load_modules_take_every_other_channel_and_the_others_are_refused():
    talk = chroma(channel=3)
    assert talk.ask("CHAN?") == "1"
    assert talk.numbers("MEAS:VOLT?")[0] == 0.0
    talk.say("*CLS")
    talk.say("CHAN 2")
    assert int(talk.ask("*ESR?")) == 16
    assert talk.ask("CHAN 3;CHAN?") == "3"
    assert talk.ask("CHAN:ID?") == "CHROMA,63640-80-80,636400004321,1.05"
    assert talk.numbers("MEAS:VOLT?")[0] > 35.0
    with pytest.raises(ValueError, match="channels"):
        LoadCore(Module(), np.random.default_rng(1), channel=2)


@pytest.mark.parametrize(("line", "event"), [
    ("VOLTT 3", 32), ("VOLT:STAT:L1", 32), ("VOLT:STAT:L1 x", 32), ("INP ON", 32), ("?", 32), (";;:", 32),
    ("VOLT:STAT:L1 999", 16),
])  # fmt: skip
def test_an_invalid_command_gets_no_answer_changes_no_level_or_input_and_sets_its_event_bit(line, event):
    talk = chroma()
    talk.say("*CLS")
    level = talk.core.level_v
    assert talk.say(line) == []
    assert talk.core.level_v == level
    assert not talk.core.on
    assert int(talk.ask("*ESR?")) == event


def test_the_error_queue_names_the_error_of_an_unknown_command():
    talk = agilent()
    talk.say("*CLS")
    talk.say("NONSENSE 3")
    assert talk.ask("SYST:ERR?") == '-113,"Undefined header"'
    assert int(talk.ask("*ESR?")) == 32


def test_control_c_discards_a_half_received_line():
    talk = chroma()
    talk.core.feed(b"LOAD O", talk.now)
    talk.core.feed(b"\x03", talk.now)
    assert talk.ask("*OPC?") == "1"
    assert talk.core.aborts == 1


def test_a_power_cycle_leaves_the_input_off_and_nothing_latched():
    talk = chroma()
    talk.say("VOLT:STAT:L1 30;:LOAD ON")
    talk.core.trip("over-temperature")
    talk.core.power_cycle(talk.now)
    assert talk.ask("LOAD?") == "OFF"
    assert talk.ask("LOAD:PROT?") == "0"
    assert talk.ask("MODE?") == "CCH"


@given(st.binary(max_size=40))
def test_random_bytes_never_break_the_simulated_load(data):
    talk = chroma()
    talk.core.feed(data, talk.now)
    talk.core.feed(b"\n\x03", talk.now)
    assert talk.ask("*OPC?") == "1"
