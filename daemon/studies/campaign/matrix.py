"""Component x fault: what each cell is called in a schedule, or why a simulator cannot do it."""

import math
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from daemon.base import plugins
from daemon.base.errors import UserError
from daemon.studies.campaign.draw import COMMANDS, FAULT_SPANS, ROTATOR_FAULT_SPANS, draw_schedule, value_ranges
from daemon.studies.campaign.schedule import Schedule, ScheduledEvent
from daemon.studies.inputs import check_regular_file

if TYPE_CHECKING:
    from daemon.config.settings import Settings

COMPONENTS = (
    "sensor", "multiplexer", "meter-link", "positioner-link", "positioner", "broker", "udp", "clock", "disk", "process",
    "wind-sensor",
)  # fmt: skip
FAULT_KINDS = (
    "off", "stuck", "garbage", "wrong", "slow", "late", "dropped-reply", "partial-line", "unplug", "renamed-port",
    "reset", "over-range", "drift", "noise", "full-buffer", "step", "full", "killed",
)  # fmt: skip

_NO_BYTES = "it gives a voltage, and sends nothing"
_NO_MEASURE = "it measures nothing"
_ON_PTY = "in memory a line has no such state; what the bench can do of it, with real processes, is in docs/bench.md"
_NO_BROKER = "the campaign's service has no broker, and no motion depends on one; the tests with mosquitto do it"
_TIME_ONLY = "a clock has its time, and nothing else that could fail"
_FILES_ONLY = "what is lost of a file is what `disk:full` and `process:killed` lose"
_PROCESS_ONLY = "a process runs, stands still or dies"
_NO_REPLY = "it is not asked, so it has no reply"
_NO_CLOCK = "it has no clock that the service uses"

CELLS: dict[tuple[str, str], tuple[str, ...] | str] = {
    ("sensor", "off"): ("face_shaded", "face_stuck"),
    ("sensor", "stuck"): ("face_stuck",),
    ("sensor", "wrong"): ("switch_line_stuck",),
    ("sensor", "unplug"): ("face_stuck",),
    ("sensor", "over-range"): ("face_stuck",),
    ("sensor", "drift"): ("face_shaded",),
    ("sensor", "noise"): ("face_noise",),
    ("multiplexer", "off"): ("unplug_multiplexer",),
    ("multiplexer", "stuck"): ("switch_line_stuck",),
    ("multiplexer", "wrong"): ("switch_line_stuck",),
    ("multiplexer", "dropped-reply"): ("switch_fails",),
    ("multiplexer", "unplug"): ("unplug_multiplexer",),
    ("multiplexer", "reset"): ("switch_reset",),
    ("meter-link", "off"): ("unplug_voltmeter",),
    ("meter-link", "stuck"): ("meter_frozen",),
    ("meter-link", "garbage"): ("meter_garbled",),
    ("meter-link", "wrong"): ("meter_late",),
    ("meter-link", "slow"): ("meter_late",),
    ("meter-link", "late"): ("meter_late",),
    ("meter-link", "dropped-reply"): ("meter_mute",),
    ("meter-link", "partial-line"): ("meter_cut",),
    ("meter-link", "unplug"): ("unplug_voltmeter",),
    ("meter-link", "reset"): ("meter_restart",),
    ("meter-link", "over-range"): ("face_stuck",),
    ("meter-link", "noise"): ("face_noise",),
    ("positioner-link", "off"): ("unplug_positioner",),
    ("positioner-link", "stuck"): ("positioner_silent",),
    ("positioner-link", "dropped-reply"): ("deaf",),
    ("positioner-link", "unplug"): ("unplug_positioner", "gone"),
    ("positioner-link", "reset"): ("reset_position_kept", "reset_position_lost"),
    ("positioner", "off"): ("undervoltage",),
    ("positioner", "stuck"): ("a_ignores_targets", "b_ignores_targets", "a_cable", "b_cable", "stopless"),
    ("positioner", "wrong"): ("own_tracking", "slave_mode", "slave_standby", "re_reference", "unit_wind", "unit_snow"),
    ("positioner", "drift"): ("a_slip", "b_slip", "a_pulse_loss", "b_pulse_loss"),
    ("positioner", "over-range"): ("a_overcurrent", "b_overcurrent", "a_destination", "b_destination"),
    ("positioner", "dropped-reply"): ("a_hall_loss", "b_hall_loss"),
    ("positioner", "garbage"): ("a_switch_closed", "b_switch_closed", "a_switch_open", "b_switch_open"),
    ("positioner", "reset"): ("reset_position_kept", "reset_position_lost"),
    ("udp", "off"): ("bridge_lost",),
    ("udp", "wrong"): ("bridge_replayed",),
    ("udp", "garbage"): ("bridge_forged",),
    ("udp", "slow"): ("bridge_late",),
    ("udp", "late"): ("bridge_late",),
    ("udp", "dropped-reply"): ("bridge_lost",),
    ("udp", "unplug"): ("bridge_lost",),
    ("udp", "stuck"): ("bridge_replayed",),
    ("clock", "step"): ("clock_step",),
    ("disk", "full"): ("disk_full",),
    ("disk", "partial-line"): ("kill_torn",),
    ("process", "off"): ("end",),
    ("process", "stuck"): ("suspended", "machine_sleeps"),
    ("process", "killed"): ("kill", "kill_torn"),
    ("process", "reset"): ("kill", "end"),
    ("wind-sensor", "off"): ("wind_silent",),
    ("wind-sensor", "unplug"): ("wind_silent",),
    ("wind-sensor", "over-range"): ("wind",),
}
"""Names of the campaign's faults by component and kind of fault."""
_EVERY = {**FAULT_SPANS, **ROTATOR_FAULT_SPANS}

_WHY_NOT: dict[str, dict[str, str]] = {
    "sensor": dict.fromkeys(("garbage", "slow", "late", "dropped-reply", "partial-line", "reset"), _NO_BYTES),
    "multiplexer": {
        **dict.fromkeys(("garbage", "partial-line", "full-buffer"), "its driver is called, and there are no bytes"),
        **dict.fromkeys(("slow", "late"), "a call of its driver has no reply that could be late"),
        **dict.fromkeys(("over-range", "drift", "noise"), _NO_MEASURE),
    },
    "meter-link": {"full-buffer": _ON_PTY, "drift": "that is the sensor's, `sensor:drift`"},
    "positioner-link": {
        **dict.fromkeys(("garbage", "wrong", "slow", "late", "partial-line", "noise", "full-buffer"), _ON_PTY),
        **dict.fromkeys(("over-range", "drift"), "that is the positioner's own"),
    },
    "positioner": dict.fromkeys(
        ("slow", "late", "partial-line", "unplug", "renamed-port", "noise", "full-buffer"), "that is its link's"
    ),
    "udp": {
        "partial-line": "a datagram comes whole or not at all",
        "full-buffer": "the system drops what is too much, which is `udp:off`",
        "reset": "there is no connection that could be reset",
        **dict.fromkeys(("over-range", "drift", "noise"), "that is the sensor's"),
    },
    "wind-sensor": dict.fromkeys(FAULT_KINDS, "the campaign sets the wind by hand; MQTT has sensors of its own"),
    "broker": dict.fromkeys(FAULT_KINDS, _NO_BROKER),
    "clock": dict.fromkeys(FAULT_KINDS, _TIME_ONLY),
    "disk": dict.fromkeys(FAULT_KINDS, _FILES_ONLY),
    "process": dict.fromkeys(FAULT_KINDS, _PROCESS_ONLY),
}
_WHY_NEVER = {
    "renamed-port": _ON_PTY,
    "full-buffer": _NO_BYTES,
    "step": _NO_CLOCK,
    "full": "it keeps no files",
    "killed": "it is no process of ours",
    "drift": _NO_MEASURE,
}


def cell(component: str, kind: str) -> tuple[str, ...] | str:
    """Return the names of the campaign's faults in a cell, or the sentence why there are none."""
    done = CELLS.get((component, kind))
    return done or _WHY_NOT.get(component, {}).get(kind) or _WHY_NEVER.get(kind) or _NO_REPLY


def chosen_faults(words: Collection[str]) -> tuple[str, ...]:
    """Return the faults that words name: a fault, ``component``, or ``component:fault``.

    Raises `UserError` for a word that names none, and for a cell that no simulator can do.
    """
    chosen: list[str] = []
    for word in words:
        component, _, kind = word.partition(":")
        if word in _EVERY:
            chosen.append(word)
        elif component not in COMPONENTS or (kind and kind not in FAULT_KINDS):
            raise UserError(
                f"--only: there is no {word}; faults are {', '.join(_EVERY)}; components are {', '.join(COMPONENTS)};"
                f" and of a component, as in sensor:stuck, {', '.join(FAULT_KINDS)}"
            )
        elif kind:
            names = cell(component, kind)
            if isinstance(names, str):
                raise UserError(f"--only: {word} cannot be simulated: {names}")
            chosen += names
        else:
            mine = [names for (one, _), names in CELLS.items() if one == component and not isinstance(names, str)]
            if not mine:
                raise UserError(f"--only: {word} cannot be simulated: {cell(component, FAULT_KINDS[0])}")
            chosen += [name for names in mine for name in names]
    return tuple(dict.fromkeys(chosen))


def chosen_schedules(
    seeds: int,
    first: int,
    hours: float,
    only: Collection[str],
    without: Collection[str],
    file: Path | None,
    trackers: int = 1,
    positioner: Literal["pozsol", "rotctld"] = "pozsol",
) -> list[Schedule]:
    """Return the schedules that a person asks for.

    Parameters
    ----------
    seeds, first, hours
        How many seeds, the first one, and the hours of each.
    only, without
        `only`: names of faults, or of cells of the matrix. `without`: names of faults and commands.
    file
        A schedule that `reduce_schedule` has left, to be run in place of any drawn from seeds.
    trackers
        How many the service has.
    positioner
        Driver of their positioners.

    Raises
    ------
    UserError
        A name is not known, or cannot be done; the file cannot be read.
    """
    if file is not None:
        check_regular_file(file, "a schedule")
        try:
            schedule = Schedule.from_json(file.read_text(encoding="utf-8"))
        except OSError as error:
            raise UserError(f"--schedule: {file} cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise UserError(
                f"--schedule: {file} is no schedule of the campaign: {error}; name a seed-N.json as --keep writes it"
            ) from None
        if schedule.law not in plugins.names(plugins.LAWS):
            laws = ", ".join(plugins.names(plugins.LAWS))
            raise UserError(f"--schedule: {file} has a law '{schedule.law}'; choose from {laws}")
        from daemon.config.file import ConfigError  # noqa: PLC0415 - as for all that follow: the whole service
        from daemon.studies.campaign.command_channel import DirectCommandChannel  # noqa: PLC0415
        from daemon.studies.campaign.person import known_commands  # noqa: PLC0415

        try:
            settings_of(schedule)
        except ConfigError as error:
            raise UserError(f"--schedule: {file}: settings.{'; settings.'.join(error.problems)}") from None
        refuse_unknown(schedule, known_commands(DirectCommandChannel()))
        _refuse_values(file, schedule.events)
        return [schedule]
    unknown = sorted(set(without) - {*_EVERY, *COMMANDS})
    if unknown:
        raise UserError(f"--without: there is no fault or command {', '.join(unknown)}")
    for name in _EVERY.keys() & only:
        _refuse_impossible(name, positioner)
    faults = tuple(name for name in chosen_faults(only) or _EVERY if name in possible_faults(positioner))
    if not faults:
        raise UserError(f"--only: a rotator has nothing of {', '.join(only)}")
    return [draw_schedule(seed, hours, without, faults, trackers, positioner) for seed in range(first, first + seeds)]


def settings_of(schedule: Schedule, directory: Path | None = None) -> "Settings":
    """Return the settings of a schedule's service, which keeps its files in a directory; raises `ConfigError`."""
    from daemon.rigs.campaign.build import plant_settings  # noqa: PLC0415 - as below

    return plant_settings(
        law=schedule.law,
        rehome=schedule.rehome,
        positioner=schedule.positioner,
        trackers=schedule.trackers,
        chosen=schedule.settings,
        directory=directory,
    )


def refuse_unknown(schedule: Schedule, commands: Collection[str]) -> None:
    """Raise `UserError` for the first event that simulator or service does not know: to skip it would be a lie."""
    from daemon.rigs.campaign.faults import FAULTS  # noqa: PLC0415 - the whole service: a wrong name does not wait for it

    for event in schedule.events:
        if event.tracker is not None and event.tracker >= schedule.trackers:
            raise UserError(f"{event.name} is for tracker {event.tracker}, and there are {schedule.trackers}, from 0")
        if event.what == "command" and event.name not in commands:
            raise UserError(f"the service has no command '{event.name}'; leave it out with --without {event.name}")
        if event.what == "fault" and event.name not in FAULTS:
            raise UserError(f"the campaign has no fault '{event.name}'; it has {', '.join(FAULTS)}")
        if event.what == "fault":
            _refuse_impossible(event.name, schedule.positioner)


def possible_faults(positioner: Literal["pozsol", "rotctld"]) -> Collection[str]:
    """Return the faults that the campaign can cause with a positioner of this driver."""
    if positioner == "pozsol":
        return FAULT_SPANS
    from daemon.rigs.campaign.faults import ROTATOR_PLANT_FAULTS  # noqa: PLC0415 - the whole service

    return ROTATOR_PLANT_FAULTS


def _refuse_impossible(name: str, positioner: Literal["pozsol", "rotctld"]) -> None:
    known = possible_faults(positioner)
    if name not in known:
        if name in ROTATOR_FAULT_SPANS:
            raise UserError(f"{name} cannot be simulated: only a rotator has it; give --positioner rotctld as well")
        raise UserError(f"{name} cannot be simulated: a rotator behind rotctld has only {', '.join(sorted(known))}")


def _refuse_values(file: Path, events: Iterable[ScheduledEvent]) -> None:
    """Raise `UserError` for the first event out of order, or with numbers that its command or fault does not take."""
    before_s = -math.inf
    for event in events:
        if event.at_s < before_s:
            raise UserError(
                f"--schedule: {file}: {event.name} at {event.at_s:g} s stands behind what happens at {before_s:g} s:"
                " put the events in the order of their times"
            )
        before_s = event.at_s
        ranges = value_ranges(event.name)
        takes = ", ".join(f"{low:g}..{high:g}" for low, high in ranges) or "nothing"
        good = len(event.value) == len(ranges)
        if good and event.what == "fault":
            good = all(low <= number <= high for number, (low, high) in zip(event.value, ranges, strict=True))
        if not good:
            raise UserError(f"--schedule: {file}: the value of {event.name} at {event.at_s:g} s must be {takes}")
