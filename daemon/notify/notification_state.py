"""Keeps over a restart of the notifier which alarms were told: one that ends meanwhile is then told as over."""

import logging
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.state import StateFile, StateFolder, UnreadableStateError

log = logging.getLogger("heliocube.notify")

FILE_NAME = "told.json"


class NotifiedAlarm(BaseModel):
    """One alarm that was on and has been told, as `/api/state` had it."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)

    name: str
    severity: str
    text: str
    latched: bool
    tracker: str | None = None
    acknowledged_at: str | None = None

    def as_api_alarm(self) -> dict[str, Any]:
        """Return it as an alarm that is on, but without its time: so an alarm that is still on is told once more."""
        return {**self.model_dump(), "state": "raised", "raised_at": ""}


class NotificationState(BaseModel):
    """What people were told of one service: whether it did not answer, and which alarms were on."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    silent: bool = False
    alarms: list[NotifiedAlarm] = Field(default_factory=list)


class NotificationStates(BaseModel):
    """What people were told of all services, by the services' addresses."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    services: dict[str, NotificationState] = Field(default_factory=dict)


class NotificationStateFile:
    """A small file with what was told; in a folder without a directory nothing is kept.

    Parameters
    ----------
    folder
        Of the file.
    """

    def __init__(self, folder: StateFolder) -> None:
        self._folder = folder
        self._file = StateFile(folder, FILE_NAME, NotificationStates, log, "which alarms were told")
        self._saved: NotificationStates | None = None

    def load(self) -> dict[str, NotificationState]:
        """Return what was kept, by address; nothing if the file cannot be read, which is logged."""
        try:
            kept = self._file.load()
        except UnreadableStateError as error:
            log.warning("%s: nobody is told which alarms ended meanwhile", error)
            return {}
        return {} if kept is None else kept.services

    def save(self, services: dict[str, NotificationState]) -> None:
        """Have the file replaced as a whole if anything has changed; after a failure of the disk, try again."""
        whole = NotificationStates(services=services)
        if whole != self._saved:
            self._saved = whole
            self._file.save(whole)
        self._folder.retry()

    def close(self) -> None:
        """Give the disk a moment for values that it has not taken yet."""
        self._folder.close()
