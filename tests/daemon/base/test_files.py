"""Kept state: what is saved comes back, what cannot be read is said and never guessed, and a full disk is no end."""

import logging

import pytest
from pydantic import BaseModel, ConfigDict

from daemon.base.files import StateFile, UnreadableStateError

LOG = logging.getLogger("heliocube.test")


class Kept(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    count: int
    why: str | None = None


def state_file(directory):
    return StateFile(directory, "kept.json", Kept, LOG, "the count")


def test_what_is_saved_comes_back_in_another_process(tmp_path):
    assert state_file(tmp_path / "new").save(Kept(count=3))
    assert state_file(tmp_path / "new").load() == Kept(count=3)
    assert (tmp_path / "new" / "kept.json").read_text() == '{"count":3}'


def test_nothing_kept_is_none():
    assert state_file(None).load() is None
    assert state_file(None).save(Kept(count=1))


def test_a_folder_that_is_not_there_holds_nothing(tmp_path):
    (tmp_path / "file").touch()
    assert state_file(tmp_path / "none").load() is None
    assert state_file(tmp_path / "file").load() is None


@pytest.mark.parametrize("content", [b"", b"{", b'{"count": "3"}', b'{"count": 3, "more": 1}', b"\xff\xfe", b"null"])
def test_what_cannot_be_read_is_the_callers_to_judge(tmp_path, content):
    (tmp_path / "kept.json").write_bytes(content)
    with pytest.raises(UnreadableStateError, match=r"kept\.json cannot be read") as caught:
        state_file(tmp_path).load()
    assert caught.value.path == tmp_path / "kept.json"


def test_a_disk_that_fails_is_reported_once_until_it_works_again(tmp_path, caplog):
    kept = state_file(tmp_path / "folder")
    (tmp_path / "folder").touch()
    assert not kept.save(Kept(count=1))
    assert not kept.save(Kept(count=2))
    assert [record.getMessage().partition("): ")[2] for record in caplog.records] == [
        "a restart would forget the count"
    ]
    (tmp_path / "folder").unlink()
    assert kept.save(Kept(count=3))
    (tmp_path / "folder" / "kept.json").unlink()
    (tmp_path / "folder").rmdir()
    (tmp_path / "folder").touch()
    assert not kept.save(Kept(count=4))
    assert len(caplog.records) == 2
