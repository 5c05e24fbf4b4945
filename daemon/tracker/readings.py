"""What the cube's scans are good for: their mean, whether the tracker can be steered by it, and whether it is night."""

import math
from collections import deque
from collections.abc import Callable, Hashable
from typing import Any
from weakref import WeakValueDictionary

from daemon.base.clock import Clock
from daemon.base.records import FACES, Irradiances, Quality, Scan
from daemon.config.settings import Settings
from daemon.tracker.modes import DataState
from solar.laws.law import Law

# Above this many times `safety.night_above_w_m2` a vertical face is lit by the sun. If the zenith face can be believed,
# it then reads at least the share below of what the sun's elevation would give it.
_SUNLIT_FACTOR = 10.0
_LEAST_SHARE = 0.5


class SharedCache:
    """What all trackers of one cube know alike, so that it is worked out only once.

    Attributes
    ----------
    laws
        Where their laws keep what they know alike.
    """

    def __init__(self) -> None:
        self.laws: WeakValueDictionary[Hashable, Any] = WeakValueDictionary()
        self._windows: dict[tuple[float, ...], Window] = {}

    def window(self, settings: Settings) -> "Window":
        """Return the window of all whose settings ask for the same."""
        stale_s = settings.safety.scan_stale_s
        alike = (settings.windows.mean_s, settings.cube.scan_every_s, stale_s, stale_s)
        return self._windows.setdefault(alike, Window(*alike))


class Readings:
    """The scans that came in, judged.

    Parameters
    ----------
    settings
        The whole configuration.
    clock
        The service's time.
    sun_elevation_deg
        Returns the sun's elevation at a UTC [s], to tell night from day.
    law
        Says how many faces it needs, and whether the zenith face can be believed.
    unheard
        Returns why the bridge hears nothing, or what it has refused since the last scan, in words; empty for nothing.
    common
        Shared with trackers that hear the same scans, on the same clock.

    Attributes
    ----------
    newest
        The newest scan, good or bad.
    newest_good_scan_s
        Monotonic time of the newest scan with as many good faces as the law needs.
    """

    def __init__(
        self,
        settings: Settings,
        clock: Clock,
        sun_elevation_deg: Callable[[float], float],
        law: Law,
        unheard: Callable[[], str] = str,
        common: SharedCache | None = None,
    ) -> None:
        self._safety = settings.safety
        self._minimum_coverage = settings.windows.minimum_coverage
        self._clock = clock
        self._sun_elevation_deg = sun_elevation_deg
        self._law = law
        self._unheard = unheard
        self._faces_needed = law.faces_needed
        self._window = (common or SharedCache()).window(settings)
        self._started_s = clock.monotonic()
        self._night = False
        self.newest: Scan | None = None
        self.newest_good_scan_s = -math.inf

    def add(self, scan: Scan) -> None:
        """Take in a scan; its monotonic times are on our clock."""
        self.newest = scan
        self._window.add(scan)
        if sum(face.quality is Quality.OK for face in scan.faces) >= self._faces_needed:
            self.newest_good_scan_s = scan.time_monotonic_s

    def forget(self) -> None:
        """Forget all readings until now: they may be older than they seem."""
        self._window.forget()

    def mean(self, now_s: float) -> Irradiances | None:
        """Return the window's mean, or None while too many faces have nothing in it."""
        return self._window.mean(now_s, self._faces_needed)

    def judge(
        self, now_s: float, mean: Irradiances | None, *, sun_known: bool = True
    ) -> tuple[DataState, str, str | None]:
        """Return what the data is good for, why, and why it counts as night (None by day).

        The zenith face tells night from day while it can be believed, with hysteresis; otherwise the ephemeris does.
        Without `sun_known` the clock is in doubt: the ephemeris is not used, and only light ends a night.
        """
        data, why = self._judge_data(now_s, mean)
        seen = mean if data is DataState.FRESH else None
        night_why = self._judge_night(seen) if sun_known else self._judge_night_without_clock(seen)
        if night_why is None and seen is not None and self._too_dark(seen, sun_known=sun_known):
            return DataState.BAD, _why_too_dark(seen.zenith_w_m2, sun_known=sun_known), None
        return data, why, night_why

    def _judge_data(self, now_s: float, mean: Irradiances | None) -> tuple[DataState, str]:
        age_s = now_s - self.newest_good_scan_s
        covered = mean is not None and mean.coverage >= self._minimum_coverage
        if age_s <= self._safety.scan_stale_s and covered:
            bad = self._bad_faces()
            return DataState.FRESH, f"the cube's readings are good{f', but not all of them{bad}' if bad else ''}"
        since_s = now_s - max(self.newest_good_scan_s, self._started_s)
        if since_s > self._safety.fallback_after_s:
            return DataState.BAD, f"no good scan for {since_s:.0f} s{self._bad_faces()}{self._why_unheard()}"
        return DataState.WAITING, f"waiting for the cube's readings{self._why_unheard()}"

    def _why_unheard(self) -> str:
        why = self._unheard()
        return f"; {why}" if why else ""

    def _bad_faces(self) -> str:
        if self.newest is None or self.newest.ok:
            return ""
        bad = [f"{n} {f.quality}" for n, f in zip(FACES, self.newest.faces, strict=True) if f.quality != "ok"]
        return f" ({', '.join(bad)})"

    def _too_dark(self, mean: Irradiances, *, sun_known: bool) -> bool:
        if math.isnan(mean.zenith_w_m2):
            # Without the zenith face and the sun's position, nothing tells day from night.
            return not sun_known
        dark = mean.zenith_w_m2 < self._safety.night_below_w_m2
        return dark and (not sun_known or self._law_believes_zenith(mean))

    def _sees_zenith(self, mean: Irradiances) -> bool:
        """Whether the zenith face tells day from night."""
        zenith = mean.zenith_w_m2
        if math.isnan(zenith):
            return False
        if zenith >= self._safety.night_above_w_m2:
            return True
        sun_deg = self._sun_deg()
        if sun_deg <= 0.0:
            return True
        vertical = [face for face in (mean.east_w_m2, mean.south_w_m2, mean.west_w_m2) if not math.isnan(face)]
        brightest = max(vertical, default=0.0)
        lit = brightest > _SUNLIT_FACTOR * self._safety.night_above_w_m2
        if lit and not (zenith >= _LEAST_SHARE * brightest * math.tan(math.radians(sun_deg))):
            return False
        return self._law_believes_zenith(mean)

    def _law_believes_zenith(self, mean: Irradiances) -> bool:
        """Whether the law believes the zenith face; a law that can do without that face does not stop for it."""
        faces = (mean.east_w_m2, mean.south_w_m2, mean.west_w_m2, mean.zenith_w_m2)
        return self._law.believes_zenith(faces, self._clock.utc())

    def _judge_night(self, seen: Irradiances | None) -> str | None:
        if seen is not None and self._sees_zenith(seen):
            threshold = self._safety.night_above_w_m2 if self._night else self._safety.night_below_w_m2
            self._night = seen.zenith_w_m2 < threshold and self._sun_deg() <= self._safety.night_highest_sun_deg
            return f"the zenith face reads {seen.zenith_w_m2:z.1f} W/m2" if self._night else None
        sun_deg = self._sun_deg()
        self._night = sun_deg < (0.5 if self._night else 0.0)
        return f"the sun stands at {sun_deg:z.1f} deg" if self._night else None

    def _sun_deg(self) -> float:
        return self._sun_elevation_deg(self._clock.utc())

    def _judge_night_without_clock(self, seen: Irradiances | None) -> str | None:
        if seen is not None and seen.zenith_w_m2 >= self._safety.night_above_w_m2:
            self._night = False
        return "it was night before the clock was set" if self._night else None


def _why_too_dark(zenith_w_m2: float, *, sun_known: bool) -> str:
    if math.isnan(zenith_w_m2):
        return "neither the zenith face nor the clock shows whether it is day or night"
    when = "in daylight" if sun_known else "while the clock is in doubt"
    return f"the zenith face reads {zenith_w_m2:z.1f} W/m2 {when}"


class Window:
    """Time-weighted mean of each face over the last `mean_s` seconds.

    A reading stands for the time since the one before it on the same face, for `longest_s` at the most; a reading that
    is not ok, or no later than the one before, stands for nothing. At an even rhythm this is the plain mean of the
    samples inside the window.

    Parameters
    ----------
    mean_s
        Length of the window.
    nominal_s
        What the first reading after a gap stands for.
    longest_s
        The longest time that one reading may stand for.
    stale_s
        A face whose newest good reading is older than this has no mean and covers nothing.
    """

    def __init__(self, mean_s: float, nominal_s: float, longest_s: float, stale_s: float = math.inf) -> None:
        self._mean_s = mean_s
        self._nominal_s = nominal_s
        self._longest_s = longest_s
        self._stale_s = stale_s
        self._newest: Scan | None = None
        self.forget()

    def forget(self) -> None:
        """Begin anew with the next scan."""
        self._faces = tuple(_FaceWindow(self._mean_s) for _ in range(4))

    def add(self, scan: Scan) -> None:
        """Take in a scan, once for all who hand it in; its monotonic times must not run backwards."""
        if scan is self._newest:
            return
        self._newest = scan
        for window, face in zip(self._faces, scan.faces, strict=True):
            if face.quality is not Quality.OK:
                continue
            elapsed_s = face.time_monotonic_s - window.newest_s
            if not elapsed_s > 0.0:
                # Scans come in order, but a sender may date a face before its reading in the scan before.
                continue
            stands_for_s = elapsed_s if elapsed_s <= self._longest_s else self._nominal_s
            window.add(face.time_monotonic_s, stands_for_s, face.irradiance_w_m2)

    def mean(self, now_s: float, faces_needed: int = 4) -> Irradiances | None:
        """Return the mean over (now - mean_s, now], or None while too many faces have no fresh good reading in it.

        A face without one is NaN; coverage is that of the worst among the `faces_needed` best.
        """
        means, covered = [], []
        for window in self._faces:
            stale = now_s - window.newest_s > self._stale_s
            mean, covered_s = (math.nan, 0.0) if stale else window.mean(now_s)
            means.append(mean)
            covered.append(covered_s)
        needed_s = sorted(covered)[-faces_needed]
        if not needed_s > 0:
            return None
        east, south, west, zenith = means
        return Irradiances(
            east_w_m2=east,
            south_w_m2=south,
            west_w_m2=west,
            zenith_w_m2=zenith,
            coverage=min(1.0, needed_s / self._mean_s),
        )


class _FaceWindow:
    """One face: when each of its readings ended, how long it stands for, and the product of both."""

    def __init__(self, mean_s: float) -> None:
        self._mean_s = mean_s
        self._ends_s: deque[float] = deque()
        self._lengths_s: deque[float] = deque()
        self._products: deque[float] = deque()
        self.newest_s = -math.inf

    def add(self, end_s: float, length_s: float, irradiance: float) -> None:
        self._ends_s.append(end_s)
        self._lengths_s.append(length_s)
        self._products.append(length_s * irradiance)
        self.newest_s = end_s

    def mean(self, now_s: float) -> tuple[float, float]:
        """Return the mean and how much of the window it stands for [s]; older readings are forgotten.

        Sums are exact to the last digit, so it makes no difference who else has asked before, and when.
        """
        ends_s, start_s = self._ends_s, now_s - self._mean_s
        while ends_s and ends_s[0] <= start_s:
            ends_s.popleft()
            self._lengths_s.popleft()
            self._products.popleft()
        if not ends_s:
            return math.nan, 0.0
        # Only the oldest reading can reach beyond the window's start.
        length_s = self._lengths_s[0]
        outside_s = max(length_s - (ends_s[0] - start_s), 0.0)
        covered_s, total = math.fsum(self._lengths_s), math.fsum(self._products)
        if outside_s > 0.0:
            covered_s -= outside_s
            total -= self._products[0] * (outside_s / length_s)
        return total / covered_s, covered_s
