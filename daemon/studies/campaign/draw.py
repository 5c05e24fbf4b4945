"""Schedules drawn from seeds.

A schedule is made of episodes. An episode often sets the tracker right first, and often begins a far move. Then one to
three things happen at nearly the same time: a fault of a component, a person's command, or a wrong command.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from random import Random
from typing import Literal

from daemon.studies.campaign.drawn_settings import draw_settings
from daemon.studies.campaign.schedule import MOST_TRACKERS, Schedule, ScheduledEvent

Span = tuple[float, float | None, float | None]

FAULT_SPANS: dict[str, Span] = {
    "unplug_positioner": (10, 0.05, 600),
    "unplug_multiplexer": (2, 0.1, 600),
    "unplug_voltmeter": (2, 0.1, 600),
    "deaf": (6, 0.3, 200),
    "undervoltage": (6, 0.3, 300),
    "own_tracking": (6, 0.5, 900),
    "slave_mode": (2, 1, 600),
    "re_reference": (4, None, None),
    "slave_standby": (1, 1, 600),
    "button": (3, 0.4, 60),
    "button_in": (2, 0.4, 60),
    "buttons_both": (1, 0.4, 10),
    "a_hall_loss": (3, 0.3, 300),
    "b_hall_loss": (3, 0.3, 300),
    "a_overcurrent": (3, None, None),
    "b_overcurrent": (3, None, None),
    "a_pulse_loss": (1, None, None),
    "b_pulse_loss": (1, None, None),
    "a_destination": (1, None, None),
    "b_destination": (1, None, None),
    "a_slip": (1, None, None),
    "b_slip": (1, None, None),
    "a_ignores_targets": (2, 0.3, 300),
    "b_ignores_targets": (2, 0.3, 300),
    "a_cable": (1, 1, 300),
    "b_cable": (1, 1, 300),
    "a_switch_closed": (2, 10, 1500),
    "b_switch_closed": (2, 10, 1500),
    "a_switch_open": (2, 10, 1500),
    "b_switch_open": (2, 10, 1500),
    "reset_position_kept": (4, None, None),
    "reset_position_lost": (4, None, None),
    "unit_wind": (2, 5, 300),
    "unit_snow": (1, 15, 300),
    "wind": (6, 1, 600),
    "wind_silent": (2, 10, 900),
    "clock_step": (4, 30, 3000),
    "face_stuck": (3, 10, 900),
    "face_shaded": (2, 10, 900),
    "meter_frozen": (2, 10, 900),
    "meter_garbled": (2, None, None),
    "meter_mute": (2, None, None),
    "meter_late": (2, 5, 120),
    "meter_restart": (1, None, None),
    "switch_fails": (2, None, None),
    "switch_reset": (1, None, None),
    "switch_line_stuck": (2, 10, 900),
    "kill": (5, 0.2, 60),
    "kill_torn": (1, 0.2, 60),
    "suspended": (2, None, None),
    "machine_sleeps": (3, None, None),
    "end": (3, 0.2, 60),
    "positioner_silent": (3, 0.3, 300),
    "face_noise": (2, 10, 900),
    "meter_cut": (2, None, None),
    "bridge_lost": (2, 10, 900),
    "bridge_late": (2, 10, 900),
    "bridge_replayed": (1, 10, 900),
    "bridge_forged": (2, None, None),
    "disk_full": (3, 1, 900),
}
"""Weight, shortest and longest time [s] of each fault, drawn evenly over its logarithm; None: over at once."""
ROTATOR_FAULT_SPANS: dict[str, Span] = {"gone": (6, 0.3, 600), "stopless": (3, 10, 3000)}
"""The same for faults that only a rotator behind rotctld can have."""
COMMANDS: dict[str, float] = {
    "stop": 14, "stow": 6, "hold": 5, "goto": 8, "auto": 9, "home": 5, "clear": 6, "snow": 3, "maintenance": 3, "bad": 3
}  # fmt: skip
"""Weight of each command; ``bad`` is a goto with wrong degrees."""
_FACES = (0, 1, 2, 3)
# How many files a service keeps for a tracker. The number drawn for `kill_torn` wraps round where there are fewer.
_FILES_OF_A_TRACKER = 12
_VALUES: dict[str, tuple[tuple[float, ...], ...]] = {
    "clock_step": ((-43200.0, -3600.0, -40.0, 3.0, 40.0, 3600.0, 43200.0),),
    "face_stuck": (_FACES, (0.0, 0.03, 0.4, 9.9)),
    "face_shaded": (_FACES, (0.0, 0.2, 0.9)),
    "face_noise": ((0.0005, 0.01, 1.0),),
    "switch_line_stuck": ((0, 1, 2), (0, 1)),
    "meter_garbled": ((1, 2, 8),),
    "meter_cut": ((1, 2, 8),),
    "meter_mute": ((1, 2, 8),),
    "meter_late": ((0.5, 2.5, 6.0),),
    "switch_fails": ((1, 2, 8),),
    "kill_torn": (tuple(range(_FILES_OF_A_TRACKER * MOST_TRACKERS)), (0, 1, 20)),
    "suspended": ((0.5, 3.0, 12.0, 60.0),),
    "machine_sleeps": ((3.0, 20.0, 90.0, 900.0, 7000.0, 27000.0),),
    "bridge_late": ((1.0, 8.0, 40.0),),
    "bridge_forged": ((1, 30, 300),),
}
"""The numbers that go with a fault, each drawn from its choices."""
_WIND_M_S = (15.1, 30.0)
_BAD = ((math.nan, 60.0), (0.0, math.nan), (51.0, 60.0), (-50.0001, 60.0), (0.0, 14.99), (math.inf, 90.0))
_PAUSES_S = (150.0, 150.0, 600.0, 2400.0)
"""Mean pauses between episodes: from a rig that never has a rest to one that is left alone for most of an hour."""
_LEFT_AT_END_S = 300.0
_SHARE_TO_ALL = 0.25
_SHARE_RELEASES_TO_ALL = 0.6


def draw_schedule(
    seed: int,
    hours: float,
    without: Collection[str] = (),
    only: Collection[str] = (),
    trackers: int = 1,
    positioner: Literal["pozsol", "rotctld"] = "pozsol",
) -> Schedule:
    """Return the schedule of a seed.

    Parameters
    ----------
    seed
        The same seed, hours and names give the same schedule.
    hours
        How long it is.
    without
        Faults and commands that are left out.
    only
        The only faults to draw; empty for all. It leaves commands as they are.
    trackers
        How many the service has. The same things happen at the same times as with one, each to one of them or to all.
    positioner
        Driver of their positioners.
    """
    random = Random(seed)  # noqa: S311 - reproducibility is the point; nothing secret depends on it
    every = {**FAULT_SPANS, **ROTATOR_FAULT_SPANS} if positioner == "rotctld" else FAULT_SPANS
    spans = {name: span for name, span in every.items() if name not in without and (not only or name in only)}
    commands = {name: weight for name, weight in COMMANDS.items() if name not in without}
    pause_s = random.choice(_PAUSES_S)
    events: list[ScheduledEvent] = []
    now_s = 60.0 + random.uniform(0, 120)
    while now_s < hours * 3600 - _LEFT_AT_END_S:
        now_s = _episode(random, now_s, events, spans, commands) + random.expovariate(1 / pause_s)
    start = f"2022-{random.choice(('10-12', '06-21', '12-21'))}T{random.choice((5, 8, 10, 11, 12, 14, 16)):02d}:00"
    law = random.choice(("mu-prime", "mu-prime", "sun-vector", "chronometric", "optimal"))
    return Schedule(
        seed=seed,
        hours=hours,
        start=start,
        law=law,
        rehome=random.choice(("operator", "operator", "automatic")),
        synchronous=random.random() < 0.2,
        sky=random.choice(((700.0, 90.0), (700.0, 90.0), (0.0, 150.0), (300.0, 200.0))),
        events=_assign_trackers(
            trackers, seed, sorted((event for event in events if event.at_s < hours * 3600), key=_at_s)
        ),
        trackers=trackers,
        positioner=positioner,
        settings=draw_settings(seed, law, positioner),
    )


def _assign_trackers(trackers: int, seed: int, events: Sequence[ScheduledEvent]) -> tuple[ScheduledEvent, ...]:
    """Return the events, each of one tracker or of all."""
    if trackers == 1:
        return tuple(events)
    from daemon.rigs.campaign.faults import FAULTS  # noqa: PLC0415 - the whole service: one tracker does not wait for it

    random = Random(f"{seed} of {trackers}")  # noqa: S311 - as above
    shared = {name for name, fault in FAULTS.items() if fault.is_shared}
    return tuple(replace(event, tracker=_tracker(random, trackers, event, shared)) for event in events)


def _tracker(random: Random, trackers: int, event: ScheduledEvent, shared: Collection[str]) -> int | None:
    if event.what == "fault" and event.name in shared:
        return 0
    to_all = _SHARE_RELEASES_TO_ALL if event.name in ("auto", "clear") else _SHARE_TO_ALL
    return None if random.random() < to_all else random.randrange(trackers)


def value_ranges(name: str) -> tuple[tuple[float, float], ...]:
    """Return the lowest and highest of each number that goes with a fault or a command.

    A command may have numbers beyond these: the service has to refuse them.
    """
    if name in ("goto", "bad"):
        return (-50.0, 50.0), (15.0, 90.0)
    if name == "wind":
        return (_WIND_M_S,)
    return tuple((min(choices), max(choices)) for choices in _VALUES.get(name, ()))


def _at_s(event: ScheduledEvent) -> float:
    return event.at_s


def _episode(
    random: Random,
    now_s: float,
    events: list[ScheduledEvent],
    spans: Mapping[str, Span],
    commands: Mapping[str, float],
) -> float:
    """Add one episode and return when the next may begin."""
    if random.random() < 0.7:
        events.append(ScheduledEvent(round(now_s, 2), "command", "auto"))
        events.append(ScheduledEvent(round(now_s + 3, 2), "command", "clear"))
        now_s += 12
        if random.random() < 0.25:
            events.append(ScheduledEvent(round(now_s, 2), "command", "home"))
            now_s += random.choice((20.0, 150.0, 400.0))
    if random.random() < 0.5 and "goto" in commands:
        events.append(_command(random, round(now_s, 2), "goto"))
        now_s += random.uniform(0, 25)
    for _ in range(random.choice((1, 1, 2, 2, 3))):
        at_s = round(now_s + random.choice((0.0, random.uniform(0, 1), random.uniform(0, 8))), 2)
        if spans and random.random() < 0.55:
            events.append(_fault(random, at_s, _pick(random, {name: span[0] for name, span in spans.items()}), spans))
        elif commands:
            events.append(_command(random, at_s, _pick(random, commands)))
    return now_s + 10


def _pick(random: Random, weights: Mapping[str, float]) -> str:
    return random.choices(tuple(weights), tuple(weights.values()))[0]


def _command(random: Random, at_s: float, name: str) -> ScheduledEvent:
    if name == "goto":
        a_deg = random.choice((-50.0, 50.0, round(random.uniform(-50, 50), 2)))
        b_deg = random.choice((15.0, 90.0, round(random.uniform(15, 90), 2)))
        return ScheduledEvent(at_s, "command", name, (a_deg, b_deg))
    return ScheduledEvent(at_s, "command", name, random.choice(_BAD) if name == "bad" else ())


def _fault(random: Random, at_s: float, name: str, spans: Mapping[str, Span]) -> ScheduledEvent:
    _, shortest_s, longest_s = spans[name]
    lasts_s = 0.0
    if shortest_s is not None and longest_s is not None:
        lasts_s = round(math.exp(random.uniform(math.log(shortest_s), math.log(longest_s))), 2)
    choices = _VALUES.get(name)
    value = () if choices is None else tuple(random.choice(one) for one in choices)
    if name == "wind":
        value = (round(random.uniform(*_WIND_M_S), 1),)
    return ScheduledEvent(at_s=at_s, what="fault", name=name, value=value, lasts_s=lasts_s)
