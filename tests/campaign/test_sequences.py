"""A person's stop in every phase of the tracker's life, and every other command after it, through every door."""

from random import Random

import pytest

from daemon.base.records import Mode
from daemon.studies.campaign.person import known_commands
from daemon.studies.campaign.run import run_schedule
from daemon.studies.campaign.schedule import Schedule, ScheduledEvent
from tests.campaign.doors import DOORS

BEGUN_S = 150.0
FAR = (-45.0, 30.0)


def fault(at_s, name, lasts_s=0.0, *value):
    return ScheduledEvent(at_s, "fault", name, value, lasts_s)


def command(at_s, name, *value):
    return ScheduledEvent(at_s, "command", name, value)


FAR_MOVE = (command(BEGUN_S, "goto", *FAR),)
UNDER_WAY = (command(BEGUN_S - 10, "goto", *FAR),)
PHASES = {
    # What happened before, and how long after BEGUN_S the stop is given.
    "before the first connection": ((fault(-1, "unplug_positioner", 200.0),), (0.0,)),
    "at the first connection": ((fault(-1, "unplug_positioner", BEGUN_S + 1),), (0.0, 0.1, 1.0, 3.0, 6.0)),
    "at rest": ((), (0.0,)),
    "as a target is being sent": (FAR_MOVE, (0.0, 0.01, 0.03, 0.05, 0.07, 0.09, 0.12, 0.2, 0.5)),
    "in mid-move": (UNDER_WAY, (0.0, 7.3)),
    "between the axes": (UNDER_WAY, (35.0, 38.0, 38.5, 39.0, 40.0)),
    "as homing begins": ((command(BEGUN_S, "home"),), (0.0, 0.02, 0.05, 0.1, 0.3, 1.0)),
    "while homing": ((command(BEGUN_S - 20, "home"),), (0.0, 50.0, 100.0)),
    "as faults are cleared": ((command(BEGUN_S, "clear"),), (0.0, 0.01, 0.05, 0.1, 0.5)),
    "in a clear that is followed by a link loss": (
        (*UNDER_WAY, command(BEGUN_S, "clear"), fault(BEGUN_S + 0.05, "unplug_positioner", 5.0)),
        (0.0, 0.04, 0.1, 3.0),
    ),
    "unplugged": ((*UNDER_WAY, fault(BEGUN_S, "unplug_positioner", 20.0)), (0.0, 10.0)),
    "reconnecting": (
        (*UNDER_WAY, fault(BEGUN_S - 5, "unplug_positioner", 5.0)),
        (0.0, 0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 8.0),
    ),
    "deaf": ((*UNDER_WAY, fault(BEGUN_S - 1, "deaf", 30.0)), (0.0, 10.0, 28.9)),
    "as its own tracking begins": (
        (fault(BEGUN_S, "own_tracking", 300.0),),
        (0.0, 0.1, 1.0, 5.0),
    ),
    "in its own reference run": ((fault(BEGUN_S, "re_reference"),), (0.0, 1.0, 5.0)),
    "stowing for the wind": ((fault(BEGUN_S - 20, "wind", 400.0, 20.0),), (0.0, 10.0)),
    "without supply": ((*UNDER_WAY, fault(BEGUN_S - 1, "undervoltage", 20.0)), (0.0, 18.9, 19.1)),
    "as the unit restarts": ((*UNDER_WAY, fault(BEGUN_S - 1, "reset_position_kept")), (0.0, 1.0, 2.0)),
    "before the process is killed": ((*UNDER_WAY, fault(BEGUN_S + 0.3, "kill", 5.0)), (0.0, 0.28)),
    "as a killed process comes back": ((*UNDER_WAY, fault(BEGUN_S - 5, "kill", 5.0)), (0.01, 0.1, 1.0)),
    "under maintenance": ((command(BEGUN_S - 10, "maintenance"),), (0.0,)),
}
CASES = [
    (phase, after_s, door)
    for phase, (_, times) in PHASES.items()
    for number, after_s in enumerate(times)
    for door in (DOORS if number == 0 else ("direct",))
]
AFTERWARDS = (
    ("goto", 20.0, 40.0), ("stow",), ("hold",), ("home",), ("clear",), ("snow",), ("maintenance",), ("goto", 0.0, 90.0)
)  # fmt: skip


def schedule(phase, after_s, commands, *, rehome="automatic"):
    """Return a stop in a phase, and all other commands after it, each when the one before has been answered."""
    stop_s = BEGUN_S + after_s
    events = [*PHASES[phase][0], command(stop_s, "stop")]
    later = [name for name in AFTERWARDS if name[0] in commands]
    events += [command(stop_s + 30 + 20 * number, *name) for number, name in enumerate(later)]
    events.sort(key=lambda event: event.at_s)
    hours = (stop_s + 30 + 20 * len(later) + 120) / 3600
    return Schedule(0, hours, "2022-10-12T10:00", "mu-prime", rehome, False, (700.0, 90.0), tuple(events))


@pytest.mark.parametrize(("phase", "after_s", "door"), CASES)
def test_a_stop_given_in_any_phase_stays_in_force_against_every_other_command(phase, after_s, door):
    chosen = schedule(phase, after_s, known_commands(DOORS[door]))
    outcome = run_schedule(chosen, DOORS[door], heal=False)
    assert not outcome.violations, "\n".join([*map(str, outcome.violations), chosen.text()])


@pytest.mark.parametrize("name", ["goto", "stow", "hold", "home", "clear", "snow", "maintenance"])
def test_every_command_can_be_given_directly_over_http_and_over_mqtt(name):
    assert [door for door, way in DOORS.items() if not way.has(name)] == []


class AnyDoor:
    """Gives each command through a door that is drawn at random."""

    def __init__(self, random):
        self._random = random

    def has(self, name):
        return all(door.has(name) for door in DOORS.values())

    async def give(self, *command):
        return await self._random.choice(list(DOORS.values())).give(*command)


@pytest.mark.parametrize("seed", range(4))
def test_the_last_of_stop_and_auto_wins_over_any_mix_of_interfaces_and_across_a_kill(seed):
    random, at_s, events = Random(seed), BEGUN_S, list(UNDER_WAY)
    for killed in (False, True):
        for _ in range(5):
            at_s += random.choice((0.02, 0.1, 0.3, 1.0, 4.0))
            events.append(command(at_s, random.choice(("stop", "auto"))))
        if not killed:
            # The kill may come while the last command is still being carried out.
            at_s += random.choice((0.01, 0.3, 2.0))
            events.append(fault(at_s, "kill", 3.0))
            at_s += 8.0
    chosen = Schedule(
        0, (at_s + 120) / 3600, "2022-10-12T10:00", "mu-prime", "operator", False, (700.0, 90.0), tuple(events)
    )
    outcome = run_schedule(chosen, AnyDoor(random), heal=False)
    assert not outcome.violations, "\n".join([*map(str, outcome.violations), chosen.text()])
    last = {"stop": Mode.HOLD, "auto": Mode.TRACKING}[events[-1].name]
    assert outcome.entered_modes[-1][1] is last, chosen.text()
