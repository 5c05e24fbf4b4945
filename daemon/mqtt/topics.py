"""The names of topics, and which texts can be one."""

import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from daemon.base.json_names import DuplicateNameError, reject_duplicate_names

_LONGEST = 200


def check_topic(text: str) -> str:
    """Return `text` if it is a topic to publish on or to listen to: no wildcard, no empty level.

    Raises
    ------
    ValueError
        In one sentence.
    """
    if "+" in text or "#" in text:
        raise ValueError(f"{text!r} has a wildcard, and a topic has none")
    if not 0 < len(text) <= _LONGEST or not text.isprintable():
        raise ValueError(f"{text!r} is not one line of 1 to {_LONGEST} letters")
    if not all(text.split("/")) or text.startswith("$"):
        raise ValueError(f"{text!r} has an empty level, or begins with $")
    return text


def check_level(text: str) -> str:
    """Return `text` if it is one level of a topic; raises `ValueError` in one sentence."""
    if "/" in check_topic(text):
        raise ValueError(f"{text!r} is more than one level of a topic")
    return text


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics of one process.

    Attributes
    ----------
    prefix
        One for the installation.
    name
        One level for this tracker, or this cube.
    """

    prefix: str
    name: str

    @property
    def base(self) -> str:
        """What all topics of this process begin with."""
        return f"{self.prefix}/{self.name}"

    @property
    def status(self) -> str:
        """Availability: ``online`` or ``offline``, retained."""
        return self.of("status")

    @property
    def state(self) -> str:
        """The whole state, retained."""
        return self.of("state")

    @property
    def reply(self) -> str:
        """The replies to commands."""
        return self.of("reply")

    @property
    def records(self) -> str:
        """Every record of the store, a page at a time, for an archive."""
        return self.of("records")

    @property
    def records_kept(self) -> str:
        """The archive's answer to each page."""
        return f"{self.records}/kept"

    def command(self, name: str) -> str:
        """Return the topic on which one command is taken."""
        return self.of(f"command/{name}")

    def command_of_all(self, name: str) -> str:
        """Return the topic on which a command for all trackers of the installation is taken."""
        return f"{self.prefix}/command/{name}"

    def of(self, kind: str) -> str:
        """Return the topic of one kind of record."""
        return f"{self.base}/{kind}"


_FORM = re.compile(r"[^.\[\]\s]+(\.[^.\[\]\s]+)*")


def check_json_path(text: str) -> str:
    """Return `text` if it is a path of names and list positions with full stops between; `ValueError` if not."""
    if text and _FORM.fullmatch(text) is None:
        raise ValueError(f"{text!r} is not a path such as wind.speed or sensors.0.speed")
    return text


def find_value(payload: bytes, path: str) -> Any:
    """Return the value at `path` of a message; with an empty path the message itself, as JSON or else as text.

    Raises
    ------
    ValueError
        In one sentence: the message is no JSON, has a name twice, or has nothing there.
    """
    try:
        found = json.loads(payload, object_pairs_hook=reject_duplicate_names)
    except DuplicateNameError as error:
        raise ValueError(f"the message has {error.name} twice") from None
    except (ValueError, RecursionError):
        if path:
            raise ValueError("the message is not JSON") from None
        return payload.decode("utf-8", "replace").strip()
    for step in path.split(".") if path else ():
        if isinstance(found, dict) and step in found:
            found = found[step]
        elif isinstance(found, list) and step.isdecimal() and int(step) < len(found):
            found = found[int(step)]
        else:
            raise ValueError(f"the message has nothing at {path}")
    return found


if TYPE_CHECKING:
    from collections.abc import Callable

    from daemon.config.settings import Settings


def find_topic_errors(settings: "Settings") -> dict[str, str]:
    """Return what is wrong with a topic, a level of one or a JSON path, by its key; empty where all are good."""
    mqtt = settings.mqtt
    given: dict[str, tuple[Callable[[str], str], str | None]] = {
        "bridge.topic": (check_topic, settings.bridge.topic),
        "mqtt.prefix": (check_topic, mqtt.prefix),
        "mqtt.name": (check_level, mqtt.name),
        "mqtt.discovery_prefix": (check_topic, mqtt.discovery_prefix),
        "mqtt.wind.topic": (check_topic, mqtt.wind.topic),
        "mqtt.wind.json_path": (check_json_path, mqtt.wind.json_path),
        "mqtt.safe.topic": (check_topic, mqtt.safe.topic),
        "mqtt.safe.json_path": (check_json_path, mqtt.safe.json_path),
    }
    found = {}
    for key, (check, text) in given.items():
        try:
            if text is not None:
                check(text)
        except ValueError as error:
            found[key] = str(error)
    return found
