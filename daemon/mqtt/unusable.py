"""Topics and JSON paths of the configuration that cannot be. They are told and lived without: the tracker tracks on."""

from typing import TYPE_CHECKING

from daemon.mqtt.json_path import check_path
from daemon.mqtt.topics import check_level, check_topic

if TYPE_CHECKING:
    from collections.abc import Callable

    from daemon.config.sections import Settings


def unusable(settings: "Settings") -> dict[str, str]:
    """Return what is wrong with a topic, a level of one or a JSON path, by its key; empty where all are good."""
    mqtt = settings.mqtt
    given: dict[str, tuple[Callable[[str], str], str | None]] = {
        "bridge.topic": (check_topic, settings.bridge.topic),
        "mqtt.prefix": (check_topic, mqtt.prefix),
        "mqtt.name": (check_level, mqtt.name),
        "mqtt.discovery_prefix": (check_topic, mqtt.discovery_prefix),
        "mqtt.wind.topic": (check_topic, mqtt.wind.topic),
        "mqtt.wind.json_path": (check_path, mqtt.wind.json_path),
        "mqtt.safe.topic": (check_topic, mqtt.safe.topic),
        "mqtt.safe.json_path": (check_path, mqtt.safe.json_path),
    }
    found = {}
    for key, (check, text) in given.items():
        try:
            if text is not None:
                check(text)
        except ValueError as error:
            found[key] = str(error)
    return found
