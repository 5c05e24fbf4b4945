"""Reasons to stow. A source is anything that answers a poll whether it wants the tracker in its stow position now."""

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

from daemon.config.sections import SafetySettings


class StowStatus(NamedTuple):
    """How one source stands.

    Attributes
    ----------
    name
        Which source.
    why
        Why it wants the tracker stowed, or None.
    age_s
        Time since the source was last heard; infinite until it is heard for the first time after the service's start.
    speed_m_s, stow_from_m_s, release_below_m_s
        Wind of the last reading (NaN once the reading is too old to count), and its two thresholds. All three are NaN
        for a source that measures no wind.
    release_in_s
        How much longer the source must be calm before it releases the tracker; NaN while it asks for no stow.
    silent
        Whether the source has been silent for longer than allowed, which is itself a reason to stow.
    """

    name: str
    why: str | None
    age_s: float
    speed_m_s: float = math.nan
    stow_from_m_s: float = math.nan
    release_below_m_s: float = math.nan
    release_in_s: float = math.nan
    silent: bool = False


class StowSource(Protocol):
    """One reason to stow; any number of them may be watched."""

    name: str

    def reason(self, now_s: float) -> str | None:
        """Return why the tracker must be stowed at this monotonic time, or None; it has to be polled often."""

    def status(self, now_s: float) -> StowStatus:
        """Return how the source stood at the last poll; changes nothing, so anybody may call it."""

    def resume(self, why: str, now_s: float) -> None:
        """Begin stowed, as before a restart or a sleep of the machine, until heard and calm for the whole time."""


class OperatorStow:
    """Stow asked for by a person: latched until a person releases it."""

    def __init__(self) -> None:
        self._why: str | None = None

    def request(self, why: str) -> None:
        """Request stow."""
        self._why = why

    def release(self) -> None:
        """Withdraw the request."""
        self._why = None

    def reason(self, now_s: float) -> str | None:  # noqa: ARG002 - polled like the others; a latch needs no time
        """Return why a person asked, or None."""
        return self._why


class WindStow:
    """Stow in strong wind, with hysteresis and a minimum stay.

    A wind reading that is missing, not a number or silent for too long counts as strong wind.

    Parameters
    ----------
    safety
        Thresholds and times.
    wind_speed_m_s
        Returns the latest wind speed [m/s], or the strongest since the last call; None while there is no reading.
    name
        Name of the source, for people.
    """

    def __init__(self, safety: SafetySettings, wind_speed_m_s: Callable[[], float | None], name: str = "wind") -> None:
        self.name = name
        self._safety = safety
        self._wind_speed_m_s = wind_speed_m_s
        self._first_poll_s: float | None = None
        self._heard_s = -math.inf
        self._speed_m_s = math.nan
        self._strong_s = -math.inf
        self._why: str | None = None

    @property
    def stowing(self) -> bool:
        """Whether the wind was a reason to stow at the last poll."""
        return self._why is not None

    def reason(self, now_s: float) -> str | None:
        """Return the wind's reason to stow, or None."""
        safety = self._safety
        if self._first_poll_s is None:
            self._first_poll_s = now_s
        wind = self._wind_speed_m_s()
        if wind is not None and 0 <= wind < math.inf:
            self._heard_s, self._speed_m_s = now_s, wind
            self._judge(wind, now_s)
            return self._why
        if self._why is not None and self._heard_s == -math.inf:
            # The time of calm counts from the first reading of the sensor, not from the restart.
            self._strong_s = now_s
        silent_s = self._silent_s(now_s)
        if silent_s > safety.wind_stale_s:
            self._stow(now_s, f"no wind reading for {silent_s:.0f} s")
        return self._why

    def _silent_s(self, now_s: float) -> float:
        return now_s - max(self._heard_s, now_s if self._first_poll_s is None else self._first_poll_s)

    def status(self, now_s: float) -> StowStatus:
        """Return how it stood at the last poll."""
        safety, age_s = self._safety, now_s - self._heard_s
        return StowStatus(
            name=self.name,
            why=self._why,
            age_s=age_s,
            speed_m_s=self._speed_m_s if age_s <= safety.wind_stale_s else math.nan,
            stow_from_m_s=safety.stow_wind_m_s,
            release_below_m_s=safety.release_wind_m_s,
            release_in_s=release_in_s(self._why, now_s - self._strong_s, safety.stow_at_least_s),
            silent=self._silent_s(now_s) > safety.wind_stale_s,
        )

    def resume(self, why: str, now_s: float) -> None:
        """Begin stowed, as before a restart."""
        self._stow(now_s, why)

    def _judge(self, wind_m_s: float, now_s: float) -> None:
        safety = self._safety
        if wind_m_s >= safety.stow_wind_m_s:
            self._stow(now_s, f"wind {wind_m_s:.1f} m/s, stow from {safety.stow_wind_m_s:g} m/s")
        elif not wind_m_s < safety.release_wind_m_s:
            self._strong_s = now_s
        elif now_s - self._strong_s >= safety.stow_at_least_s:
            self._why = None

    def _stow(self, now_s: float, why: str) -> None:
        self._strong_s = now_s
        self._why = why


def release_in_s(why: str | None, calm_s: float, at_least_s: float) -> float:
    """Return how long a source that stows must still be calm [s]; NaN for one that does not stow."""
    return math.nan if why is None else max(0.0, at_least_s - calm_s)
