"""Copies a store's file into an archive, for records that its service cannot send, or would send for hours."""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from daemon.archive.address import ArchiveAddress, PagesRefusedError
from daemon.archive.refused_records import write_accepted_records
from daemon.archive.writer import ArchiveWriter, SentPage
from daemon.base.errors import UserError
from daemon.store.batches import Batch, BatchError, decoded, encoded, is_sound, next_batch, with_identifier
from daemon.store.runs import StoredRun, runs_of
from daemon.store.schema import FILE_NAME, open_for_reading, unreadable_store_error

_PAGES_AT_ONCE = 20


class FillResult(NamedTuple):
    """What became of a store's records.

    Attributes
    ----------
    read, added
        How many records it has, and how many of them the archive did not have.
    aside
        How many the database does not take; they are set aside there.
    damaged
        How many are damaged in the store and left out.
    unsound
        Runs that are left out, because what the store knows of them is damaged.
    """

    read: int
    added: int
    aside: int
    damaged: int
    unsound: tuple[int, ...]


def fill(
    store: Path, address: ArchiveAddress, installation: str, progress: Callable[[int], None] = lambda _count: None
) -> FillResult:
    """Write every record of a store that the archive does not have.

    Parameters
    ----------
    store
        Its folder, or its file; a service may write to it meanwhile.
    address, installation
        Of the archive, and the name of the records there, ``PREFIX/NAME``: the service's own if it sends records too.
    progress
        Called with the number of records that are done.

    Raises
    ------
    UserError
        The store cannot be read, or the archive not written.
    """
    path = store / FILE_NAME if store.is_dir() else store
    writer = None
    read = added = aside = damaged = 0
    runs = [StoredRun(run, with_identifier(run, origin)) for run, origin in runs_of(path)]
    unsound = tuple(run for run, origin in runs if not is_sound(origin))
    try:
        part: list[SentPage] = []
        for batch in _batches(path, [each for each in runs if each.run not in unsound]):
            damaged += batch.damaged
            if writer is None:
                writer = ArchiveWriter(address)
                writer.prepare()
            part.append(SentPage(installation, batch, live=False))
            if len(part) == _PAGES_AT_ONCE:
                more, refused = _take(writer, part)
                added, aside, part = added + more, aside + refused, []
            read += batch.count
            progress(read)
        if writer is not None and part:
            more, refused = _take(writer, part)
            added, aside = added + more, aside + refused
    finally:
        if writer is not None:
            writer.close()
    return FillResult(read=read, added=added, aside=aside, damaged=damaged, unsound=unsound)


def _take(writer: ArchiveWriter, pages: list[SentPage]) -> tuple[int, int]:
    """Write pages; return how many records are new, and how many are set aside."""
    try:
        return writer.write(pages).added, 0
    except PagesRefusedError:
        sifted = [write_accepted_records(writer, page) for page in pages]
        return sum(added for added, _ in sifted), sum(len(refused) for _, refused in sifted)


def _batches(path: Path, runs: list[StoredRun]) -> Iterator[Batch]:
    with closing(open_for_reading(path)) as connection:
        for run, origin in runs:
            after = -1
            try:
                while batch := next_batch(connection, run, origin, after):
                    # Encoded and decoded, so that it is checked like a page that comes over a broker.
                    yield replace(decoded(encoded(batch)), damaged=batch.damaged)
                    after = batch.through
            except sqlite3.Error as error:
                raise unreadable_store_error(path, error) from None
            except BatchError as error:
                place = f"the store {path} has a record after number {after} of run {run} that no archive takes"
                raise UserError(f"{place}: {error}") from None
