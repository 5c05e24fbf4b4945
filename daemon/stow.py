"""Reasons to stow. A source is anything that can be asked whether it wants the tracker in its stow position now."""

import math
from collections.abc import Callable
from typing import Protocol

from daemon.config import Safety


class StowSource(Protocol):
    """One reason to stow; any number of them may be watched."""

    def reason(self, now_s: float) -> str | None:
        """Return why the tracker must be stowed at this monotonic time, or None."""


class OperatorStow:
    """Stow asked for by a person: latched until a person releases it."""

    def __init__(self) -> None:
        self._why: str | None = None

    def ask(self, why: str) -> None:
        """Ask for stow."""
        self._why = why

    def release(self) -> None:
        """Withdraw the request."""
        self._why = None

    def reason(self, now_s: float) -> str | None:  # noqa: ARG002 - the protocol's argument; a latch needs no time
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
        Returns the latest wind speed [m/s], or None while there is no reading.
    """

    def __init__(self, safety: Safety, wind_speed_m_s: Callable[[], float | None]) -> None:
        self._safety = safety
        self._wind_speed_m_s = wind_speed_m_s
        self._heard_s: float | None = None
        self._strong_s = -math.inf
        self._stowed = False
        self._why = ""

    @property
    def stowing(self) -> bool:
        """Whether it asked for stow when it was last looked at."""
        return self._stowed

    def reason(self, now_s: float) -> str | None:
        """Return the wind's reason to stow, or None."""
        safety = self._safety
        if self._heard_s is None:
            self._heard_s = now_s
        wind = self._wind_speed_m_s()
        if wind is not None and 0 <= wind < math.inf:
            self._heard_s = now_s
        silent_s = now_s - self._heard_s
        if silent_s > safety.wind_stale_s:
            self._hold_stow(now_s, f"no wind reading for {silent_s:.0f} s")
        elif wind is not None and wind >= safety.stow_wind_m_s:
            self._hold_stow(now_s, f"wind {wind:.1f} m/s, stow from {safety.stow_wind_m_s:g} m/s")
        elif self._stowed and silent_s == 0 and wind is not None:
            calm = wind < safety.release_wind_m_s
            if not calm:
                self._strong_s = now_s
            elif now_s - self._strong_s >= safety.stow_at_least_s:
                self._stowed = False
        return self._why if self._stowed else None

    def _hold_stow(self, now_s: float, why: str) -> None:
        self._strong_s = now_s
        if not self._stowed:
            self._why = why
        self._stowed = True
