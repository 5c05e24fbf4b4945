"""Records of an archive on their way to a disk that is full, or that nobody may write to."""

import hashlib
import subprocess
import tempfile
from contextlib import closing
from datetime import date

import pytest

from daemon.archive.address import ArchiveError, parse_archive
from daemon.archive.parquet import drop_days, write_days
from daemon.archive.reader import ArchiveReader, temporary_store
from daemon.archive.writer import ArchiveWriter, SentPage
from daemon.base.errors import UserError
from tests.daemon.store.test_full_disk import small_disk
from tests.support.archive import T0, batch_of, origin, pose_row

__all__ = ["small_disk"]


@pytest.fixture
def address(database):
    """The address of an archive with more records than the small disk holds."""
    # Random text, which Parquet cannot compress.
    texts = ("".join(hashlib.sha256(b"%d %d" % (n, m)).hexdigest() for m in range(4)) for n in range(5000))
    rows = [(n, T0 + n, float(n), "test", text, None) for n, text in enumerate(texts)]
    with closing(ArchiveWriter(parse_archive(database))) as writer:
        writer.prepare()
        writer.write([SentPage("lab/roof", batch_of(origin(), {"events": rows}))])
    return parse_archive(database)


def test_copying_records_to_a_full_disk_fails_in_one_sentence_and_leaves_no_file(address, small_disk, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(small_disk))
    with (
        closing(ArchiveReader(address)) as reader,
        pytest.raises(
            ArchiveError, match=r"cannot take the records of lab/roof \(database or disk is full\): make room"
        ),
        temporary_store(reader, T0, T0 + 9000.0),
    ):
        pass
    assert list(small_disk.iterdir()) == []


def test_a_day_written_to_a_full_disk_leaves_no_partial_file(address, small_disk):
    with pytest.raises(UserError, match=r"records.parquet cannot be written"):
        list(write_days(address, small_disk / "days", date(2026, 1, 1)))
    assert [path for path in small_disk.rglob("*") if path.is_file()] == []


def test_a_day_whose_file_cannot_be_renamed_is_not_dropped_and_fails_in_one_sentence(database, small_disk, postgres):
    address, today = parse_archive(database), date(2026, 1, 1)
    with closing(ArchiveWriter(address)) as writer:
        writer.prepare()
        writer.write([SentPage("lab/roof", batch_of(origin(), {"poses": [pose_row(0)]}))])
    assert len(list(write_days(address, small_disk / "days", today))) == 1
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with pytest.raises(UserError, match=r"--out: .*/records.parquet cannot get its final name: Read-only file system"):
        list(drop_days(address, small_disk / "days", today))
    assert postgres.sql("SELECT count(*) FROM heliocube.poses", database.rpartition("/")[2]) == [(1,)]
