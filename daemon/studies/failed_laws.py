"""Laws that failed in a study: what is written from then on is another law's."""

from collections.abc import Iterable

from daemon.base.clock import iso_utc
from daemon.base.records import Event

_RAISED = "raised law-failed: "


def failed_laws(events: Iterable[Event], *, several: bool) -> list[str]:
    """Return a sentence for each law that failed, with the time from which on another one points.

    Parameters
    ----------
    events
        What the service told.
    several
        Whether the sentence has to name the tracker.
    """
    return [
        f"{f'{event.tracker}: ' if several else ''}{event.text.removeprefix(_RAISED)}"
        f" from {iso_utc(event.time_utc_s)[:19]}Z on"
        for event in events
        if event.subject == "alarm" and event.text.startswith(_RAISED)
    ]
