"""What a law has learned survives a restart, and an unreadable file is not a fresh beginning."""

from daemon.base.state import StateFolder
from daemon.tracker.law_file import FILE_NAME, LawFile


def test_what_was_learned_is_there_for_the_next_start(tmp_path):
    LawFile(StateFolder(tmp_path)).save({"albedo": 0.2})
    assert LawFile(StateFolder(tmp_path)).load() == {"albedo": 0.2}


def test_a_law_that_has_learned_nothing_leaves_what_is_there(tmp_path):
    LawFile(StateFolder(tmp_path)).save({"albedo": 0.2})
    LawFile(StateFolder(tmp_path)).save(None)
    assert LawFile(StateFolder(tmp_path)).load() == {"albedo": 0.2}
    assert LawFile(StateFolder(tmp_path), "another.json").load() is None


def test_what_cannot_be_read_is_learned_anew_and_said(tmp_path, caplog):
    (tmp_path / FILE_NAME).write_text('{"albedo": ')
    assert LawFile(StateFolder(tmp_path)).load() is None
    assert "learned.json cannot be used: the law learns the site again from the beginning" in caplog.text
