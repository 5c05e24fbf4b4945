"""Note which functions each test enters, and how long it takes, so that a change is put to those tests alone.

Usage: ``python -m tests.mutation.reach reach.json tests/daemon``, then ``tests.mutation.run --reach reach.json``. It is
worth its time, about twice that of the tests, where many tests drive the whole service: the nearest folder then says
little about who enters a function. Whole functions and not lines are noted, because the interpreter tells of calls for
a fraction of what it takes to tell of lines.
"""

import json
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.support import ROOT

_OURS = ("solar", "drivers", "daemon")


def main() -> None:
    """Run the tests that are named and write down what they enter."""
    kept, *paths = sys.argv[1:]
    plugin = Reach(Path(kept))
    code = pytest.main(
        ["-q", "-p", "no:randomly", "-m", "not system and not broker and not campaign", *paths], plugins=[plugin]
    )
    plugin.keep()
    sys.exit(code)


class Reach:
    """A pytest plugin: for each test that passes, its seconds and the functions it enters, ``path:qualified name``."""

    def __init__(self, kept: Path) -> None:
        self._kept = kept
        self._tests: dict[str, dict] = {}
        self._names: dict[object, str | None] = {}
        self._entered: set[object] = set()
        self._failed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item, nextitem):
        """Watch a test with its fixtures."""
        self._entered = set()
        began_s = time.monotonic()
        threading.settrace(self._enter)
        sys.settrace(self._enter)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)
            if item.nodeid not in self._failed:
                functions = sorted({self._names[code] for code in self._entered})
                self._tests[item.nodeid] = {"seconds": time.monotonic() - began_s, "functions": functions}
            if nextitem is None or nextitem.path != item.path:
                self.keep()

    def pytest_runtest_logreport(self, report):
        """Leave out a test that does not pass."""
        if not report.passed:
            self._failed.add(report.nodeid)

    def keep(self) -> None:
        """Write down what is known, with what is there of other tests."""
        known = json.loads(self._kept.read_text()) if self._kept.exists() else {}
        self._kept.write_text(json.dumps(known | self._tests))

    def _enter(self, frame, event, argument):
        code = frame.f_code
        if code not in self._names:
            self._names[code] = _name(code)
        if self._names[code] is not None:
            self._entered.add(code)


def _name(code) -> str | None:
    path = code.co_filename.removeprefix(f"{ROOT}/")
    if not path.startswith(_OURS):
        return None
    # What stands in angles, such as <lambda>, has no name in the source.
    return f"{path}:{'.'.join(part for part in code.co_qualname.split('.') if not part.startswith('<'))}"


if __name__ == "__main__":
    main()
