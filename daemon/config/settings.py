"""The settings of the service: all sections together, consistent with each other."""

from typing import NamedTuple, Self

from pydantic import model_validator

from daemon.config.rules import conflicts
from daemon.config.sections import Sections


class NamedSettings(NamedTuple):
    """A tracker's name and the settings that hold for it."""

    name: str
    settings: "Settings"


class Settings(Sections):
    """The whole file."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        found = [f"{conflict.key} {conflict.reason}" for conflict in conflicts(self)]
        if found:
            raise ValueError("; ".join(found))
        return self

    @property
    def real(self) -> bool:
        """Whether the settings ask for real instruments."""
        return self.instruments.kind == "real"

    @property
    def trackers(self) -> tuple[NamedSettings, ...]:
        """The trackers of this process, each with its own settings."""
        return (NamedSettings(self.mqtt.name or "tracker", self),)
