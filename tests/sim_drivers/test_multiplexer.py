import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_drivers.multiplexer import DaqWriteError, MultiplexerCore

CONNECTED = range(5)


def volts(channel, now):
    return channel + now / 1000.0 if channel in CONNECTED else None


def test_the_multiplexer_selects_input_7_at_power_up_and_after_a_power_cycle():
    core = MultiplexerCore(volts)
    assert core.selected(0.0) == 7
    core.write(2, 1.0)
    assert core.selected(1.1) == 2
    core.write(3, 2.0)
    core.power_cycle(2.001)
    assert core.selected(2.001) == 7
    assert core.selected(3.0) == 7


@given(st.integers(0, 7), st.integers(0, 7))
def test_a_write_selects_its_channel_after_the_latency_and_not_before(first, second):
    core = MultiplexerCore(volts, latency_s=0.01)
    core.write(first, 0.0)
    core.write(second, 1.0)
    assert core.selected(1.009) == first
    assert core.selected(1.01) == second


def test_writes_take_effect_in_their_order():
    core = MultiplexerCore(volts, latency_s=0.02)
    core.write(1, 0.0)
    core.write(2, 0.01)
    assert [core.selected(now) for now in (0.0, 0.02, 0.03)] == [7, 1, 2]


def test_the_output_follows_the_present_voltage_of_a_connected_input():
    core = MultiplexerCore(volts)
    core.write(3, 0.0)
    assert core.output_voltage(100.0) == pytest.approx(3.1)
    assert core.output_voltage(200.0) == pytest.approx(3.2)


def test_a_floating_input_keeps_the_voltage_of_the_moment_of_switching():
    core = MultiplexerCore(volts, latency_s=0.0)
    core.write(3, 0.0)
    core.output_voltage(100.0)
    core.write(6, 200.0)
    assert core.output_voltage(900.0) == pytest.approx(3.2)
    assert core.output_voltage(1900.0) == pytest.approx(3.2)


def test_the_output_keeps_its_voltage_over_any_number_of_open_inputs_even_if_it_was_not_read():
    core = MultiplexerCore(volts, latency_s=0.0)
    core.write(3, 0.0)
    core.write(6, 100.0)
    for i in range(40):
        core.write(5 + i % 3, 200.0 + i)
    assert core.output_voltage(900.0) == pytest.approx(3.1)


def test_an_output_that_never_had_a_voltage_is_at_zero():
    assert MultiplexerCore(volts).output_voltage(0.0) == 0.0


def test_a_sensor_whose_wire_breaks_keeps_its_last_reading():
    core = MultiplexerCore(lambda channel, now: 0.5 if now < 10.0 else None)
    core.write(1, 0.0)
    assert core.output_voltage(5.0) == 0.5
    assert core.output_voltage(11.0) == 0.5


@pytest.mark.parametrize(("high", "seen"), [(True, [2, 3, 2, 3]), (False, [0, 1, 0, 1])])
def test_a_stuck_address_bit_makes_two_inputs_answer_for_one(high, seen):
    core = MultiplexerCore(volts, latency_s=0.0)
    core.stick(1, high, 0.0)
    found = []
    for channel in range(4):
        core.write(channel, float(channel))
        found.append(core.selected(float(channel)))
    assert found == seen
    core.unstick(10.0)
    assert core.selected(10.0) == 3


def test_a_bit_that_sticks_while_a_channel_is_selected_changes_it_at_once():
    core = MultiplexerCore(volts, latency_s=0.0)
    core.write(4, 0.0)
    core.stick(0, True, 1.0)
    assert core.selected(1.0) == 5


def test_swapped_address_lines_swap_inputs():
    core = MultiplexerCore(volts, latency_s=0.0, address_lines=(1, 0, 2))
    core.write(1, 0.0)
    assert core.selected(0.0) == 2
    core.write(3, 1.0)
    assert core.selected(1.0) == 3


def test_the_enable_line_may_be_active_high_or_active_low():
    high = MultiplexerCore(volts, latency_s=0.0, enable="active-high")
    low = MultiplexerCore(volts, latency_s=0.0, enable="active-low")
    assert high.selected(0.0) == 7
    assert low.selected(0.0) is None
    for core in (high, low):
        core.write(0b0010, 1.0)
    assert high.selected(1.0) is None
    assert low.selected(1.0) == 2
    low.output_voltage(1.0)
    low.write(0b1010, 2.0)
    assert low.output_voltage(3.0) == pytest.approx(2.002)


def test_an_injected_write_error_leaves_the_selection_unchanged():
    core = MultiplexerCore(volts, latency_s=0.0)
    core.write(1, 0.0)
    core.fail_next(-200587, times=2)
    for _ in range(2):
        with pytest.raises(DaqWriteError) as caught:
            core.write(2, 1.0)
        assert caught.value.code == -200587
    assert core.selected(1.0) == 1
    core.write(2, 2.0)
    assert core.selected(2.0) == 2


def test_invalid_values_error_codes_bits_address_lines_and_latencies_are_refused():
    core = MultiplexerCore(volts)
    with pytest.raises(ValueError, match="0 to 15"):
        core.write(16, 0.0)
    with pytest.raises(ValueError, match="negative"):
        core.fail_next(1)
    with pytest.raises(ValueError, match="address bits"):
        core.stick(3, True, 0.0)
    with pytest.raises(ValueError, match="order"):
        MultiplexerCore(volts, address_lines=(0, 0, 1))
    with pytest.raises(ValueError, match="latency"):
        MultiplexerCore(volts, latency_s=float("nan"))
