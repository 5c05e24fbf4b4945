"""What reaches the disk, as tests see it."""

import os
from pathlib import Path

import pytest


@pytest.fixture
def synced_files(monkeypatch):
    """Return the names of the files that were synced while not empty, in order."""
    names, fsync = [], os.fsync

    def noted(descriptor):
        fsync(descriptor)
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        if path.is_file() and path.stat().st_size:
            names.append(path.name)

    monkeypatch.setattr(os, "fsync", noted)
    return names
