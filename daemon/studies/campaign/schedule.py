"""What happens to a tracker in some hours, as plain data."""

import json
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, ConfigDict, Field, JsonValue, TypeAdapter, ValidationError

from daemon.config.rules import END_OF_STARTS, FIRST_START

_STRICT_CONFIG = ConfigDict(extra="forbid", strict=True)
MOST_TRACKERS = 10
_Place = Annotated[int, Field(ge=0, lt=MOST_TRACKERS)]
_YEAR_S = 31_536_000.0
_Instant = Annotated[float, Field(ge=-_YEAR_S, le=_YEAR_S, allow_inf_nan=False)]
_Length = Annotated[float, Field(ge=0, le=_YEAR_S, allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Section = Literal["site", "cube", "windows", "limits", "motion", "safety", "law", "positioner"]
SettingsOverrides = dict[_Section, dict[str, JsonValue]]
"""Settings that are not the defaults, by section and key; ``positioner`` stands for ``instruments.positioner``."""


def _check_start(text: str) -> str:
    found = datetime.fromisoformat(text)
    # The same range as in every simulation: the bridge takes scans of other years for forged.
    if found.tzinfo is not None or not FIRST_START <= found.replace(tzinfo=UTC) < END_OF_STARTS:
        raise ValueError(text)
    return text


@dataclass(frozen=True, slots=True)
class ScheduledEvent:
    """One thing that happens.

    Attributes
    ----------
    at_s
        Seconds after the start; before 0 there is no service yet.
    what
        A fault of the rig, or a person's command.
    name
        Name of the fault, as in `daemon.rigs.campaign.faults.FAULTS`, or of the command.
    value
        What goes with it: degrees of a goto, m/s of wind, volts of a sensor; empty for most. That of a wrong command
        may be NaN.
    lasts_s
        How long a fault lasts; 0 for one that is over at once.
    tracker
        To which of several it happens, from 0; None: to all at once. A fault of something that they share ignores it.
    """

    __pydantic_config__: ClassVar = _STRICT_CONFIG

    at_s: _Instant
    what: Literal["fault", "command"]
    name: str
    value: tuple[float, ...] = ()
    lasts_s: _Length = 0.0
    tracker: _Place | None = 0

    def __str__(self) -> str:
        value = " ".join(f"{number:g}" for number in self.value)
        lasts = f" for {self.lasts_s:g} s" if self.lasts_s else ""
        tracker = "" if self.tracker == 0 else f" of {'all' if self.tracker is None else f't{self.tracker}'}"
        return f"{self.at_s:9.2f} s  {self.what} {self.name} {value}{lasts}".rstrip() + tracker


@dataclass(frozen=True, slots=True)
class Schedule:
    """Everything that one run of the campaign depends on.

    Attributes
    ----------
    seed
        The seed that it was drawn from.
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
    trackers
        How many the service has.
    positioner
        Driver of their positioners.
    settings
        Those that are not the defaults, by section and key.
    """

    __pydantic_config__: ClassVar = _STRICT_CONFIG

    seed: int
    hours: Annotated[float, Field(gt=0, le=8760)]
    start: Annotated[str, AfterValidator(_check_start)]
    law: str
    rehome: Literal["operator", "automatic"]
    synchronous: bool
    sky: tuple[_NotNegative, _NotNegative]
    events: tuple[ScheduledEvent, ...]
    trackers: Annotated[int, Field(ge=1, le=MOST_TRACKERS)] = 1
    positioner: Literal["pozsol", "rotctld"] = "pozsol"
    settings: SettingsOverrides = field(default_factory=dict)

    @property
    def begin(self) -> datetime:
        """The instant at 0 s."""
        return datetime.fromisoformat(self.start).replace(tzinfo=UTC)

    def text(self) -> str:
        """Return the schedule for people: a line for each event."""
        of_several = f" {self.trackers} trackers," if self.trackers > 1 else ""
        of_several += " behind rotctld," if self.positioner == "rotctld" else ""
        head = (
            f"seed {self.seed}, {self.hours:g} h from {self.start}, law {self.law}, rehome {self.rehome},"
            f"{of_several} {'both axes at once' if self.synchronous else 'one axis at a time'}, DNI/DHI {self.sky}"
        )
        for section, values in self.settings.items():
            head += f", {section} {', '.join(f'{name} {value}' for name, value in values.items())}"
        return "\n".join([head, *map(str, self.events)])

    def json(self) -> str:
        """Return the schedule as text for `from_json`."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Schedule":
        """Read what `json` has written; `ValueError`, with the place, for anything else."""
        try:
            return _SCHEDULE.validate_json(text)
        except ValidationError as error:
            wrong = error.errors(include_url=False)[0]
        if not wrong["loc"]:
            raise ValueError("it is not one object in JSON")
        place = ".".join(str(part) for part in wrong["loc"])
        if wrong["type"] == "missing":
            raise ValueError(f"it has no {place}")
        if wrong["type"] == "unexpected_keyword_argument":
            raise ValueError(f"it may not have {place}"[:200])
        raise ValueError(f"its {place} cannot be {wrong['input']!r}"[:200])


_SCHEDULE = TypeAdapter(Schedule)
