"""An older file in today's form: what it means stays, comments stay, the old one stays beside it."""

import stat
import tomllib

import pytest

from daemon.base.errors import UserError
from daemon.config.file import load_settings
from daemon.config.migrate import migrate

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
    old = path.with_name("heliocube.toml.before")
    told = migrate(path)
    assert told == (
        f"{path} is in today's form: its tracker is named roof, law.name is law.driver now; the old one is {old}"
    )
    assert path.read_text() == OLDER.replace('name = "flat"', 'driver = "flat"') + '\n[[tracker]]\nname = "roof"\n'
    assert old.read_text() == OLDER
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(old.stat().st_mode) == 0o640
    ((name, own),) = load_settings(path).trackers
    assert (name, own.law.driver, own.mqtt.name) == (before.trackers[0].name, "flat", "roof")


def test_a_file_that_is_in_todays_form_is_left_alone(file):
    path = file(OLDER)
    migrate(path)
    text = path.read_text()
    path.with_name("heliocube.toml.before").unlink()
    assert migrate(path) == f"{path} needs nothing: it is in today's form"
    assert path.read_text() == text
    assert not path.with_name("heliocube.toml.before").exists()


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
    path.write_text(OLDER)
    path.with_name("heliocube.toml.before").write_text("precious")
    with pytest.raises(UserError, match="is not overwritten"):
        migrate(path)
    assert path.read_text() == OLDER
    assert path.with_name("heliocube.toml.before").read_text() == "precious"
