"""Tables for people fit into 80 columns, and wider ones are continued below."""

import pytest

from daemon.studies.text_table import WIDTH, signed, table


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(-0.004, 2, "+0.00"), (0.0, 1, "+0.0"), (-0.0, 1, "+0.0"), (-0.006, 2, "-0.01"), (3.14, 1, "+3.1")],
)
def test_a_value_that_rounds_to_zero_is_written_without_a_minus(value, digits, text):
    assert signed(value, digits) == text
    assert (signed(float("nan"), 2), signed(float("nan"), 2, "")) == ("-", "")


def test_a_narrow_table_is_written_in_one_piece():
    assert table([("law", "kWh"), ("mu-prime", "9.1"), ("flat", "12.0")]) == [
        "law        kWh",
        "mu-prime   9.1",
        "flat      12.0",
    ]


def test_a_wide_table_is_continued_below_with_its_key_columns_repeated():
    heads = ("date", "period", *(f"quantity {number}" for number in range(9)))
    body = ("2022-10-12", "clear sky", *(f"{number}.00" for number in range(9)))
    lines = table([heads, body], keys=2)
    assert max(map(len, lines)) <= WIDTH
    assert [line.startswith(("date", "2022-10-12  clear sky")) for line in lines if line] == [True] * 6
    assert lines.count("") == 2
    words = " ".join(lines).split()
    assert all(words.count(f"{number}.00") == 1 for number in range(9))


def test_a_column_that_is_too_wide_by_itself_is_put_in_a_part_of_its_own():
    lines = table([("a", "b", "c"), ("1", "x" * 100, "y")])
    assert [len(line.split()) for line in lines] == [2, 2, 0, 2, 2]
