import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.transcript import TranscriptEntry, line_of, parse

PIECES = st.builds(TranscriptEntry, st.integers(0, 10**9).map(lambda ms: ms / 1000), st.sampled_from("<>"), st.binary())


@given(st.lists(PIECES))
def test_a_written_transcript_is_read_back_unchanged(pieces):
    lines = ["# a remark", "", *map(line_of, pieces)]
    assert all("\n" not in line for line in lines)
    assert parse(lines) == pieces


@pytest.mark.parametrize("line", ["1.0 >", '1.0 ! "x"', 'soon > "x"', "1.0 > x", "1.0 > 5", '1.0 > "€"'])
def test_a_malformed_transcript_line_is_reported_with_its_number(line):
    with pytest.raises(ValueError, match="line 2 of the transcript"):
        parse(['0.0 > "*IDN?"', line])
