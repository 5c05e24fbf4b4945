"""Laws that failed in a study: the results from then on are those of another law."""

from collections.abc import Sequence

from daemon.base.clock import iso_utc
from daemon.service.tracker import Tracker


def failed_laws(trackers: Sequence[Tracker]) -> list[str]:
    """Return a sentence for each law that failed, with the time from which on another one points."""
    return [
        f"{f'{tracker.name}: ' if len(trackers) > 1 else ''}{alarm.text} from {iso_utc(alarm.raised_utc_s)[:19]}Z on"
        for tracker in trackers
        for alarm in tracker.alarms.shown
        if alarm.name == "law-failed"
    ]
