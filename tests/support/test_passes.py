import sys

import pytest

from tests.support.passes import exit_code, run


def python(code):
    return (sys.executable, "-c", code)


@pytest.mark.parametrize(
    ("codes", "together"),
    [
        ((0, 0), 0),
        ((1, 0), 1),
        ((0, 1), 1),
        ((5, 0), 0),
        ((0, 5), 0),
        ((5, 5), 5),
        ((5, 1), 1),
        ((1, 2), 2),
        ((0, 4), 4),
    ],
)
def test_a_failure_of_either_is_one_of_both(codes, together):
    assert exit_code(codes) == together


@pytest.mark.parametrize("at_once", [True, False])
def test_each_line_bears_its_pass_and_results_come_in_one_piece(at_once):
    told = []
    waiting = python("print('== test session starts ==\\n....', '\\n== FAILURES ==\\nit failed\\n=== 1 failed ==')")
    computing = python("print('....\\n== 3 passed ==\\n'); raise SystemExit(1)")
    assert run(waiting, computing, at_once=at_once, say=told.append) == 1
    lines = [text.strip() for text in told]
    assert "waiting | == test session starts ==" in lines
    assert any("== FAILURES ==\nit failed\n=== 1 failed ==" in text for text in lines)
    assert "computing | ...." in lines
