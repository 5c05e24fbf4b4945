"""All sources of stow together: every one is polled at every tick, and what they answered outlives a restart.

A service that is killed in a storm must not come back tracking because its sensors have not spoken yet.
"""

import asyncio
import logging
import math
from collections.abc import Callable, Mapping, Sequence, Set
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock, iso_utc
from daemon.base.state import StateFile, StateFolder, UnreadableStateError
from daemon.base.timeloop import call_every
from daemon.tracker.guarded_stow import GuardedStow
from daemon.tracker.stow import StowSource, StowStatus

log = logging.getLogger("heliocube.stow")

FILE_NAME = "safety.json"
# Shorter than a gust.
_POLL_EVERY_S = 1.0


class KeptSafety(BaseModel):
    """Which sources stowed the tracker, their reasons, and since when; that time is for people and ends no stow."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    stowing: dict[str, str] = {}
    since_utc: str


class StowBeforeRestart(NamedTuple):
    """Why the tracker was stowed before a restart.

    Attributes
    ----------
    text
        The reason, as a sentence.
    stowing
        The reasons by their sources, as they were kept.
    since_utc
        Since when, or None where nobody knows.
    """

    text: str
    stowing: Mapping[str, str]
    since_utc: str | None


class SafetyFile:
    """State of safety in a small file beside the store; in a folder without a directory it lives in memory only.

    Parameters
    ----------
    folder
        Folder of the file.
    """

    def __init__(self, folder: StateFolder) -> None:
        self._file = StateFile(folder, FILE_NAME, KeptSafety, log, "the storm")
        self._file.reserve()

    def load(self) -> StowBeforeRestart | None:
        """Return why the tracker was stowed when the file was written, or None; an unreadable file counts as stow."""
        try:
            kept = self._file.load()
        except UnreadableStateError as error:
            log.warning("%s: it counts as stow", error)
            text = f"{error}: it is not known whether the tracker was stowed before the restart"
            return StowBeforeRestart(text, {FILE_NAME: text}, None)
        if kept is None or not kept.stowing:
            return None
        reasons = "; ".join(dict.fromkeys(kept.stowing.values()))
        return StowBeforeRestart(
            f"stowed before the restart, since {kept.since_utc}: {reasons}", kept.stowing, kept.since_utc
        )

    def save(self, stowing: dict[str, str], since_utc: str) -> None:
        """Have the file replaced as a whole; a slow or failing disk does not hold up the stow."""
        self._file.save(KeptSafety(stowing=stowing, since_utc=since_utc))


class StowWatch:
    """Polls every source at every tick.

    Parameters
    ----------
    sources
        All that may ask for stow besides a person.
    file
        Keeps what they said over a restart.
    clock
        The service's time.
    alarms
        Where a source that is silent or has failed is raised.
    wake
        Called when a source begins to stow, so that control does not wait for its next tick.
    """

    def __init__(
        self,
        sources: Sequence[StowSource],
        file: SafetyFile,
        clock: Clock,
        alarms: Alarms,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        self._sources: list[GuardedStow] = []
        for each in sources:
            self._sources.append(GuardedStow(each, [source.name for source in self._sources]))
        self._file = file
        self._clock = clock
        self._alarms = alarms
        self._wake = wake
        self._silent: dict[str, str] | None = None
        self._failed: list[str] | None = None
        self._kept_names: Set[str] | None = None
        self._gust_m_s = math.nan
        self._unheard_names = {source.name for source in self._sources}
        self._heard_after_s = -math.inf
        self._storm_before = file.load()
        if self._storm_before is not None:
            for source in self._sources:
                source.resume(self._storm_before.text, clock.monotonic())

    @property
    def has_sources(self) -> bool:
        """Whether there is any source at all."""
        return bool(self._sources)

    def reasons(self, now_s: float) -> tuple[str, ...]:
        """Poll every source at this monotonic time and return all reasons to stow, none of them twice."""
        found: dict[str, str] = {}
        silent: dict[str, str] = {}
        failed: list[str] = []
        for source in self._sources:
            why, status = source.poll(now_s)
            if why is not None:
                found[source.name] = why
            if source.failed_why is not None:
                failed.append(source.failed_why)
            if status.silent:
                silent[source.name] = _silence_text(status)
            # Count only a reading of this very poll; NaN is no reading.
            if status.age_s < _POLL_EVERY_S and not status.speed_m_s <= self._gust_m_s and status.speed_m_s >= 0.0:
                self._gust_m_s = status.speed_m_s
        if found.keys() != self._kept_names:
            self._keep(found)
        if silent != self._silent:
            # Compare the sources, not the texts: one name may contain another, such as roof and roof (2).
            worse = not silent.keys() <= (self._silent or {}).keys()
            self._silent = silent
            text = "; ".join(silent.values()) or None
            self._alarms.set("stow-source-silent", text, of=silent, worse=worse)
        if failed != self._failed:
            worse = len(failed) > len(self._failed or ())
            self._failed = failed
            self._alarms.set("stow-source-failed", "; ".join(failed) or None, worse=worse)
        return tuple(dict.fromkeys(found.values())) if found else ()

    def take_gust(self) -> float:
        """Return the strongest wind [m/s] that any source has read since the last call; NaN where none was read."""
        gust_m_s, self._gust_m_s = self._gust_m_s, math.nan
        return gust_m_s

    def waiting_why(self, now_s: float) -> str | None:
        """Return which sources have not been heard once since the start or a sleep, in words, or None."""
        if self._unheard_names:
            heard_s = {status.name: now_s - status.age_s for status in self.statuses(now_s)}
            self._unheard_names = {name for name, at_s in heard_s.items() if not at_s > self._heard_after_s}
        if not self._unheard_names:
            return None
        names = " and ".join(sorted(self._unheard_names))
        if self._heard_after_s == -math.inf:
            return f"waiting for the first message of {names}"
        return f"waiting for {names} to be heard: the machine has slept"

    def note_sleep(self, now_s: float) -> None:
        """Take note that the machine has slept before this monotonic time: nobody heard what the wind did.

        Every source has to be heard again. One that stows must also be calm for its whole time, as after a restart.
        """
        self._heard_after_s = now_s
        self._unheard_names = {source.name for source in self._sources}
        for source in self._sources:
            if (why := source.status(now_s).why) is not None:
                source.resume(why, now_s)

    def statuses(self, now_s: float) -> tuple[StowStatus, ...]:
        """Return how each source stands."""
        return tuple(source.status(now_s) for source in self._sources)

    async def run(self) -> None:
        """Poll the sources between the ticks of control too, so that no gust is missed, until cancelled."""
        loop = asyncio.get_running_loop()
        failed: asyncio.Future[None] = loop.create_future()
        stowed = False

        def poll() -> bool:
            # A callback, not a sleeping task: the 86,400 polls of a simulated day have to be cheap.
            nonlocal stowed
            if failed.done():
                return True
            try:
                stows = bool(self.reasons(self._clock.monotonic()))
            except Exception as error:  # noqa: BLE001 - `await failed` raises it below
                failed.set_exception(error)
                return True
            begins, stowed = stows and not stowed, stows
            if begins:
                self._wake()
            return begins

        if self._storm_before is not None and self._sources:
            log.warning("stow goes on: %s", self._storm_before.text)
        end = call_every(_POLL_EVERY_S, poll)
        try:
            poll()
            await failed
        finally:
            end()

    def _keep(self, found: dict[str, str]) -> None:
        self._kept_names = found.keys()
        if not self._sources:
            return
        before, since_utc = self._storm_before, iso_utc(self._clock.utc())
        if before is not None and before.text in found.values():
            # Keep the reasons as they were kept: `before.text` quotes them, and would grow with every restart.
            found = {**before.stowing, **{name: why for name, why in found.items() if why != before.text}}
            since_utc = before.since_utc or since_utc
        self._file.save(found, since_utc)


def _silence_text(status: StowStatus) -> str:
    said = "has not been heard since the start of the service" if status.age_s == math.inf else "is silent"
    return f"{status.name} {said}"
