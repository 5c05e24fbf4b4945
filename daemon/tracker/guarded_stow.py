"""A guard around a stow source: a source that fails is not known to be safe, so it stows and the service goes on."""

import logging
import math
from collections.abc import Collection
from itertools import count
from typing import NamedTuple

from daemon.tracker.stow import StowSource, StowStatus

log = logging.getLogger("heliocube.stow")

# A source that fails now and then is reported once, not at each failure.
_SOUND_AFTER_S = 60.0
# A source may read its own clock a moment after ours, so an age slightly below zero is no error.
_LEAST_AGE_S = -1.0
# Types of a status without a reason. Such a status is handed on without a copy: there are 100,000 in a simulated day.
_CALM_STATUS_TYPES = (str, type(None), float, float, float, float, float, bool)


class StowAnswer(NamedTuple):
    """What one source said at a poll: why the tracker must be stowed, or None, and how the source stands."""

    why: str | None
    status: StowStatus


class GuardedStow:
    """A source of stow that also stows while it raises errors or gives invalid answers.

    It counts as failed until it has worked for a minute. After each failure it is told to `resume`, so that it has to
    be calm for its whole time.

    Parameters
    ----------
    source
        The source, which anybody may have written.
    taken
        The names of the sources before it.

    Attributes
    ----------
    name
        Name of the source, or of its class where it has none; with a number where that name is taken.
    failed_why
        What has happened, in a sentence, or None.
    """

    def __init__(self, source: StowSource, taken: Collection[str]) -> None:
        self._source = source
        name = getattr(source, "name", None)
        given = name if isinstance(name, str) else type(source).__name__
        # Reasons, alarms and metrics are kept by name: of two sources with one name, one would be lost.
        numbered = (f"{given} ({number})" for number in count(2))
        self.name = given if given not in taken else next(each for each in numbered if each not in taken)
        self.failed_why: str | None = None
        self._failed_s = self._worked_s = -math.inf

    def poll(self, now_s: float) -> StowAnswer:
        """Ask the source at this monotonic time [s]."""
        try:
            why = _checked_reason(self._source.reason(now_s))
            status = _checked(self._source.status(now_s), self.name)
        except Exception as error:  # noqa: BLE001 - it is logged once
            self._fail(now_s, error)
            self.resume(f"{self.failed_why}, and must now report calm for its whole time", now_s)
        else:
            self._worked_s = now_s
            if self.failed_why is None:
                return StowAnswer(why, status)
            if now_s - self._failed_s >= _SOUND_AFTER_S:
                log.info("the stow source %s works again", self.name)
                self.failed_why = None
                return StowAnswer(why, status)
        return StowAnswer(self.failed_why, self._status_failed(now_s))

    def status(self, now_s: float) -> StowStatus:
        """Return how the source stood at the last poll."""
        if self.failed_why is None:
            try:
                return _checked(self._source.status(now_s), self.name)
            except Exception as error:  # noqa: BLE001 - it is logged once
                self._fail(now_s, error)
        return self._status_failed(now_s)

    def resume(self, why: str, now_s: float) -> None:
        """Begin stowed, as before a restart."""
        try:
            self._source.resume(why, now_s)
        except Exception as error:  # noqa: BLE001 - it is logged once
            self._fail(now_s, error)

    def _fail(self, now_s: float, error: Exception) -> None:
        self._failed_s = now_s
        if self.failed_why is not None:
            return
        why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        self.failed_why = f"the stow source {self.name} has failed ({why})"
        log.error("%s: it counts as a reason to stow", self.failed_why, exc_info=error)

    def _status_failed(self, now_s: float) -> StowStatus:
        return StowStatus(self.name, self.failed_why, now_s - self._worked_s)


def _checked_reason(why: object) -> str | None:
    if why is None:
        return None
    if not isinstance(why, str) or not why.strip():
        raise TypeError(f"its reason is {why!r}, neither a sentence nor None")
    return str(why)


def _checked(status: object, name: str) -> StowStatus:
    """Return the status with plain Python numbers; `TypeError` or `ValueError` for an invalid one."""
    if not isinstance(status, StowStatus):
        raise TypeError(f"its status is {status!r}, not a StowStatus")
    age_s = float(status.age_s)
    if not age_s >= _LEAST_AGE_S:
        raise ValueError(f"its last reading is {age_s:g} s old, which cannot be")
    if age_s >= 0.0 and status.name == name and tuple(map(type, status)) == _CALM_STATUS_TYPES:
        return status
    return StowStatus(
        name=name,
        why=_checked_reason(status.why),
        age_s=max(age_s, 0.0),
        speed_m_s=float(status.speed_m_s),
        stow_from_m_s=float(status.stow_from_m_s),
        release_below_m_s=float(status.release_below_m_s),
        release_in_s=float(status.release_in_s),
        silent=bool(status.silent),
    )
