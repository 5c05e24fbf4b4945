"""What each make's registers mean, and which of their values are believed."""

import math

import pytest

from drivers.cube.pyranometers.makes import Hukseflux, Smp, WrongSensorError, make_of
from drivers.cube.pyranometers.settings import RegisterMapSettings

SMP_NOON = (601, 100, 1, 0, 0, 997, 997)


def smp(**changes):
    words = dict(zip(("kind", "model", "mode", "status", "scale", "value", "raw"), SMP_NOON, strict=True)) | changes
    return Smp().decode(tuple(word & 0xFFFF for word in words.values()))


def test_the_captured_registers_of_an_smp_at_noon_give_997_w_m2():
    assert smp() == (997.0, None, "")


def test_an_smp_value_is_decoded_with_its_scale_and_sign():
    found = [smp(scale=scale, value=value).w_m2 for scale, value in ((2, 1234), (1, 9970), (-1, 99), (1, -31))]
    assert found == [12.34, 997.0, 990.0, -3.1]


def test_an_smp_value_in_any_mode_but_the_normal_one_is_missing_with_a_note():
    for mode, word in {2: "service", 3: "calibration", 4: "factory", 5: "fatal", 9: "mode 9"}.items():
        told = smp(mode=mode)
        assert math.isnan(told.w_m2)
        assert told.flaw == "missing"
        assert word in told.note


def test_an_smp_value_with_an_error_flag_is_missing_with_a_note():
    for bit in (0, 2, 4, 5, 6, 7):
        told = smp(status=1 << bit)
        assert math.isnan(told.w_m2)
        assert (told.flaw, told.note[:7]) == ("missing", "reports")


def test_an_smp_overflow_flag_means_over_range():
    assert smp(status=2).flaw == "over-range"


def test_smp_status_bit_3_alone_keeps_the_value_and_gives_a_note_with_the_remedy():
    told = smp(status=8)
    assert (told.w_m2, told.flaw) == (997.0, None)
    assert "--clear" in told.note


def test_smp_power_tilt_and_humidity_flags_do_not_affect_the_irradiance():
    assert {smp(status=bits) for bits in (1 << 8, 1 << 9, 1 << 12)} == {(997.0, None, "")}


@pytest.mark.parametrize("scale", [3, 7, -2])
def test_an_smp_value_with_a_scale_that_the_manual_does_not_list_is_missing_with_a_note(scale):
    told = smp(scale=scale)
    assert math.isnan(told.w_m2)
    assert (told.flaw, told.note) == ("missing", f"has the scale {scale}, which is not in its manual")


def test_a_device_that_is_not_an_smp_pyranometer_is_refused_with_its_type():
    for kind, word in {613: "pyrheliometer", 609: "pyrgeometer", 4: "type 4"}.items():
        with pytest.raises(WrongSensorError, match=word):
            smp(kind=kind)


def test_an_smp_is_identified_by_its_type_serial_number_and_software():
    who = Smp().identify((2023, 180123, 108, 5, 1), (633, 107))
    assert who == ("SMP12 no. 180123 of 2023, software 108", 180123)
    assert Smp().serial((2023, 180123, 108, 5, 1)) == 180123


@pytest.mark.parametrize(("name", "kinds"), [
    ("SMP3", (601, 602)), ("SMP11", (603, 604)), ("SMP21", (605, 606)), ("SMP22", (607, 608)), ("SMP10", (617, 618)),
    ("SMP6", (619, 620)), ("SMP12", (633,)), ("SMP of type 611", (611,)),
])  # fmt: skip
def test_every_type_of_smp_has_its_name(name, kinds):
    for kind in kinds:
        assert Smp().identify((2023, 1, 108, 5, 1), (kind, 107)).text == f"{name} no. 1 of 2023, software 108"


@pytest.mark.parametrize("kind", [599, 609, 610, 613, 614, 700])
def test_type_numbers_beside_those_of_smp_pyranometers_are_refused(kind):
    with pytest.raises(WrongSensorError):
        smp(kind=kind)


def test_sr20_values_are_divided_by_the_scale_that_the_sensor_reports():
    make = Hukseflux()
    assert make.decode((1, 0x7C4F)).w_m2 == 973.59, "in hundredths, until it says otherwise"
    assert make.serial((4321, 0, 0)) == 4321
    model = tuple(ord(low) | ord(high) << 8 for low, high in ("SR", "20", "-D", "2 ", "  "))
    assert make.identify((4321, 0, 0), (2225, 1234, 100, 100), model) == ("SR20-D2 no. 4321", 4321)
    assert make.decode((1, 0x7C4F)).w_m2 == 973.59
    make.identify((4321, 0, 0), (2225, 1234, 1000, 100), model)
    assert make.decode((1, 0x7C4F)).w_m2 == 97.359
    assert make.decode((0xFFFF, 0xFE0C)).w_m2 == -0.5
    make.identify((4321, 0, 0), (2225, 1234, 1, 100), model)
    assert make.decode((1, 0x7C4F)).w_m2 == 97359.0
    with pytest.raises(WrongSensorError, match="has the scale 0 in register 8"):
        make.identify((4321, 0, 0), (2225, 1234, 0, 100), model)


def test_hukseflux_values_at_the_ends_of_the_number_range_are_over_range():
    assert {Hukseflux().decode(ends).flaw for ends in ((0x7FFF, 0xFFFF), (0x8000, 0))} == {"over-range"}


def test_a_device_that_is_not_a_hukseflux_sr_is_refused():
    with pytest.raises(WrongSensorError, match="is not a Hukseflux"):
        Hukseflux().identify((1, 0, 0), (0, 0, 100, 0), (0x4241, 0, 0, 0, 0))


def test_hukseflux_is_never_asked_for_more_than_five_registers():
    for name in ("hukseflux", "hukseflux-pv"):
        make = make_of(name, RegisterMapSettings())
        blocks = [make.data, make.proof, *make.more]
        assert max(block.length for block in blocks) == 5
        assert len({block.length for block in blocks}) == len(blocks)


def test_the_data_and_proof_questions_of_every_make_have_replies_of_different_length():
    for name in ("smp", "hukseflux", "hukseflux-pv", "apogee", "eko-ms60s", "delta-ohm"):
        make = make_of(name, RegisterMapSettings())
        assert make.proof.length != make.data.length


MAPPED = [
    ({"number_type": "int16", "scale": 0.1}, (0xFFE2,), -3.0),
    ({"number_type": "uint16"}, (1005,), 1005.0),
    ({"number_type": "float32"}, (0x447A, 0), 1000.0),
    ({"number_type": "float32", "word_order": "low-first"}, (0, 0x447A), 1000.0),
    ({"number_type": "int32", "scale": 0.001}, (0xF, 0x4240), 1000.0),
    ({"number_type": "int16", "register_number": 10, "status_register": 8}, (0, 55, 300), 300.0),
    ({"number_type": "int16", "register_number": 8, "status_register": 9, "status_bits": 1}, (300, 6), 300.0),
]


def test_a_configured_register_map_reads_every_number_type_and_word_order():
    for used, words, w_m2 in MAPPED:
        make = make_of("map", RegisterMapSettings(**used))
        assert make.data.length == len(words)
        assert make.decode(words).w_m2 == pytest.approx(w_m2)


def test_a_configured_register_map_reports_the_bits_of_its_status_register():
    make = make_of("map", RegisterMapSettings(number_type="int16", register_number=8, status_register=9, status_bits=5))
    assert make.decode((300, 4)).note == "reports status bits 0x0004"


@pytest.mark.parametrize(
    ("used", "block", "words", "who"),
    [
        ({}, (3, 0, 1), (0,), ("pyranometer", None)),
        ({"serial_register": 40, "serial_type": "uint32"}, (3, 40, 2), (1, 2), ("pyranometer no. 65538", 65538)),
        ({"serial_register": 40, "serial_type": "uint16"}, (3, 40, 1), (7,), ("pyranometer no. 7", 7)),
    ],
)
def test_a_register_map_identifies_its_sensor_by_serial_number_if_it_names_that_register(used, block, words, who):
    make = make_of("map", RegisterMapSettings(number_type="float32", **used))
    assert make.proof == block
    assert make.identify(words) == who


def test_a_nan_in_a_float_register_gives_a_missing_value():
    assert make_of("apogee", RegisterMapSettings()).decode((0x7FC0, 0)).flaw == "missing"
