"""Reasons to stow that come over the broker. Silence, or a garbled message or one of unknown age, is never safe."""

import json
import math
from collections.abc import Callable
from typing import Any

from daemon.config.links import SafeInput, WindInput
from daemon.mqtt.connection import Incoming
from daemon.mqtt.topics import find_value
from daemon.tracker.stow import StowStatus, release_in_s
from drivers.numbers import read_number

_LONGEST = 65536
_M_S_PER_UNIT = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600, "kt": 1852 / 3600}
_STRONGEST_M_S = 150.0

# Called with what the sentence is about, and the sentence, or None when it is no longer true.
Trouble = Callable[[str, str | None], None]


class WindReadings:
    """Wind speeds from a topic, for `daemon.tracker.stow.WindStow`.

    Parameters
    ----------
    settings
        The topic, where in its messages the speed is, and in which unit.
    threshold_m_s
        A message of unknown age counts only from here: it proves wind, but no living sensor.
    clock_s
        Returns the monotonic time.
    strong
        Called when a reading reaches the threshold, so that the tracker does not wait for the next tick.
    trouble
        Told of messages that cannot be read.
    """

    def __init__(
        self,
        settings: WindInput,
        threshold_m_s: float,
        clock_s: Callable[[], float],
        strong: Callable[[], None],
        trouble: Trouble,
    ) -> None:
        self.heard_s: float | None = None
        self._settings = settings
        self._clock_s = clock_s
        self._threshold_m_s = threshold_m_s
        self._on_strong_wind = strong
        self._trouble = trouble
        self._strongest_m_s: float | None = None

    def take(self, message: Incoming) -> None:
        """Take in one message."""
        subject = f"mqtt.wind of {self._settings.topic}"
        try:
            speed_m_s = self._speed_m_s(message.payload)
        except ValueError as error:
            self._trouble(subject, f"{subject} cannot be used: {error}")
            return
        self._trouble(subject, None)
        if not message.of_unknown_age:
            self.heard_s = self._clock_s()
        if message.of_unknown_age and not speed_m_s >= self._threshold_m_s:
            return
        self._strongest_m_s = max(speed_m_s, self._strongest_m_s or 0.0)
        if speed_m_s >= self._threshold_m_s:
            self._on_strong_wind()

    def strongest_since_last_read(self) -> float | None:
        """Return the strongest wind [m/s] since the last call, or None if there was no reading."""
        strongest_m_s, self._strongest_m_s = self._strongest_m_s, None
        return strongest_m_s

    def _speed_m_s(self, payload: bytes) -> float:
        value = _value(payload, self._settings.json_path)
        try:
            if isinstance(value, str):
                speed = read_number(value)
            else:
                speed = math.nan if isinstance(value, bool) else float(value)
        except (TypeError, ValueError, OverflowError):
            speed = math.nan
        speed_m_s = speed * _M_S_PER_UNIT[self._settings.unit]
        if not 0.0 <= speed_m_s <= _STRONGEST_M_S:
            raise ValueError(f"{ascii(value)[:40]} is not a wind speed in {self._settings.unit}")
        return speed_m_s


class SafeInputStow:
    """Stow while somebody else says that it is unsafe, or says nothing; a `daemon.tracker.stow.StowSource`.

    Parameters
    ----------
    settings
        The topic, its words, and its times.
    clock_s
        Returns the monotonic time.
    unsafe
        Called when the word is unsafe, so that the tracker does not wait for the next tick.
    trouble
        Told of messages that cannot be read.
    """

    def __init__(
        self, settings: SafeInput, clock_s: Callable[[], float], unsafe: Callable[[], None], trouble: Trouble
    ) -> None:
        self.name = f"the word on {settings.topic}"
        self.heard_s: float | None = None
        self._settings = settings
        self._clock_s = clock_s
        self._on_unsafe = unsafe
        self._trouble = trouble
        self._heard_safe = False
        self._unsafe_in_force = False
        self._last_safe_s: float | None = None
        self._begun_s: float | None = None
        self._last_unsafe_s = -math.inf
        self._why: str | None = None

    @property
    def stowing(self) -> bool:
        """Whether it asked for stow at the last poll."""
        return self._why is not None

    def take(self, message: Incoming) -> None:
        """Take in one message."""
        settings = self._settings
        subject = f"mqtt.safe of {settings.topic}"
        try:
            word = self._word(message.payload)
        except ValueError as error:
            self._trouble(subject, f"{subject} cannot be used: {error}")
            return
        self._trouble(subject, None)
        if not message.of_unknown_age:
            self.heard_s = self._clock_s()
        if word == settings.unsafe:
            self._unsafe_in_force = True
            self._heard_safe = False
            self._on_unsafe()
        elif not message.of_unknown_age:
            self._heard_safe = True

    def reason(self, now_s: float) -> str | None:
        """Return why the tracker must be stowed at this monotonic time, or None."""
        settings = self._settings
        if self._last_safe_s is None:
            self._last_safe_s = self._begun_s = now_s
        if self._heard_safe:
            self._last_safe_s = now_s
        elif self.heard_s is None:
            # The time of safety counts from the first safe message, and not from a restart.
            self._last_unsafe_s = now_s
        silent_s = now_s - self._last_safe_s
        if self._unsafe_in_force:
            self._stow(now_s, f"{settings.topic} says {settings.unsafe}")
        elif silent_s > settings.stale_s:
            self._stow(now_s, f"{settings.topic} has not said {settings.safe} for {silent_s:.0f} s")
        elif self._heard_safe and now_s - self._last_unsafe_s >= settings.stow_at_least_s:
            self._why = None
        if self._heard_safe:
            self._unsafe_in_force = self._heard_safe = False
        return self._why

    def status(self, now_s: float) -> StowStatus:
        """Return how it stood at the last poll."""
        last_s = self.heard_s if self.heard_s is not None else self._begun_s
        return StowStatus(
            self.name,
            self._why,
            math.inf if self.heard_s is None else now_s - self.heard_s,
            silent=last_s is not None and now_s - last_s > self._settings.stale_s,
            release_in_s=release_in_s(self._why, now_s - self._last_unsafe_s, self._settings.stow_at_least_s),
        )

    def resume(self, why: str, now_s: float) -> None:
        """Begin stowed, as before a restart."""
        self._stow(now_s, why)

    def _word(self, payload: bytes) -> str:
        settings = self._settings
        value = _value(payload, settings.json_path)
        # Numbers and truth values are words as JSON writes them.
        word = value.strip() if isinstance(value, str) else json.dumps(value)
        if word not in (settings.safe, settings.unsafe):
            raise ValueError(f"{ascii(word)[:40]} is neither {settings.safe!r} nor {settings.unsafe!r}")
        return word

    def _stow(self, now_s: float, why: str) -> None:
        self._last_unsafe_s = now_s
        self._why = why


def _value(payload: bytes, path: str) -> Any:
    if len(payload) > _LONGEST:
        raise ValueError(f"the message is longer than {_LONGEST} bytes")
    return find_value(payload, path)
