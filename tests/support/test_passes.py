import sys

import pytest

from tests.support.passes import exit_code, has_session_share_bug, run, smaller_session_share


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
def test_the_exit_code_of_two_test_passes_reports_a_failure_of_either(codes, together):
    assert exit_code(codes) == together


@pytest.mark.parametrize("at_once", [True, False])
def test_each_output_line_bears_the_name_of_its_test_pass_and_results_are_printed_in_one_piece(at_once):
    told = []
    waiting = python("print('== test session starts ==\\n....', '\\n== FAILURES ==\\nit failed\\n=== 1 failed ==')")
    computing = python("print('....\\n== 3 passed ==\\n'); raise SystemExit(1)")
    assert run(waiting, computing, at_once=at_once, say=told.append) == 1
    lines = [text.strip() for text in told]
    assert "waiting | == test session starts ==" in lines
    assert any("== FAILURES ==\nit failed\n=== 1 failed ==" in text for text in lines)
    assert "computing | ...." in lines


@pytest.mark.parametrize(
    ("release", "wrong"),
    [
        ("6.1.0-37-amd64", False),
        ("6.11.9-amd64", False),
        ("6.12.48-amd64", True),
        ("6.18-rc1", True),
        ("6.18.44-cloud", True),
        ("6.18.45", False),
        ("7.0.1", False),
        ("unknown", False),
    ],
)
def test_the_session_gets_a_smaller_share_only_on_kernels_that_misplace_sessions(tmp_path, release, wrong):
    share = tmp_path / "autogroup"
    share.write_text("/autogroup-17 nice 2\n")
    assert has_session_share_bug(release) is wrong
    with smaller_session_share(share, release):
        assert (share.read_text() == "6") is wrong
    assert share.read_text().strip() == ("2" if wrong else "/autogroup-17 nice 2")


def test_on_a_kernel_without_session_shares_no_share_is_written(tmp_path):
    with smaller_session_share(tmp_path / "nothing", "6.18.44"):
        assert not (tmp_path / "nothing").exists()
