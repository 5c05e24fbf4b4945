"""Named stretches of time from the command line, read before scientific libraries are loaded."""

import re
from dataclasses import dataclass

from daemon.base.errors import UserError
from daemon.studies.inputs import instant

_PERIOD = re.compile(r"(?P<name>[^=]+)=(?P<start>[^/]+)/(?P<end>[^/]+)")


@dataclass(frozen=True, slots=True)
class Span:
    """A named stretch of time, the end not included [s UTC]."""

    name: str
    start_utc_s: float
    end_utc_s: float


def parse_span(text: str) -> Span:
    """Return the stretch of time of ``NAME=FROM/TO``; `UserError` for other text."""
    match = _PERIOD.fullmatch(text)
    if match is None:
        raise UserError(f"--period: '{text}' is not NAME=FROM/TO, such as fog=2022-10-12T06:20/2022-10-12T08:10")
    begin_s, end_s = (instant(match[key].strip(), "--period").timestamp() for key in ("start", "end"))
    if not begin_s < end_s:
        raise UserError(f"--period: '{text}' ends before it begins")
    return Span(match["name"], begin_s, end_s)
