"""The report as one HTML page that needs no other file."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import tzinfo
from importlib.metadata import version
from importlib.resources import files

import numpy as np
from matplotlib.figure import Figure

from daemon.base.records import FACES, Quality
from daemon.store.settings_kept import SUBJECT
from daemon.studies.report import pictures
from daemon.studies.report.availability import Availability, availability_of
from daemon.studies.report.events import AlarmSpan, Note, alarms_of, notes_of
from daemon.studies.report.formatting import NO_VALUE, format_duration, format_number, format_times, summary
from daemon.studies.report.html import Node, Part, element, page, picture, table
from daemon.studies.report.material import Material
from daemon.studies.report.motion import TOLERANCE_DEG, RecordedMotion, motion_of
from daemon.studies.report.pictures import PictureData
from daemon.studies.report.yields import RecordedLight, Yield, days_of, light_of, module_kwh, yield_of
from daemon.studies.stamp import STAMP_COLOUR
from solar.ephemeris import DAY_S

_COLOURS = {
    pictures.INK: "var(--ink)",
    pictures.FAINT: "var(--grid)",
    STAMP_COLOUR: "var(--mark)",
    pictures.NIGHT: "var(--night)",
}
_MOST_LINES = 300
# Up to this many days pictures show every reading; of a longer span they compare the days.
_MOST_DAYS_IN_LINES = 8.0


@dataclass(frozen=True, slots=True)
class Findings:
    """Everything that a report says of its material."""

    material: Material
    light: RecordedLight
    gained: Yield
    days: tuple[str, ...]
    by_day: tuple[Yield, ...]
    motion: RecordedMotion
    quality: Availability
    alarms: list[AlarmSpan]
    notes: list[Note]
    zone: tzinfo | None

    @property
    def has_several_days(self) -> bool:
        """Whether the span is more than one day."""
        return len(self.by_day) > 1


def findings_of(material: Material, zone: tzinfo | None) -> Findings:
    """Compute what the report says; `zone` is the time zone of local times, None for this machine's."""
    light = light_of(material)
    span, days = material.span, days_of(material)
    return Findings(
        material=material,
        light=light,
        gained=yield_of(material, light, span.start_utc_s, span.end_utc_s),
        days=tuple(day.name for day in days),
        by_day=tuple(yield_of(material, light, day.start_utc_s, day.end_utc_s) for day in days),
        motion=motion_of(material),
        quality=availability_of(material),
        alarms=alarms_of(material),
        notes=notes_of(material),
        zone=zone,
    )


def page_of(found: Findings) -> str:
    """Return the page's text."""
    material = found.material
    title = f"{material.site_name}, {material.tracker}: {material.span.title}"
    style = files("daemon.studies.report").joinpath("style.css").read_text(encoding="utf-8")
    mark = "SIMULATED " if material.simulated else ""
    sections = (_pictures(found), _energy(found), _days(found), _modes(found), _moves(found), _quality(found))
    told = (_outages(found), _runs(found), _events(found))
    body = [*_head(found, title), *(part for section in (*sections, *told) for part in section), _foot(found)]
    stamp = [element("div", "SIMULATED", class_="stamp", aria_hidden="true")] if material.simulated else []
    return page(mark + title, style, *stamp, element("main", *body))


def _head(found: Findings, title: str) -> Iterator[Part]:
    material, gained, motion, quality = found.material, found.gained, found.motion, found.quality
    if material.simulated:
        yield element("p", "SIMULATED: no hardware is behind these figures.", class_="simulated", role="note")
    yield element("h1", title)
    ends = (material.span.start_utc_s, material.span.end_utc_s)
    (first, first_local), (last, last_local) = (format_times(at, found.zone, day=True) for at in ends)
    yield element("p", f"{first} to {last} UTC; {first_local} to {last_local} local time.", class_="soft")
    yield element(
        "p", " ".join(summary(material, found.light, gained, motion, quality, found.alarms)), class_="summary"
    )
    shown = (
        ("In the tracker's plane", f"{format_number(gained.actual_kwh_m2, 2)} kWh/m²"),
        ("Over chronometric", f"{format_number(gained.gain_pct, 1, sign=True)} %"),
        ("Of the best possible", f"{format_number(gained.of_bound_pct)} %"),
        ("Valid scans, daylight", f"{format_number(quality.daylight.valid_pct)} %"),
        ("Tracker availability", f"{format_number(motion.available_pct)} %"),
        ("Moves", f"{motion.moves}"),
    )
    yield element("dl", *(element("div", element("dt", n), element("dd", v)) for n, v in shown), class_="figures")


def _pictures(found: Findings) -> Iterator[Part]:
    material = found.material
    yield element("h2", "Pictures")
    if found.has_several_days:
        drawn = pictures.days_picture(found.days, found.by_day, material.simulated)
        yield _captioned(drawn, "days", "Day by day: what the planes received, and the gain over chronometric tracking")
    drawing = PictureData(material, found.light, found.motion, found.zone)
    if material.span.duration_s > _MOST_DAYS_IN_LINES * DAY_S:
        names_shown = ["motion"]
    else:
        without = set() if len(material.tables["curves"]) else {"power"}
        without |= set() if np.isfinite(material.column("poses", "wind_m_s")).any() else {"wind"}
        names_shown = [name for name in pictures.PICTURES if name not in without]
    for name in names_shown:
        series = pictures.PICTURES[name]
        yield _captioned(series.draw(drawing), name, series.about[0].upper() + series.about[1:])


def _captioned(drawn: Figure, name: str, about: str) -> Node:
    shown = picture(drawn, name, about, _COLOURS)
    shown.append(element("figcaption", f"{about}."))
    return shown


def _energy(found: Findings) -> Iterator[Part]:
    gained, light = found.gained, found.light
    yield element("h2", "Energy")
    rows = [
        ("Tracker, as it stood", format_number(gained.actual_kwh_m2, 3), format_number(gained.gain_pct, 2, sign=True)),
        ("Chronometric, within the limits", format_number(gained.chronometric_kwh_m2, 3), format_number(0.0, 2)),
        (
            "Best pose at every instant: the bound",
            format_number(gained.best_kwh_m2, 3),
            format_number(gained.bound_pct, 2, sign=True),
        ),
    ]
    yield table(("Plane", "kWh/m²", "over chronometric %"), rows, "Estimated insolation of three planes")
    albedo = (
        f"the albedo is the law's own estimate, {light.albedo:.2f} on average"
        if light.albedo_estimated
        else f"the albedo is taken to be {light.albedo:.2f}, for no law estimated it"
    )
    yield element(
        "p",
        "These are results of a model: at each scan the beam, the diffuse light and the brightness of the horizon that"
        f" explain the four faces best are put on three planes (docs/report.md); {albedo}. They stand for"
        f" {format_duration(gained.known_s)} of {format_duration(gained.daylight_s)} of daylight"
        f" ({format_number(gained.known_pct)} %); nothing is added for the rest. Chronometric and best poses move"
        " at once and always, which no tracker can. The dashboard counts the same from means of a minute while it"
        " happens, with what was known of the albedo then: the last digit may differ.",
        class_="soft",
    )
    faces = [(name, format_number(value, 3)) for name, value in zip(FACES, gained.faces_kwh_m2, strict=False)]
    yield table(("Face", "kWh/m²"), faces, "Measured on the faces of the cube, good readings in daylight")
    energy, known_s = module_kwh(found.material, found.material.span.start_utc_s, found.material.span.end_utc_s)
    if known_s:
        yield element(
            "p",
            f"Module: {format_number(1000.0 * energy, 0)} Wh at its maximum power point, by I-V curves that stand for"
            f" {format_duration(known_s)}.",
        )


def _days(found: Findings) -> Iterator[Part]:
    if not found.has_several_days:
        return
    rows = [
        (
            day,
            format_number(each.actual_kwh_m2, 2),
            format_number(each.gain_pct, 2, sign=True),
            format_number(each.bound_pct, 2, sign=True),
            format_number(each.known_pct),
            f"{moves}",
            format_number(travel, 0),
        )
        for day, each, (moves, travel) in zip(found.days, found.by_day, found.motion.by_day, strict=True)
    ]
    head = ("Day", "kWh/m²", "over chronometric %", "bound %", "daylight known %", "moves", "travel deg")
    yield element("h2", "Day by day")
    yield table(head, rows, "Days of the site, from solar midnight to solar midnight")


def _modes(found: Findings) -> Iterator[Part]:
    motion, total = found.motion, found.material.span.duration_s / 3600.0
    yield element("h2", "Modes")
    rows = [
        (mode, format_number(hours), format_number(100.0 * hours / total)) for mode, hours in motion.hours().items()
    ]
    yield table(("Mode", "hours", "share %"), rows, "Time in each mode")
    special = [one for one in motion.mode_periods if one.mode not in ("night", "tracking", "starting")]
    if special:
        listed = [
            (one.mode, *_time_cells(one.start_utc_s, found), format_duration(one.duration_s), one.why or NO_VALUE)
            for one in special[:_MOST_LINES]
        ]
        name = _caption_of_many("When it neither tracked nor slept", len(special))
        yield table(("Mode", "UTC", "local", "for", "why"), listed, name)


def _moves(found: Findings) -> Iterator[Part]:
    material, motion = found.material, found.motion
    yield element("h2", "Moves and wear")
    outcomes = ", ".join(f"{count} {name}" for name, count in motion.outcomes.items()) or "none"
    rows = [
        ("Moves", f"{motion.moves}", outcomes),
        ("Travel of A", f"{format_number(motion.travel_a_deg)} deg", ""),
        ("Travel of B", f"{format_number(motion.travel_b_deg)} deg", ""),
    ]
    if material.budget_deg is not None:
        worst = max((travel for _, travel in motion.by_day), default=0.0)
        share = format_number(100.0 * worst / material.budget_deg)
        rows.append(
            ("Most in a day", f"{format_number(worst)} deg", f"{share} % of the {material.budget_deg:g} deg of a day")
        )
    if material.budget_moves is not None:
        most = max((moves for moves, _ in motion.by_day), default=0)
        rows.append(("Most moves in a day", f"{most}", f"of {material.budget_moves} that a law may order"))
    rows += [
        ("Deviation at rest, mean", f"{format_number(motion.deviation_deg, 2)} deg", "greater of A and B, in daylight"),
        ("Deviation at rest, 95 %", f"{format_number(motion.deviation_p95_deg, 2)} deg", "are nearer to the set point"),
        (
            "Tracker availability",
            f"{format_number(motion.available_pct)} %",
            f"of daylight within {TOLERANCE_DEG:g} deg of the set point; stow and what persons ordered left out",
        ),
    ]
    rows += _wind(material)
    yield table(("What", "how much", "of that"), rows, "Moves, travel and how near the tracker stood to its set point")


def _wind(material: Material) -> list[tuple[str, str, str]]:
    wind = material.column("poses", "wind_m_s")
    if not np.isfinite(wind).any():
        return []
    place = int(np.nanargmax(wind))
    at = format_times(float(material.times_of("poses")[place]), None, day=True)[0]
    stows = "" if material.stow_wind_m_s is None else f"; from {material.stow_wind_m_s:g} m/s on it stows"
    return [("Strongest wind", f"{format_number(float(wind[place]), 1)} m/s", f"{at} UTC{stows}")]


def _quality(found: Findings) -> Iterator[Part]:
    quality = found.quality
    yield element("h2", "Data quality and availability")
    rows = [
        (
            name,
            f"{count.expected}",
            f"{format_number(count.available_pct, 2)} %",
            f"{format_number(count.valid_pct, 2)} %",
            f"{count.flagged}",
            f"{count.missing}",
        )
        for name, count in (("Reporting period", quality.period), ("Daylight", quality.daylight))
    ]
    yield table(
        ("Time", "scans expected", "data availability", "valid", "flagged", "missing"),
        rows,
        f"Scans of all four faces, in the terms of IEC 61724-1; one is expected every {quality.interval_s:.3g} s",
    )
    reasons = [reason for reason in Quality if any(counts[reason] for counts in quality.faces.values())]
    if quality.faces:
        by_face = [(face, *(f"{counts[reason]}" for reason in reasons)) for face, counts in quality.faces.items()]
        yield table(("Face", *reasons), by_face, "Readings in daylight by quality; all but ok are flagged and not used")
    if quality.gaps:
        gaps = [
            (*_time_cells(gap.start_utc_s, found), format_duration(gap.end_utc_s - gap.start_utc_s))
            for gap in quality.gaps[:_MOST_LINES]
        ]
        yield table(("UTC", "local", "for"), gaps, _caption_of_many("Gaps without scans", len(quality.gaps)))


def _outages(found: Findings) -> Iterator[Part]:
    yield element("h2", "Outages and alarms")
    if not found.alarms:
        yield element("p", "No alarm was raised, and none was on.")
        return
    begins_s = found.material.span.start_utc_s
    rows = [
        (
            *_time_cells(alarm.start_utc_s, found, day=(alarm.start_utc_s or begins_s) < begins_s),
            _alarm_length(alarm, found),
            alarm.text,
            alarm.acknowledged or NO_VALUE,
        )
        for alarm in found.alarms[:_MOST_LINES]
    ]
    yield table(
        ("UTC", "local", "for", "alarm", "acknowledged by"),
        rows,
        _caption_of_many("Alarms, as they were raised", len(found.alarms)),
    )


def _alarm_length(alarm: AlarmSpan, found: Findings) -> str:
    if alarm.start_utc_s is None:
        return "on since before"
    if alarm.end_utc_s is None:
        return f"{format_duration(found.material.span.end_utc_s - alarm.start_utc_s)}, still on"
    return format_duration(alarm.end_utc_s - alarm.start_utc_s)


def _runs(found: Findings) -> Iterator[Part]:
    material = found.material
    if not material.runs:
        return
    yield element("h2", "Runs and configuration")
    rows = [
        (
            f"{run.run}",
            *_time_cells(run.origin.started_utc_s, found, day=True),
            run.origin.version,
            run.origin.role,
            "SIMULATED" if run.origin.simulated else "real",
        )
        for run in material.runs
    ]
    yield table(
        ("Run", "started UTC", "local", "version", "role", "instruments"), rows, "Runs with records of this time"
    )
    changes = [
        (*_time_cells(note.utc_s, found, day=True), note.text) for note in found.notes if note.subject == SUBJECT
    ]
    if not changes:
        yield element("p", "No change of the configuration was recorded.")
    else:
        name = _caption_of_many("Changes of the configuration, found at a start", len(changes))
        yield table(("UTC", "local", "key"), changes[:_MOST_LINES], name)


def _events(found: Findings) -> Iterator[Part]:
    if not found.notes:
        return
    yield element("h2", "Events")
    rows = [(*_time_cells(note.utc_s, found), note.subject, note.text) for note in found.notes[:_MOST_LINES]]
    yield table(("UTC", "local", "about", "what"), rows, _caption_of_many("Messages of the service", len(found.notes)))


def _foot(found: Findings) -> Node:
    site = found.material.site
    where = f"{site.latitude_deg:.4f}, {site.longitude_deg:.4f}, {site.altitude_m:g} m"
    text = f"From {found.material.source}; site {where}; heliocube {version('heliocube')}."
    return element("footer", element("p", text, class_="soft"))


def _time_cells(utc_s: float | None, found: Findings, day: bool = False) -> tuple[str, str]:
    return format_times(utc_s, found.zone, day=day or found.has_several_days)


def _caption_of_many(what: str, count: int) -> str:
    return what if count <= _MOST_LINES else f"{what}: the first {_MOST_LINES} of {count}"
