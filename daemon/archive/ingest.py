"""Takes records from a broker into the database; records that the database has are confirmed to their sender."""

import asyncio
import contextlib
import json
import logging
import math
import secrets
from collections.abc import Callable, Iterator
from functools import partial
from random import Random
from typing import Any, TypeVar

from daemon.archive.address import ArchiveAddress, ArchiveError, ArchiveUnreachableError, PagesRefusedError
from daemon.archive.refused_records import RefusedRecordFinder
from daemon.archive.writer import ArchiveWriter, SentPage, WriteResult
from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.base.process import SystemdNotifier, on_signals
from daemon.base.reconnect import Backoff, Outage
from daemon.base.words import pluralise
from daemon.config.links import ArchiveSettings, MqttSettings
from daemon.mqtt.connection import Connection, ConnectionLostError, Incoming, run_until_first_ends
from daemon.mqtt.outbox import Message
from daemon.store.batches import BatchError, decoded

log = logging.getLogger("heliocube.archive")

Result = TypeVar("Result")

_GATHER_S = 0.25
_MOST_ROWS = 10_000
_MOST_PAGES = 1000
# The pages that are read at once take four times as much memory.
_MOST_BYTES = 2_000_000
_HUNG_S = 30.0
_FIRST_DELAY_S, _LONGEST_DELAY_S = 1.0, 30.0
_AGAIN_S = 3600.0
_MOST_NAMES = 10_000


async def serve(
    mqtt: MqttSettings, settings: ArchiveSettings, address: ArchiveAddress, clock: Clock, manager: SystemdNotifier
) -> None:
    """Take in records until SIGINT, SIGTERM or SIGHUP.

    Raises `ArchiveError` for a database that cannot be used as it is.
    """
    loop, end = asyncio.get_running_loop(), asyncio.Event()

    def end_from_outside() -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended already
            loop.call_soon_threadsafe(end.set)

    ingester = Ingester(mqtt, settings, address, clock, manager)
    with on_signals(end_from_outside):
        task, ended = asyncio.create_task(ingester.run()), asyncio.create_task(end.wait())
        await asyncio.wait((task, ended), return_when=asyncio.FIRST_COMPLETED)
        manager.stopping()
        for each in (task, ended):
            each.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


class Ingester:
    """Keeps nothing itself: records that are not in the database are not confirmed, and their sender sends them again.

    Several processes share the work of one group. A process that has lost its database leaves the broker, so that the
    others get everything.

    Parameters
    ----------
    mqtt, settings, address
        The broker, the topics, and the database.
    clock
        For pauses between lines of the log.
    manager
        Is told that the process is ready, and that it lives.
    """

    def __init__(
        self,
        mqtt: MqttSettings,
        settings: ArchiveSettings,
        address: ArchiveAddress,
        clock: Clock,
        manager: SystemdNotifier,
    ) -> None:
        self._mqtt = mqtt
        self._filters = [f"$share/{settings.group}/{topic}" for topic in settings.topics]
        self._address = address
        self._clock = clock
        self._manager = manager
        self._client_id = f"{mqtt.client_id or 'heliocube-archive'}-{secrets.token_hex(4)}"
        self._database_outage = Outage(log, "the database")
        self._broker_outage = Outage(log, "the MQTT broker")
        self._backoff = Backoff(Random(), _FIRST_DELAY_S, 2.0, _LONGEST_DELAY_S)  # noqa: S311 - jitter
        self._last_warned_s: dict[str, float] = {}
        self._began = False
        self.records = 0

    async def run(self) -> None:
        """Take in records until cancelled; raises `ArchiveError` if the database cannot be used at the beginning."""
        while True:
            try:
                await self._with_database()
            except ArchiveError as error:
                if not self._began and not isinstance(error, ArchiveUnreachableError):
                    raise
                self._database_outage.down(self._clock.monotonic(), str(error))
                # Without this report systemd would end and restart the process again and again while the database is
                # away.
                self._manager.ready()
            except (ConnectionLostError, UserError) as error:
                self._broker_outage.down(self._clock.monotonic(), str(error))
            self._manager.watchdog()
            await asyncio.sleep(self._backoff.next_s())

    async def _with_database(self) -> None:
        writer = await asyncio.to_thread(ArchiveWriter, self._address)
        try:
            await self._call_with_time_limit(writer, writer.prepare)
            self._database_outage.up(self._clock.monotonic())
            self._begin()
            await self._with_broker(writer)
        finally:
            writer.close()

    def _begin(self) -> None:
        if not self._began:
            self._began = True
            self._manager.ready()
            log.info("writing to %s the records that come on %s", self._address, ", ".join(self._filters))

    async def _with_broker(self, writer: ArchiveWriter) -> None:
        connection = Connection(self._mqtt, self._client_id, None, 1.0)
        await connection.open()
        try:
            for topic in self._filters:
                if not await connection.subscribe(topic):
                    raise ConnectionLostError(f"the broker does not let this user listen to {topic}")
            await self._receive_and_write(connection, writer)
        finally:
            await connection.close()

    async def _receive_and_write(self, connection: Connection, writer: ArchiveWriter) -> None:
        """Hear and write at the same time; the first of the two that ends raises why."""
        heard: asyncio.Queue[Incoming] = asyncio.Queue(_MOST_PAGES)
        await run_until_first_ends(self._receive_messages(connection, heard), self._write(connection, writer, heard))

    async def _receive_messages(self, connection: Connection, heard: "asyncio.Queue[Incoming]") -> None:
        async for message in connection.incoming():
            if not message.retained:
                await heard.put(message)

    async def _write(self, connection: Connection, writer: ArchiveWriter, heard: "asyncio.Queue[Incoming]") -> None:
        while True:
            self._manager.watchdog()
            self._broker_outage.up(self._clock.monotonic())
            messages = await _gather_messages(_HUNG_S, heard)
            if messages:
                await self._handle_messages(connection, writer, messages)
                self._backoff.reset()

    async def _handle_messages(self, connection: Connection, writer: ArchiveWriter, messages: list[Incoming]) -> None:
        pages, answers = await asyncio.to_thread(self._read, messages)
        await self._send_answers(connection, answers)
        for part in _parts(pages):
            await self._send_answers(connection, await self._write_pages(writer, part))

    async def _send_answers(self, connection: Connection, answers: list[Message]) -> None:
        for answer in answers:
            self._manager.watchdog()
            # With QoS 0: a sender that misses the answer sends its page again.
            await connection.publish(answer)

    def _read(self, messages: list[Incoming]) -> tuple[list[SentPage], list[Message]]:
        """Return the pages of messages, and the answers to messages that are not pages."""
        pages, answers = [], []
        for message in messages:
            installation, _, kind = message.topic.rpartition("/")
            if kind != "records":
                continue
            try:
                pages.append(SentPage(installation, decoded(message.payload)))
            except BatchError as error:
                self._warn_hourly(installation, f"a message on {message.topic} is not kept: {error}")
                if run := _run_of(message.payload):
                    answers.append(_answer(installation, {"run": run, "refused": str(error)}))
        return pages, answers

    async def _write_pages(self, writer: ArchiveWriter, pages: list[SentPage]) -> list[Message]:
        """Write pages and return the answers to their senders; a page that cannot be kept does not stop the others."""
        try:
            taken = await self._call_with_time_limit(writer, partial(writer.write, pages))
        except PagesRefusedError:
            if len(pages) > 1:
                return [answer for page in pages for answer in await self._write_pages(writer, [page])]
            return [await self._write_by_parts(writer, pages[0])]
        self._database_outage.up(self._clock.monotonic())
        self._note(taken)
        return [
            _answer(page.installation, {"run": page.batch.origin.id, "through": page.batch.through}) for page in pages
        ]

    async def _write_by_parts(self, writer: ArchiveWriter, page: SentPage) -> Message:
        """Write the records of a page that the database takes, set aside the rest, and return the sender's answer."""
        (installation, batch, _), sieve = page, RefusedRecordFinder(page)
        try:
            for part in sieve:
                try:
                    self._note(await self._call_with_time_limit(writer, partial(writer.write, [part])))
                except PagesRefusedError as error:
                    sieve.note_refusal(part, error)
            await self._call_with_time_limit(writer, partial(writer.set_aside, page, sieve.refused))
        except PagesRefusedError as error:
            self._warn_hourly(installation, f"a page of {installation} is not kept: {error}")
            return _answer(installation, {"run": batch.origin.id, "refused": str(error)})
        self._database_outage.up(self._clock.monotonic())
        kept = {"run": batch.origin.id, "through": batch.through}
        if not sieve.refused:
            return _answer(installation, kept)
        aside = len(sieve.refused)
        what = f"{pluralise(aside, 'record is', 'records are')} set aside ({sieve.refused[0].why})"
        self._warn_hourly(
            f"aside {installation}", f"of {installation} {what}: put it right, then 'heliocube archive retry'"
        )
        return _answer(installation, {**kept, "set_aside": aside, "why": sieve.refused[0].why})

    def _note(self, taken: WriteResult) -> None:
        self.records += taken.added
        self._manager.status(f"{pluralise(self.records, 'record')} since the start")
        for sentence in taken.name_conflicts:
            self._warn_hourly(sentence, sentence)

    def _warn_hourly(self, subject: str, sentence: str) -> None:
        """Warn of one thing once an hour at most."""
        now_s = self._clock.monotonic()
        if now_s - self._last_warned_s.get(subject, -math.inf) >= _AGAIN_S:
            if len(self._last_warned_s) >= _MOST_NAMES:
                self._last_warned_s.clear()
            self._last_warned_s[subject] = now_s
            log.warning("%s", sentence)

    async def _call_with_time_limit(self, writer: ArchiveWriter, call: Callable[[], Result]) -> Result:
        """Return the result of a database call; a call that hangs, or that nobody waits for any more, is ended."""
        self._manager.watchdog()
        job = asyncio.ensure_future(asyncio.to_thread(call))
        timer = asyncio.get_running_loop().call_later(_HUNG_S, writer.abort_call)
        try:
            return await asyncio.shield(job)
        except asyncio.CancelledError:
            writer.abort_call()
            await asyncio.gather(job, return_exceptions=True)
            raise
        finally:
            timer.cancel()


async def _gather_messages(first_s: float, heard: "asyncio.Queue[Incoming]") -> list[Incoming]:
    """Return the messages that come within a moment of the first: so a thousand small pages cost one transaction.

    Of large pages only as many are returned as make about one transaction; the others wait as they are.
    """
    messages: list[Incoming] = []
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(first_s):
            messages.append(await heard.get())
        size = len(messages[0].payload)
        async with asyncio.timeout(_GATHER_S):
            while len(messages) < _MOST_PAGES and size < _MOST_BYTES:
                messages.append(await heard.get())
                size += len(messages[-1].payload)
    return messages


def _parts(pages: list[SentPage]) -> Iterator[list[SentPage]]:
    """Yield pages in parts with so few records that each is written quickly."""
    part: list[SentPage] = []
    count = 0
    for page in pages:
        part.append(page)
        count += page.batch.count
        if count >= _MOST_ROWS:
            yield part
            part, count = [], 0
    if part:
        yield part


def _answer(installation: str, page: dict[str, Any]) -> Message:
    return Message(f"{installation}/records/kept", json.dumps(page).encode())


def _run_of(payload: bytes) -> str | None:
    """Return the run that a message says it is of, whatever else is wrong with it."""
    try:
        found = json.loads(payload)["run"]["id"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return found if isinstance(found, str) else None
