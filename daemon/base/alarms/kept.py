"""Which alarms a restart must not forget: those that wait for a person, and those that one has acknowledged."""

import logging
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.alarms.alarm import Alarm
from daemon.base.clock import LEAST_SHOWN_UTC_S, MOST_SHOWN_UTC_S
from daemon.base.state import StateFile, StateFolder, UnreadableStateError

log = logging.getLogger("heliocube.alarm")

FILE_NAME = "alarms.json"
CUBE_FILE_NAME = "cube-alarms.json"

_Utc = Annotated[float, Field(ge=LEAST_SHOWN_UTC_S, le=MOST_SHOWN_UTC_S)]


class KeptAlarm(BaseModel):
    """One alarm in the file; its times are UTC [s]."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    text: str
    raised_utc_s: _Utc
    acknowledged_utc_s: _Utc | None = None
    acknowledged_by: str = ""
    cleared_utc_s: _Utc | None = None

    @classmethod
    def of(cls, alarm: Alarm) -> Self:
        """Return what is kept of an alarm."""
        return cls(
            text=alarm.text,
            raised_utc_s=alarm.raised_utc_s,
            acknowledged_utc_s=alarm.acknowledged_utc_s,
            acknowledged_by=alarm.acknowledged_by,
            cleared_utc_s=alarm.cleared_utc_s,
        )

    def alarm(self, name: str, text: str) -> Alarm:
        """Return the alarm, as one that is on."""
        return Alarm(
            name=name,
            text=text,
            raised_utc_s=self.raised_utc_s,
            acknowledged_utc_s=self.acknowledged_utc_s,
            acknowledged_by=self.acknowledged_by,
        )


class KeptAlarms(BaseModel):
    """The alarms of one tracker, or of the cube, by their names."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    alarms: dict[str, KeptAlarm] = Field(default_factory=dict)


class AlarmFile:
    """Alarms in a small file beside the store; in a folder without a directory they live in memory only.

    Parameters
    ----------
    folder, name
        Folder and name of the file.
    """

    def __init__(self, folder: StateFolder, name: str = FILE_NAME) -> None:
        self._file = StateFile(folder, name, KeptAlarms, log, "which alarms were acknowledged")

    def load(self) -> dict[str, KeptAlarm]:
        """Return what was kept, by name; nothing from a file that cannot be read, which is logged."""
        try:
            kept = self._file.load()
        except UnreadableStateError as error:
            log.warning("%s: which alarms were acknowledged is not known", error)
            return {}
        return {} if kept is None else kept.alarms

    def save(self, alarms: dict[str, KeptAlarm]) -> None:
        """Have the file replaced as a whole."""
        self._file.save(KeptAlarms(alarms=alarms))
