"""The reference sender: measured or made-up irradiances from a CSV file, sent as a cube would send them."""

import asyncio
import csv
import gzip
import math
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, TextIO, cast

from daemon.base.addresses import BridgeError
from daemon.base.records import FACES, FaceReading, Quality, Scan
from daemon.bridge import senml
from daemon.bridge.sender import BridgeSender

if TYPE_CHECKING:
    from random import Random

    from daemon.base.clock import Clock
    from daemon.config.links import BridgeSettings

COLUMNS = ("time", *FACES)


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the file: UTC [s since 1970] and east, south, west, zenith [W/m2], NaN where the cell is empty."""

    time_utc_s: float
    irradiances_w_m2: tuple[float, float, float, float]


def read_csv(path: Path) -> list[Row]:
    """Return the rows of a CSV file, plain or ``.gz``, with the columns time, east, south, west and zenith.

    ``time`` is ISO 8601, UTC where it names no zone, and rises from line to line. An empty cell or ``nan`` is a face
    without a reading. Other columns are ignored.

    Raises
    ------
    BridgeError
        One sentence with the file, the line, the value and what is expected.
    """
    try:
        with _opened(path) as file:
            rows = list(_rows(path, file))
    except FileNotFoundError:
        raise BridgeError(f"{path} does not exist: name a CSV file with the columns {','.join(COLUMNS)}") from None
    except (OSError, EOFError, zlib.error) as error:
        raise BridgeError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    except UnicodeDecodeError:
        raise BridgeError(f"{path} is not text: a CSV file in UTF-8, plain or .gz, is expected") from None
    if not rows:
        raise BridgeError(f"{path} has no readings below its header")
    return rows


async def send_csv(
    path: Path,
    settings: "BridgeSettings",
    key: bytes | None,
    clock: "Clock",
    rng: "Random",
    *,
    speed: float = 1.0,
    keep_times: bool = False,
    on_progress: Callable[[int, int], None] | None = None,
    source: str = "csv",
) -> int:
    """Send every row of a CSV file as a scan, in the rhythm of its own times, and return how many were sent.

    The whole file is read and checked before the first scan is sent. The scans are marked as simulated.

    Parameters
    ----------
    path, settings, key, clock
        The file (see `read_csv`); where to send, signed with what (see `BridgeSender`); the time to pace by.
    rng
        Names the session.
    speed
        How many times faster than the file's own times.
    keep_times
        Send the file's UTC instead of the present one; a receiver refuses what is beyond its ``clock_skew_s``.
    on_progress
        Called after each scan with the number sent and the number in the file.
    source
        Name of the cube.

    Raises
    ------
    BridgeError
        For a wrong file, speed or setting.
    """
    if not (0 < speed < math.inf):
        raise BridgeError(f"the speed must be a number greater than 0, not {speed:g}")
    sender = BridgeSender(settings, key, clock)
    rows = read_csv(path)
    session = f"{rng.getrandbits(64):016x}"
    await sender.open()
    try:
        start_s = clock.monotonic()
        for sequence, row in enumerate(rows):
            due_s = start_s + (row.time_utc_s - rows[0].time_utc_s) / speed
            await asyncio.sleep(max(0.0, due_s - clock.monotonic()))
            utc_s = row.time_utc_s if keep_times else clock.utc()
            sender.send(_scan(row, source, session, sequence, utc_s, clock.monotonic()))
            if on_progress is not None:
                on_progress(sequence + 1, len(rows))
    finally:
        await sender.close()
    return len(rows)


def _scan(row: Row, source: str, session: str, sequence: int, utc_s: float, monotonic_s: float) -> Scan:
    east, south, west, zenith = (
        FaceReading(value, Quality.MISSING if math.isnan(value) else Quality.OK, utc_s, monotonic_s)
        for value in row.irradiances_w_m2
    )
    return Scan(
        source=source,
        session=session,
        sequence=sequence,
        time_utc_s=utc_s,
        time_monotonic_s=monotonic_s,
        east=east,
        south=south,
        west=west,
        zenith=zenith,
        simulated=True,
    )


def _opened(path: Path) -> TextIO:
    if path.suffix == ".gz":
        return cast("TextIO", gzip.open(path, "rt", encoding="utf-8-sig", newline=""))
    return path.open(encoding="utf-8-sig", newline="")


def _rows(path: Path, file: TextIO) -> Iterator[Row]:
    reader = csv.reader(file)
    try:
        header = [name.strip() for name in next(reader, [])]
        missing = [name for name in COLUMNS if name not in header]
        if missing:
            raise BridgeError(
                f"{path}, line 1: the column {missing[0]} is missing; the header must name {','.join(COLUMNS)}"
            )
        places = [header.index(name) for name in COLUMNS]
        before_s = -math.inf
        for cells in reader:
            if not cells:
                continue
            row = _row(cells, len(header), places, before_s)
            before_s = row.time_utc_s
            yield row
    except UnicodeDecodeError:
        raise
    except ValueError as error:
        raise BridgeError(f"{path}, line {reader.line_num}: {error}") from None
    except csv.Error as error:
        raise BridgeError(f"{path}, line {reader.line_num}: not CSV ({error})") from None


def _row(cells: list[str], width: int, places: list[int], before_s: float) -> Row:
    if len(cells) != width:
        raise ValueError(f"there are {len(cells)} cells where the header has {width}")
    stamp, *values = [cells[place].strip() for place in places]
    time_utc_s = _utc(stamp)
    if not (time_utc_s > before_s):
        raise ValueError(f"the time {stamp} is not later than that of the line before")
    east, south, west, zenith = map(_irradiance, FACES, values)
    return Row(time_utc_s, (east, south, west, zenith))


def _utc(text: str) -> float:
    try:
        instant = datetime.fromisoformat(text)
        return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        raise ValueError(f"the time {text!r} is not ISO 8601, such as 2022-10-14T10:20:05Z") from None


def _irradiance(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.inf if text else math.nan
    if not (abs(value) <= senml.LARGEST_W_M2) and not math.isnan(value):
        raise ValueError(
            f"{name} is {text!r}, not a number of W/m2 from {-senml.LARGEST_W_M2:g} to {senml.LARGEST_W_M2:g}"
        )
    return value
