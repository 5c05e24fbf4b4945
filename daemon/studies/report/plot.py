"""The pictures of the report, written to files one by one, without a report."""

import math
import time
from collections.abc import Callable, Sequence
from datetime import tzinfo
from pathlib import Path

import numpy as np
from matplotlib import rc_context

from daemon.base.errors import UserError
from daemon.config.settings import Settings
from daemon.store.runs import no_records_text
from daemon.studies.inputs import parse_site
from daemon.studies.picture_file import save_picture
from daemon.studies.report.choices import format_of_tables
from daemon.studies.report.material import Material, read_tables, span_of_tables, split_by_tracker
from daemon.studies.report.motion import motion_of
from daemon.studies.report.pictures import PICTURES, PictureData
from daemon.studies.report.span import RequestedSpan
from daemon.studies.report.yields import light_of
from solar.ephemeris import Site

_DPI = 150


def material_of_tables(
    directory: Path,
    site: str | None,
    settings: Settings | None,
    wanted: RequestedSpan | None,
    tracker: str | None,
    warn: Callable[[str], None] = lambda _: None,
) -> Material:
    """Return the material of a folder of tables, all of it or a span; `warn` as for `read_tables`.

    Raises
    ------
    UserError
        There are no tables, or several trackers and none is chosen, or the site is not given.
    """
    if site is None and settings is None:
        raise UserError("tables do not say where the site is: add --site LAT,LON[,ALT] or --config FILE")
    table_format = format_of_tables(directory)
    if settings is None or site is not None:
        name, place = str(site), Site(*parse_site(str(site)))
    else:
        name, place = settings.site.name, settings.site.place()
    tables, source = read_tables(directory, table_format, warn), f"the tables in {directory}"
    if wanted is None:
        span = span_of_tables(tables, source)
    else:
        # Simulated tables may hold days of the future.
        span = wanted.span(place.longitude_deg, time.time() if wanted.is_relative_to_today else math.inf)
    found = split_by_tracker(tables, span, place, name, source)
    if tracker is None and len(found) == 1:
        return found[0]
    names = [material.tracker for material in found]
    if tracker not in names:
        raise UserError(f"those tables have the trackers {', '.join(names)}: choose one with --tracker NAME")
    return found[names.index(tracker)]


def missing_picture_notes(material: Material, names: Sequence[str]) -> dict[str, str]:
    """Return for each of the pictures without data a sentence that says so."""
    recorded = {
        "power": ("I-V curve", len(material.tables["curves"]) > 0),
        "wind": ("reading of the wind", bool(np.isfinite(material.column("poses", "wind_m_s")).any())),
    }
    span, found = material.span, {}
    for name in names:
        record, there = recorded.get(name, ("", True))
        if not there:
            nothing = no_records_text(span.start_utc_s, span.end_utc_s, material.source, None, record)
            found[name] = f"{name}: {nothing}"
    return found


def draw(material: Material, names: Sequence[str], paths: Sequence[Path], zone: tzinfo | None) -> None:
    """Draw pictures to files, their folders too; raises `UserError` for a file that cannot be written."""
    drawing = PictureData(material, light_of(material), motion_of(material), zone)
    for name, path in zip(names, paths, strict=True):
        figure = PICTURES[name].draw(drawing)
        # On a page a picture shows the page's colour behind it; a file needs a background of its own.
        figure.patch.set(alpha=1.0, facecolor="white")
        with rc_context({"svg.fonttype": "none"}):
            save_picture(figure, path, dpi=_DPI)
