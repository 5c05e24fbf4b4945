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
from tests.support.disk import synced

__all__ = ["small_disk", "synced"]

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


def test_comments_and_order_stay_and_the_old_file_too(file):
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


def test_a_file_that_is_in_todays_form_is_left_alone(file):
    path = file(OLDER)
    migrate(path)
    text = path.read_text()
    path.with_name(BEFORE).unlink()
    assert migrate(path) == f"{path} is up to date: nothing was changed"
    assert path.read_text() == text
    assert not path.with_name(BEFORE).exists()


def test_the_tables_of_trackers_are_brought_up_to_date_as_well(file):
    path = file('[[tracker]]\nname = "east" # the near one\n[tracker.law]\nname = "flat"\n')
    assert "law.name is law.driver now" in migrate(path)
    assert path.read_text() == '[[tracker]]\nname = "east" # the near one\n[tracker.law]\ndriver = "flat"\n'


def test_what_stands_in_one_line_is_written_anew_without_comments(file):
    path = file('law = {name = "flat"} # short\n')
    assert migrate(path).endswith("its comments are in the old one only")
    assert tomllib.loads(path.read_text()) == {"law": {"driver": "flat"}, "tracker": [{"name": "tracker"}]}


def test_what_cannot_be_is_told_and_nothing_is_written(file):
    path = file('[mqtt]\nname = "two words"\n')
    with pytest.raises(UserError, match="a tracker's name is 1 to 32 letters"):
        migrate(path)
    assert not path.with_name(BEFORE).exists()


def test_an_old_file_that_is_kept_already_is_not_overwritten(file):
    path = file(OLDER)
    path.with_name(BEFORE).write_text("precious")
    assert migrate(path).endswith(f"; the old one is {path.with_name(BEFORE)}-2")
    assert path.with_name(BEFORE).read_text() == "precious"
    assert path.with_name(f"{BEFORE}-2").read_text() == OLDER


def test_an_upgrade_gives_keys_their_names_and_a_tracker_none(file):
    path = file(OLDER)
    assert migrate(path, keys_only=True).startswith(f"{path} is updated: law.name is law.driver now; ")
    assert path.read_text() == OLDER.replace('name = "flat"', 'driver = "flat"')
    assert migrate(path, keys_only=True) == f"{path} is up to date: nothing was changed"


@pytest.mark.skipif(sys.platform != "linux", reason="what is synced is seen in /proc")
def test_the_old_file_is_on_the_disk_before_the_new_one_takes_its_place(file, synced):
    path = file(OLDER)
    migrate(path)
    assert synced == [BEFORE, ".heliocube.toml.part"]


@pytest.mark.parametrize("room_bytes", [0, 4096])
def test_on_a_full_disk_nothing_is_kept_that_is_not_whole_nor_without_need(small_disk, room_bytes):
    path = small_disk / "heliocube.toml"
    path.write_text(OLDER)
    fill(small_disk / "filler")
    os.truncate(small_disk / "filler", (small_disk / "filler").stat().st_size - room_bytes)
    with pytest.raises(UserError, match="cannot be migrated: No space left"):
        migrate(path)
    assert sorted(each.name for each in small_disk.iterdir()) == ["filler", "heliocube.toml"]
    assert path.read_text() == OLDER
