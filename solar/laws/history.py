"""What a law has heard of the cube, as a chain of links: trackers that have heard the same readings hold the same link.

What a link stands for never changes. A law that hears the next reading asks its link for the link after that reading;
the first law that asks works it out, and the others find it. So what hundreds of trackers know alike is worked out
once. A tracker that has missed a reading, or has been told to forget, goes on along links of its own: sharing can
change no result.
"""

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple
from weakref import ref

import numpy as np

from solar.ephemeris import Site, solar_days, sun_direction
from solar.frames import Array
from solar.laws.law import Reading
from solar.laws.memory import LightMemory
from solar.laws.site import LearnedSite

_MEAN_S = 15.0
# No reading stands for longer than this; a cube that scans more slowly leaves the rest open.
_LONGEST_S = 60.0
# In modes without decisions nobody asks for the means: they are then taken in this many at a time.
_MOST_WAITING = 40
# So many of the newest links are held, for trackers of one cube are no further apart. If each link held the next, a
# tracker that hears no more would hold every later one.
_MOST_LINKS = 60

FourNumbers = tuple[float, float, float, float]
_FOUR_ZEROS: FourNumbers = (0.0, 0.0, 0.0, 0.0)


class PartialMean(NamedTuple):
    """A mean that is being made: its seconds, those of each face, and sums by seconds of readings and of UTC [s]."""

    elapsed_s: float = 0.0
    middle: float = 0.0
    sums: FourNumbers = _FOUR_ZEROS
    seconds: FourNumbers = _FOUR_ZEROS

    def with_reading(self, reading: Reading, elapsed_s: float) -> "PartialMean":
        """Return the mean with one reading more, which stands for `elapsed_s`."""
        sums, seconds = list(self.sums), list(self.seconds)
        for place, irradiance_w_m2 in enumerate(reading.faces_w_m2):
            if not math.isnan(irradiance_w_m2):
                sums[place] += elapsed_s * irradiance_w_m2
                seconds[place] += elapsed_s
        (e, s, w, z), (e_s, s_s, w_s, z_s) = sums, seconds
        middle = self.middle + elapsed_s * reading.utc_s
        return PartialMean(self.elapsed_s + elapsed_s, middle, (e, s, w, z), (e_s, s_s, w_s, z_s))

    def ended(self) -> tuple[float, float, list[float]]:
        """Return its middle UTC [s], its length [s] and its faces [W/m2], NaN for one without readings."""
        pairs = zip(self.sums, self.seconds, strict=True)
        faces = [total / seconds if seconds > 0.0 else math.nan for total, seconds in pairs]
        return self.middle / self.elapsed_s, self.elapsed_s, faces


_EMPTY_MEAN = PartialMean()


@dataclass(slots=True, weakref_slot=True, eq=False)
class ReadingHistory:
    """One link: all readings up to some instant.

    Attributes
    ----------
    site, scan_every_s
        Where the cube stands, and its rhythm.
    day
        The solar day; what it teaches of the site is taken over at its end.
    """

    site: Site
    scan_every_s: float
    day: int
    _memory: LightMemory
    _newest_s: float = -math.inf
    _begun: PartialMean = _EMPTY_MEAN
    _waiting_means: tuple[tuple[float, float, list[float]], ...] = ()
    _newest_links: "deque[ReadingHistory]" = field(default_factory=lambda: deque(maxlen=_MOST_LINKS))
    _next_link: "tuple[Reading, ref[ReadingHistory]] | None" = None
    _day_link: "ReadingHistory | None" = None

    def __deepcopy__(self, memo: dict[int, Any]) -> "ReadingHistory":
        """Return itself: what it stands for does not change."""
        return self

    def after(self, reading: Reading) -> "ReadingHistory":
        """Return the link of a law that has heard this reading as well."""
        known = self._next_link[1]() if self._next_link is not None and self._next_link[0] == reading else None
        if known is None:
            day = int(solar_days(reading.utc_s, self.site.longitude_deg))
            known = self.on(day).extended(reading)
            self._newest_links.append(known)
            self._next_link = (reading, ref(known))
        return known

    def on(self, day: int) -> "ReadingHistory":
        """Return the link of a law that has taken over what the days before this one have taught."""
        if day == self.day:
            return self
        if self._day_link is None or self._day_link.day != day:
            memory = self.memory().copied()
            memory.site.end_of_day()
            self._day_link = self._with_changes(day=day, _memory=memory)
        return self._day_link

    def with_learned(self, learned: LearnedSite) -> "ReadingHistory":
        """Return the link of a law that has forgotten what was learned of the site, and begins with `learned`."""
        # The light is no knowledge of the site: the means that wait are still taken in.
        memory = self.memory().copied()
        memory.site.reset()
        memory.site.learned = learned
        return self._with_changes(_memory=memory)

    @property
    def learned(self) -> LearnedSite:
        """What was learned of the site; another object when it has changed."""
        return self._memory.site.learned

    @property
    def waiting_utc_s(self) -> list[float]:
        """The times of the means that wait to be taken in, in UTC [s]."""
        return [mean[0] for mean in self._waiting_means]

    def memory(self, sun: Array | None = None) -> LightMemory:
        """Return the memory of all means so far, to be read only; `sun` are the directions for those that wait."""
        if self._waiting_means:
            utc_s, elapsed_s, faces = zip(*self._waiting_means, strict=True)
            memory = self._memory.copied()
            # One call for all: it costs little more than a single one.
            suns = sun_direction(np.array(utc_s), *self.site) if sun is None else sun
            memory.observe(np.array(faces), suns, np.array(elapsed_s))
            self._memory, self._waiting_means = memory, ()
        return self._memory

    def extended(self, reading: Reading) -> "ReadingHistory":
        """Work out the link after a reading of the same day."""
        elapsed_s = reading.monotonic_s - self._newest_s
        begun, waiting = self._begun, self._waiting_means
        if not (elapsed_s <= _LONGEST_S):
            # The memory ages by the gap. The mean that was begun before it is dropped, for the sun has moved since.
            unread = (reading.utc_s, elapsed_s - self.scan_every_s, [math.nan] * len(_FOUR_ZEROS))
            begun, waiting = _EMPTY_MEAN, (*waiting, unread) if math.isfinite(elapsed_s) else waiting
            elapsed_s = self.scan_every_s
        begun = begun.with_reading(reading, elapsed_s)
        if begun.elapsed_s >= _MEAN_S - 1e-3:
            begun, waiting = _EMPTY_MEAN, (*waiting, begun.ended())
        # This runs once a scan for each tracker, and `replace` would take as long as all the rest.
        made = ReadingHistory(
            site=self.site,
            scan_every_s=self.scan_every_s,
            day=self.day,
            _memory=self._memory,
            _newest_s=reading.monotonic_s,
            _begun=begun,
            _waiting_means=waiting,
            _newest_links=self._newest_links,
        )
        if len(waiting) >= _MOST_WAITING:
            made.memory()
        return made

    def _with_changes(self, **changes: Any) -> "ReadingHistory":
        return replace(self, **changes, _next_link=None, _day_link=None)
