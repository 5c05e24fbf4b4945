"""What each make's registers mean, and which of their values are believed."""

import math

import pytest

from drivers.cube.pyranometers.makes import Hukseflux, Smp, WrongSensorError, make_of
from drivers.cube.pyranometers.settings import RegisterMapSettings

SMP_NOON = (601, 100, 1, 0, 0, 997, 997)


def smp(**changes):
    words = dict(zip(("kind", "model", "mode", "status", "scale", "value", "raw"), SMP_NOON, strict=True)) | changes
    return Smp().told(tuple(word & 0xFFFF for word in words.values()))


def test_a_captured_smp_at_noon():
    assert smp() == (997.0, None, "")


def test_its_scale_and_sign():
    found = [smp(scale=scale, value=value).w_m2 for scale, value in ((2, 1234), (1, 9970), (-1, 99), (1, -31))]
    assert found == [12.34, 997.0, 990.0, -3.1]


def test_in_another_mode_it_is_not_believed():
    for mode, word in {2: "service", 3: "calibration", 4: "factory", 5: "fatal", 9: "mode 9"}.items():
        told = smp(mode=mode)
        assert math.isnan(told.w_m2)
        assert told.flaw == "missing"
        assert word in told.note


def test_with_a_flag_it_is_not_believed():
    for bit in (0, 2, 4, 5, 6, 7):
        told = smp(status=1 << bit)
        assert math.isnan(told.w_m2)
        assert (told.flaw, told.note[:7]) == ("missing", "reports")


def test_an_overflow_is_over_range():
    assert smp(status=2).flaw == "over-range"


def test_bit_three_alone_is_a_warning_with_a_remedy():
    told = smp(status=8)
    assert (told.w_m2, told.flaw) == (997.0, None)
    assert "--clear" in told.note


def test_power_tilt_and_humidity_spoil_no_irradiance():
    assert {smp(status=bits) for bits in (1 << 8, 1 << 9, 1 << 12)} == {(997.0, None, "")}


def test_a_scale_that_the_manual_does_not_know_gives_nothing():
    assert "scale 7" in smp(scale=7).note


def test_what_is_no_smp_pyranometer_is_refused():
    for kind, word in {613: "pyrheliometer", 609: "pyrgeometer", 4: "type 4"}.items():
        with pytest.raises(WrongSensorError, match=word):
            smp(kind=kind)


def test_an_smp_says_who_it_is():
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
def test_what_is_next_to_them_is_none(kind):
    with pytest.raises(WrongSensorError):
        smp(kind=kind)


def test_an_sr20_is_divided_by_its_own_scale():
    make = Hukseflux()
    assert make.told((1, 0x7C4F)).w_m2 == 973.59, "in hundredths, until it says otherwise"
    assert make.serial((4321, 0, 0)) == 4321
    model = tuple(ord(low) | ord(high) << 8 for low, high in ("SR", "20", "-D", "2 ", "  "))
    assert make.identify((4321, 0, 0), (2225, 1234, 100, 100), model) == ("SR20-D2 no. 4321", 4321)
    assert make.told((1, 0x7C4F)).w_m2 == 973.59
    make.identify((4321, 0, 0), (2225, 1234, 1000, 100), model)
    assert make.told((1, 0x7C4F)).w_m2 == 97.359
    assert make.told((0xFFFF, 0xFE0C)).w_m2 == -0.5
    make.identify((4321, 0, 0), (2225, 1234, 1, 100), model)
    assert make.told((1, 0x7C4F)).w_m2 == 97359.0
    with pytest.raises(WrongSensorError, match="has the scale 0 in register 8"):
        make.identify((4321, 0, 0), (2225, 1234, 0, 100), model)


def test_the_ends_of_its_range_are_no_values():
    assert {Hukseflux().told(ends).flaw for ends in ((0x7FFF, 0xFFFF), (0x8000, 0))} == {"over-range"}


def test_what_is_no_sr_is_refused():
    with pytest.raises(WrongSensorError, match="is not a Hukseflux"):
        Hukseflux().identify((1, 0, 0), (0, 0, 100, 0), (0x4241, 0, 0, 0, 0))


def test_hukseflux_is_never_asked_for_more_than_five_registers():
    for name in ("hukseflux", "hukseflux-pv"):
        make = make_of(name, RegisterMapSettings())
        blocks = [make.data, make.proof, *make.more]
        assert max(block.length for block in blocks) == 5
        assert len({block.length for block in blocks}) == len(blocks)


def test_a_late_reply_cannot_pass_for_one_to_the_other_question():
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


def test_a_map_reads_any_plain_register():
    for used, words, w_m2 in MAPPED:
        make = make_of("map", RegisterMapSettings(**used))
        assert make.data.length == len(words)
        assert make.told(words).w_m2 == pytest.approx(w_m2)


def test_a_map_heeds_its_status():
    make = make_of("map", RegisterMapSettings(number_type="int16", register_number=8, status_register=9, status_bits=5))
    assert make.told((300, 4)).note == "reports status bits 0x0004"


@pytest.mark.parametrize(
    ("used", "block", "words", "who"),
    [
        ({}, (3, 0, 1), (0,), ("pyranometer", None)),
        ({"serial_register": 40, "serial_type": "uint32"}, (3, 40, 2), (1, 2), ("pyranometer no. 65538", 65538)),
        ({"serial_register": 40, "serial_type": "uint16"}, (3, 40, 1), (7,), ("pyranometer no. 7", 7)),
    ],
)
def test_a_map_is_proven_by_its_serial_number_if_it_names_one(used, block, words, who):
    make = make_of("map", RegisterMapSettings(number_type="float32", **used))
    assert make.proof == block
    assert make.identify(words) == who


def test_a_float_that_is_none_gives_nothing():
    assert make_of("apogee", RegisterMapSettings()).told((0x7FC0, 0)).flaw == "missing"
