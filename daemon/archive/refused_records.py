"""Records that the database does not take: found among those of a page, and set aside in a table of their own.

A constraint that somebody has added, or a column of a narrower type, must not keep back all records after the first
that it refuses.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from daemon.archive.address import ArchiveAddress, PagesRefusedError, RecordsRefusedError
from daemon.archive.writer import ArchiveWriter, RefusedRecord, SentPage
from daemon.store.batches import Batch


class RefusedRecordFinder:
    """Hands out a refused page in ever smaller parts, until only single records are refused.

    Iterate over the parts and try to write each; `note_refusal` those that fail. No part moves the end of its run.

    Attributes
    ----------
    refused
        The records, and why.
    """

    def __init__(self, page: SentPage) -> None:
        self._parts_left = _halves(page) or [page]
        self.refused: list[RefusedRecord] = []

    def __iter__(self) -> Iterator[SentPage]:
        """Yield parts until all are tried."""
        while self._parts_left:
            yield self._parts_left.pop()

    def note_refusal(self, part: SentPage, error: PagesRefusedError) -> None:
        """Take note that a part was refused; raises the error if it is not about the only record of the part."""
        halves = _halves(part)
        if not halves and not isinstance(error, RecordsRefusedError):
            raise error
        self._parts_left += halves
        if not halves:
            ((kind, (row,)),) = part.batch.rows.items()
            self.refused.append(RefusedRecord(kind, row, str(error)))


def _halves(page: SentPage) -> list[SentPage]:
    """Return the two halves of a page, the later one first; none for one record. Records of a kind are adjacent."""
    batch = page.batch
    records = [(kind, row) for kind, rows in batch.rows.items() for row in rows]
    if len(records) < 2:
        return []
    middle = len(records) // 2
    halves = records[middle:], records[:middle]
    return [page._replace(batch=Batch(batch.origin, -1, _by_kind(half))) for half in halves]


def _by_kind(records: Sequence[tuple[str, tuple[Any, ...]]]) -> dict[str, list[tuple[Any, ...]]]:
    rows: dict[str, list[tuple[Any, ...]]] = {}
    for kind, row in records:
        rows.setdefault(kind, []).append(row)
    return rows


def write_accepted_records(writer: ArchiveWriter, page: SentPage) -> tuple[int, list[RefusedRecord]]:
    """Write a page without the records that the database does not take; return how many are new, and the refused ones.

    Raises
    ------
    ArchiveError
        As `ArchiveWriter.write`, except for records that are set aside.
    """
    try:
        return writer.write([page]).added, []
    except PagesRefusedError:
        sieve, added = RefusedRecordFinder(page), 0
    for part in sieve:
        try:
            added += writer.write([part]).added
        except PagesRefusedError as error:
            sieve.note_refusal(part, error)
    writer.set_aside(page, sieve.refused)
    return added, sieve.refused


class RetryResult(NamedTuple):
    """How many records were set aside, how many of them the database takes now, and why it does not take the others."""

    aside: int
    taken: int
    still: dict[str, int]


def retry(address: ArchiveAddress, progress: Callable[[int], None] = lambda _count: None) -> RetryResult:
    """Write the records that were set aside, and remove each from there that the database has now.

    Parameters
    ----------
    address
        Of the archive.
    progress
        Called with the number of records that are done.

    Raises
    ------
    ArchiveError
        The database cannot be used, or does not answer.
    """
    writer = ArchiveWriter(address)
    try:
        writer.prepare()
        aside, still = 0, dict[str, int]()
        for page in writer.pages_aside():
            _, refused = write_accepted_records(writer, page)
            for each in refused:
                still[each.why] = still.get(each.why, 0) + 1
            writer.forget_aside(page, refused)
            aside += page.batch.count
            progress(aside)
    finally:
        writer.close()
    return RetryResult(aside, aside - sum(still.values()), still)
