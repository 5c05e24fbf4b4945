"""A report's sentences, and numbers as people read them."""

import math
from datetime import tzinfo

from daemon.base.words import pluralise
from daemon.studies.report.availability import Availability
from daemon.studies.report.events import AlarmSpan
from daemon.studies.report.material import Material
from daemon.studies.report.motion import RecordedMotion
from daemon.studies.report.span import utc_and_local_time
from daemon.studies.report.yields import RecordedLight, Yield, daylight_s
from solar.ephemeris import DAY_S
from solar.skies.sky_periods import LOWEST_SUN_DEG

NO_VALUE = "–"
# With one decimal, less than this would be shown as 0.0.
_LEAST_TOLD_H = 0.05


def format_number(value: float, digits: int = 1, sign: bool = False) -> str:
    """Return a number with its decimals and no minus before a zero; a dash if it is not finite."""
    if not math.isfinite(value):
        return NO_VALUE
    text = f"{value:{'+' if sign else ''}.{digits}f}"
    return f"{abs(float(text)):.{digits}f}" if float(text) == 0.0 else text.replace("-", "−")


def format_duration(duration_s: float) -> str:
    """Return a duration in the units that fit it."""
    if duration_s < 100.0:
        return f"{duration_s:.0f} s"
    minutes = round(duration_s / 60.0)
    if minutes < 100:
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:
        return f"{hours} h {minutes:02d} min"
    return f"{duration_s / DAY_S:.1f} days"


def format_times(utc_s: float | None, zone: tzinfo | None, day: bool = False) -> tuple[str, str]:
    """Return an instant [s] in UTC and as the local clock has it, with its day if wanted; dashes for None."""
    if utc_s is None:
        return NO_VALUE, NO_VALUE
    form = "%Y-%m-%d %H:%M:%S" if day else "%H:%M:%S"
    utc, local = utc_and_local_time(utc_s, zone)
    return f"{utc:{form}}", f"{local:{form}}"


def summary(
    material: Material,
    light: RecordedLight,
    gained: Yield,
    motion: RecordedMotion,
    quality: Availability,
    alarms: list[AlarmSpan],
) -> list[str]:
    """Return the three sentences: the sky, the gain, and how well it all went."""
    return [
        _sky_sentence(material, light, gained),
        _gain_sentence(gained),
        _operation_sentence(motion, quality, alarms),
    ]


def _sky_sentence(material: Material, light: RecordedLight, gained: Yield) -> str:
    span = material.span
    hours = dict.fromkeys(("clear", "variable", "overcast"), 0.0)
    for period in light.periods():
        hours[period.kind] += (period.end_utc_s - period.start_utc_s) / 3600.0
    high_h = daylight_s(material, span.start_utc_s, span.end_utc_s, LOWEST_SUN_DEG) / 3600.0
    hours["not known"] = high_h - sum(hours.values())
    hours[f"with the sun below {LOWEST_SUN_DEG:g} deg"] = gained.daylight_s / 3600.0 - high_h
    kinds = ", ".join(
        f"{format_number(length_h)} h {kind}" for kind, length_h in hours.items() if length_h >= _LEAST_TOLD_H
    )
    seen = f": {kinds}" if kinds else ""
    level = gained.faces_kwh_m2[3] if gained.faces_kwh_m2 else math.nan
    return (
        f"{material.site_name} had {format_number(gained.daylight_s / 3600.0)} h of daylight{seen};"
        f" the zenith face measured {format_number(level, 2)} kWh/m²."
    )


def _gain_sentence(gained: Yield) -> str:
    if not gained.known_s:
        return "What the tracker's plane received is not known: there are no good readings in daylight."
    than = "more" if gained.gain_pct >= 0.0 else "less"
    return (
        "By the light that the cube shows, the tracker's plane received"
        f" {format_number(gained.actual_kwh_m2, 2)} kWh/m², {format_number(abs(gained.gain_pct))} % {than}"
        f" than one that follows the sun by the clock, where the best possible pointing"
        f" would have gained {format_number(gained.bound_pct)} %."
    )


def _operation_sentence(motion: RecordedMotion, quality: Availability, alarms: list[AlarmSpan]) -> str:
    moves = (
        f"{pluralise(motion.moves, 'move')} over {format_number(motion.travel_a_deg + motion.travel_b_deg, 0)} degrees"
    )
    valid = format_number(quality.daylight.valid_pct if quality.daylight.expected else quality.period.valid_pct)
    where = "in daylight" if quality.daylight.expected else "of the period"
    stows = sum(stretch.mode == "stow" for stretch in motion.mode_periods)
    faults = sum(stretch.mode == "fault" for stretch in motion.mode_periods)
    what = f"{_count(len(alarms), 'alarm')}, {_count(stows, 'stow')} and {_count(faults, 'fault')}"
    return f"It made {moves}, {valid} % of the expected scans {where} were valid, and the records have {what}."


def _count(count: int, what: str) -> str:
    return f"no {what}s" if not count else pluralise(count, what)
