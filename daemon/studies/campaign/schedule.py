"""What happens to a tracker in some hours, as plain data."""

import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Literal


@dataclass(frozen=True, slots=True)
class Happening:
    """One thing that happens.

    Attributes
    ----------
    at_s
        Seconds after the start; before 0 there is no service yet.
    what
        A fault of the rig, or a person's command.
    name
        Of the fault, as in `daemon.rigs.campaign.faults.FAULTS`, or of the command.
    value
        What goes with it: degrees of a goto, m/s of wind, volts of a sensor; empty for most.
    lasts_s
        How long a fault lasts; 0 for one that is over at once.
    """

    at_s: float
    what: Literal["fault", "command"]
    name: str
    value: tuple[float, ...] = ()
    lasts_s: float = 0.0

    def __str__(self) -> str:
        value = " ".join(f"{number:g}" for number in self.value)
        lasts = f" for {self.lasts_s:g} s" if self.lasts_s else ""
        return f"{self.at_s:9.2f} s  {self.what} {self.name} {value}{lasts}".rstrip()


@dataclass(frozen=True, slots=True)
class Schedule:
    """Everything that one run of the campaign depends on.

    Attributes
    ----------
    seed
        That it was drawn from.
    hours
        How long it is.
    start
        ISO 8601, UTC.
    law, rehome
        As in the settings.
    synchronous
        Whether the unit drives both axes at once.
    sky
        DNI and DHI [W/m2].
    events
        In the order of their time.
    """

    seed: int
    hours: float
    start: str
    law: str
    rehome: str
    synchronous: bool
    sky: tuple[float, float]
    events: tuple[Happening, ...]

    @property
    def begin(self) -> datetime:
        """The instant at 0 s."""
        return datetime.fromisoformat(self.start).replace(tzinfo=UTC)

    def text(self) -> str:
        """Return it for people: a line for each event."""
        head = (
            f"seed {self.seed}, {self.hours:g} h from {self.start}, law {self.law}, rehome {self.rehome},"
            f" {'both axes at once' if self.synchronous else 'one axis at a time'}, DNI/DHI {self.sky}"
        )
        return "\n".join([head, *map(str, self.events)])

    def json(self) -> str:
        """Return it for `from_json`."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Schedule":
        """Read what `json` has written; `ValueError` for anything else."""
        try:
            found = json.loads(text)
            events = [Happening(**{**event, "value": tuple(event["value"])}) for event in found.pop("events")]
            return cls(**{**found, "sky": tuple(found["sky"]), "events": tuple(events)})
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"this is not a schedule of the campaign: {error}") from error
