"""The simulated LabJack refuses what a real one refuses according to LabJack's list of registers."""

import pytest

from drivers.modbus.pdu import decode_number, encode_number
from drivers.modbus.server import RefusedRequestError
from sim_drivers.modbus.labjack import SimulatedLabjack

HALF_VOLT, OVER_SETTLING, NO_NUMBER = (encode_number(value, "float32") for value in (0.5, 50001.0, float("nan")))


def device(product=7):
    return SimulatedLabjack(lambda each, _now_s: 0.01 * each, product)


@pytest.mark.parametrize(
    ("product", "register", "words"),
    [
        (7, 41000, (2,)),
        (7, 41001, (2,)),
        (7, 41500, (13,)),
        (8, 41500, (17,)),
        (7, 40000, HALF_VOLT),
        (7, 40000, encode_number(1.2, "float32")),
        (8, 40000, encode_number(1.0, "float32")),
        (7, 42000, OVER_SETTLING),
        (7, 42000, NO_NUMBER),
        (7, 42000, encode_number(-1.0, "float32")),
        (7, 40000, (0,)),
        (7, 40001, (0, 0)),
        (8, 41008, (199,)),
        (7, 55100, (0, 0)),
        (7, 60000, (0, 0)),
    ],
)
def test_the_simulated_labjack_refuses_writes_that_a_real_one_does_not_take(product, register, words):
    with pytest.raises(RefusedRequestError):
        device(product).write(16, register, words)


def test_a_t8_ignores_negative_channel_and_settling_time():
    labjack = device(8)
    labjack.write(16, 41001, (2,))
    labjack.write(16, 42000, OVER_SETTLING)
    assert labjack.read(3, 41001, 1) == (199,)
    assert labjack.read(3, 42000, 2) == (0, 0)


@pytest.mark.parametrize(("register", "count"), [(0, 1), (1, 2), (40001, 1), (60000, 3), (28, 2)])
def test_reading_part_of_a_value_or_beyond_the_inputs_is_refused(register, count):
    with pytest.raises(RefusedRequestError):
        device().read(3, register, count)


def test_an_input_read_against_ground_includes_the_voltage_drop_of_the_ground_resistor():
    labjack = device()
    against_ground_v = decode_number(labjack.read(3, 4, 2), "float32")
    labjack.write(16, 41002, (3,))
    assert against_ground_v - decode_number(labjack.read(3, 4, 2), "float32") == pytest.approx(0.002, abs=10 / 2**15)


def test_a_power_cycle_resets_range_and_resolution_of_the_labjack():
    labjack = device()
    labjack.write(16, 40000, encode_number(0.1, "float32"))
    labjack.write(16, 41500, (8,))
    labjack.power_cycle(0.0)
    assert decode_number(labjack.read(3, 40000, 2), "float32") == 10.0
    assert labjack.read(3, 41500, 1) == (0,)
