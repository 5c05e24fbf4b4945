"""What a person has to look at before the tracker goes on: doubts about the reference, and motion nobody ordered.

Kept beside the store, so that a restart of the service forgets none of it.
"""

import logging
from collections.abc import Collection, Iterable

from pydantic import BaseModel, ConfigDict, Field

from daemon.base.state import StateFile, StateFolder, UnreadableStateError
from drivers.interfaces import Telemetry

log = logging.getLogger("heliocube.motion")

FILE_NAME = "motion.json"
_FAULT_PREFIX = "fault "
NOT_FINISHED = "homing was not finished, the reference is in doubt: home it"
RESET = "the positioner has restarted and may have lost its reference: home it, or clear the mark"


def remedy_of(*, has_reference_run: bool) -> str:
    """Return what ends a doubt about the count, as the end of a sentence: not every drive can be homed."""
    return "home it" if has_reference_run else "compare the angles with where the tracker points, then clear it"


def fault_text(name: str) -> str:
    """Return how a latched fault is shown."""
    return f"the positioner reports {name}"


class _KeptDoubts(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    doubts: dict[str, str] = Field(default_factory=dict)
    incidents: dict[str, str] = Field(default_factory=dict)
    faults: list[str] = Field(default_factory=list)
    homing: bool = False


def _join_without_repeats(texts: Iterable[str]) -> str:
    """Return the sentences joined into one, without those that another one contains."""
    parts = list(dict.fromkeys(part for text in texts for part in text.split("; ")))
    return "; ".join(part for part in parts if not any(part in other for other in parts if other != part))


def _file_in(folder: StateFolder) -> StateFile[_KeptDoubts]:
    return StateFile(folder, FILE_NAME, _KeptDoubts, log, "what is in doubt")


def _load(file: StateFile[_KeptDoubts], remedy: str) -> _KeptDoubts:
    try:
        return file.load() or _KeptDoubts()
    except UnreadableStateError as error:
        text = f"{error}, so it is not known what was in doubt before the restart: {remedy}"
        log.warning("%s", text)
        return _KeptDoubts(doubts={"unreadable": text})


def kept_doubts(folder: StateFolder, seen: Telemetry | None = None) -> tuple[str, ...]:
    """Return what is in doubt in a folder that no service is using, a sentence each; nothing is written there.

    With telemetry `seen` today, also tell which faults have gone since.
    """
    # It is not known which drive it was, and whether that one can be homed.
    remedy = "compare the angles with where the tracker points"
    kept = _load(_file_in(folder), remedy)
    gone = (
        ()
        if seen is None
        else tuple(_vanished_fault_text(name, remedy) for name in kept.faults if name not in seen.faults)
    )
    return (*kept.incidents.values(), *kept.doubts.values(), *gone, *((NOT_FINISHED,) if kept.homing else ()))


def _vanished_fault_text(fault: str, remedy: str) -> str:
    return f"{fault} cleared by itself, the reference may be lost: {remedy}"


class Doubts:
    """Doubts and incidents by kind, and the faults that were last seen.

    A doubt is about the reference: a stow may go ahead, and reference runs of both axes end it. An incident is motion
    without an order or against a stop: nothing moves at all before a person has cleared it.

    Parameters
    ----------
    folder
        Folder of the file.
    remedy
        What ends a doubt about the count, see `remedy_of`.

    Attributes
    ----------
    reference
        Why the reference is in doubt, or None.
    reference_alarm_text
        The same without the doubts of `vanished_faults`, which have an alarm of their own.
    incident
        What moved without an order or did not stop, or None.
    change_count
        Grows with every change, for those who show it.
    """

    def __init__(self, folder: StateFolder, remedy: str = remedy_of(has_reference_run=True)) -> None:
        self._file = _file_in(folder)
        self._file.reserve()
        self.remedy = remedy
        kept = _load(self._file, remedy)
        self._doubts = dict(kept.doubts)
        self._incidents = dict(kept.incidents)
        self._faults = tuple(kept.faults)
        self._homing = False
        self.change_count = 0
        self._sum_up()
        if kept.homing:
            self.add_doubt("homing", NOT_FINISHED)

    @property
    def vanished_faults(self) -> dict[str, str]:
        """The doubts about faults that went away by themselves, by the names of the faults."""
        return {
            kind.removeprefix(_FAULT_PREFIX): text
            for kind, text in self._doubts.items()
            if kind.startswith(_FAULT_PREFIX)
        }

    @property
    def texts(self) -> tuple[str, ...]:
        """All incidents and doubts, a sentence each."""
        return (*self._incidents.values(), *self._doubts.values())

    def incident_of(self, kind: str) -> str | None:
        """Return one incident, or None."""
        return self._incidents.get(kind)

    def add_doubt(self, kind: str, text: str) -> None:
        """Keep a doubt; a new text for one of the same kind replaces the old one."""
        self._put(self._doubts, kind, text)

    def add_incident(self, kind: str, text: str) -> None:
        """Keep an incident; the first of a kind stays until it has been cleared."""
        if kind not in self._incidents:
            self._put(self._incidents, kind, text)

    def see(self, telemetry: Telemetry, *, clearing: bool) -> None:
        """Take in what telemetry says about reference and faults; a fault may vanish only while we clear."""
        if telemetry.was_reset:
            self.add_doubt("reset", RESET)
        if telemetry.reference_doubt:
            self.add_doubt("count", telemetry.reference_doubt)
        if clearing or telemetry.faults == self._faults:
            return
        for name in self._faults:
            if name not in telemetry.faults:
                self.add_doubt(f"{_FAULT_PREFIX}{name}", _vanished_fault_text(name, self.remedy))
        self._faults = telemetry.faults
        self._save()

    def acknowledge(self, shown: Collection[str], before: Telemetry) -> None:
        """Forget what a person was shown; keep faults that the unit has cleared although nobody had seen them.

        Parameters
        ----------
        shown
            Sentences of `texts`, or of `fault_text`.
        before
            The last telemetry before the unit cleared its marks.
        """
        self.see(before, clearing=True)
        for name in before.faults:
            if fault_text(name) not in shown:
                self.add_doubt(
                    f"{_FAULT_PREFIX}{name}", f"{name} was cleared before anybody had seen it: {self.remedy}"
                )
        for texts in (self._doubts, self._incidents):
            for kind in [kind for kind, text in texts.items() if text in shown]:
                del texts[kind]
        self.note_faults_cleared()

    def note_faults_cleared(self) -> None:
        """Expect no faults: the unit has cleared them because we asked it to."""
        self._faults = ()
        self._save()

    def homing_begins(self) -> None:
        """Keep in mind that a reference run is on: if the service dies before its end, it was not finished."""
        self._homing = True
        self._save()

    def homing_ends(self, doubt: str | None) -> None:
        """Note the end of a reference run, and keep the doubt that it has left, if any."""
        self._homing = False
        if doubt is None:
            self._save()
        else:
            self.add_doubt("homing", doubt)

    def clear_doubts(self) -> None:
        """End all doubts: both axes have made a good reference run."""
        self._homing = False
        self._doubts.clear()
        self._save()

    def _put(self, texts: dict[str, str], kind: str, text: str) -> None:
        if texts.get(kind) != text:
            texts[kind] = text
            self._save()

    def _sum_up(self) -> None:
        # These are read at every look at the positioner, some 200,000 times a day, and seldom change.
        self.reference = _join_without_repeats(self._doubts.values()) or None
        self.reference_alarm_text = (
            _join_without_repeats(text for kind, text in self._doubts.items() if not kind.startswith(_FAULT_PREFIX))
            or None
        )
        self.incident = "; ".join(self._incidents.values()) or None
        self.change_count += 1

    def _save(self) -> None:
        self._sum_up()
        faults = list(self._faults)
        self._file.save(_KeptDoubts(doubts=self._doubts, incidents=self._incidents, faults=faults, homing=self._homing))
