"""Who is logged in. Sessions are in memory alone: a restart of the dashboard asks everybody for the token again."""

import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass

LONGEST_IDLE_S = 30 * 86400.0
"""How long a session is kept without use [s]."""

_MOST = 100
_TRIES = 5
_TRIES_WITHIN_S = 60.0


@dataclass(slots=True)
class Session:
    """Somebody who is logged in.

    Attributes
    ----------
    by
        Who, for the records of the services.
    tokens
        By service: the tokens that the services have accepted, or that could not be tried yet.
    used_s
        Monotonic time of the last use.
    """

    by: str
    tokens: dict[str, str]
    used_s: float


class Sessions:
    """The sessions by their secret names, which only the browser's cookie bears.

    Parameters
    ----------
    monotonic
        Returns the time [s].
    """

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self._monotonic = monotonic
        self._sessions: dict[str, Session] = {}
        self._failures: list[float] = []

    def open(self, by: str, tokens: Mapping[str, str]) -> str:
        """Begin a session and return its name; the one that was idle for longest makes room."""
        while len(self._sessions) >= _MOST:
            del self._sessions[min(self._sessions, key=lambda name: self._sessions[name].used_s)]
        name = secrets.token_urlsafe(32)
        self._sessions[name] = Session(by, dict(tokens), self._monotonic())
        return name

    def find(self, name: str | None) -> Session | None:
        """Return the session of a name, if there is one that has not been idle for too long."""
        session = self._sessions.get(name or "")
        now_s = self._monotonic()
        if session is None or now_s - session.used_s > LONGEST_IDLE_S:
            return None
        session.used_s = now_s
        return session

    def close(self, name: str | None) -> None:
        """End a session."""
        self._sessions.pop(name or "", None)

    @property
    def lockout_s(self) -> float:
        """How long nobody may try a token, after too many that were wrong [s]."""
        now_s = self._monotonic()
        self._failures = [at_s for at_s in self._failures if now_s - at_s < _TRIES_WITHIN_S]
        return 0.0 if len(self._failures) < _TRIES else _TRIES_WITHIN_S - (now_s - self._failures[0])

    def note_wrong_token(self) -> None:
        """Note a wrong token."""
        self._failures.append(self._monotonic())
