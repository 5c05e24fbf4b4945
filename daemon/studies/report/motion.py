"""What the tracker did: its modes, its moves, and how near it stood to its set point."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daemon.base.records import Mode
from daemon.studies.report.material import Material
from daemon.studies.report.yields import DAYLIGHT_EVERY_S, days_of, latest_column_values, latest_values, sun_up
from solar.ephemeris import DAY_S
from solar.frames import Array

TOLERANCE_DEG = 5.0
"""A tracker with A or B further than this from its set point is not available; independent monitors count so too."""

NOT_RECORDED = "not recorded"
# Poses come every few seconds while the service runs, at rest as well.
SILENT_S = 900.0
"""A longer time without any record counts as not recorded."""
_EDGE_S = 120.0
_EXCUSED_MODES = (Mode.STOW, Mode.SNOW, Mode.MAINTENANCE, Mode.HOLD)


@dataclass(frozen=True, slots=True)
class ModePeriod:
    """A mode from one instant to another [s UTC], and why it was entered."""

    mode: str
    start_utc_s: float
    end_utc_s: float
    why: str

    @property
    def duration_s(self) -> float:
        """How long it lasted."""
        return self.end_utc_s - self.start_utc_s


@dataclass(frozen=True, slots=True)
class RecordedMotion:
    """Moves and modes of a span.

    Attributes
    ----------
    mode_periods
        The modes one after the other; ``not recorded`` where there are no records.
    outcomes
        How many moves had each outcome.
    travel_a_deg, travel_b_deg
        Added over all moves, from where each began to where it ended.
    by_day
        Number of moves, and travel with A and B added, of each of the site's days.
    deviation_deg, deviation_p95_deg
        Mean and 95th percentile of the greater deviation of both angles from the set point, at rest in daylight.
    available_pct
        Share of daylight with both angles within 5 deg of the set point; stow and what persons ordered left out.
    """

    mode_periods: tuple[ModePeriod, ...]
    outcomes: dict[str, int]
    travel_a_deg: float
    travel_b_deg: float
    by_day: tuple[tuple[int, float], ...]
    deviation_deg: float
    deviation_p95_deg: float
    available_pct: float

    @property
    def moves(self) -> int:
        """The number of moves, whatever their outcome."""
        return sum(self.outcomes.values())

    def hours(self) -> dict[str, float]:
        """Return the hours of each mode, the longest first."""
        found: dict[str, float] = {}
        for stretch in self.mode_periods:
            found[stretch.mode] = found.get(stretch.mode, 0.0) + stretch.duration_s / 3600.0
        return dict(sorted(found.items(), key=lambda item: -item[1]))


def motion_of(material: Material) -> RecordedMotion:
    """Return what the tracker did in a span."""
    mode_periods = _stretches(material)
    moves = material.tables["moves"]
    travel_a, travel_b = (_travel(material, angle) for angle in ("a_deg", "b_deg"))
    begun = material.times_of("moves")
    days = [(begun >= day.start_utc_s) & (begun < day.end_utc_s) for day in days_of(material)]
    mean, p95, available = _deviation_and_availability(material, mode_periods)
    return RecordedMotion(
        mode_periods=mode_periods,
        outcomes={str(name): int(count) for name, count in moves["outcome"].value_counts().items()}
        if len(moves)
        else {},
        travel_a_deg=float(travel_a.sum()),
        travel_b_deg=float(travel_b.sum()),
        by_day=tuple((int(day.sum()), float((travel_a + travel_b)[day].sum())) for day in days),
        deviation_deg=mean,
        deviation_p95_deg=p95,
        available_pct=available,
    )


def set_points_of(material: Material, angle: str) -> tuple[Array, Array]:
    """Return the set points of an angle: when each was given [s UTC], and its value [deg], each of shape (n,).

    Every move gives one. Before the first move of a span the target of the first decision is the set point: on an
    overcast day the tracker may lie at its target until the evening without a move.
    """
    utc_s, values = material.times_of("moves"), material.column("moves", f"target_{angle}")
    decided_utc_s, targets = material.times_of("decisions"), material.column("decisions", f"target_{angle}")
    if decided_utc_s.size and not np.any(utc_s <= decided_utc_s[0]):
        return np.insert(utc_s, 0, decided_utc_s[0]), np.insert(values, 0, targets[0])
    return utc_s, values


def _travel(material: Material, angle: str) -> Array:
    way: Array = np.abs(material.column("moves", f"end_{angle}") - material.column("moves", f"from_{angle}"))
    return np.nan_to_num(way)


def _stretches(material: Material) -> tuple[ModePeriod, ...]:
    """Return the modes, with ``not recorded`` where there are no records for long."""
    found: list[ModePeriod] = []
    for start, end in _recorded_spans(material):
        found += _modes_between(material, start, end)
    filled: list[ModePeriod] = []
    at = material.span.start_utc_s
    for stretch in found:
        if stretch.start_utc_s > at + 1.0:
            filled.append(ModePeriod(NOT_RECORDED, at, stretch.start_utc_s, ""))
        filled.append(stretch)
        at = stretch.end_utc_s
    if material.span.end_utc_s > at + 1.0:
        filled.append(ModePeriod(NOT_RECORDED, at, material.span.end_utc_s, ""))
    return tuple(filled)


def _recorded_spans(material: Material) -> list[tuple[float, float]]:
    """Return begin and end of each stretch of time with records of any kind and no long pause."""
    every = np.sort(np.concatenate([material.times_of(kind) for kind in material.tables]))
    start, end = material.span.start_utc_s, material.span.end_utc_s
    edges = np.concatenate([[start - SILENT_S * 2], every, [end + SILENT_S * 2]])
    quiet = np.flatnonzero(np.diff(edges) > SILENT_S)
    found = [(float(edges[one + 1]), float(edges[other])) for one, other in pairwise(quiet.tolist())]
    # The first and the last minutes of the span count as recorded, even if the first record comes a little later.
    return [
        (start if first - start < _EDGE_S else first, end if end - last < _EDGE_S else last) for first, last in found
    ]


def _modes_between(material: Material, start: float, end: float) -> list[ModePeriod]:
    utc_s = material.times_of("modes")
    inside = np.flatnonzero((utc_s >= start) & (utc_s < end))
    modes = material.tables["modes"]
    if not inside.size:
        return [ModePeriod(_mode_before(material, start), start, end, "")]
    rows = modes.iloc[inside]
    at = [start, *utc_s[inside].tolist(), end]
    names = [str(rows["before"].iloc[0]), *(str(name) for name in rows["after"])]
    whys = ["", *(str(why) for why in rows["why"])]
    return [
        ModePeriod(name, first, last, why)
        for name, why, first, last in zip(names, whys, at[:-1], at[1:], strict=True)
        if last > first
    ]


def _mode_before(material: Material, start: float) -> str:
    """Return the mode of a stretch without a change, from the last change before the span or from its decisions."""
    if material.before.modes and start == material.span.start_utc_s:
        return material.before.modes[-1][2]
    decisions = material.tables["decisions"]
    later = np.flatnonzero(material.times_of("decisions") >= start)
    return str(decisions["mode"].iloc[int(later[0])]) if later.size else "no change of mode recorded"


def _deviation_and_availability(material: Material, mode_periods: tuple[ModePeriod, ...]) -> tuple[float, float, float]:
    """Return mean and 95th percentile of the deviation at rest in daylight [deg], and the availability [%]."""
    span = material.span
    utc_s = np.arange(span.start_utc_s + DAYLIGHT_EVERY_S / 2.0, span.end_utc_s, DAYLIGHT_EVERY_S)
    counts = (sun_up(material, utc_s) > 0.0) & ~_mask_of_modes(mode_periods, utc_s, _EXCUSED_MODES)
    set_points = [latest_values(*set_points_of(material, angle), utc_s, DAY_S) for angle in ("a_deg", "b_deg")]
    stands = [latest_column_values(material, "poses", angle, utc_s, SILENT_S) for angle in ("a_deg", "b_deg")]
    apart = np.maximum(*(np.abs(wanted - is_at) for wanted, is_at in zip(set_points, stands, strict=True)))
    # Before the first decision or move of a span its set point is not known.
    counts &= np.isfinite(set_points[0])
    if not counts.any():
        return np.nan, np.nan, np.nan
    within = apart[counts] <= TOLERANCE_DEG
    still = counts & (latest_column_values(material, "poses", "moving", utc_s, SILENT_S) == 0.0) & np.isfinite(apart)
    if not still.any():
        return np.nan, np.nan, 100.0 * float(within.mean())
    return float(apart[still].mean()), float(np.percentile(apart[still], 95.0)), 100.0 * float(within.mean())


def _mask_of_modes(mode_periods: tuple[ModePeriod, ...], utc_s: Array, modes: tuple[Mode, ...]) -> NDArray[np.bool_]:
    inside = np.zeros(utc_s.shape, dtype=np.bool_)
    for stretch in mode_periods:
        if stretch.mode in modes:
            inside |= (utc_s >= stretch.start_utc_s) & (utc_s < stretch.end_utc_s)
    return inside
