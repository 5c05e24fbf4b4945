"""The time that a report is about: days of the site, from one solar midnight to the next, or two instants."""

import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta, tzinfo

from daemon.base.clock import local_time
from daemon.base.errors import UserError
from daemon.studies.inputs import YEARS, instant
from solar.ephemeris import DAY_S

MOST_DAYS = 62
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}\Z")
_DAYS_AGO = {"today": 0, "yesterday": 1}


@dataclass(frozen=True, slots=True)
class ReportSpan:
    """A stretch of time [s UTC], the end not included; `name` is what its file is called."""

    start_utc_s: float
    end_utc_s: float
    name: str

    @property
    def title(self) -> str:
        """What it is called for people: its day, its days, or both instants."""
        if "T" not in self.name:
            # The day that --to names is not part of the span.
            day, _, behind = self.name.partition("_")
            last = (date.fromisoformat(behind) - timedelta(days=1)).isoformat() if behind else day
            return day if last == day else f"{day} to {last}"
        first, last = (f"{utc_and_local_time(at, None)[0]:%Y-%m-%d %H:%M}" for at in (self.start_utc_s, self.end_utc_s))
        return f"{first} to {last} UTC"

    @property
    def duration_s(self) -> float:
        """How long it is."""
        return self.end_utc_s - self.start_utc_s

    def days(self) -> list["ReportSpan"]:
        """Return the span in pieces of a day, to be read one by one; the last one may be shorter."""
        return [
            ReportSpan(at, min(at + DAY_S, self.end_utc_s), "")
            for at in (self.start_utc_s + number * DAY_S for number in range(-int(-self.duration_s // DAY_S)))
        ]


@dataclass(frozen=True, slots=True)
class RequestedSpan:
    """The span as the command line gives it, a day or two ends, before it is known where the site is."""

    day: str | None = None
    start: str | None = None
    end: str | None = None

    def __post_init__(self) -> None:
        """Raise `UserError` for a span that makes no sense."""
        if (self.day is None) is (self.start is None and self.end is None):
            raise UserError("name either --day DAY, or --from and --to")
        if self.day is None and (self.start is None or self.end is None):
            raise UserError("--from and --to belong together: name both")
        if self.day is not None and self.day not in _DAYS_AGO:
            _date(self.day, "--day")
        for text, option in ((self.start, "--from"), (self.end, "--to")):
            if text is not None:
                instant(text, option)

    @property
    def is_relative_to_today(self) -> bool:
        """Whether the day is given relative to today."""
        return self.day in _DAYS_AGO

    def span(self, longitude_deg: float, now_utc_s: float) -> ReportSpan:
        """Return the span at a site [degrees east]; raises `UserError` if it is empty, too long or in the future."""
        if self.day is not None:
            found = _day(self.day, longitude_deg, now_utc_s)
        else:
            start, end = self.start or "", self.end or ""
            first, last = (_bound(text, option, longitude_deg) for text, option in ((start, "--from"), (end, "--to")))
            if not (first < last):
                raise UserError(f"--from {start} is not before --to {end}: exchange them")
            found = ReportSpan(first, last, f"{_file_part(start)}_{_file_part(end)}")
        if found.duration_s > MOST_DAYS * DAY_S:
            raise UserError(f"that is {found.duration_s / DAY_S:.0f} days and a report has {MOST_DAYS} at most")
        if not (found.start_utc_s < now_utc_s):
            raise UserError(f"{found.name} is in the future: name a day that has begun")
        return ReportSpan(found.start_utc_s, min(found.end_utc_s, now_utc_s), found.name)


def solar_midnight_s(day: date, longitude_deg: float) -> float:
    """Return the UTC [s] at which the mean sun is lowest as `day` begins there."""
    return datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp() - longitude_deg * DAY_S / 360.0


def utc_and_local_time(utc_s: float, zone: tzinfo | None) -> tuple[datetime, datetime]:
    """Return the instant in UTC and in the time of a zone, None for this machine's."""
    return datetime.fromtimestamp(utc_s, UTC), local_time(utc_s, zone)


def _day(text: str, longitude_deg: float, now_utc_s: float) -> ReportSpan:
    if text in _DAYS_AGO:
        now = datetime.fromtimestamp(now_utc_s + longitude_deg * DAY_S / 360.0, UTC)
        day = now.date() - timedelta(days=_DAYS_AGO[text])
    else:
        day = _date(text, "--day")
    start = solar_midnight_s(day, longitude_deg)
    return ReportSpan(start, start + DAY_S, day.isoformat())


def _date(text: str, option: str) -> date:
    try:
        if _DATE.match(text) and (found := date.fromisoformat(text)).year in YEARS:
            return found
    except ValueError:
        pass
    raise UserError(f"{option}: '{text}' is not a day; write 2022-10-14, yesterday or today")


def _bound(text: str, option: str, longitude_deg: float) -> float:
    if _DATE.match(text):
        return solar_midnight_s(_date(text, option), longitude_deg)
    return instant(text, option).timestamp()


def _file_part(text: str) -> str:
    return text if _DATE.match(text) else f"{instant(text, '--from'):%Y%m%dT%H%MZ}"
