"""Commands on an archive that are interrupted: finished work stays, and temporary files go."""

import os
import signal

import pytest

from daemon.archive.address import connect_to_archive, parse_archive
from tests.daemon.store.test_store import keep
from tests.daemon.store.test_tables import scan
from tests.daemon.store.test_unusable_store import until
from tests.support import PATIENCE_S, forks

__all__ = ["keep"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("fill", "STORE", "--name", "lab/roof"), "what was read so far is in URL"),
        (("parquet", "--out", "DAYS"), "what was written so far is in DAYS"),
    ],
)
def test_an_interrupted_archive_command_says_where_its_finished_work_is(
    words, told, keep, postgres, database, heliocube, tmp_path
):
    import psycopg  # noqa: PLC0415 - in an extra

    places = {"STORE": keep(scan()), "DAYS": tmp_path / "days", "URL": database}
    fill = ("fill", places["STORE"], "--name", "lab/other")
    assert heliocube("archive", *fill, "--to", database)[0] == 0
    waits = "SELECT count(*) FROM pg_locks WHERE NOT granted"
    with (tmp_path / "said").open("w") as said, psycopg.connect(database) as other:
        other.execute("LOCK TABLE heliocube.scans, heliocube.runs")
        command = ["archive", *(places.get(word, word) for word in words), "--to", database]
        running = forks.start(command, stdout=said, stderr=said)
        until(lambda: postgres.sql(waits, database.rpartition("/")[2]) == [(1,)])
        running.send_signal(signal.SIGINT)
        assert running.wait(PATIENCE_S) == 130
    for word, place in places.items():
        told = told.replace(word, str(place))
    sentence = f"heliocube: interrupted: {told}; give the command again for the rest\n"
    assert (tmp_path / "said").read_text() == sentence


def test_the_temporary_copy_of_an_archive_is_removed_when_the_terminals_connection_is_lost(
    keep, postgres, database, heliocube, tmp_path
):
    import psycopg  # noqa: PLC0415 - in an extra

    assert heliocube("archive", "fill", keep(scan()), "--name", "lab/roof", "--to", database)[0] == 0
    waits = "SELECT count(*) FROM pg_locks WHERE NOT granted"
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    with psycopg.connect(database) as other:
        other.execute("LOCK TABLE heliocube.scans")
        command = ["export", "--store", database, "--out", tmp_path / "out"]
        running = forks.start(command, env=os.environ | {"TMPDIR": str(temporary)})
        until(lambda: postgres.sql(waits, database.rpartition("/")[2]) == [(1,)])
        assert len(list(temporary.glob("heliocube-archive-*"))) == 1
        running.send_signal(signal.SIGHUP)
        assert running.wait(PATIENCE_S) == 130
    assert list(temporary.iterdir()) == []


def test_an_interruption_of_a_database_transaction_logs_no_message_of_the_library(database, caplog):
    def interrupted():
        with connect_to_archive(parse_archive(database), "a test") as connection, connection.transaction():
            # As if the interruption came just between a question and the wait for its answer.
            connection.pgconn.send_query(b"SELECT pg_sleep(0.1)")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert caplog.messages == []
