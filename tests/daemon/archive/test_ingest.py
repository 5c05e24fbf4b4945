"""Services, a broker and a database, each of which may be killed, restarted or hung: every record is there once."""

import asyncio
import contextlib
import logging
import math
import signal
import threading
from itertools import pairwise

import pytest

from daemon.archive.address import ArchiveError, ArchiveUnreachableError, PagesRefusedError, parse_archive
from daemon.archive.ingest import Ingester
from daemon.archive.writer import ArchiveWriter, SentPage
from daemon.base.clock import SystemClock
from daemon.base.process import SystemdNotifier
from daemon.config.links import ArchiveSettings, MqttSettings
from daemon.store.batches import encoded
from tests.daemon.bridge.desk import HandClock
from tests.support.archive import T0, Sender, archived_records, batch_of, event, origin, pose, pose_row, scan
from tests.support.mqtt import SPEED, needs_mosquitto, observer, until
from tests.support.postgres import Postgres

pytestmark = needs_mosquitto


def running(scenario):
    """Run a scenario on the loop that makes the senders' waits short."""
    from daemon.base.timeloop import ScaledTimeLoop  # noqa: PLC0415

    with asyncio.Runner(loop_factory=lambda: ScaledTimeLoop(SPEED)) as runner:
        runner.run(scenario())


async def all_kept(postgres, database, *senders):
    """Wait until the archive has all records of the stores, and check that it has each once."""
    for sender in senders:
        await until(lambda sender=sender: sender.store.status.waiting == 0, "a store with all records")
        wanted = sorted(sender.rows())
        found = []
        for _ in range(600):
            with contextlib.suppress(Exception):
                found = sorted(archived_records(postgres, database, sender.installation))
            if len(found) >= len(wanted):
                break
            await asyncio.sleep(0.1 * SPEED)
        assert found == wanted


def test_every_record_arrives_once_though_broker_database_or_archive_is_killed_or_hangs(
    postgres, database, broker, tmp_path, start_archive
):
    async def scenario():
        first, second = start_archive(broker.port), start_archive(broker.port)
        senders = [Sender(tmp_path / name, broker.port, name, speed=SPEED) for name in ("roof", "field")]
        count = 0

        def more():
            nonlocal count
            for sender in senders:
                sender.keep(*(pose(count + n) for n in range(700)), scan(count), event(count, "a\0b 'x' \\ ü"))
            count += 700

        async with senders[0].sending(), senders[1].sending():
            more()
            await all_kept(postgres, database, *senders)
            broker.kill()
            first.kill()
            more()
            broker.start()
            await all_kept(postgres, database, *senders)
            more()
            postgres.kill()
            more()
            await asyncio.sleep(SPEED)
            postgres.start()
            await all_kept(postgres, database, *senders)
            postgres.hang()
            more()
            await asyncio.sleep(SPEED)
            second.send_signal(signal.SIGSTOP)
            broker.hang()
            postgres.resume()
            more()
            await asyncio.sleep(SPEED)
            second.send_signal(signal.SIGCONT)
            broker.resume()
            await all_kept(postgres, database, *senders)
        for sender in senders:
            sender.store.close()

    running(scenario)


def test_two_services_under_one_name_are_logged_and_both_kept_and_an_invalid_page_is_refused(
    postgres, database, broker, tmp_path, start_archive
):
    async def scenario():
        start_archive(broker.port)
        early, late = (
            Sender(tmp_path / site, broker.port, "roof", run=origin(site=site), speed=SPEED) for site in ("one", "two")
        )
        early.keep(pose(0))
        async with observer(broker.port) as lab, early.sending(), late.sending():
            await until_kept(lab, early)
            late.keep(pose(5))
            await until_kept(lab, late)
            early.keep(pose(10))
            await until_kept(lab, early)
            kept = {row[0] for row in archived_records(postgres, database, "lab/roof")}
            assert kept == {early.origin.id, late.origin.id}
            log = (tmp_path / "archive.log").read_text()
            assert "two services send under the name lab/roof (sites one and two): give one of them another" in log
            await lab.publish("lab/roof/records", {"format": 9, "run": {"id": "x" * 32}})
            refusal = await lab.until("lab/roof/records/kept", lambda found: "refused" in found)
            assert refusal == {
                "run": "x" * 32,
                "refused": "it is of format 9, and this archive reads format 1: update the archive",
            }
            await lab.publish("lab/roof/records", b"\xff")
            late.keep(pose(11))
            await until_kept(lab, late)
        for sender in (early, late):
            sender.store.close()

    running(scenario)


async def until_kept(lab, sender):
    """Wait until the archive has confirmed the newest record of a service."""
    await until(lambda: sender.store.status.waiting == 0, "a store with all records")
    newest = max(number for _, _, number in sender.rows())
    await lab.until(
        f"{sender.installation}/records/kept",
        lambda found: found["run"] == sender.origin.id and found.get("through") == newest,
    )


def test_records_for_a_dropped_day_are_taken_by_the_writer_that_wrote_that_day_before(postgres, database):
    writer, run = ArchiveWriter(parse_archive(database)), origin()
    writer.prepare()
    try:
        assert writer.write([SentPage("lab/roof", batch_of(run, {"poses": [pose_row(0)]}))]).added == 1
        name = database.rpartition("/")[2]
        postgres.sql("DROP TABLE heliocube.poses_20221014", name)
        assert writer.write([SentPage("lab/roof", batch_of(run, {"poses": [pose_row(1)]}))]).added == 1
        assert postgres.sql("SELECT number FROM heliocube.poses", name) == [(1,)]
    finally:
        writer.close()


def test_a_record_just_before_midnight_whose_time_rounds_up_is_stored_in_the_next_day(postgres, database):
    writer, run = ArchiveWriter(parse_archive(database)), origin()
    writer.prepare()
    try:
        # The database's microseconds would round this to midnight.
        just_before_s = math.nextafter(T0 + 86400.0, 0.0)
        assert writer.write([SentPage("lab/roof", batch_of(run, {"poses": [pose_row(0, just_before_s)]}))]).added == 1
        assert postgres.sql("SELECT number FROM heliocube.poses_20221015", database.rpartition("/")[2]) == [(0,)]
    finally:
        writer.close()


def test_a_page_of_more_days_than_the_database_can_lock_is_refused_and_the_next_is_taken(postgres):
    server = Postgres(max_locks_per_transaction=10)

    def page(first_day, days):
        rows = [pose_row(number, T0 - 86400.0 * (first_day + number)) for number in range(days)]
        return SentPage("lab/roof", batch_of(origin(), {"poses": rows}))

    try:
        with contextlib.closing(ArchiveWriter(parse_archive(server.url()))) as writer:
            writer.prepare()
            with pytest.raises(
                PagesRefusedError, match=r"cannot take the records in one transaction: out of shared memory"
            ):
                writer.write([page(0, 500)])
            # Making a day takes more locks than writing into it, so not all are made at once.
            assert writer.write([page(1000, 250)]).added == 250
    finally:
        server.close()


def test_a_wait_for_a_database_that_hangs_can_be_ended(postgres, database):
    writer = ArchiveWriter(parse_archive(database))
    writer.prepare()
    page = SentPage("lab/roof", batch_of(origin(), {"poses": [pose_row(0)]}))
    assert writer.write([page, page]).added == 1
    postgres.hang()
    try:
        timer = threading.Timer(0.3, writer.abort_call)
        timer.start()
        with pytest.raises(ArchiveUnreachableError, match="does not answer"):
            writer.write([page])
    finally:
        postgres.resume()
        timer.join()
        writer.close()


def test_a_database_without_rights_for_this_user_or_missing_is_refused_in_one_sentence(postgres, database, heliocube):
    postgres.sql("DROP ROLE IF EXISTS guest")
    postgres.sql("CREATE ROLE guest LOGIN")
    code, _, err = heliocube("archive", "--to", database.replace("archive@", "guest@"))
    assert code == 2
    assert err == (
        "heliocube: this user may not make the archive's tables (permission denied for database"
        f" {database.rpartition('/')[2]}): make this user the owner of the database, or grant it CREATE on it\n"
    )
    code, _, err = heliocube("archive", "--to", database + "x")
    assert (code, "make it with createdb" in err, len(err.splitlines())) == (2, True, 1)


def test_a_database_set_to_read_only_is_not_reported_as_certainly_a_replica(postgres, database):
    postgres.sql(f"ALTER DATABASE {database.rpartition('/')[2]} SET default_transaction_read_only = on")
    part = "else set default_transaction_read_only off for it"
    with contextlib.closing(ArchiveWriter(parse_archive(database))) as writer, pytest.raises(ArchiveError, match=part):
        writer.prepare()


def test_a_database_with_sql_ascii_encoding_is_refused_with_advice_to_create_another(postgres):
    postgres.sql("CREATE DATABASE ascii ENCODING 'SQL_ASCII' TEMPLATE template0")
    with pytest.raises(ArchiveError, match="has the encoding SQL_ASCII: make one with 'createdb") as error:
        ArchiveWriter(parse_archive(postgres.url("ascii")))
    assert not isinstance(error.value, ArchiveUnreachableError)
    postgres.sql("DROP DATABASE ascii WITH (FORCE)")


def test_a_page_with_an_invalid_text_is_refused_and_the_next_page_is_taken(postgres, database, monkeypatch):
    monkeypatch.setenv("PGCLIENTENCODING", "LATIN1")
    with contextlib.closing(ArchiveWriter(parse_archive(database))) as writer:
        writer.prepare()
        for site, taken in (("\ud800", False), ("Łódź", True)):
            page = SentPage("lab/roof", batch_of(origin(site=site), {"poses": [pose_row(0)]}))
            with contextlib.nullcontext() if taken else pytest.raises(PagesRefusedError, match="does not take"):
                assert writer.write([page]).added == 1


def test_a_user_who_may_only_read_the_archive_is_refused_as_its_writer(postgres, database):
    with contextlib.closing(ArchiveWriter(parse_archive(database))) as writer:
        writer.prepare()
    name = database.rpartition("/")[2]
    postgres.sql("DROP ROLE IF EXISTS reader; CREATE ROLE reader LOGIN")
    postgres.sql("GRANT USAGE ON SCHEMA heliocube TO reader", name)
    postgres.sql("GRANT SELECT ON ALL TABLES IN SCHEMA heliocube TO reader", name)
    with contextlib.closing(ArchiveWriter(parse_archive(database.replace("archive@", "reader@")))) as reader:
        with pytest.raises(ArchiveError) as refusal:
            reader.prepare()
        assert str(refusal.value) == (
            "this user may not write into the archive's tables: name their owner, archive, instead"
        )
    postgres.sql("DROP OWNED BY reader; DROP ROLE reader", name)


def test_a_broker_that_stays_up_after_repeated_losses_is_logged_as_steady_again(database, broker, caplog):
    caplog.set_level(logging.INFO, "heliocube")
    clock = HandClock()

    async def heard():
        async with observer(broker.port) as lab:
            while not lab.messages_on("heliocube/roof/records/kept"):
                await lab.publish("heliocube/roof/records", {"run": {"id": "none"}})
                await asyncio.sleep(1.0)

    async def scenario():
        settings = MqttSettings(port=broker.port, keepalive_s=2)
        ingester = Ingester(settings, ArchiveSettings(), parse_archive(database), clock, SystemdNotifier({}, 0))
        work = asyncio.create_task(ingester.run())
        for _ in range(7):
            await heard()
            broker.kill()
            broker.start()
        await heard()
        clock.now_s += 1900.0
        await heard()
        await until(lambda: "the MQTT broker is steady again: it has worked for 32 min" in caplog.text, "the line")
        work.cancel()
        await asyncio.wait([work])

    running(scenario)


def test_the_archive_reports_ready_to_the_service_manager_while_the_database_is_away():
    class Manager(SystemdNotifier):
        ready_told = False

        def ready(self):
            self.ready_told = True

    async def scenario():
        manager = Manager({}, 0)
        address = parse_archive("postgresql://archive@127.0.0.1:1/none")
        work = asyncio.create_task(Ingester(MqttSettings(), ArchiveSettings(), address, SystemClock(), manager).run())
        await until(lambda: manager.ready_told or work.done(), "the word to the manager")
        assert not work.done()
        work.cancel()
        await asyncio.wait([work])

    asyncio.run(scenario())


def test_the_service_manager_gets_watchdog_messages_between_the_parts_of_a_long_backlog(database, broker):
    class Manager(SystemdNotifier):
        def __init__(self):
            super().__init__({}, 0)
            self.told = []

        def status(self, text):
            self.told.append(text)

        def watchdog(self):
            self.told.append("alive")

    async def scenario():
        manager, run = Manager(), origin()
        settings = MqttSettings(port=broker.port, keepalive_s=2)
        ingester = Ingester(settings, ArchiveSettings(), parse_archive(database), SystemClock(), manager)
        work = asyncio.create_task(ingester.run())
        async with observer(broker.port) as lab:
            while not lab.messages_on("heliocube/roof/records/kept"):
                await lab.publish("heliocube/roof/records", {"run": {"id": "none"}})
                await asyncio.sleep(1.0)
            pages = [{"poses": [pose_row(n) for n in range(page, page + 5000)]} for page in range(0, 20_000, 5000)]
            async with asyncio.TaskGroup() as group:
                for page in pages:
                    group.create_task(lab.publish("heliocube/roof/records", encoded(batch_of(run, page))))
            await until(lambda: "20000 records since the start" in manager.told, "all records")
        work.cancel()
        await asyncio.wait([work])
        counts = [at for at, text in enumerate(manager.told) if text.endswith("since the start")]
        assert all("alive" in manager.told[one:other] for one, other in pairwise(counts))
        assert len(counts) > 1

    running(scenario)
