"""Times as a person at a terminal reads them: the clock on the wall, and UTC beside it."""

from datetime import UTC, datetime

from daemon.base.clock import local_time

_DAY = "%Y-%m-%d"
_CLOCK = "%H:%M:%S"


def moment(iso_utc: str, now: str | None = None) -> str:
    """Return an instant in local time and in UTC, with the date where it is another one than that of `now`.

    Parameters
    ----------
    iso_utc, now
        As the interface writes times, such as ``2022-10-14T08:00:00.000Z``; without `now` the date is always there.
    """
    utc, local = _both(iso_utc)
    dated = now is None or _both(now)[1].date() != local.date()
    day = local.strftime(f"{_DAY} ") if dated else ""
    if local.utcoffset() == utc.utcoffset():
        return f"{day}{local.strftime(_CLOCK)} UTC"
    utc_day = utc.strftime(f"{_DAY} ") if utc.date() != local.date() else ""
    return f"{day}{local.strftime(_CLOCK)} ({utc_day}{utc.strftime(_CLOCK)} UTC)"


def dated(iso_utc: str) -> str:
    """Return an instant in local time alone, with its date."""
    return _both(iso_utc)[1].strftime(f"{_DAY} {_CLOCK}")


def zone(iso_utc: str) -> str:
    """Return in which time the line of `dated` is, such as ``UTC+02:00``."""
    offset = _both(iso_utc)[1].strftime("%z")
    return "UTC" if offset == "+0000" else f"local time, UTC{offset[:3]}:{offset[3:]}"


def _both(iso_utc: str) -> tuple[datetime, datetime]:
    utc = datetime.fromisoformat(iso_utc).astimezone(UTC)
    return utc, local_time(utc.timestamp())
