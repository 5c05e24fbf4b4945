"""Records of a store on their way to an archive: a page of one run at a time, as JSON.

A record keeps the number that its store gave it; this number and the identifier of its run are its key everywhere.
"""

import json
import math
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from typing import Any
from uuid import NAMESPACE_URL, uuid5

from daemon.base.clock import END_UTC_S, FIRST_UTC_S
from daemon.store.schema import columns_of
from daemon.store.store import Origin
from daemon.store.tables import COLUMNS

FORMAT = 1
"""Version of the message's form; a reader refuses any other."""
MOST_ROWS = 500
"""Most records of one page, some 100 kB."""
MOST_NUMBER = 1 << 53
"""The numbers of records are smaller than this."""
_MOST_ROWS_TAKEN = 5000
_COLUMNS = dict(COLUMNS.values())
_ORIGIN_TYPES = {field.name: field.type for field in fields(Origin)}
_KNOWN = {name: {"number", *(column.name for column in columns)} for name, columns in _COLUMNS.items()}
KINDS = tuple(_COLUMNS)


class BatchError(ValueError):
    """A message is not a page of records; one sentence."""


@dataclass(frozen=True, slots=True)
class Batch:
    """A page of one run's records.

    Attributes
    ----------
    origin
        The run; its `id` is never empty.
    through
        The page holds every record that its store has of the run, from the previous page up to this number.
    rows
        By the name of the table: the number and then the values of its columns, None for what is not known.
    damaged
        How many records of the store are left out, because no archive takes them.
    """

    origin: Origin
    through: int
    rows: dict[str, list[tuple[Any, ...]]]
    damaged: int = 0

    @property
    def count(self) -> int:
        """How many records it holds."""
        return sum(map(len, self.rows.values()))

    @property
    def last_utc_s(self) -> float:
        """The latest time of its records [s UTC]."""
        return max((row[1] for rows in self.rows.values() for row in rows), default=-math.inf)


def with_identifier(run: int, origin: Origin) -> Origin:
    """Return a run's origin with an identifier; a run from before there were any gets the same one at each call."""
    if origin.id:
        return origin
    known = "/".join(str(value) for value in (run, *asdict(origin).values()))
    return Origin(**(asdict(origin) | {"id": uuid5(NAMESPACE_URL, known).hex}))


def next_batch(
    connection: sqlite3.Connection, run: int, origin: Origin, after: int, most: int = MOST_ROWS
) -> Batch | None:
    """Return the records of a run that follow a number, in the order of their numbers; None where there are none yet.

    Parameters
    ----------
    connection
        To the store, for reading.
    run, origin
        As `runs_of` returns them.
    after
        The number of the last record that is not wanted any more, -1 for none.
    """
    connection.text_factory = _text_or_bytes
    # In one transaction: otherwise a record that a service writes to the first table while the second is read would be
    # missed. The page ends at a later number, so nobody would ask for that record again.
    with connection:
        connection.execute("BEGIN")
        found = [row for name in _COLUMNS for row in _rows_after(connection, name, run, after, most)]
    if not found:
        return None
    found.sort(key=lambda item: item[0])
    page = found[:most]
    rows: dict[str, list[tuple[Any, ...]]] = {}
    for _, name, row in page:
        if _is_sound_record(name, row):
            rows.setdefault(name, []).append(row)
    return Batch(with_identifier(run, origin), page[-1][0], rows, len(page) - sum(map(len, rows.values())))


def is_sound(origin: Origin) -> bool:
    """Tell whether an archive takes the origin of a run; it refuses only what a damaged store has."""
    try:
        _origin(asdict(origin))
    except (ValueError, TypeError):
        return False
    return True


def _is_sound_record(name: str, row: tuple[Any, ...]) -> bool:
    """Tell whether an archive takes a record."""
    try:
        values = [_CONVERTERS[column.holds](value) for column, value in zip(_COLUMNS[name], row[1:], strict=True)]
    except ValueError:
        return False
    return values[0] is not None


def _text_or_bytes(text: bytes) -> str | bytes:
    try:
        return text.decode()
    except UnicodeDecodeError:
        # Its record is judged by itself; an error of SQLite's here would end the reading of all records after it.
        return text


def _rows_after(
    connection: sqlite3.Connection, name: str, run: int, after: int, most: int
) -> Iterator[tuple[int, str, tuple[Any, ...]]]:
    """Yield the first rows of a table after a number, each with its number and the table's name."""
    there = columns_of(connection, name)
    if there:
        wanted = ", ".join(column.name if column.name in there else "NULL" for column in _COLUMNS[name])
        query = (
            f"SELECT number, {wanted} FROM {name} WHERE run = ? AND number > ? AND typeof(number) = 'integer'"  # noqa: S608 - our own names
            " ORDER BY number LIMIT ?"
        )
        for row in connection.execute(query, (run, after, most)):
            yield row[0], name, row


def encoded(batch: Batch) -> bytes:
    """Return a page of `next_batch` as the JSON of a message; its run has to be sound."""
    kinds = {
        name: {"columns": ["number", *(column.name for column in _COLUMNS[name])], "rows": rows}
        for name, rows in batch.rows.items()
    }
    page = {"format": FORMAT, "run": asdict(batch.origin), "through": batch.through, "records": kinds}
    return json.dumps(page, separators=(",", ":")).encode()


def decoded(payload: bytes) -> Batch:
    """Return the page of a message.

    Each column is checked, because anybody who may write to the broker may have written the page. A number that is not
    finite or out of range counts as unknown, and so does a column that the message lacks. A kind or a column that this
    program does not know is refused, because it would be lost once the page is confirmed.

    Raises
    ------
    BatchError
        It is not a page of records, or has a kind of records, or a column with values, that a later program writes.
    """
    try:
        page = json.loads(payload)
        _check_format(page["format"])
        origin = _origin(page["run"])
        rows = {name: _rows(name, **table) for name, table in page["records"].items()}
        through = _record_number(page["through"])
    except BatchError:
        raise
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError) as error:
        raise BatchError(f"it is no page of records ({ascii(error)[:200]})") from None
    batch = Batch(origin, through, rows)
    if batch.count > _MOST_ROWS_TAKEN:
        raise BatchError(f"it has {batch.count} records, and {_MOST_ROWS_TAKEN} are the most")
    if any(row[0] > through for table in rows.values() for row in table):
        raise BatchError("it has records after its own end")
    return batch


def _check_format(found: Any) -> None:
    if found != FORMAT:
        raise BatchError(
            f"it is of format {ascii(found)[:20]}, and this archive reads format {FORMAT}: update the archive"
        )


def _origin(found: dict[str, Any]) -> Origin:
    values = {name: _ORIGIN_CONVERTERS[kind](found[name]) for name, kind in _ORIGIN_TYPES.items()}
    origin = Origin(**values)
    if not 16 <= len(origin.id) <= 64 or not origin.id.isalnum():
        raise BatchError("its run has no identifier")
    has_place = all(map(math.isfinite, (origin.latitude_deg, origin.longitude_deg, origin.altitude_m)))
    if not (has_place and FIRST_UTC_S <= origin.started_utc_s < END_UTC_S):
        raise BatchError("its run has no place or no start")
    return origin


def _rows(name: str, columns: list[str], rows: list[list[Any]]) -> list[tuple[Any, ...]]:
    if name not in _COLUMNS:
        raise _unknown_name_error(name)
    places = {column: place for place, column in enumerate(columns)}
    for column in places.keys() - _KNOWN[name]:
        if any(row[places[column]] is not None for row in rows):
            raise _unknown_name_error(column, f"{name} with ")
    number = places["number"]
    chosen = [(places.get(column.name), _CONVERTERS[column.holds]) for column in _COLUMNS[name]]
    found = []
    for row in rows:
        values = [None if place is None else value(row[place]) for place, value in chosen]
        if values[0] is None:
            raise BatchError("a record has no time from 1970 to 2200")
        found.append((_record_number(row[number]), *values))
    return found


def _unknown_name_error(found: str, where: str = "") -> BatchError:
    return BatchError(f"it has {where}{ascii(found)[:40]}, which this archive does not know: update the archive")


def _record_number(value: Any) -> int:
    if type(value) is not int or not 0 <= value < MOST_NUMBER:
        raise BatchError(f"{ascii(value)[:40]} is not the number of a record")
    return value


def _float(value: Any) -> float | None:
    if value is None or type(value) not in (float, int):
        _require_none(value, "number")
        return None
    return float(value) if math.isfinite(value) else None


def _time(value: Any) -> float | None:
    found = _float(value)
    # Other times count as unknown: an archive makes a table for every day that a record names.
    return found if found is not None and FIRST_UTC_S <= found < END_UTC_S else None


def _int(value: Any) -> int | None:
    if type(value) not in (int, bool):
        _require_none(value, "whole number")
        return None
    return int(value) if -MOST_NUMBER < value < MOST_NUMBER else None


def _bool(value: Any) -> bool | None:
    if type(value) not in (int, bool):
        _require_none(value, "truth")
        return None
    return bool(value)


def _text(value: Any) -> str | None:
    if not isinstance(value, str):
        _require_none(value, "text")
        return None
    # JSON can spell lone surrogates, which cannot be written anywhere; encoding raises a UnicodeEncodeError for them.
    value.encode()
    # PostgreSQL cannot store the character NUL.
    return value.replace("\0", "")


def _require_none(value: Any, what: str) -> None:
    if value is not None:
        raise BatchError(f"{ascii(value)[:40]} is no {what}")


_CONVERTERS: dict[str, Callable[[Any], Any]] = {
    "time": _time,
    "float": _float,
    "int": _int,
    "bool": _bool,
    "text": _text,
}
_ORIGIN_CONVERTERS: dict[Any, Callable[[Any], Any]] = {
    float: lambda value: math.nan if (found := _float(value)) is None else found,
    bool: lambda value: bool(_bool(value)),
    str: lambda value: _text(value) or "",
}
