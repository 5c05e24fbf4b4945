"""What a law has learned survives a restart, and an unreadable file is not a fresh beginning."""

from daemon.base.state import StateFolder
from daemon.tracker.law_file import FILE_NAME, LawFile


def test_the_learned_values_of_a_law_are_loaded_at_the_next_start(tmp_path):
    LawFile(StateFolder(tmp_path)).save({"albedo": 0.2})
    assert LawFile(StateFolder(tmp_path)).load() == {"albedo": 0.2}


def test_a_law_without_learned_values_leaves_the_kept_file_as_it_is(tmp_path):
    LawFile(StateFolder(tmp_path)).save({"albedo": 0.2})
    LawFile(StateFolder(tmp_path)).save(None)
    assert LawFile(StateFolder(tmp_path)).load() == {"albedo": 0.2}
    assert LawFile(StateFolder(tmp_path), "another.json").load() is None


def test_an_unreadable_law_file_is_logged_and_the_law_learns_anew(tmp_path, caplog):
    (tmp_path / FILE_NAME).write_text('{"albedo": ')
    assert LawFile(StateFolder(tmp_path)).load() is None
    assert "learned.json cannot be used: the law learns the site again from the beginning" in caplog.text
