"""The reference sender: sends measured or invented irradiances from a CSV file as a cube would send them."""

import asyncio
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.base.addresses import BridgeError
from daemon.base.records import FaceReading, Quality, Scan
from daemon.bridge.sender import BridgeSender
from daemon.studies.recorded import RecordedScan, read_csv, unit_note

if TYPE_CHECKING:
    from random import Random

    from daemon.base.clock import Clock
    from daemon.config.links import BridgeSettings
    from solar.ephemeris import Site


async def send_csv(
    path: Path,
    settings: "BridgeSettings",
    key: bytes | None,
    clock: "Clock",
    rng: "Random",
    site: "Site",
    *,
    speed: float = 1.0,
    keep_times: bool = False,
    on_progress: Callable[[int, int], None] | None = None,
    warn: Callable[[str], None] = lambda _note: None,
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
    site
        Where the readings are from: readings that are far too low while the sun is high there may be in kW/m2.
    speed
        How many times faster than the file's own times.
    keep_times
        Send the file's UTC instead of the present one; a receiver refuses times beyond its ``clock_skew_s``.
    on_progress
        Called after each scan with the number sent and the number in the file.
    warn
        Called before the first scan with a sentence for anything missing in the file, and for readings in kW/m2.
    source
        Name of the cube.

    Raises
    ------
    UserError
        For a wrong file, speed or setting.
    """
    if not (0 < speed < math.inf):
        raise BridgeError(f"the speed must be a number greater than 0, not {speed:g}")
    sender = BridgeSender(settings, key, clock)
    recording = read_csv(path)
    rows = recording.rows
    for note in recording.notes():
        warn(f"{path}: {note}")
    if (in_kilowatts := unit_note(str(path), rows, site)) is not None:
        warn(in_kilowatts)
    session = f"{rng.getrandbits(64):016x}"
    await sender.open()
    try:
        start_s, first_utc_s = clock.monotonic(), float(rows.utc_s[0])
        for sequence, row in enumerate(rows):
            due_s = start_s + (row.time_utc_s - first_utc_s) / speed
            await asyncio.sleep(max(0.0, due_s - clock.monotonic()))
            utc_s = row.time_utc_s if keep_times else clock.utc()
            sender.send(_scan(row, source, session, sequence, utc_s, clock.monotonic()))
            if on_progress is not None:
                on_progress(sequence + 1, len(rows))
    finally:
        await sender.close()
    return len(rows)


def _scan(row: RecordedScan, source: str, session: str, sequence: int, utc_s: float, monotonic_s: float) -> Scan:
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
