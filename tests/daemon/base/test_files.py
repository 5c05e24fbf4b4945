"""Files that are written as a whole or not at all: a person's own, which stay that person's, and secrets."""

import os
import stat
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from daemon.base.errors import UserError
from daemon.base.files import atomic_text_file, read_secret, replace_file, rewrite_file, write_secret
from daemon.base.state import replace_state_file
from tests.daemon.store.test_full_disk import fill, small_disk

__all__ = ["small_disk"]


def test_rewriting_a_file_keeps_its_owner_and_mode_and_the_link_to_it(tmp_path):
    file, link = tmp_path / "real.toml", tmp_path / "link.toml"
    file.write_text("a = 1\n")
    file.chmod(0o640)
    if os.geteuid() == 0:
        os.chown(file, 65534, 65534)
    before = file.stat()
    link.symlink_to(file)
    rewrite_file(link, "b = 2\n")
    after = file.stat()
    assert (file.read_text(), link.is_symlink()) == ("b = 2\n", True)
    assert (after.st_uid, after.st_gid, stat.S_IMODE(after.st_mode)) == (before.st_uid, before.st_gid, 0o640)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.toml", "real.toml"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows syncs no folders")
@pytest.mark.parametrize("write", [replace_file, rewrite_file, replace_state_file])
def test_replacing_a_file_returns_only_after_its_folder_is_synced_to_disk(tmp_path, monkeypatch, write):
    file, synced_files, fsync = tmp_path / "kept.json", [], os.fsync
    file.write_text("before")

    def noted(descriptor):
        fsync(descriptor)
        if os.path.samestat(os.fstat(descriptor), tmp_path.stat()):
            synced_files.append(file.read_text())

    monkeypatch.setattr(os, "fsync", noted)
    write(file, "after")
    # If only memory knows of a rename, a power cut brings back the file from before.
    assert synced_files == ["after"]


def test_writing_a_file_through_a_link_keeps_the_link_and_replaces_a_link_to_itself(tmp_path):
    file, link, loop = tmp_path / "real.csv", tmp_path / "link.csv", tmp_path / "loop.csv"
    link.symlink_to(file)
    loop.symlink_to(loop)
    for path in (link, loop):
        with atomic_text_file(path) as written:
            written.write("a\n")
    assert (file.read_text(), link.is_symlink(), loop.read_text(), loop.is_symlink()) == ("a\n", True, "a\n", False)


def test_rewriting_a_file_on_a_full_disk_leaves_it_unchanged(small_disk):
    file = small_disk / "heliocube.toml"
    file.write_text("a = 1\n")
    fill(small_disk / "filler")
    with pytest.raises(OSError, match="No space left"):
        rewrite_file(file, "b = 2\n" * 1000)
    assert file.read_text() == "a = 1\n"
    assert sorted(path.name for path in small_disk.iterdir()) == ["filler", "heliocube.toml"]


def test_a_secret_that_does_not_fit_on_a_full_disk_leaves_no_file(small_disk):
    file = small_disk / "bridge.key"
    fill(small_disk / "filler")
    with pytest.raises(UserError, match=r"^the key cannot be written: No space left on device$"):
        write_secret(file, b"k" * 10000, "the key", UserError)
    assert not file.exists()
    (small_disk / "filler").unlink()
    write_secret(file, b"whole", "the key", UserError)
    assert (file.read_bytes(), stat.S_IMODE(file.stat().st_mode)) == (b"whole", 0o600)
    with pytest.raises(UserError, match="exists and is not overwritten"):
        write_secret(file, b"other", "the key", UserError)
    assert file.read_bytes() == b"whole"


def test_a_secret_in_a_folder_that_may_not_be_entered_is_refused_in_one_sentence():
    user = os.geteuid()
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_secret(folder / "bridge.key", b"k", "the key", UserError)
        folder.chmod(0)
        try:
            if user == 0:
                os.seteuid(65534)
            with pytest.raises(UserError, match=r"^the key cannot be read: Permission denied$"):
                read_secret(folder / "bridge.key", 100, "the key", "missing", UserError, group_may_read=False)
        finally:
            os.seteuid(user)
            folder.chmod(0o700)
