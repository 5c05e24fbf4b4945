"""Numbers that others have written as text."""

import math

import pytest

from drivers.numbers import read_number


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("15", 15.0),
        (" +3.5\r\n", 3.5),
        ("-0.5", -0.5),
        (".5", 0.5),
        ("5.", 5.0),
        ("1.2E-03", 0.0012),
        ("1e400", math.inf),
    ],
)
def test_numbers_in_the_usual_notations_are_read(text, number):
    assert read_number(text) == number


@pytest.mark.parametrize(
    "text", ["", " ", "1_5", "\uff11\uff15", "\u0661", "nan", "inf", "-infinity", "1,5", "0x1F", "1 5", "."]
)
def test_text_that_is_not_a_plain_decimal_number_is_refused(text):
    with pytest.raises(ValueError, match="is not a number"):
        read_number(text)
