"""Tests lie in the same folders as what they test."""

import pytest

from tests.support import ROOT

MIRRORED = ("solar", "drivers", "sim_drivers", "daemon", "heliocube", "docs")
# Recorded bytes, not tests.
RECORDS = {ROOT / "tests" / "drivers" / "transcripts"}


@pytest.mark.parametrize("top", MIRRORED)
def test_every_test_folder_mirrors_a_source_folder(top):
    own = ROOT / "tests" / top
    folders = [own, *(path for path in own.rglob("*") if path.is_dir() and path.name != "__pycache__")]
    astray = [
        str(path.relative_to(ROOT))
        for path in folders
        if path not in RECORDS and not (ROOT / path.relative_to(ROOT / "tests")).is_dir()
    ]
    assert not astray, f"no such folder in the source: {astray}"


def test_top_level_test_folders_are_mirrored_packages_or_known_tiers():
    tiers = {"campaign", "firmware", "fuzz", "mutation", "support", "system"}
    # Tests at the top look at the whole house.
    places = {path.relative_to(ROOT / "tests").parts[0] for path in (ROOT / "tests").rglob("*/test_*.py")}
    assert places <= tiers | set(MIRRORED)
