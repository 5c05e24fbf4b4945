"""Sends every record of the store to an archive on the broker, again and again until the archive confirms it."""

import asyncio
import json
import logging
import math
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.clock import Clock
from daemon.base.reconnect import Backoff
from daemon.base.state import StateFile, StateFolder, UnreadableStateError
from daemon.base.timeloop import wait_at_most
from daemon.base.words import pluralise
from daemon.mqtt.connection import Incoming
from daemon.mqtt.link import Link
from daemon.mqtt.outbox import Message
from daemon.mqtt.topics import Topics
from daemon.service.rig import Role
from daemon.store.batches import MOST_NUMBER, MOST_ROWS, Batch, encoded, is_sound, next_batch, with_identifier
from daemon.store.runs import StoredRun, runs_of
from daemon.store.schema import FILE_NAME, open_for_reading, unreadable_store_error

log = logging.getLogger("heliocube.mqtt.archive")

STATE_NAME = "archived.json"
CUBE_STATE_NAME = "cube-archived.json"
_FIRST_ANSWER_S = 10.0
_LONGEST_ANSWER_S = 60.0
_TROUBLE_AFTER_S = 600.0
_ALARM_AFTER_S = 3600.0
_SAVE_EVERY_S = 60.0
# Of all runs but the last eight, one that had nothing more to send is finished for good.
_RUNS_NEVER_FINISHED = 8


class ArchiveProgress(BaseModel):
    """How far the archive has each run: by the run's identifier, the last number that the archive has confirmed."""

    model_config = ConfigDict(extra="forbid")

    through: dict[str, Annotated[int, Field(ge=-1, lt=MOST_NUMBER)]] = {}


@dataclass(frozen=True, slots=True)
class _Answer:
    run: str
    through: int
    refused: str = ""
    aside: int = 0
    why: str = ""


class ArchiveFeed:
    """Sends page after page, each when the one before is confirmed; a page that is not confirmed is sent again.

    Records wait in the store: nothing is lost while a broker or an archive is away, for as long as the store keeps it.

    Parameters
    ----------
    link, topics
        The way out, and under which names.
    directory, role
        Of the store, which the processes of cube and tracker may share: each sends its own runs. The file that says
        how far the archive has them is kept beside it.
    every_s
        How often the store is looked into when all is confirmed, on the machine's clock.
    keep_days
        How long the store keeps what is not confirmed.
    clock, random
        The service's time; jitter of repetition.
    speed
        The clock runs this many times as fast as the machine's.
    """

    def __init__(
        self,
        link: Link,
        topics: Topics,
        directory: Path,
        role: Role,
        every_s: float,
        keep_days: int,
        clock: Clock,
        random: Random,
        speed: float,
    ) -> None:
        self._link = link
        self._topic = topics.records
        self._path = directory / FILE_NAME
        self._of_cube = role is Role.CUBE
        self._every_s = every_s * speed
        self._keep_days = keep_days
        self._clock = clock
        self._speed = speed
        self._backoff = Backoff(random, _FIRST_ANSWER_S, 2.0, _LONGEST_ANSWER_S)
        name = CUBE_STATE_NAME if self._of_cube else STATE_NAME
        folder = StateFolder(directory, behind=True)
        self._file = StateFile(folder, name, ArchiveProgress, log, "how far the archive has the records")
        self._confirmed_through: dict[str, int] = {}
        self._finished: set[str] = set()
        self._sent_batch: Batch | None = None
        self._refusal_why = ""
        self._is_kept = False
        self._answered = asyncio.Event()
        self._aside_count, self._last_aside_s = 0, math.inf
        self._damaged = 0
        self._unsound: list[int] = []
        self._saved_s = clock.monotonic()
        self._confirmed_s = clock.monotonic()
        self._alarm: Callable[[str, str | None], None] = lambda _name, _text: None
        link.listen(topics.records_kept, self._take_answer)

    def set_alarm_callback(self, alarm: Callable[[str, str | None], None]) -> None:
        """Call `alarm` from now on with the name of an alarm and its text, None at its end."""
        self._alarm = alarm

    async def run(self) -> None:
        """Send until cancelled."""
        try:
            self._confirmed_through = (self._file.load() or ArchiveProgress()).through
        except UnreadableStateError as error:
            log.warning("%s: the archive gets all records of the store again, and keeps each once", error)
        try:
            while True:
                try:
                    page = await asyncio.to_thread(self._next_page)
                except Exception as error:  # noqa: BLE001 - nothing in a damaged store may end the service; it is shown
                    # A store that cannot be read for a moment needs no sentence here: the store itself reports it.
                    self._report_unconfirmed(
                        str(unreadable_store_error(self._path, error) if isinstance(error, sqlite3.Error) else error)
                    )
                    await asyncio.sleep(self._every_s)
                    continue
                self._report_unsound_runs()
                if page is None:
                    self._confirmed_s = self._clock.monotonic()
                    await asyncio.sleep(self._every_s)
                else:
                    await self._deliver(*page)
        finally:
            self._save()

    def _next_page(self) -> tuple[Batch, bytes] | None:
        """Return the next page and its message, of the oldest run first, None if all is confirmed.

        The message is no longer than the broker takes, except for a single record. Raises if the store cannot be read.
        """
        runs = [each for each in runs_of(self._path) if (each.origin.role == Role.CUBE.value) is self._of_cube]
        self._unsound = [run for run, origin in runs if not is_sound(with_identifier(run, origin))]
        runs = [each for each in runs if each.run not in self._unsound]
        with closing(open_for_reading(self._path)) as connection:
            ordered, most = sorted(runs, key=lambda each: each.run), MOST_ROWS
            while batch := self._page_of(connection, ordered, most):
                payload = encoded(batch)
                if self._is_short_enough(batch, payload):
                    return batch, payload
                most = batch.count // 2
        return None

    def _is_short_enough(self, batch: Batch, payload: bytes) -> bool:
        return batch.count == 1 or len(payload) <= self._link.most_bytes

    def _page_of(self, connection: sqlite3.Connection, runs: list[StoredRun], most: int) -> Batch | None:
        origins = {run: with_identifier(run, stored) for run, stored in runs}
        self._confirmed_through = {origin.id: self._confirmed_through.get(origin.id, -1) for origin in origins.values()}
        for place, (run, origin) in enumerate(origins.items()):
            if origin.id in self._finished:
                continue
            batch = next_batch(connection, run, origin, self._confirmed_through[origin.id], most)
            if batch is not None:
                return batch
            if place < len(runs) - _RUNS_NEVER_FINISHED:
                # By the identifier, not the number: a store that begins anew counts its runs from one again.
                self._finished.add(origin.id)
        return None

    async def _deliver(self, batch: Batch, payload: bytes) -> None:
        """Send one page until it is confirmed, or until it is too long for another broker that is connected by then."""
        message = Message(self._topic, payload, 1)
        self._sent_batch, self._is_kept, self._refusal_why = batch, False, ""
        self._answered.clear()
        self._backoff.reset()
        while self._is_short_enough(batch, payload):
            self._link.send_now(message)
            await wait_at_most(self._answered, self._backoff.next_s() * self._speed)
            if self._is_kept:
                self._note_confirmed(batch)
                return
            self._report_unconfirmed(self._refusal_why)

    def _note_confirmed(self, batch: Batch) -> None:
        self._confirmed_through[batch.origin.id] = batch.through
        self._confirmed_s = now_s = self._clock.monotonic()
        self._link.set_trouble("archive", None)
        self._alarm("archive-behind", None)
        if batch.damaged:
            self._damaged += batch.damaged
            are = pluralise(
                self._damaged, f"record of the store {self._path} is", f"records of the store {self._path} are"
            )
            self._link.set_trouble("archive damage", f"{are} damaged: they stay there, and no archive gets them")
        if now_s - self._saved_s >= _SAVE_EVERY_S:
            self._save()

    def _report_unsound_runs(self) -> None:
        if self._unsound:
            runs = ", ".join(map(str, self._unsound))
            what = f"the entry of run {runs} in the store {self._path} is damaged"
            self._link.set_trouble("archive runs", f"{what}: the run's records stay there, and no archive gets them")

    def _report_unconfirmed(self, why: str = "") -> None:
        """Report that nothing is confirmed, once that has lasted, with the reason unless no archive is there at all."""
        because = f" ({why})" if why else ""
        waited_s = (self._clock.monotonic() - self._confirmed_s) / self._speed
        if waited_s >= _ALARM_AFTER_S:
            what = f"no archive has confirmed records of {self._topic} for {waited_s / 3600.0:.0f} h{because}"
            self._alarm("archive-behind", f"{what}: they wait in the store, which keeps {self._keep_days} days")
        if waited_s >= _TROUBLE_AFTER_S and (why or self._link.connected):
            self._link.set_trouble(
                "archive",
                f"no archive confirms the records of {self._topic}{because}: they wait in the store, which keeps"
                f" {self._keep_days} days; see 'heliocube archive' on the archive's machine",
            )

    def _note_aside(self, answer: _Answer) -> None:
        """Raise an alarm if the archive's database does not take records; end it once it has taken all for an hour."""
        now_s = self._clock.monotonic()
        if answer.aside > 0:
            self._aside_count += answer.aside
            self._last_aside_s = now_s
            what = f"the archive's database does not take {pluralise(self._aside_count, 'record')} of {self._topic}"
            self._alarm("archive-set-aside", f"{what}: {answer.why}")
        elif now_s - self._last_aside_s >= _ALARM_AFTER_S * self._speed:
            self._aside_count, self._last_aside_s = 0, math.inf
            self._alarm("archive-set-aside", None)

    def _save(self) -> None:
        self._saved_s = self._clock.monotonic()
        self._file.save(ArchiveProgress(through=self._confirmed_through))

    def _take_answer(self, message: Incoming) -> None:
        if message.retained:
            return
        try:
            answer = _read(json.loads(message.payload))
        except (ValueError, RecursionError):
            self._link.set_trouble("archive answer", f"the message on {message.topic} is not an answer of an archive")
            return
        self._link.set_trouble("archive answer", None)
        if self._sent_batch is None or answer.run != self._sent_batch.origin.id:
            return
        if answer.refused:
            self._refusal_why = answer.refused
            self._link.set_trouble("archive", f"the archive refuses records of {self._topic}: {answer.refused}")
        elif answer.through == self._sent_batch.through:
            # An answer with another last number is for a page that was confirmed before, or never sent.
            self._note_aside(answer)
            self._is_kept = True
            self._answered.set()


def _read(found: Any) -> _Answer:
    match found:
        case {"run": str(run), "refused": str(refused)}:
            return _Answer(run, -1, _shown(refused))
        case {"run": str(run), "through": int(through), "set_aside": int(aside), "why": str(why)}:
            return _Answer(run, through, aside=aside, why=_shown(why))
        case {"run": str(run), "through": int(through)}:
            return _Answer(run, through)
    raise ValueError("it says neither how far a run is kept nor why it is not")


def _shown(text: str) -> str:
    # In ASCII and cut, because it is logged, shown and stored, whatever letters somebody has put there.
    return ascii(text)[1:-1][:300]
