"""An older file in today's form: its meaning stays, comments stay, the old file stays beside it."""

import os
import stat
import sys
import tomllib

import pytest

from daemon.base.errors import UserError
from daemon.base.installation import release
from daemon.config.file import load_settings
from daemon.config.migrate import migrate
from tests.daemon.store.test_full_disk import fill, small_disk
from tests.support.disk import synced_files

__all__ = ["small_disk", "synced_files"]

BEFORE = f"heliocube.toml.before-{release()}"
OLDER = """\
# The roof.
[mqtt]
name = "roof"   # on the broker

[law]
# the paper's
name = "flat"   # for now
thrift = 2.0
"""


@pytest.fixture
def file(tmp_path):
    """Write a file and return its path."""

    def write(text):
        path = tmp_path / "heliocube.toml"
        path.write_text(text)
        path.chmod(0o640)
        return path

    return write


def test_migration_keeps_comments_order_and_the_old_file(file):
    path = file(OLDER)
    before = load_settings(path)
    old = path.with_name(BEFORE)
    told = migrate(path)
    assert told == (f"{path} is updated: its tracker is named roof, law.name is law.driver now; the old one is {old}")
    assert path.read_text() == OLDER.replace('name = "flat"', 'driver = "flat"') + '\n[[tracker]]\nname = "roof"\n'
    assert old.read_text() == OLDER
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(old.stat().st_mode) == 0o640
    ((name, own),) = load_settings(path).trackers
    assert (name, own.law.driver, own.mqtt.name) == (before.trackers[0].name, "flat", "roof")


def test_migration_leaves_an_up_to_date_file_alone(file):
    path = file(OLDER)
    migrate(path)
    text = path.read_text()
    path.with_name(BEFORE).unlink()
    assert migrate(path) == f"{path} is up to date: nothing was changed"
    assert path.read_text() == text
    assert not path.with_name(BEFORE).exists()


def test_migration_updates_the_tables_of_trackers_too(file):
    path = file('[[tracker]]\nname = "east" # the near one\n[tracker.law]\nname = "flat"\n')
    assert "law.name is law.driver now" in migrate(path)
    assert path.read_text() == '[[tracker]]\nname = "east" # the near one\n[tracker.law]\ndriver = "flat"\n'


def test_migration_rewrites_an_inline_table_without_its_comments(file):
    path = file('law = {name = "flat"} # short\n')
    assert migrate(path).endswith("its comments are in the old one only")
    assert tomllib.loads(path.read_text()) == {"law": {"driver": "flat"}, "tracker": [{"name": "tracker"}]}


def test_migration_to_an_invalid_tracker_name_is_refused_and_writes_nothing(file):
    path = file('[mqtt]\nname = "two words"\n')
    with pytest.raises(UserError, match="a tracker's name is 1 to 32 letters"):
        migrate(path)
    assert not path.with_name(BEFORE).exists()


def test_migration_does_not_overwrite_an_old_file_that_was_kept_before(file):
    path = file(OLDER)
    path.with_name(BEFORE).write_text("precious")
    assert migrate(path).endswith(f"; the old one is {path.with_name(BEFORE)}-2")
    assert path.with_name(BEFORE).read_text() == "precious"
    assert path.with_name(f"{BEFORE}-2").read_text() == OLDER


def test_migration_of_keys_only_renames_keys_and_gives_the_tracker_no_name(file):
    path = file(OLDER)
    assert migrate(path, keys_only=True).startswith(f"{path} is updated: law.name is law.driver now; ")
    assert path.read_text() == OLDER.replace('name = "flat"', 'driver = "flat"')
    assert migrate(path, keys_only=True) == f"{path} is up to date: nothing was changed"


@pytest.mark.skipif(sys.platform != "linux", reason="what is synced is seen in /proc")
def test_migration_syncs_the_old_file_to_disk_before_the_new_one_replaces_it(file, synced_files):
    path = file(OLDER)
    migrate(path)
    assert synced_files == [BEFORE, ".heliocube.toml.part"]


@pytest.mark.parametrize("room_bytes", [0, 4096])
def test_a_migration_that_fails_on_a_full_disk_changes_no_file_and_leaves_no_part(small_disk, room_bytes):
    path = small_disk / "heliocube.toml"
    path.write_text(OLDER)
    fill(small_disk / "filler")
    os.truncate(small_disk / "filler", (small_disk / "filler").stat().st_size - room_bytes)
    with pytest.raises(UserError, match="cannot be migrated: No space left"):
        migrate(path)
    assert sorted(each.name for each in small_disk.iterdir()) == ["filler", "heliocube.toml"]
    assert path.read_text() == OLDER
