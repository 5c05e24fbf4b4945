"""What a service sends to an archive, and what it says while none takes its records, in virtual time."""

import asyncio
import contextlib
import json
import math
import sqlite3
from contextlib import closing
from random import Random

import pytest

from daemon.base.clock import LoopClock
from daemon.base.timeloop import ScaledTimeLoop, VirtualTimeLoop
from daemon.mqtt.archive_feed import STATE_NAME, ArchiveFeed
from daemon.mqtt.connection import Incoming
from daemon.mqtt.outbox import Message
from daemon.mqtt.topics import Topics
from daemon.service.rig import Role
from daemon.store.batches import decoded
from daemon.store.schema import FILE_NAME
from daemon.store.store import Store
from tests.support.archive import T0, Sender, event, origin, pose
from tests.support.mqtt import SPEED, needs_mosquitto, observer, until

KEPT = "lab/roof/records/kept"


class HandLink:
    """A link to an archive that gives the answers of a test; `kept` has the records that it has confirmed."""

    connected = True
    most_bytes = math.inf

    def __init__(self):
        self.answers = []
        self.pages = []
        self.kept = set()
        self.troubles = {}

    def listen(self, topic, handler):
        assert topic == KEPT
        self._handler = handler

    def set_trouble(self, subject, sentence):
        self.troubles[subject] = sentence

    def send_now(self, message):
        """Give the next answer of the test, or none for None; confirm the page when no answers are left."""
        page = json.loads(message.payload)
        self.pages.append(page)
        run, through = page["run"]["id"], page["through"]
        if self.answers:
            payload = self.answers.pop(0)
        else:
            payload = json.dumps({"run": run, "through": through}).encode()
            self.kept |= {(run, row[0]) for table in page["records"].values() for row in table["rows"]}
        if payload is not None:
            asyncio.get_running_loop().call_soon(self._handler, Incoming(KEPT, payload, retained=False))


class Service:
    """A store and its feed; the runs that keep records follow one another."""

    def __init__(self, folder, link):
        self.folder = folder
        self.clock = LoopClock(asyncio.get_running_loop().time, T0)
        self.alarms = {}
        self.feed = ArchiveFeed(link, Topics("lab", "roof"), folder, Role.BOTH, 10.0, 400, self.clock, Random(1), 1.0)
        self.feed.set_alarm_callback(self.alarms.__setitem__)

    def keep(self, *records, run=None):
        """Keep records by one run of the service, from its beginning to its end."""
        store = Store(self.folder, 60.0, 400, run or origin(), self.clock, print)
        for record in records:
            store.keep(record)
        store.close()

    async def send_for(self, time_s):
        sending = asyncio.create_task(self.feed.run())
        done, _ = await asyncio.wait([sending], timeout=time_s)
        assert not done, sending
        sending.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await sending


def virtual(scenario):
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


DEEP = b"[" * 100_000


@pytest.mark.parametrize(
    "payload",
    [
        b"[]", b"1", b'"x"', b"null", b"{}", DEEP, b'{"run":' + DEEP, b'{"run":"RUN","through":1e400}',
        b'{"run":"RUN","through":NaN}', b'{"run":"RUN","through":"1"}', b'{"run":1,"through":1}',
        b'{"run":"RUN","refused":1}', b"\xff",
    ],
)  # fmt: skip
def test_a_message_that_is_no_archive_answer_is_reported_until_a_valid_answer_comes(tmp_path, payload):
    async def scenario():
        link, run = HandLink(), origin()
        service = Service(tmp_path, link)
        service.keep(pose(0), run=run)
        link.answers = [payload.replace(b"RUN", run.id.encode())]
        await service.send_for(5.0)
        assert link.troubles["archive answer"] == f"the message on {KEPT} is not an answer of an archive"
        await service.send_for(60.0)
        assert link.troubles["archive answer"] is None
        assert link.kept == {(run.id, 0)}

    virtual(scenario)


@pytest.mark.parametrize("through", [-1, 1, 2**63 - 1, 2**63])
def test_a_confirmation_of_records_that_were_not_sent_is_ignored_and_the_page_is_sent_again(tmp_path, through):
    async def scenario():
        link, run = HandLink(), origin()
        service = Service(tmp_path, link)
        service.keep(pose(0), run=run)
        link.answers = [json.dumps({"run": run.id, "through": through}).encode()]
        await service.send_for(100.0)
        assert link.kept == {(run.id, 0)}
        assert [page["through"] for page in link.pages] == [0, 0]

    virtual(scenario)


@pytest.mark.parametrize("through", [-2, 2**53, 2**63])
def test_a_saved_record_number_that_no_record_has_is_ignored_and_all_records_are_sent_again(tmp_path, through, caplog):
    async def scenario():
        link, run = HandLink(), origin()
        service = Service(tmp_path, link)
        service.keep(pose(0), run=run)
        (tmp_path / STATE_NAME).write_text(json.dumps({"through": {run.id: through}}))
        await service.send_for(100.0)
        assert link.kept == {(run.id, 0)}
        assert "the archive gets all records of the store again" in caplog.text

    virtual(scenario)


def test_an_archive_refusal_with_unencodable_characters_is_shown_escaped(tmp_path):
    async def scenario():
        link, run = HandLink(), origin()
        service = Service(tmp_path, link)
        service.keep(pose(0), run=run)
        link.answers = [json.dumps({"run": run.id, "refused": "no \ud800\n"}).encode()] * 3
        await service.send_for(5.0)
        refused = "the archive refuses records of lab/roof/records: no \\ud800\\n"
        assert link.troubles == {"archive answer": None, "archive": refused}

    virtual(scenario)


def test_records_that_the_archive_refuses_for_an_hour_raise_an_alarm_with_the_reason(tmp_path):
    async def scenario():
        link, run = HandLink(), origin()
        service = Service(tmp_path, link)
        service.keep(pose(0), run=run)
        link.answers = [json.dumps({"run": run.id, "refused": "update it"}).encode()] * 1000
        await service.send_for(4000.0)
        assert service.alarms["archive-behind"] == (
            "no archive has confirmed records of lab/roof/records for 1 h (update it): they wait in the store, which"
            " keeps 400 days"
        )
        link.answers.clear()
        await service.send_for(100.0)
        assert link.kept == {(run.id, 0)}

    virtual(scenario)


def test_the_archive_also_gets_the_records_of_a_store_that_was_begun_anew(tmp_path):
    async def scenario():
        link, late = HandLink(), origin()
        service = Service(tmp_path, link)
        for number in range(11):
            service.keep(pose(number))
        await service.send_for(100.0)
        assert len(link.kept) == 11
        (tmp_path / FILE_NAME).unlink()
        service.keep(pose(11), run=late)
        await service.send_for(100.0)
        assert (late.id, 0) in link.kept

    virtual(scenario)


def test_time_with_an_unreadable_store_counts_towards_the_hour_before_the_archive_alarm(tmp_path):
    async def scenario():
        link = HandLink()
        service = Service(tmp_path, link)
        link.answers = [None] * 1000
        (tmp_path / FILE_NAME).write_bytes(b"no store")
        await service.send_for(3500.0)
        (tmp_path / FILE_NAME).unlink()
        service.keep(pose(0))
        await service.send_for(50.0)
        assert service.alarms == {}
        await service.send_for(200.0)
        assert service.alarms["archive-behind"].startswith("no archive has confirmed records of lab/roof/records for 1")

    virtual(scenario)


@pytest.mark.parametrize(
    "damage",
    [
        "a_deg = x'00'", "a_deg = 'steep'", "moving = 'perhaps'", "tracker = x'ff'", "tracker = CAST(x'ff' AS TEXT)",
        "time = x'00'", "time = 1e10", "time = -1", "number = x'00'", "number = 'many'",
    ],
)  # fmt: skip
def test_damaged_records_are_reported_and_stay_in_the_store_and_all_others_are_sent(tmp_path, damage):
    async def scenario():
        link, run, later = HandLink(), origin(), origin()
        service = Service(tmp_path, link)
        service.keep(*(pose(n) for n in range(1200)), run=run)
        service.keep(pose(1200), run=later)
        with closing(sqlite3.connect(tmp_path / FILE_NAME)) as store, store:
            store.execute("UPDATE poses SET wind_m_s = 'nothing' WHERE run = 1 AND number BETWEEN 500 AND 999")
            store.execute(f"UPDATE poses SET {damage} WHERE run = 1 AND number = 300")
        await service.send_for(100.0)
        assert link.kept == {(run.id, n) for n in range(1200) if n != 300 and not 500 <= n < 1000} | {(later.id, 0)}
        assert all(decoded(json.dumps(page).encode()) for page in link.pages)
        number = 500 + ("number" not in damage)
        assert link.troubles["archive damage"] == (
            f"{number} records of the store {tmp_path / FILE_NAME} are damaged: they stay there, and no archive gets"
            " them"
        )

    virtual(scenario)


@pytest.mark.parametrize("damage", ["site = x'00'", "latitude_deg = 'north'", "started = 1e18"])
def test_a_run_with_a_damaged_entry_is_reported_and_the_records_of_other_runs_are_sent(tmp_path, damage):
    async def scenario():
        link, later = HandLink(), origin()
        service = Service(tmp_path, link)
        service.keep(pose(0))
        service.keep(pose(1), run=later)
        with closing(sqlite3.connect(tmp_path / FILE_NAME)) as store, store:
            store.execute(f"UPDATE runs SET {damage} WHERE run = 1")
        await service.send_for(100.0)
        assert link.kept == {(later.id, 0)}
        assert link.troubles["archive runs"] == (
            f"the entry of run 1 in the store {tmp_path / FILE_NAME} is damaged: the run's records stay"
            " there, and no archive gets them"
        )

    virtual(scenario)


def rubbish(path):
    """Overwrite pages in the middle, which nobody writes to any more."""
    with closing(sqlite3.connect(path)) as store:
        store.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    whole = bytearray(path.read_bytes())
    middle = len(whole) // 8192 * 4096
    whole[middle : middle + 16384] = b"\xa5" * 16384
    path.write_bytes(whole)


def test_a_store_damaged_in_the_middle_is_reported_and_raises_the_alarm_and_the_feed_goes_on(tmp_path):
    async def scenario():
        link = HandLink()
        service = Service(tmp_path, link)
        service.keep(*(pose(n) for n in range(3000)))
        rubbish(tmp_path / FILE_NAME)
        await service.send_for(4000.0)
        assert 0 < len(link.kept) <= 1500
        why = "'heliocube store salvage "
        assert why in link.troubles["archive"]
        assert service.alarms["archive-behind"].startswith("no archive has confirmed records of lab/roof/records for 1")
        assert why in service.alarms["archive-behind"]

    virtual(scenario)


def test_an_hour_without_an_archive_raises_an_alarm_and_the_records_stay_in_the_store(tmp_path, free_udp_port):
    async def scenario():
        clock = LoopClock(asyncio.get_running_loop().time, T0)
        # No broker listens there.
        sender = Sender(tmp_path, free_udp_port, clock=clock)
        sender.keep(*(pose(n) for n in range(3)))
        sender.store.close()
        async with sender.sending():
            await asyncio.sleep(3500.0)
            assert sender.alarms == {}
            await asyncio.sleep(300.0)
            waits = "they wait in the store, which keeps 400 days"
            text = f"no archive has confirmed records of lab/roof/records for 1 h: {waits}"
            assert sender.alarms == {"archive-behind": text}
        assert len(sender.rows()) == 3

    virtual(scenario)


def test_a_page_is_no_longer_than_the_broker_takes_except_for_a_single_record(tmp_path):
    async def scenario():
        link, run = HandLink(), origin()
        service = Service(tmp_path, link)
        service.keep(*(pose(n) for n in range(100)), event(100, "long " * 400), run=run)
        link.answers = [None]
        sending = asyncio.create_task(service.send_for(1000.0))
        await asyncio.sleep(1.0)
        assert [page["through"] for page in link.pages] == [100]
        link.most_bytes = 2000
        await sending
        assert link.kept == {(run.id, number) for number in range(101)}
        short = [len(json.dumps(page, separators=(",", ":"))) for page in link.pages[1:-1]]
        assert 1000 < max(short) <= 2000
        assert [row[0] for row in link.pages[-1]["records"]["events"]["rows"]] == [100]

    virtual(scenario)


@needs_mosquitto
def test_a_message_longer_than_the_broker_accepts_is_reported_and_does_not_end_the_connection(tmp_path, make_broker):
    async def scenario():
        broker = make_broker(most_bytes=5000).start()
        sender = Sender(tmp_path / "store", broker.port)
        sender.link.at_birth(lambda: [Message("lab/roof/config", b"x" * 5001)])
        sender.keep(*(pose(n) for n in range(300)))
        async with sender.sending():
            await until(lambda: sender.link.status.sent >= 1, "a page")
        longest = "the broker takes no message of more than 4488 bytes, and one for lab/roof/config has 5001"
        assert sender.link.status.troubles == (f"{longest}: raise its limit (mosquitto: max_packet_size)",)
        assert sender.link.status.connections == 1
        sender.store.close()

    asyncio.run(scenario())


@needs_mosquitto
def test_a_broker_that_ends_the_connection_at_a_page_without_a_reason_gets_shorter_pages(tmp_path, make_broker):
    async def scenario():
        broker = make_broker(unsaid_most_bytes=5000).start()
        sender = Sender(tmp_path / "store", broker.port, speed=SPEED)
        sender.keep(*(pose(n) for n in range(150)))
        async with observer(broker.port, "lab/roof/records") as lab, sender.sending():
            page = await lab.until("lab/roof/records")
            assert page["through"] == 74
            ends = sender.link.status.connections
            await until(lambda: len(lab.messages_on("lab/roof/records")) > 2, "the page again")
            assert sender.link.status.connections == ends
        sender.store.close()

    with asyncio.Runner(loop_factory=lambda: ScaledTimeLoop(SPEED)) as runner:
        runner.run(scenario())


@needs_mosquitto
def test_a_connection_that_ends_at_a_short_message_does_not_shorten_the_archive_pages(tmp_path, make_broker):
    async def scenario():
        broker = make_broker(unsaid_most_bytes=300).start()
        sender = Sender(tmp_path / "store", broker.port, speed=SPEED)
        sender.link.send(Message("lab/roof/reply", b"x" * 400, 1))
        async with sender.sending():
            await until(lambda: sender.link.status.connections > 3, "the end of three connections")
        assert sender.link.most_bytes > 100_000
        sender.store.close()

    with asyncio.Runner(loop_factory=lambda: ScaledTimeLoop(SPEED)) as runner:
        runner.run(scenario())
