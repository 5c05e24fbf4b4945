"""Days of an archive as Parquet: their files outlive the database's rows."""

import os
import subprocess
import sys
from contextlib import closing
from datetime import date

import pytest

from daemon.archive.address import parse_archive
from daemon.archive.parquet import drop_days, rows_in, write_days
from daemon.archive.writer import ArchiveWriter, SentPage
from daemon.base.errors import UserError
from tests.support.archive import T0, batch_of, origin, pose_row
from tests.support.postgres import BINARIES, WITHOUT_POSTGRES, Postgres


@pytest.mark.skipif(sys.platform == "win32", reason="Windows syncs no folders")
def test_a_day_is_dropped_only_after_its_file_and_folders_are_synced_to_disk(postgres, database, tmp_path, monkeypatch):
    address, synced_files, fsync = parse_archive(database), [], os.fsync
    with closing(ArchiveWriter(address)) as writer:
        writer.prepare()
        writer.write([SentPage("lab/roof", batch_of(origin(), {"poses": [pose_row(0)]}))])

    def parts():
        query = "SELECT count(*) FROM pg_class WHERE relname = 'poses_20221014'"
        return postgres.sql(query, database.rpartition("/")[2])[0][0]

    def noted(descriptor):
        fsync(descriptor)
        found, final = os.fstat(descriptor), list(tmp_path.rglob("final-*.parquet"))
        synced_files.append((found.st_ino, found.st_size, bool(final), parts()))

    monkeypatch.setattr(os, "fsync", noted)
    out = tmp_path / "days"
    out.mkdir()
    (written,) = write_days(address, out, date(2026, 1, 1))
    (dropped,) = drop_days(address, out, date(2026, 1, 1))
    assert (written.written, dropped.rows, parts()) == (True, 1, 0)
    file = dropped.path.stat()
    assert (file.st_ino, file.st_size, False, 1) in synced_files
    with_final_name = {number for number, _, final, part in synced_files if final and part}
    assert with_final_name >= {folder.stat().st_ino for folder in dropped.path.parents[:3]}


def test_the_file_of_a_day_dropped_by_hand_survives_records_that_arrive_late(postgres, database, tmp_path):
    address, run = parse_archive(database), origin()
    with closing(ArchiveWriter(address)) as writer:
        writer.prepare()
        for rows in ([pose_row(0), pose_row(1)], [pose_row(2)]):
            writer.write([SentPage("lab/roof", batch_of(run, {"poses": rows}))])
            assert [one.written for one in write_days(address, tmp_path, date(2026, 1, 1))] == [True]
            postgres.sql("DROP TABLE heliocube.poses_20221014", database.rpartition("/")[2])
    files = sorted((tmp_path / "poses" / "day=2022-10-14").iterdir())
    assert [(path.name.partition("-")[0], rows_in(path)) for path in files] == [("final", 2), ("records.parquet", 1)]


def test_records_that_the_database_has_lost_stay_in_the_file_of_their_day(postgres, database, tmp_path):
    """A database loses records if it is restored from a backup. If it gets them back, the file is written anew."""
    address, run = parse_archive(database), origin()
    page = SentPage("lab/roof", batch_of(run, {"poses": [pose_row(0), pose_row(1)]}))
    with closing(ArchiveWriter(address)) as writer:
        writer.prepare()
        writer.write([page])
        list(write_days(address, tmp_path, date(2026, 1, 1)))
        postgres.sql("DELETE FROM heliocube.poses WHERE number = 1", database.rpartition("/")[2])
        assert [(one.rows, one.written) for one in write_days(address, tmp_path, date(2026, 1, 1))] == [(2, False)]
        assert list(drop_days(address, tmp_path, date(2026, 1, 1))) == []
        writer.write([page, SentPage("lab/late", page.batch)])
    assert [(one.rows, one.written) for one in write_days(address, tmp_path, date(2026, 1, 1))] == [(4, True)]


@pytest.mark.parametrize("drops", [False, True])
def test_after_restoring_a_dump_a_record_is_in_one_file_whether_its_day_was_dropped_or_not(
    postgres, database, tmp_path, drops
):
    address, run, name = parse_archive(database), origin(), database.rpartition("/")[2]

    def take(*rows):
        with closing(ArchiveWriter(address)) as writer:
            writer.prepare()
            writer.write([SentPage("lab/roof", batch_of(run, {"poses": list(rows)}))])

    def written():
        return [(one.rows, one.written) for one in write_days(address, tmp_path, date(2026, 1, 1))]

    take(pose_row(0))
    dump = postgres.dump(name)
    take(pose_row(1))
    assert written() == [(2, True)]
    if drops:
        assert [one.rows for one in drop_days(address, tmp_path, date(2026, 1, 1))] == [2]
    postgres.restore(name, dump)
    assert written() == [(2, False)]
    assert list(drop_days(address, tmp_path, date(2026, 1, 1))) == []
    take(pose_row(0), pose_row(1), pose_row(2))
    assert written() == [(3, True)]
    assert [one.rows for one in drop_days(address, tmp_path, date(2026, 1, 1))] == [3]
    assert list(map(rows_in, tmp_path.rglob("*.parquet"))) == [3]


def test_an_earlier_file_that_cannot_be_read_is_reported_in_one_sentence(database, tmp_path):
    address = parse_archive(database)
    with closing(ArchiveWriter(address)) as writer:
        writer.prepare()
        writer.write([SentPage("lab/roof", batch_of(origin(), {"poses": [pose_row(0)]}))])
    # A disk with bad sectors raises an OSError too: neither means that the file is damaged.
    (tmp_path / "poses" / "day=2022-10-14" / "records.parquet").mkdir(parents=True)
    with pytest.raises(UserError, match=r"^--out: .*/records.parquet cannot be written: .*is a directory"):
        list(write_days(address, tmp_path, date(2026, 1, 1)))


@pytest.mark.skipif(BINARIES is None, reason=WITHOUT_POSTGRES)
def test_the_file_of_a_dropped_day_survives_a_database_server_that_is_set_up_anew(tmp_path):
    """A server that is set up anew by the same steps gives its parts the same numbers."""
    out, run = tmp_path / "days", origin()
    out.mkdir()
    for rows in ([pose_row(0), pose_row(1)], [pose_row(1)]):
        server = Postgres()
        try:
            address = parse_archive(server.url())
            with closing(ArchiveWriter(address)) as writer:
                writer.prepare()
                writer.write([SentPage("lab/roof", batch_of(run, {"poses": rows}))])
            assert [one.written for one in write_days(address, out, date(2026, 1, 1))] == [True]
            assert [one.rows for one in drop_days(address, out, date(2026, 1, 1))] == [len(rows)]
        finally:
            server.close()
    assert sorted(map(rows_in, out.rglob("final-*.parquet"))) == [1, 2]


@pytest.mark.skipif(BINARIES is None, reason=WITHOUT_POSTGRES)
def test_late_records_survive_restoring_a_server_backup_from_before_the_day_was_dropped(tmp_path):
    """A backup of the server's own files holds the part of that day again, under the same number."""
    out, run, today = tmp_path / "days", origin(), date(2026, 1, 1)
    out.mkdir()
    server = Postgres()
    try:
        address = parse_archive(server.url())
        with closing(ArchiveWriter(address)) as writer:
            writer.prepare()
            writer.write([SentPage("lab/roof", batch_of(run, {"poses": [pose_row(0), pose_row(1)]}))])
        data, backup = server.folder / "data", server.folder / "backup"
        server.kill()
        subprocess.run(["cp", "-a", data, backup], check=True)
        server.start()
        list(write_days(address, out, today))
        assert [one.rows for one in drop_days(address, out, today)] == [2]
        with closing(ArchiveWriter(address)) as writer:
            writer.prepare()
            writer.write([SentPage("lab/roof", batch_of(run, {"poses": [pose_row(2)]}))])
        assert [one.rows for one in write_days(address, out, today)] == [1]
        server.kill()
        data.rename(server.folder / "lost")
        backup.rename(data)
        server.start()
        assert [(one.rows, one.written) for one in write_days(address, out, today)] == [(2, False)]
    finally:
        server.close()
    assert sorted(map(rows_in, out.rglob("*.parquet"))) == [1, 2]


def test_a_file_with_a_damaged_footer_is_written_again_and_blocks_no_other_day(database, tmp_path):
    """Damage inside its footer raises another kind of error than damage around it."""
    address = parse_archive(database)
    rows = [pose_row(0), pose_row(1, utc_s=T0 + 86400)]
    with closing(ArchiveWriter(address)) as writer:
        writer.prepare()
        writer.write([SentPage("lab/roof", batch_of(origin(), {"poses": rows}))])
    first, second = (one.path for one in write_days(address, tmp_path, date(2026, 1, 1)))
    second.unlink()
    whole = first.read_bytes()
    first.write_bytes(whole[:-200] + b"\xff" * 192 + whole[-8:])
    assert list(drop_days(address, tmp_path, date(2026, 1, 1))) == []
    assert [one.written for one in write_days(address, tmp_path, date(2026, 1, 1))] == [True, True]
    assert (rows_in(first), rows_in(second)) == (1, 1)
