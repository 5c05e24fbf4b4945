"""Every alarm there is: what causes it, what it costs, what to do, and whether it waits for a person to look.

``docs/alarms_table.py`` writes docs/alarms.md from this list; a test holds the list against the source.
"""

import re
from dataclasses import dataclass
from enum import StrEnum

# Those that need a name where there are several trackers.
_COMMAND = re.compile(r"\bheliocube (?:auto|hold|snow|goto|maintenance|home|clear|relearn|alarms ack [\w-]+)\b")


class Severity(StrEnum):
    """How soon somebody has to come."""

    CRITICAL = "critical"
    WARNING = "warning"
    NOTICE = "notice"


@dataclass(frozen=True, slots=True)
class AlarmKind:
    """One kind of alarm.

    Attributes
    ----------
    name
        By which it is known everywhere, such as ``unexplained-motion``.
    severity
        ``critical``: steel, people or the shelter from a storm are at stake, at any hour. ``warning``: data or safety
        suffer until somebody acts, by day. ``notice``: worth knowing.
    latched
        Whether it stays on show after its cause has ended, until a person has acknowledged it.
    cause, effect, remedy
        A sentence each, without the full stop.
    """

    name: str
    severity: Severity
    latched: bool
    cause: str
    effect: str
    remedy: str


def _kind(name: str, severity: Severity, cause: str, effect: str, remedy: str, *, latched: bool = False) -> AlarmKind:
    return AlarmKind(name=name, severity=severity, latched=latched, cause=cause, effect=effect, remedy=remedy)


_ALL = (
    _kind(
        "deaf-to-stop",
        Severity.CRITICAL,
        "5 s after stop the positioner still moves",
        "stop is sent again and again; nothing else is ordered",
        "switch the supply of the motors off, look for the cause, then `heliocube clear`",
        latched=True,
    ),
    _kind(
        "unexplained-motion",
        Severity.CRITICAL,
        "an axis moved without an order, away from its target, or against a stop",
        "the axes are stopped and nothing moves any more, not even to stow",
        "somebody may be at the axes: look who or what it was, then `heliocube clear`; where the angles of `status` are"
        " not those of the arms, `heliocube hold` before that and `heliocube home` after it",
        latched=True,
    ),
    _kind(
        "positioner-fault",
        Severity.CRITICAL,
        "the positioner reports a fault, one went away before anybody had seen it, or a mode of its own stays on",
        "nothing moves while the fault is on; after one that vanished nothing but a stow",
        "find the cause at the mechanics, then `heliocube clear`, or `heliocube home` after a lost reference",
        latched=True,
    ),
    _kind(
        "move-failed",
        Severity.CRITICAL,
        "a move or a stow was given up after `motion.attempts` tries, or the link was lost in three moves in a row; "
        "ends with a move that arrives",
        "the tracker is not where it should be, maybe not stowed; it is tried again with growing pauses",
        "look for ice, something in the way, a slack cable, the unit's supply; the alarm's text says how it failed",
        latched=True,
    ),
    _kind(
        "positioner-setup",
        Severity.CRITICAL,
        "geometry, offsets or ranges in the unit contradict the configuration",
        "nothing moves, not even to stow",
        "correct the one that is wrong, then restart the service",
    ),
    _kind(
        "stow-wanted",
        Severity.CRITICAL,
        "wind, or another reason to stow, while a person keeps the tracker still anywhere but at stow",
        "the module stands in the wind as it was left",
        "see that nobody is at the axes, then `heliocube auto`",
    ),
    _kind(
        "positioner-down",
        Severity.CRITICAL,
        "for 60 s the positioner has not answered, or only for moments; ends when it has answered for 15 s",
        "the tracker is neither moved nor stowed",
        "cable, supply, adapter; the service connects by itself within some ten seconds",
    ),
    _kind(
        "driver-hung",
        Severity.CRITICAL,
        "of several trackers, the driver of one does not return, or has failed; only a new process can connect it",
        "this tracker is neither moved nor stowed; the others go on",
        "restart the service when the others may stand still for it",
    ),
    _kind(
        "law-failed",
        Severity.WARNING,
        "the pointing law has raised an error of its own, which the log has in full",
        "the tracker follows the sun by ephemeris; limits, stow and commands work as always",
        "correct the law or choose another, then restart the service",
    ),
    _kind(
        "no-wind-source",
        Severity.WARNING,
        "real instruments, and no wind sensor or other guard is configured",
        "nothing stows the tracker in a storm",
        'set mqtt.wind.topic or mqtt.safe.topic, or safety.without_wind_source = "accepted"',
    ),
    _kind(
        "stow-source-silent",
        Severity.WARNING,
        "a wind sensor or the word of `mqtt.safe` has not been heard for longer than it may be silent",
        "the tracker is stowed until it is heard again and calm",
        "look after the sensor, its cable, the broker and the topic; `heliocube status` tells when it was heard",
    ),
    _kind(
        "reference",
        Severity.WARNING,
        "the reference of an axis is in doubt: a restart of the unit, a jump of its count, a failed reference run",
        "nothing moves but a stow",
        "compare the angles of `status` with the arms; `heliocube clear` if they agree, else `heliocube home`",
    ),
    _kind(
        "motor-current",
        Severity.WARNING,
        "for 2 s a motor draws more than `instruments.positioner.current_alarm_a`, or draws current at rest (it is"
        " then stopped again); ends after an hour without",
        "the drive wears, and may stall before it reaches its stow position",
        "look for ice, something in the way, a dry joint, a worn spindle",
        latched=True,
    ),
    _kind(
        "cube-face",
        Severity.WARNING,
        "a face of the cube reads what cannot be true",
        "the face is not used: the laws go on by three, and without a second one by the ephemeris",
        "look after the sensor, its cable and the multiplexer, its shade, and whether cables are swapped; it is used"
        " again after ten sound looks, one that stood still or contradicted the others once it follows the light",
    ),
    _kind(
        "face-unread",
        Severity.WARNING,
        "for ten scans a face of the cube gives no reading (over-range, stale, missing) while others do",
        "the laws go on by three faces, and without a second one by the ephemeris",
        "look after its sensor, its plug and its cable; ten scans with it end the alarm",
    ),
    _kind(
        "cube-sensor",
        Severity.WARNING,
        "a digital sensor reports a fault, is silent for the third time, or is another one than configured",
        "its face has no reading, or a doubtful one",
        "do what the alarm's text says; docs/instruments.md explains the flags; ten scans without it end the alarm",
    ),
    _kind(
        "no-readings",
        Severity.WARNING,
        "for 15 minutes of daylight the law has had no good readings",
        "the tracker follows the ephemeris",
        "look after the cube, its process, the bridge and the network; the mode's reason says which",
    ),
    _kind(
        "clock",
        Severity.WARNING,
        "the time of day was set by a large step, or never synchronised",
        "after a step the sun's position is not used: the tracker goes by the cube alone, or stays where it is, until"
        " the clock is synchronised or set back, or the service is started anew",
        "see to time synchronisation: `timedatectl`, the network, the NTP server; without any, set the time right and"
        " start the service anew",
    ),
    _kind(
        "hold-forgotten",
        Severity.WARNING,
        "the sun has risen since somebody said `hold`, `goto` or `snow`",
        "the tracker does not track",
        "`heliocube auto`, if it was forgotten",
    ),
    _kind(
        "release-changed",
        Severity.WARNING,
        "another release of heliocube runs than at the last start, or a tracker that was stopped, stowed, held or in"
        " doubt has another name or no table any more; and nobody had asked for anything",
        "the tracker is held where it stands, but for a stow",
        "`heliocube self-check`, a look at the tracker, then `heliocube auto`",
    ),
    _kind(
        "nothing-kept",
        Severity.WARNING,
        "real instruments, and a program of your own has named no folder: `heliocube run` always has one",
        "a restart forgets stops, storms and doubts, and no records are kept",
        "set store.directory, then restart the service",
    ),
    _kind(
        "not-kept",
        Severity.WARNING,
        "a file of kept state cannot be written, which is tried at the start",
        "a restart would forget what the alarm's text names",
        "free the disk, or correct its rights; writing is tried again every few seconds",
    ),
    _kind(
        "store-aside",
        Severity.WARNING,
        "the file of records was damaged, and a new one was begun",
        "the records before are in the file that was moved aside",
        "salvage them with `heliocube store salvage FILE --into FOLDER`, then move that file to another folder",
    ),
    _kind(
        "store-down",
        Severity.WARNING,
        "the store cannot write",
        "records wait in memory; of too many the oldest are lost",
        "free the disk, or correct its rights; the alarm ends with the first record that is written",
    ),
    _kind(
        "archive-behind",
        Severity.WARNING,
        "no archive has confirmed records for an hour",
        "records wait in the store, which forgets its oldest days in the end; the tracker is not concerned",
        "see the broker and the log of heliocube archive; before the store forgets a day, copy its file and fill that"
        " in later (docs/archive.md)",
    ),
    _kind(
        "day-budget",
        Severity.NOTICE,
        "the laws have used three quarters of the moves or the travel of the solar day, or all; ends at solar midnight",
        "until then it follows the sun by the clock; with nothing left it stands, but for stow, night and persons",
        "a sky that varies much; if it is usual, raise motion.deadband_deg, or the day's limits",
    ),
)

KINDS: dict[str, AlarmKind] = {kind.name: kind for kind in _ALL}
"""By name, the most severe first."""


def as_typed(text: str, tracker: str | None) -> str:
    """Return a text with its commands as they are typed for one of several trackers; None for the only one."""
    return text if tracker is None else _COMMAND.sub(rf"\g<0> --tracker {tracker}", text)


def kind_of_alarm(name: str) -> AlarmKind:
    """Return the kind of a name; one that a plugged-in part has made up is a warning that its text must explain."""
    found = KINDS.get(name)
    return found or _kind(name, Severity.WARNING, "as the alarm's text says", "unknown", "as the alarm's text says")
