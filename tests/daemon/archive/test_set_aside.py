"""Records that the database refuses are set aside one by one: none behind them waits, and nothing is lost."""

import asyncio
import contextlib
from random import Random

import pytest

from daemon.archive.address import parse_archive
from daemon.archive.refused_records import retry, write_accepted_records
from daemon.archive.writer import ArchiveWriter, SentPage
from tests.daemon.archive.test_ingest import all_kept, running
from tests.support.archive import Sender, archived_records, batch_of, event, origin, pose, pose_row
from tests.support.mqtt import SPEED, needs_mosquitto, observer, until
from tests.support.postgres import Postgres

NO_SEVEN = "ALTER TABLE heliocube.poses ADD CONSTRAINT no_seven CHECK (number <> 7)"
TRIGGER = (
    "CREATE FUNCTION heliocube.no() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN IF NEW.number = 7 THEN"
    " RAISE EXCEPTION 'no seven'; END IF; RETURN NEW; END $$;"
    " CREATE TRIGGER no BEFORE INSERT ON heliocube.poses FOR EACH ROW EXECUTE FUNCTION heliocube.no()"
)


@pytest.fixture
def writer(database):
    with contextlib.closing(ArchiveWriter(parse_archive(database))) as made:
        made.prepare()
        yield made


@pytest.fixture
def ask(postgres, database):
    return lambda statement: postgres.sql(statement, database.rpartition("/")[2])


def page_of(count=100, **rows):
    return SentPage("lab/roof", batch_of(origin(), {"poses": [pose_row(number) for number in range(count)], **rows}))


@pytest.mark.parametrize(
    ("made", "why", "undone"),
    [
        (NO_SEVEN, 'violates check constraint "no_seven"', "ALTER TABLE heliocube.poses DROP CONSTRAINT no_seven"),
        (TRIGGER, "no seven", "DROP TRIGGER no ON heliocube.poses"),
        (
            "ALTER TABLE heliocube.poses ADD CONSTRAINT own UNIQUE (time, time_monotonic_s, moving)",
            'violates unique constraint "',
            "ALTER TABLE heliocube.poses DROP CONSTRAINT own",
        ),
    ],
)
def test_one_record_that_the_database_refuses_is_set_aside_and_written_once_it_is_accepted(
    database, ask, writer, made, why, undone
):
    ask(made)
    page = page_of()
    if "UNIQUE" in made:
        # A record of the same instant as the one before.
        page.batch.rows["poses"][7] = (7, *page.batch.rows["poses"][6][1:])
    added, refused = write_accepted_records(writer, page)
    assert (added, [(each.kind, each.row[0]) for each in refused]) == (99, [("poses", 7)])
    assert why in refused[0].why
    ((kind, number, record, said),) = ask("SELECT kind, number, record, why FROM heliocube.set_aside")
    assert (kind, number, record["tracker"], record["a_deg"]) == ("poses", 7, "roof", 1.5)
    assert why in said
    assert ask("SELECT through FROM heliocube.runs") == [(99,)]
    assert write_accepted_records(writer, page)[0] == 0, "what comes twice is set aside once"
    still = retry(parse_archive(database))
    assert (still.aside, still.taken, list(still.still.values())) == (1, 0, [1])
    ask(undone)
    assert retry(parse_archive(database)) == (1, 1, {})
    assert ask("SELECT count(*), count(DISTINCT number), max(a_deg) FROM heliocube.poses") == [(100, 100, 1.5)]
    assert ask("SELECT count(*) FROM heliocube.set_aside") == [(0,)]


@pytest.mark.parametrize(
    ("column", "holds", "aside"),
    [
        ("a_deg", "numeric", 0),
        ("a_deg", "float4", 0),
        ("a_deg", "text", 0),
        ("tracker", "varchar(3)", 100),
        ("moving", "date", 100),
    ],
)
def test_records_go_into_a_changed_column_if_its_type_allows_and_are_set_aside_otherwise(
    ask, writer, column, holds, aside
):
    ask(f"ALTER TABLE heliocube.poses DROP COLUMN {column}")
    ask(f"ALTER TABLE heliocube.poses ADD COLUMN {column} {holds}")
    added, refused = write_accepted_records(writer, page_of())
    assert (added, len(refused)) == (100 - aside, aside)


def test_a_record_with_a_text_too_long_for_a_user_made_index_is_set_aside(ask, writer):
    ask("CREATE INDEX ON heliocube.events (text)")
    noise = Random(1).randbytes(20_000).hex()
    page = page_of(
        events=[(100, 1.6657056e9, 100.0, "test", noise, "roof"), (101, 1.6657056e9, 101.0, "test", "", "roof")]
    )
    added, refused = write_accepted_records(writer, page)
    assert (added, [(each.kind, each.row[0]) for each in refused]) == (101, [("events", 100)])
    assert "index row" in refused[0].why


def test_a_page_of_more_days_than_the_database_can_lock_is_written_in_parts():
    server = Postgres(max_locks_per_transaction=10)
    try:
        with contextlib.closing(ArchiveWriter(parse_archive(server.url()))) as writer:
            writer.prepare()
            rows = [pose_row(number, 1.5e9 - 86400.0 * number) for number in range(500)]
            page = SentPage("lab/roof", batch_of(origin(), {"poses": rows}))
            assert write_accepted_records(writer, page) == (500, [])
        assert server.sql("SELECT through FROM heliocube.runs") == [(499,)]
    finally:
        server.close()


@needs_mosquitto
def test_records_after_a_refused_one_are_kept_and_the_service_raises_an_alarm(
    postgres, database, broker, tmp_path, start_archive, ask, heliocube
):
    async def scenario():
        start_archive(broker.port)
        sender = Sender(tmp_path / "roof", broker.port, "roof", speed=SPEED)
        async with observer(broker.port) as lab, sender.sending():
            sender.keep(pose(0))
            await all_kept(postgres, database, sender)
            ask(NO_SEVEN)
            sender.keep(*(pose(number) for number in range(1, 20)), event(20))
            kept = await lab.until("lab/roof/records/kept", lambda found: "set_aside" in found)
            assert (kept["set_aside"], "no_seven" in kept["why"]) == (1, True)
            await until(lambda: "archive-set-aside" in sender.alarms, "the alarm")
            text = sender.alarms["archive-set-aside"]
            assert text.startswith("the archive's database does not take 1 record of lab/roof/records: the database")
            sender.keep(pose(21), event(22))
            await until(lambda: len(archived_records(postgres, database, "lab/roof")) == 22, "all others")
            assert "of lab/roof 1 record is set aside (" in (tmp_path / "archive.log").read_text()
        sender.store.close()
        ask("ALTER TABLE heliocube.poses DROP CONSTRAINT no_seven")
        code, out, _ = heliocube("archive", "retry", "--to", database)
        assert (code, out) == (0, f"1 record was set aside in {database}; written now: 1\n")
        await all_kept(postgres, database, sender)

    running(scenario)


def test_archive_fill_continues_after_a_record_that_the_database_refuses(
    database, ask, writer, tmp_path, heliocube, broker
):
    ask(NO_SEVEN)
    sender = Sender(tmp_path / "roof", broker.port)
    sender.keep(*(pose(number) for number in range(30)))
    asyncio.run(asyncio.sleep(0.3))
    sender.store.close()
    code, out, err = heliocube("archive", "fill", str(tmp_path / "roof"), "--name", "lab/roof", "--to", database)
    assert (code, "30 records were read; 29 of them are new" in out) == (0, True)
    assert "warning: 1 record was not taken by the database, and set aside: see why in heliocube.set_aside" in " ".join(
        err.split()
    )
