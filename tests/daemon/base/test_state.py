"""Kept state: saved state comes back, unreadable state is reported and never guessed, a full disk ends nothing."""

import contextlib
import logging
import os
import threading

import pytest
from pydantic import BaseModel, ConfigDict

from daemon.base.files import replace_file
from daemon.base.state import ROOM_BYTES, StateFile, StateFolder, UnreadableStateError, replace_state_file, spare_of
from tests.daemon.store.test_full_disk import fill, small_disk
from tests.support import PATIENCE_S

__all__ = ["small_disk"]

LOG = logging.getLogger("heliocube.test")


class Kept(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    count: int
    why: str | None = None


def state_file(directory):
    return StateFile(StateFolder(directory), "kept.json", Kept, LOG, "the count")


def test_saved_state_can_be_loaded_again_from_its_file(tmp_path):
    state_file(tmp_path / "new").save(Kept(count=3))
    assert state_file(tmp_path / "new").load() == Kept(count=3)
    assert (tmp_path / "new" / "kept.json").read_text() == '{"count":3}'


def test_a_state_file_without_a_folder_saves_nothing_and_loads_none():
    assert state_file(None).load() is None
    state_file(None).save(Kept(count=1))


def test_state_in_a_folder_that_does_not_exist_is_loaded_as_none(tmp_path):
    (tmp_path / "file").touch()
    assert state_file(tmp_path / "none").load() is None
    assert state_file(tmp_path / "file").load() is None


@pytest.mark.parametrize("content", [b"", b"{", b'{"count": "3"}', b'{"count": 3, "more": 1}', b"\xff\xfe", b"null"])
def test_an_unreadable_state_file_raises_an_error_that_names_its_path(tmp_path, content):
    (tmp_path / "kept.json").write_bytes(content)
    with pytest.raises(UnreadableStateError, match=r"kept\.json cannot be read") as caught:
        state_file(tmp_path).load()
    assert caught.value.path == tmp_path / "kept.json"


def test_a_pipe_in_place_of_a_state_file_is_unreadable_and_replaced_by_the_next_save(tmp_path):
    path = tmp_path / "kept.json"
    os.mkfifo(path)
    with pytest.raises(UnreadableStateError):
        state_file(tmp_path).load()
    for count in range(3):
        state_file(tmp_path).save(Kept(count=count))
        assert state_file(tmp_path).load() == Kept(count=count)


def test_a_state_file_that_is_a_dangling_link_or_enormous_cannot_be_read(tmp_path):
    path = tmp_path / "kept.json"
    path.symlink_to("nowhere")
    with pytest.raises(UnreadableStateError):
        state_file(tmp_path).load()
    path.unlink()
    with path.open("w") as file:
        file.truncate(1 << 40)
    with pytest.raises(UnreadableStateError):
        state_file(tmp_path).load()
    state_file(tmp_path).save(Kept(count=2))
    assert state_file(tmp_path).load() == Kept(count=2)


def test_a_disk_that_fails_is_reported_once_until_it_works_again_and_gets_the_newest_content(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    directory = tmp_path / "folder"
    folder = StateFolder(directory)
    kept = StateFile(folder, "kept.json", Kept, LOG, "the count")
    why = f"a restart would forget the count: {directory / 'kept.json'} cannot be written (File exists)"
    directory.touch()
    kept.save(Kept(count=1))
    kept.save(Kept(count=2))
    folder.retry()
    assert folder.unsaved == folder.trouble == why
    directory.unlink()
    folder.retry()
    assert folder.unsaved is folder.trouble is None
    assert kept.load() == Kept(count=2)
    assert [record.getMessage() for record in caplog.records] == [
        f"{directory / 'kept.json'} cannot be written (File exists): a restart would forget the count",
        f"{directory / 'kept.json'} is written again",
    ]


def test_the_same_state_unsaved_in_two_files_is_reported_in_one_sentence(tmp_path):
    directory = tmp_path / "folder"
    folder = StateFolder(directory)
    directory.touch()
    for name in ("one.json", "two.json"):
        StateFile(folder, name, Kept, LOG, "the light of today").save(Kept(count=1))
    files = f"{directory / 'one.json'} and two.json"
    assert folder.unsaved == f"a restart would forget the light of today: {files} cannot be written (File exists)"


class SlowDisk:
    """A disk that writes one file at a time, when a test lets it, and remembers the order."""

    def __init__(self):
        self.begun, self.let, self.written = threading.Semaphore(0), threading.Semaphore(0), []

    def replace(self, path, text):
        self.begun.release()
        assert self.let.acquire(timeout=PATIENCE_S)
        self.written.append((path.name, text))
        replace_file(path, text)


def test_saving_state_does_not_wait_for_a_slow_disk_which_gets_the_newest_contents_in_order(tmp_path):
    disk, now_s = SlowDisk(), [100.0]
    folder = StateFolder(tmp_path, behind=True, replace=disk.replace, now_s=lambda: now_s[0])
    first, second = (StateFile(folder, name, Kept, LOG, f"the {name}") for name in ("a.json", "b.json"))
    first.save(Kept(count=1))
    assert disk.begun.acquire(timeout=PATIENCE_S)
    second.save(Kept(count=2))
    for count in (3, 4, 5):
        first.save(Kept(count=count))
    assert disk.written == []
    assert folder.is_writing
    assert folder.unsaved.startswith("a restart would forget the b.json and the a.json: ")
    assert folder.trouble is None, "a disk at work is no trouble yet"
    now_s[0] += 6.0
    assert folder.trouble == folder.unsaved
    assert folder.trouble.endswith(
        f": {tmp_path / 'b.json'} and a.json cannot be written (the disk has not answered yet)"
    )
    disk.let.release(3)
    assert folder.wait_for_writes(60)
    assert disk.written == [("a.json", '{"count":1}'), ("b.json", '{"count":2}'), ("a.json", '{"count":5}')]
    assert folder.unsaved is None
    assert first.load() == Kept(count=5)


def test_closing_the_state_folder_tries_to_save_once_more_and_logs_what_is_lost(tmp_path, caplog):
    folder = StateFolder(tmp_path / "folder", behind=True)
    (tmp_path / "folder").touch()
    StateFile(folder, "kept.json", Kept, LOG, "the count").save(Kept(count=1))
    folder.close()
    assert "a restart would forget the count" in caplog.messages[-1]
    (tmp_path / "folder").unlink()
    caplog.clear()
    folder.close()
    assert (tmp_path / "folder" / "kept.json").is_file()
    assert not caplog.records


def test_on_a_full_disk_state_is_saved_into_reserved_room_or_left_unchanged_if_too_long(small_disk):
    kept = state_file(small_disk)
    kept.reserve()
    fill(small_disk / "filler")
    with pytest.raises(OSError, match="No space left"):
        replace_file(small_disk / "kept.json", "{}")
    for count in range(5):
        kept.save(Kept(count=count, why="w" * 100 * count))
        assert state_file(small_disk).load() == Kept(count=count, why="w" * 100 * count)
    for longer in (ROOM_BYTES + 1, 2 * ROOM_BYTES):
        kept.save(Kept(count=9, why="w" * longer))
        assert state_file(small_disk).load() == Kept(count=4, why="w" * 400), "what has no room leaves the file alone"


def test_on_a_full_disk_without_reserved_room_the_first_state_is_reported_as_unsaved(small_disk, caplog):
    fill(small_disk / "filler")
    folder = StateFolder(small_disk)
    StateFile(folder, "kept.json", Kept, LOG, "the count").save(Kept(count=1))
    assert folder.trouble.endswith("kept.json cannot be written (No space left on device)")


@pytest.fixture
def dies_in_the_middle(monkeypatch):
    """Replace a kept file twice, and a third time in a process that dies before its nth change on the disk."""

    def die(path, count):
        for text in ("first", "second"):
            replace_state_file(path, text)
        done = []

        def counting(name):
            call = getattr(os, name)

            def counted(*arguments, **named):
                if len(done) == count:
                    raise KeyboardInterrupt
                done.append(name)
                return call(*arguments, **named)

            return counted

        for name in ("fsync", "link", "rename", "replace", "unlink"):
            monkeypatch.setattr(os, name, counting(name))
        with contextlib.suppress(KeyboardInterrupt):
            replace_state_file(path, "third, and longer")
        monkeypatch.undo()

    return die


@pytest.mark.parametrize("dies_at", range(6))
def test_a_process_that_dies_while_replacing_a_file_leaves_the_whole_old_or_the_whole_new_one(
    tmp_path, dies_in_the_middle, dies_at
):
    path = tmp_path / "kept.json"
    dies_in_the_middle(path, dies_at)
    assert path.read_text() in ("second", "third, and longer")
    replace_state_file(path, "4th")
    assert (path.read_text(), spare_of(path).exists()) == ("4th", True)


@pytest.mark.parametrize("dies_at", range(6))
def test_reserved_room_on_a_full_disk_survives_a_process_that_died_while_replacing_a_file(
    small_disk, dies_in_the_middle, dies_at
):
    path = small_disk / "kept.json"
    dies_in_the_middle(path, dies_at)
    fill(small_disk / "filler")
    for text in ("4th", "5th"):
        replace_state_file(path, text)
        assert path.read_text() == text


def test_a_file_system_without_hard_links_keeps_reserved_room_too(tmp_path, monkeypatch):
    def link(*_):
        raise OSError

    monkeypatch.setattr(os, "link", link)
    for text in ("first", "second, and longer", "3rd"):
        replace_state_file(tmp_path / "kept.json", text)
        assert (tmp_path / "kept.json").read_text() == text
        assert spare_of(tmp_path / "kept.json").read_text() == text


def test_a_spare_file_that_the_service_may_not_write_is_made_anew(tmp_path, monkeypatch):
    state_file(tmp_path).save(Kept(count=1))
    spare = spare_of(tmp_path / "kept.json")
    with spare.open() as left:
        monkeypatch.setattr(os, "access", lambda path, _mode: path != spare)
        state_file(tmp_path).save(Kept(count=2))
        assert left.read() == '{"count":1}', "not written to"
    assert state_file(tmp_path).load() == Kept(count=2)


def test_state_is_reported_as_unsaved_and_written_later_when_no_thread_can_start(tmp_path, monkeypatch):
    now_s = 0.0
    folder = StateFolder(tmp_path, behind=True, now_s=lambda: now_s)
    kept = StateFile(folder, "kept.json", Kept, LOG, "the count")

    def refuse(_):
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as full:
        full.setattr(threading.Thread, "start", refuse)
        kept.save(Kept(count=1))
        folder.retry()
        now_s = 6.0
        assert folder.trouble is not None
        assert not folder.is_writing
    folder.retry()
    assert folder.wait_for_writes(60.0)
    assert kept.load() == Kept(count=1)


def test_an_unexpected_error_while_saving_state_is_reported_and_blocks_no_other_file(tmp_path):
    broken = True

    def replace(path, text):
        if broken and path.name == "one.json":
            raise MemoryError
        replace_file(path, text)

    folder = StateFolder(tmp_path, behind=True, replace=replace)
    one, other = (StateFile(folder, name, Kept, LOG, "the count") for name in ("one.json", "other.json"))
    one.save(Kept(count=1))
    other.save(Kept(count=2))
    assert not folder.wait_for_writes(60.0)
    assert "one.json cannot be written (MemoryError())" in folder.trouble
    assert other.load() == Kept(count=2)
    broken = False
    folder.retry()
    assert folder.wait_for_writes(60.0)
    assert one.load() == Kept(count=1)
