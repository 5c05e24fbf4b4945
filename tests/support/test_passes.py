import os
import sys

import psutil
import pytest

from tests.support.passes import POLITE, exit_code, run


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


PATIENT = """
import os, pathlib, subprocess, sys, time
seen = pathlib.Path({seen!r})
def until(nice):
    while os.nice(0) != nice:
        time.sleep(0.02)
    asked = [sys.executable, "-c", "import os; print('child', os.nice(0))"]
    print("own", nice, subprocess.run(asked, capture_output=True, text=True).stdout, flush=True)
    seen.touch()
"""


# Where this itself is among what computes, its own share may change meanwhile.
@pytest.mark.live
def test_what_computes_is_polite_with_its_children_until_it_is_alone(tmp_path):
    own = psutil.Process().nice()
    polite = own + POLITE
    computing = PATIENT.format(seen=str(seen := tmp_path / "seen")) + f"until({polite})\n"
    waiting = f"import pathlib, time\nwhile not pathlib.Path({str(seen)!r}).exists(): time.sleep(0.02)"
    # Who may not take his share back goes on with less.
    may = os.geteuid() == 0
    told = []
    assert run(python(waiting), python(computing + f"until({own})" * may), at_once=True, say=told.append) == 0
    lines = "".join(told)
    assert f"computing | own {polite} child {polite}\n" in lines
    assert (f"computing | own {own} child {own}\n" in lines) is may
