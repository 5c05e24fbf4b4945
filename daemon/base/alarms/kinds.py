"""Every alarm there is: what causes it, what it costs, what to do, and whether it waits for a person to look.

``docs/alarms_table.py`` writes docs/alarms.md from this list; a test holds the list against the source.
"""

import re
from dataclasses import dataclass
from enum import StrEnum

# Commands that, where there are several trackers, need a name or are for all without one; not those that have a name.
_COMMAND = re.compile(
    r"\bheliocube (?:stop|stow|auto|hold|snow|goto|maintenance|home|clear|relearn|alarms ack [\w-]+)\b(?! --tracker)"
)


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
        The name by which it is known everywhere, such as ``unexplained-motion``.
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
        "switch the motors' supply off, find the cause, then `heliocube clear`",
        latched=True,
    ),
    _kind(
        "unexplained-motion",
        Severity.CRITICAL,
        "an axis moved without an order, away from its target, or against a stop",
        "the axes are stopped, and nothing moves any more, not even to stow",
        "somebody may be at the axes: find out who or what moved them. If the angles of `status` agree with the arms:"
        " `heliocube clear`; if they do not: `heliocube hold`, then `heliocube clear`, then `heliocube home`",
        latched=True,
    ),
    _kind(
        "positioner-fault",
        Severity.CRITICAL,
        "the positioner reports a fault, a fault went away before anybody saw it, or a mode of the unit's own stays on",
        "nothing moves while the fault lasts; after one that went away, only a stow moves the tracker",
        "find the cause at the mechanics, then `heliocube clear`, or `heliocube home` if the reference was lost",
        latched=True,
    ),
    _kind(
        "move-failed",
        Severity.CRITICAL,
        "a move or a stow was given up after `motion.attempts` attempts, or the link was lost in three moves in a row; "
        "ends with a move that arrives",
        "the tracker is not where it should be, and may not be stowed; unless a fault or a person forbids it, the move"
        " is tried again after longer and longer pauses",
        "check for ice, an obstacle, a slack cable, and the unit's supply; the alarm's text says how the move failed",
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
        "there is wind, or another reason to stow, but a person keeps the tracker still outside the stow position",
        "the tracker stays in the wind where it stands",
        "make sure that nobody is at the axes, then `heliocube auto`",
    ),
    _kind(
        "positioner-down",
        Severity.CRITICAL,
        "for 60 s the positioner has not answered, or only for moments; ends when it has answered for 15 s",
        "the tracker is neither moved nor stowed",
        "check cable, supply and adapter; then the service connects by itself within about ten seconds",
    ),
    _kind(
        "driver-hung",
        Severity.CRITICAL,
        "the driver of one of several trackers does not return, or has failed; only a new process can connect it",
        "this tracker is neither moved nor stowed; the others go on",
        "restart the service at a time when the other trackers may stop for a moment",
    ),
    _kind(
        "law-failed",
        Severity.WARNING,
        "the pointing law failed with an error, which is in the log, or gave an answer that cannot be used",
        "the tracker follows the sun by ephemeris; limits, stow and commands work as usual",
        "correct the law or choose another, then restart the service",
    ),
    _kind(
        "no-wind-source",
        Severity.WARNING,
        "the instruments are real, and no wind sensor or other source of stow is configured",
        "nothing stows the tracker in a storm",
        'set mqtt.wind.topic or mqtt.safe.topic, or safety.without_wind_source = "accepted"',
    ),
    _kind(
        "stow-source-silent",
        Severity.WARNING,
        "a wind sensor or the safety input `mqtt.safe` has been silent for longer than allowed",
        "the tracker is stowed until the source is heard again and reports calm for long enough",
        "check the sensor, its cable, the broker and the topic; `heliocube status` shows when it was last heard",
    ),
    _kind(
        "stow-source-failed",
        Severity.WARNING,
        "a source of stow raised an error, which is in the log, or gave an answer that cannot be used; ends when the"
        " source has worked for a minute",
        "the tracker is stowed until then, and until the source has been calm for long enough",
        "correct what the alarm's text names, or take the source out, then restart the service",
    ),
    _kind(
        "reference",
        Severity.WARNING,
        "the reference of an axis is in doubt: a restart of the unit, a jump of its count, a failed reference run",
        "only a stow moves the tracker",
        "compare the angles of `status` with the arms; `heliocube clear` if they agree, otherwise `heliocube home`",
    ),
    _kind(
        "motor-current",
        Severity.WARNING,
        "for 2 s a motor draws more than `instruments.positioner.current_alarm_a`, or draws current at rest (it is"
        " then stopped again); ends after an hour without it",
        "the drive wears, and may stall before it reaches the stow position",
        "check for ice, an obstacle, a joint without grease, a worn spindle",
        latched=True,
    ),
    _kind(
        "cube-face",
        Severity.WARNING,
        "one or more faces of the cube give readings that cannot be true",
        "such a face is not used: the laws work with three; if two are missing, the tracker follows the ephemeris",
        "for each face in the alarm's text check the sensor, its cable, the multiplexer, anything that shades it, and"
        " whether cables are swapped; the face is used again after ten good checks, and if it stood still or"
        " contradicted the others, only once it follows the light",
    ),
    _kind(
        "face-unread",
        Severity.WARNING,
        "for ten scans one or more faces of the cube have given no reading (over-range, stale, missing, late) while"
        " others have",
        "the laws work with three faces; if two are missing, the tracker follows the ephemeris",
        "for each face in the alarm's text check sensor, plug and cable; ten scans with a reading end the alarm",
    ),
    _kind(
        "cube-sensor",
        Severity.WARNING,
        "a digital sensor reports a fault, is silent for the third time, or is not the one that is configured",
        "its face has no reading, or a doubtful one",
        "do what the alarm's text says; docs/instruments.md explains the flags; ten scans without the cause end the"
        " alarm",
    ),
    _kind(
        "no-readings",
        Severity.WARNING,
        "for 15 minutes of daylight the law has had no good readings",
        "the tracker follows the ephemeris, unless a person, a stow or a fault keeps it elsewhere",
        "check the cube, its process, the bridge and the network; the alarm's text says which",
    ),
    _kind(
        "clock",
        Severity.WARNING,
        "the time of day was set by a large step, or never synchronised",
        "after a step the sun's position is not used: the tracker points by the cube alone, or stays where it is, until"
        " the clock is synchronised or set back, or the service is restarted",
        "check the time synchronisation: `timedatectl`, the network, the NTP server; where there is none, set the time"
        " correctly and restart the service",
    ),
    _kind(
        "hold-forgotten",
        Severity.WARNING,
        "the sun has risen since somebody gave `hold`, `goto` or `snow`",
        "the tracker does not track",
        "`heliocube auto`, if it was forgotten",
    ),
    _kind(
        "release-changed",
        Severity.WARNING,
        "heliocube has another release than at the last start, or a tracker that was stopped, stowed, held or in doubt"
        " now has another name or no table; and no command of a person was in force",
        "the tracker is held where it stands; only a stow moves it",
        "run `heliocube self-check`, look at the tracker, then `heliocube auto`",
    ),
    _kind(
        "nothing-kept",
        Severity.WARNING,
        "the instruments are real, and your own program has named no folder (`heliocube run` always has one)",
        "a restart forgets stops, storms and doubts, and no records are kept",
        "set store.directory, then restart the service",
    ),
    _kind(
        "not-kept",
        Severity.WARNING,
        "a file of kept state cannot be written (the start of the service tries it)",
        "a restart would forget what the alarm's text names",
        "free space on the disk, or correct its permissions; writing is tried again every few seconds",
    ),
    _kind(
        "store-aside",
        Severity.WARNING,
        "the store could not be used (damaged, or written by a newer heliocube), and was moved aside",
        "the earlier records are in the file that was moved aside",
        "salvage them with `heliocube store salvage FILE --into FOLDER`, then move that file to another folder",
    ),
    _kind(
        "store-down",
        Severity.WARNING,
        "the store cannot write",
        "records wait in memory; if they become too many, the oldest are lost",
        "free space on the disk, or correct its permissions; the alarm ends with the first record that is written",
    ),
    _kind(
        "bridge-down",
        Severity.WARNING,
        "for a minute the address of `bridge.listen`, or the network of `bridge.multicast_group`, has not been on this"
        " machine, or another program has the port that the service waited for; ends when it has been there for a"
        " minute",
        "no scan of a cube elsewhere is heard: the tracker follows the ephemeris, unless the process has a cube of its"
        " own, or a person, a stow or a fault keeps it elsewhere",
        "compare the address with those of this machine (`ip address`): check its network, cable and DHCP, and the"
        " service listens there within 5 s; or correct bridge.listen or bridge.multicast_interface, then restart the"
        " service",
    ),
    _kind(
        "api-down",
        Severity.WARNING,
        "the address and port of `api.listen` cannot be used: another program has them, this one has no right to them,"
        " or this machine has no such address",
        "`heliocube stop` and all other commands, the dashboard, `/metrics` and `heliocube notify` cannot reach the"
        " service; the tracker and commands over MQTT and SunSpec are not affected",
        "end the program that has the port (`ss -ltnp` names it), or see why the address is not there (`ip address`):"
        " the service takes it within 10 s; or correct api.listen, then restart the service",
    ),
    _kind(
        "sunspec-down",
        Severity.WARNING,
        "the address and port of `sunspec.listen` cannot be used: another program has them, this one has no right to"
        " them, or this machine has no such address",
        "no control room reads or commands over SunSpec; the tracker and all other ways to it are not affected",
        "end the program that has the port (`ss -ltnp` names it), or see why the address is not there (`ip address`):"
        " the service takes it within 10 s; or correct sunspec.listen, then restart the service",
    ),
    _kind(
        "archive-behind",
        Severity.WARNING,
        "no archive has confirmed records for an hour",
        "records wait in the store, which deletes its oldest days in time; the tracker is not affected",
        "check the broker and the log of heliocube archive; before the store deletes a day that waits, copy its file"
        " and fill that into the archive later (docs/archive.md)",
    ),
    _kind(
        "archive-set-aside",
        Severity.WARNING,
        "the archive's database refuses some records: somebody has added a constraint or a trigger, or a column is too"
        " small",
        "these records are set aside in the database, with the reason, and all others go on; ends an hour after the"
        " last one",
        "look into heliocube.set_aside there, put the database right, then `heliocube archive retry` (docs/archive.md)",
        latched=True,
    ),
    _kind(
        "day-budget",
        Severity.NOTICE,
        "the laws have used three quarters of the solar day's travel, or all of it, or all moves; ends at midnight",
        "until then the tracker follows the sun by the clock; with nothing left it moves only to stow, for the night"
        " and on command",
        "nothing on a day with much change in the sky; if it happens often, raise motion.deadband_deg, or the day's"
        " limits",
    ),
)

KINDS: dict[str, AlarmKind] = {kind.name: kind for kind in _ALL}
"""Every kind by its name, the most severe first."""


def with_tracker_option(text: str, tracker: str | None) -> str:
    """Return a text with its commands as they are typed for one of several trackers; None for the only one.

    Every part that shows people a text of a tracker passes it through here: the part that makes the text knows of no
    other trackers.
    """
    return text if tracker is None else _COMMAND.sub(rf"\g<0> --tracker {tracker}", text)


def kind_of_alarm(name: str) -> AlarmKind:
    """Return the kind of a name; a name that a plug-in has made up is a warning that its text must explain."""
    found = KINDS.get(name)
    return found or _kind(name, Severity.WARNING, "as the alarm's text says", "unknown", "as the alarm's text says")
