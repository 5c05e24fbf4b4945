"""The settings of the service: all sections together, consistent with each other."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any, NamedTuple, Self

from pydantic import Field, model_validator

from daemon.base.errors import UserError
from daemon.config.rules import conflicts
from daemon.config.sections import Sections
from daemon.config.trackers import TrackerTable, clashes, merge_tracker_table, values_of


class NamedSettings(NamedTuple):
    """A tracker's name and the settings that hold for it."""

    name: str
    settings: "Settings"


class Settings(Sections):
    """The whole file: the sections, and a table for each tracker that has a name of its own."""

    tracker: tuple[TrackerTable, ...] = Field((), strict=False)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        found = [f"{conflict.key} {conflict.reason}" for conflict in conflicts(self)]
        names = [table.name.lower() for table in self.tracker]
        found += [f"tracker[{name}] is there twice" for name in {name for name in names if names.count(name) > 1}]
        found += [
            f"tracker[{clash.tracker}].{clash.key} {clash.reason}"
            for clash in clashes(self.site.latitude_deg, self.trackers)
        ]
        if found:
            raise ValueError("; ".join(found))
        return self

    @property
    def real(self) -> bool:
        """Whether the settings ask for real instruments."""
        return self.instruments.kind == "real"

    @property
    def bench_clock(self) -> tuple[datetime, datetime] | None:
        """What a bench's clock shows, and the real time at which it shows that; None where the time is the machine's.

        Both keys may also stand in the file of a rig without a bench; its time is real all the same.
        """
        start, anchor = self.simulation.start_utc, self.simulation.anchor_utc
        return None if start is None or anchor is None or not self.instruments.bench else (start, anchor)

    @property
    def trackers(self) -> tuple[NamedSettings, ...]:
        """The trackers of this process, each with its own settings; what it keeps is in a folder of its own.

        Without tables there is one, named as in [mqtt], with the settings of the file as they are.
        """
        if not self.tracker:
            return (NamedSettings(self.mqtt.name or "tracker", self),)
        values = values_of(self)
        return tuple(NamedSettings(table.name, self._settings_of(table, values)) for table in self.tracker)

    def _settings_of(self, table: TrackerTable, values: Mapping[str, Any]) -> "Settings":
        # Two connections with one name keep disconnecting each other.
        client_id = None if self.mqtt.client_id is None else f"{self.mqtt.client_id}-{table.name}"
        directory = None if self.store.directory is None else self.store.directory / table.name
        own = {
            "mqtt": self.mqtt.model_copy(update={"name": table.name, "client_id": client_id}),
            "store": self.store.model_copy(update={"directory": directory}),
        }
        if not table.model_fields_set - {"name"}:
            # Hundreds of trackers may differ in a name only: to check the same values again takes milliseconds each.
            return self.model_copy(update={"tracker": (), **own})
        return Settings.model_validate(merge_tracker_table(values, table.model_dump())).model_copy(update=own)


def settings_of_tracker(settings: Settings, tracker: str | None) -> Settings:
    """Return the settings of one tracker, the only one where none is named, for a program that drives only one.

    Raises
    ------
    UserError
        There is no tracker of that name, or there are several and none is named.
    """
    own = dict(settings.trackers)
    names = ", ".join(own)
    if tracker is None and len(own) > 1:
        raise UserError(f"this is for one tracker and the configuration has {names}: choose one with --tracker NAME")
    if tracker is not None and tracker not in own:
        raise UserError(f"--tracker {ascii(tracker)[:40]}: there is no such tracker; the configuration has {names}")
    return own[tracker] if tracker is not None else next(iter(own.values()))
