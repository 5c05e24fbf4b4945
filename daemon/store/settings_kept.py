"""The configuration of the last start: values that have changed since are published as events, and so recorded."""

import json
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from daemon.base.clock import Clock
from daemon.base.records import Event
from daemon.base.state import StateFile, StateFolder, UnreadableStateError

log = logging.getLogger("heliocube.store")

FILE_NAME = "configuration.json"
CUBE_FILE_NAME = "cube-configuration.json"
SUBJECT = "configuration"

_MOST = 40
_LONGEST = 120


class SettingsKept(BaseModel):
    """The values of a configuration as JSON, by their dotted keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    values: dict[str, str]


def publish_changes(
    settings: Mapping[str, Any],
    directory: Path,
    clock: Clock,
    publish: Callable[[Event], None],
    name: str = FILE_NAME,
) -> None:
    """Publish an event for each key whose value has changed since the last start, and keep the present values.

    Parameters
    ----------
    settings
        The whole configuration, as JSON would have it; it names files of secrets, but holds none.
    directory
        Where the values of the last start are kept. If there are none, as at the first start, nothing is published.
    clock
        For the events' times.
    publish
        Takes them.
    name
        Of the file, `FILE_NAME` or `CUBE_FILE_NAME`: two services may share a folder.
    """
    file = StateFile(StateFolder(directory), name, SettingsKept, log, "what the configuration said")
    now = _flatten(settings)
    try:
        kept = file.load()
    except UnreadableStateError as error:
        log.warning("%s: changes of the configuration since the last start are not recorded", error)
        kept = None
    before = now if kept is None else kept.values
    changed = [key for key in dict.fromkeys([*before, *now]) if before.get(key) != now.get(key)]
    texts = [f"{key} was {_shorten(before.get(key))} and is {_shorten(now.get(key))}" for key in changed[:_MOST]]
    if len(changed) > _MOST:
        texts.append(f"{len(changed) - _MOST} more keys have changed")
    for text in texts:
        publish(Event(clock.utc(), clock.monotonic(), SUBJECT, text))
    if kept is None or changed:
        file.save(SettingsKept(values=now))


def _flatten(table: Mapping[str, Any], outer: str = "") -> dict[str, str]:
    found: dict[str, str] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            found |= _flatten(value, f"{outer}{key}.")
        else:
            found[f"{outer}{key}"] = json.dumps(value)
    return found


def _shorten(value: str | None) -> str:
    if value is None:
        return "not there"
    return value if len(value) <= _LONGEST else f"{value[:_LONGEST]}..."
