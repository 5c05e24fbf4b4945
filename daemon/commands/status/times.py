"""Times for people at a terminal: local time, with UTC beside it."""

import re
from datetime import UTC, datetime
from typing import Any

from daemon.base.clock import local_time

_DAY = "%Y-%m-%d"
_CLOCK = "%H:%M:%S"
_TO_THE_MINUTE = "%H:%M"
# The form in which the service writes an instant into a sentence.
_WRITTEN = re.compile(r"(\d{4}-\d\d-\d\d) (\d\d:\d\d(:\d\d)?) UTC", re.ASCII)


def local_and_utc_time(iso_utc: str, now: str | None = None, clock: str = _CLOCK) -> str:
    """Return an instant in local time and in UTC, with the date if it differs from that of `now`.

    Parameters
    ----------
    iso_utc, now
        As the interface writes times, such as ``2022-10-14T08:00:00.000Z``; without `now` the date is always there.
    clock
        How the time of day is written.
    """
    utc, local = _utc_and_local(iso_utc)
    dated = now is None or _utc_and_local(now)[1].date() != local.date()
    day = local.strftime(f"{_DAY} ") if dated else ""
    if local.utcoffset() == utc.utcoffset():
        return f"{day}{local.strftime(clock)} UTC"
    utc_day = utc.strftime(f"{_DAY} ") if utc.date() != local.date() else ""
    return f"{day}{local.strftime(clock)} ({utc_day}{utc.strftime(clock)} UTC)"


def localise_times(said: Any, now: str | None = None) -> Any:
    """Return a text or the JSON of the service, the times in its sentences written as `local_and_utc_time` does."""
    if isinstance(said, str):
        return _WRITTEN.sub(lambda found: _moment_of_match(found, now), said)
    if isinstance(said, dict):
        return {name: localise_times(value, now) for name, value in said.items()}
    return [localise_times(value, now) for value in said] if isinstance(said, list) else said


def _moment_of_match(found: re.Match[str], now: str | None) -> str:
    day, time, seconds = found.groups()
    try:
        return local_and_utc_time(f"{day}T{time}Z", now, _CLOCK if seconds else _TO_THE_MINUTE)
    except ValueError:
        return found.group()


def local_date_and_time(iso_utc: str) -> str:
    """Return an instant in local time alone, with its date."""
    return _utc_and_local(iso_utc)[1].strftime(f"{_DAY} {_CLOCK}")


def time_zone_text(iso_utc: str) -> str:
    """Return the time zone of what `local_date_and_time` returns, such as ``local time, UTC+02:00``."""
    offset = _utc_and_local(iso_utc)[1].strftime("%z")
    return "UTC" if offset == "+0000" else f"local time, UTC{offset[:3]}:{offset[3:]}"


def _utc_and_local(iso_utc: str) -> tuple[datetime, datetime]:
    utc = datetime.fromisoformat(iso_utc).astimezone(UTC)
    return utc, local_time(utc.timestamp())
