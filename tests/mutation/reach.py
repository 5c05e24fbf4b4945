"""Note which lines each test reaches and how long it takes, so that all tests that reach a change are run for it.

Usage: ``python -m tests.mutation.reach reach.json tests/daemon``, then ``tests.mutation.run --reach reach.json``. New
notes of a test replace its old ones; those of all others stay. Other arguments go to pytest.

With a tracer these tests take three times as long (coverage 7.17, Python 3.11). Instead, in a copy of the tree, each
block of our functions gets a statement that sets one byte, which costs next to nothing.
"""

import argparse
import importlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path

import pytest

from tests.mutation.blocks import HITS, digest, marked
from tests.mutation.nearest import OURS
from tests.mutation.tree import begin_afresh, copy_into
from tests.support import ROOT


def main() -> None:
    """Run the named tests and note what they reach."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("kept", type=Path, metavar="FILE", help="file for the notes, as JSON")
    parser.add_argument("tests", nargs="+", help="files and folders of tests; other arguments go to pytest")
    known, for_pytest = parser.parse_known_args()
    kept, asked = known.kept.absolute(), [*known.tests, *for_pytest]
    sources = {str(file.relative_to(ROOT)): digest(file) for folder in OURS for file in (ROOT / folder).rglob("*.py")}
    with tempfile.TemporaryDirectory(prefix="heliocube-reach-") as folder:
        tree = copy_into(Path(folder))
        blocks = _mark(tree)
        os.chdir(tree)
        begin_afresh()
        plugin = Reach(importlib.import_module(HITS).HITS, blocks)
        options = ["-q", "--tb=line", "-p", "no:randomly", "-p", "no:cacheprovider", "-p", "no:schemathesis"]
        try:
            code = pytest.main([*options, *asked], plugins=[plugin])
        finally:
            plugin.write(kept, sources)
    # Tests that fail in a copy of the tree are left out, and named.
    sys.exit(0 if code == pytest.ExitCode.TESTS_FAILED else code)


class Reach:
    """A pytest plugin that notes for each test that passes its seconds and the blocks that it reaches."""

    def __init__(self, hits: bytearray, blocks: list[str]) -> None:
        self._hits = hits
        self._blocks = blocks
        self._tests: dict[str, dict] = {}
        self._failed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item, nextitem):
        """Watch a test with its fixtures."""
        self._hits[:] = bytes(len(self._hits))
        began_s = time.monotonic()
        try:
            return (yield)
        finally:
            reached = [block for block, hit in zip(self._blocks, self._hits, strict=True) if hit]
            self._tests[item.nodeid] = {"seconds": time.monotonic() - began_s, "blocks": reached}

    def pytest_runtest_logreport(self, report):
        """Leave out a test that does not pass."""
        if not report.passed:
            self._failed.add(report.nodeid)

    def write(self, kept: Path, sources: dict[str, str]) -> None:
        """Write the notes down, together with those of other tests."""
        known = json.loads(kept.read_text()) if kept.exists() else {"tests": {}}
        passed = {test: entry for test, entry in self._tests.items() if test not in self._failed}
        kept.write_text(json.dumps({"sources": sources, "tests": known["tests"] | passed}))


def _mark(tree: Path) -> list[str]:
    blocks: list[str] = []
    for file in sorted(file for folder in OURS for file in (tree / folder).rglob("*.py")):
        file.write_text(marked(str(file.relative_to(tree)), file.read_bytes(), blocks))
    (tree / f"{HITS}.py").write_text(f"HITS = bytearray({len(blocks)})\n")
    return blocks


if __name__ == "__main__":
    main()
