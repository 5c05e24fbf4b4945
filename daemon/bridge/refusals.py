"""What the receiver refused: the kinds, their counts, and a log of them that cannot flood."""

import logging
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from typing import TYPE_CHECKING

from daemon.base.addresses import Address

if TYPE_CHECKING:
    from daemon.bridge.port import Peer

_log = logging.getLogger("heliocube.bridge")

HOUR_S = 3600.0
QUIET_S = 6 * HOUR_S
SILENCE_S = 60.0


class Refusal(StrEnum):
    """Why a datagram did not become a scan. The names are those of `Statistics`."""

    OVERSIZED = "oversized"
    REFUSED_SENDER = "refused_sender"
    FORGED = "forged"
    MALFORMED = "malformed"
    OTHER_SOURCE = "other_source"
    SECOND_CUBE = "second_cube"
    DUPLICATE = "duplicate"
    REORDERED = "reordered"
    REPLAYED = "replayed"
    SKEWED = "skewed"
    LATE = "late"


class ScanRefusedError(Exception):
    """One datagram is refused.

    Parameters
    ----------
    kind
        Under which name it is counted.
    reason
        What is wrong and, where there is one, the remedy.
    """

    def __init__(self, kind: Refusal, reason: str) -> None:
        super().__init__(reason)
        self.kind = kind
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Statistics:
    """What a receiver has seen since it was made.

    Attributes
    ----------
    accepted
        Scans passed on.
    lost
        Sequence numbers that a session left out and that did not come afterwards.
    duplicate, reordered, late, skewed, malformed, forged, oversized, refused_sender, other_source, replayed
        Datagrams refused, each counted once.
    second_cube
        Likewise: of a second program under the same cube's name and key.
    last_refusal
        The latest refusal in one sentence; empty when there was none.
    last_refusal_utc_s
        When it came.
    """

    accepted: int
    lost: int
    duplicate: int
    reordered: int
    late: int
    skewed: int
    malformed: int
    forged: int
    oversized: int
    refused_sender: int
    other_source: int
    second_cube: int
    replayed: int
    last_refusal: str
    last_refusal_utc_s: float | None

    @property
    def refused(self) -> int:
        """Datagrams refused, of all kinds."""
        return sum(getattr(self, kind) for kind in Refusal)


class Tally:
    """Counts scans and refusals and logs what an operator needs.

    A stretch of refusals gets one WARNING for the first of each kind, then summaries after 1, 2, 4... hours, and one
    INFO when scans come through again after a gap. Six hours without a refusal end the stretch.
    """

    def __init__(self) -> None:
        self._accepted = 0
        self._refused: Counter[Refusal] = Counter()
        self._last: tuple[Refusal, str | Peer, str] | None = None
        self._last_utc_s: float | None = None
        self._last_monotonic_s = -inf
        self._gap_began_s: float | None = None
        self._gap_counts: Counter[Refusal] = Counter()
        self._begin_stretch(-inf)

    def _begin_stretch(self, now_monotonic_s: float) -> None:
        self._reported: set[Refusal] = set()
        self._unreported: Counter[Refusal] = Counter()
        self._recovery_reported = False
        self._summary_every_s = HOUR_S
        self._summary_at_s = now_monotonic_s + HOUR_S

    def accept(self, now_monotonic_s: float) -> None:
        """Count a scan that is passed on."""
        self._accepted += 1
        if self._gap_began_s is not None:
            gap_s = now_monotonic_s - self._gap_began_s
            if gap_s >= SILENCE_S and not self._recovery_reported:
                self._recovery_reported = True
                _log.info("scans are accepted again, %.0f s and %d refusals later", gap_s, self._gap_counts.total())
            self._gap_began_s = None

    def refuse(self, refused: ScanRefusedError, sender: "str | Peer", utc_s: float, now_monotonic_s: float) -> None:
        """Count a datagram that is not passed on, and log it if it is news."""
        kind = refused.kind
        if now_monotonic_s - self._last_monotonic_s >= QUIET_S:
            self._begin_stretch(now_monotonic_s)
        if self._gap_began_s is None:
            self._gap_began_s = now_monotonic_s
            self._gap_counts.clear()
        self._gap_counts[kind] += 1
        self._refused[kind] += 1
        self._last = kind, sender, refused.reason
        self._last_utc_s = utc_s
        self._last_monotonic_s = now_monotonic_s
        if kind not in self._reported:
            self._reported.add(kind)
            _log.warning("%s; more of this kind are counted, not logged", self._last_refusal)
            return
        self._unreported[kind] += 1
        if now_monotonic_s >= self._summary_at_s:
            self._summarise(now_monotonic_s)

    @property
    def since_accepted(self) -> str:
        """What was refused since the last scan that was passed on, in words; empty for nothing."""
        if self._gap_began_s is None:
            return ""
        return f"the bridge refused {_counts_text(self._gap_counts)} since; the latest is {self._last_refusal}"

    @property
    def _last_refusal(self) -> str:
        """The latest refusal in one sentence, put into words only when it is read: that keeps a flood cheap."""
        if self._last is None:
            return ""
        kind, sender, reason = self._last
        place = sender if isinstance(sender, str) else Address(sender[0], sender[1])
        return f"{kind.replace('_', ' ')}: a datagram from {place} {reason}"

    def statistics(self, lost: int) -> Statistics:
        """Return the counts so far; `lost` comes from the `SequenceGuard`, which knows the order."""
        counts = {kind.value: self._refused[kind] for kind in Refusal}
        return Statistics(
            accepted=self._accepted,
            lost=lost,
            last_refusal=self._last_refusal,
            last_refusal_utc_s=self._last_utc_s,
            **counts,
        )

    def _summarise(self, now_monotonic_s: float) -> None:
        counts = _counts_text(self._unreported)
        _log.warning("datagrams refused and not logged yet: %s; the latest was %s", counts, self._last_refusal)
        self._unreported.clear()
        # Doubling keeps a day of refusals under twenty lines, however many datagrams there are.
        self._summary_every_s *= 2
        self._summary_at_s = now_monotonic_s + self._summary_every_s


def _counts_text(counts: Counter[Refusal]) -> str:
    return ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in sorted(counts.items()))
