"""What happens to a tracker in a few hours: faults and commands, drawn from a seed, as plain data.

A schedule is made of episodes. Something is set right first or not, a far move is often begun, and into that fall one
to three things at nearly the same time: a fault of a component, a person's command, or a wrong one.
"""

import json
import math
from dataclasses import asdict, dataclass
from random import Random


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happens.

    Attributes
    ----------
    at_s
        Seconds after the start.
    what
        ``fault`` or ``command``.
    name
        Of the fault, as in `tests.campaign.faults.FAULTS`, or of the command.
    value
        What goes with it: degrees of a goto, m/s of wind, volts of a sensor; empty for most.
    lasts_s
        How long a fault lasts; 0 for one that is over at once.
    """

    at_s: float
    what: str
    name: str
    value: tuple[float, ...] = ()
    lasts_s: float = 0.0

    def __str__(self):
        value = " ".join(f"{number:g}" for number in self.value)
        lasts = f" for {self.lasts_s:g} s" if self.lasts_s else ""
        return f"{self.at_s:9.2f} s  {self.what} {self.name} {value}{lasts}".rstrip()


@dataclass(frozen=True, slots=True)
class Schedule:
    """Everything that one run of the campaign depends on."""

    seed: int
    hours: float
    start: str
    law: str
    rehome: str
    synchronous: bool
    sky: tuple[float, float]
    events: tuple[Event, ...]

    def text(self):
        """Return it for people: a line for each event."""
        head = (
            f"seed {self.seed}, {self.hours:g} h from {self.start}, law {self.law}, rehome {self.rehome},"
            f" {'both axes at once' if self.synchronous else 'one axis at a time'}, DNI/DHI {self.sky}"
        )
        return "\n".join([head, *map(str, self.events)])

    def json(self):
        return json.dumps(asdict(self))

    @classmethod
    def of_json(cls, text):
        found = json.loads(text)
        events = [Event(**{**event, "value": tuple(event["value"])}) for event in found.pop("events")]
        return cls(**{**found, "sky": tuple(found["sky"]), "events": tuple(events)})


# Weight, shortest and longest time of each fault; drawn evenly over the logarithm. None: over at once.
_SPAN = {
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
    "end": (3, 0.2, 60),
}
_COMMANDS = {
    "stop": 14, "stow": 6, "hold": 5, "goto": 8, "auto": 9, "home": 5, "clear": 6, "snow": 3, "maintenance": 3, "bad": 3
}  # fmt: skip
_STEPS_S = (-43200.0, -3600.0, -40.0, 3.0, 40.0, 3600.0, 43200.0)
_BAD = ((math.nan, 60.0), (0.0, math.nan), (51.0, 60.0), (-50.0001, 60.0), (0.0, 14.99), (math.inf, 90.0))


def draw(seed, hours, without=()):
    """Return the schedule of a seed; `without` names faults and commands that are left out."""
    random = Random(seed)
    spans = {name: span for name, span in _SPAN.items() if name not in without}
    commands = {name: weight for name, weight in _COMMANDS.items() if name not in without}
    events, now_s = [], 60.0 + random.uniform(0, 120)
    while now_s < hours * 3600 - 300:
        now_s = _episode(random, now_s, events, spans, commands)
    return Schedule(
        seed,
        hours,
        f"2022-{random.choice(('10-12', '06-21', '12-21'))}T{random.choice((5, 8, 10, 11, 12, 14, 16)):02d}:00",
        random.choice(("mu-prime", "mu-prime", "sun-vector", "chronometric", "optimal")),
        random.choice(("operator", "operator", "automatic")),
        random.random() < 0.2,
        random.choice(((700.0, 90.0), (700.0, 90.0), (0.0, 150.0), (300.0, 200.0))),
        tuple(sorted((event for event in events if event.at_s < hours * 3600), key=lambda event: event.at_s)),
    )


def _episode(random, now_s, events, spans, commands):
    """Add one episode and return when the next may begin."""
    if random.random() < 0.7:
        events.append(Event(round(now_s, 2), "command", "auto"))
        events.append(Event(round(now_s + 3, 2), "command", "clear"))
        now_s += 12
        if random.random() < 0.25:
            events.append(Event(round(now_s, 2), "command", "home"))
            now_s += random.choice((20.0, 150.0, 400.0))
    if random.random() < 0.5 and "goto" in commands:
        events.append(_command(random, round(now_s, 2), "goto"))
        now_s += random.uniform(0, 25)
    for _ in range(random.choice((1, 1, 2, 2, 3))):
        at_s = round(now_s + random.choice((0.0, random.uniform(0, 1), random.uniform(0, 8))), 2)
        if random.random() < 0.55:
            events.append(_fault(random, at_s, _pick(random, {name: span[0] for name, span in spans.items()}), spans))
        else:
            events.append(_command(random, at_s, _pick(random, commands)))
    return now_s + 10 + random.expovariate(1 / 150)


def _pick(random, weights):
    return random.choices(tuple(weights), tuple(weights.values()))[0]


def _command(random, at_s, name):
    if name == "goto":
        a_deg = random.choice((-50.0, 50.0, round(random.uniform(-50, 50), 2)))
        return Event(at_s, "command", name, (a_deg, random.choice((15.0, 90.0, round(random.uniform(15, 90), 2)))))
    return Event(at_s, "command", name, random.choice(_BAD) if name == "bad" else ())


def _fault(random, at_s, name, spans):
    _, shortest_s, longest_s = spans[name]
    lasts_s = 0.0
    if shortest_s is not None:
        lasts_s = round(math.exp(random.uniform(math.log(shortest_s), math.log(longest_s))), 2)
    value = ()
    if name == "wind":
        value = (round(random.uniform(15.1, 30), 1),)
    elif name == "clock_step":
        value = (random.choice(_STEPS_S),)
    elif name == "face_stuck":
        value = (random.randrange(4), random.choice((0.0, 0.03, 0.4, 9.9)))
    elif name == "face_shaded":
        value = (random.randrange(4), random.choice((0.0, 0.2)))
    elif name == "switch_line_stuck":
        value = (random.randrange(3), random.randrange(2))
    elif name in ("meter_garbled", "meter_mute", "switch_fails"):
        value = (random.choice((1, 2, 8)),)
    elif name == "kill_torn":
        value = (random.randrange(8), random.choice((0, 1, 20)))
    elif name == "suspended":
        value = (random.choice((0.5, 3.0, 12.0, 60.0)),)
    elif name == "meter_late":
        value = (random.choice((0.5, 2.5, 6.0)),)
    return Event(at_s, "fault", name, value, lasts_s)
