"""A tier can be chosen by its mark, which no test bears by hand."""

import os
import subprocess
import sys

import pytest

from tests.support import PATIENCE_S, ROOT


@pytest.mark.slow
def test_a_tier_of_tests_is_selected_by_its_mark():
    asked = ["--collect-only", "-q", "-p", "no:cacheprovider", "tests/daemon/mqtt/test_link_status.py"]
    found = [
        subprocess.run(
            [sys.executable, "-m", "pytest", "-m", mark, *asked],
            cwd=ROOT,
            env={name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")},
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE_S,
        ).stdout.count("::test_")
        for mark in ("broker", "rig")
    ]
    assert found == [3, 0]
