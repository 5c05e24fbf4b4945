"""The report of a simulation or a replay: the same page, made from the files that they have written."""

from collections.abc import Sequence
from datetime import UTC, datetime, tzinfo
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from daemon.base.records import FACES, Event, Quality
from daemon.config.settings import Settings
from daemon.studies.recorded import RecordedScans
from daemon.studies.replay import ReplayResult
from daemon.studies.report.material import Material, read_tables, split_by_tracker
from daemon.studies.report.span import ReportSpan
from daemon.studies.report.write import with_settings, write_reports
from solar.ephemeris import DAY_S
from solar.frames import Array

# A pose that changes by less than this from one row to the next is at rest.
_MOVING_DEG = 0.05


def span_of(start_utc_s: float, end_utc_s: float) -> ReportSpan:
    """Return the span of a study; its name is the day's, if it is one."""
    first, last = (datetime.fromtimestamp(at, UTC) for at in (start_utc_s, end_utc_s))
    name = f"{first:%Y%m%dT%H%MZ}_{last:%Y%m%dT%H%MZ}"
    if start_utc_s % DAY_S == 0.0 and end_utc_s - start_utc_s == DAY_S:
        name = f"{first:%Y-%m-%d}"
    return ReportSpan(start_utc_s, end_utc_s, name)


def report_simulation(
    settings: Settings,
    span: tuple[float, float],
    tables: Path,
    table_format: str,
    out: Path,
    zone: tzinfo | None,
    *,
    force: bool,
) -> list[Path]:
    """Write the report of a simulation from its tables; returns the paths of its pages."""
    site, source = settings.site, f"the simulation in {tables}"
    found = split_by_tracker(read_tables(tables, table_format), span_of(*span), site.place(), site.name, source)
    return _write_pages(found, settings, out, zone, force=force)


def report_replay(
    settings: Settings,
    span: tuple[float, float],
    rows: RecordedScans,
    replayed: ReplayResult,
    positions: Path,
    out: Path,
    zone: tzinfo | None,
    *,
    force: bool,
) -> list[Path]:
    """Write the report of a replay from its rows, its outcome and its positions; returns the page's path."""
    table = pd.read_csv(positions, index_col="time")
    table.index = pd.to_datetime(table.index, utc=True, format="ISO8601")
    found = split_by_tracker(
        {
            "scans": _scans(table, rows.faces_w_m2, replayed.qualities),
            "poses": _poses(table),
            "moves": _moves(table),
            "modes": _modes(table),
            "decisions": table[["mode", "law", "dni_est", "dhi_est", "albedo_est"]],
            "events": _events(replayed.events),
            "curves": table.iloc[:0],
        },
        span_of(*span),
        settings.site.place(),
        settings.site.name,
        f"the replay in {positions}",
    )
    return _write_pages(found, settings, out, zone, force=force)


def _write_pages(
    found: list[Material], settings: Settings, out: Path, zone: tzinfo | None, *, force: bool
) -> list[Path]:
    known = [with_settings(material, settings) for material in found]
    return write_reports(known, out, zone, _ignore_progress, force=force)


def _ignore_progress(_share: float) -> None:
    """Take the share that is done and ignore it: nobody waits for it."""


def _scans(table: pd.DataFrame, faces: Array, qualities: NDArray[np.uint8]) -> pd.DataFrame:
    words = np.array([quality.value for quality in Quality])
    columns: dict[str, object] = {"simulated": True}
    for face, values, quality in zip(FACES, faces.T, qualities.T, strict=True):
        columns[f"{face}_w_m2"] = values
        columns[f"{face}_quality"] = words[quality]
    return pd.DataFrame(columns, index=table.index)


def _events(events: Sequence[Event]) -> pd.DataFrame:
    index = pd.to_datetime([event.time_utc_s for event in events], unit="s", utc=True)
    columns = {"subject": [event.subject for event in events], "text": [event.text for event in events]}
    return pd.DataFrame(columns, index=pd.DatetimeIndex(index))


def _poses(table: pd.DataFrame) -> pd.DataFrame:
    way = table[["a", "b"]].diff().abs().max(axis=1)
    return pd.DataFrame({"a_deg": table["a"], "b_deg": table["b"], "moving": (way > _MOVING_DEG).astype(float)})


def _moves(table: pd.DataFrame) -> pd.DataFrame:
    """Return a move for every change of the set point, from where the tracker stood to where it was at the next one."""
    changed = (table[["a_set", "b_set"]].diff().abs().max(axis=1) > 0.0).to_numpy()
    places = np.flatnonzero(changed)
    before, ends = np.maximum(places - 1, 0), np.append(places[1:] - 1, len(table) - 1)[: len(places)]
    columns = {
        f"{when}_{angle}_deg": table[name].to_numpy()[rows]
        for angle, name, set_name in (("a", "a", "a_set"), ("b", "b", "b_set"))
        for when, name, rows in (("from", name, before), ("target", set_name, places), ("end", name, ends))
    }
    return pd.DataFrame(columns | {"outcome": "ordered", "why": ""}, index=table.index[places])


def _modes(table: pd.DataFrame) -> pd.DataFrame:
    modes = table["mode"].to_numpy()
    places = np.flatnonzero(modes[1:] != modes[:-1]) + 1
    return pd.DataFrame({"before": modes[places - 1], "after": modes[places], "why": ""}, index=table.index[places])
