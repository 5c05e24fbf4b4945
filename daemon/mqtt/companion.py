"""Everything over MQTT put together, as companions of the service: a link for each tracker, or one for the cube."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from daemon.base.clock import Clock, iso_utc
from daemon.base.process import CURRENT_TRACKER
from daemon.base.records import Record, tag_with_tracker
from daemon.bridge.receiver import BridgeReceiver
from daemon.config.settings import Settings
from daemon.mqtt.archive_feed import ArchiveFeed
from daemon.mqtt.commands import Commands
from daemon.mqtt.connection import Incoming
from daemon.mqtt.discovery import discovery
from daemon.mqtt.link import Handler, Link
from daemon.mqtt.outbox import Message
from daemon.mqtt.safety_inputs import SafeInputStow, WindReadings
from daemon.mqtt.telemetry import TelemetryPublisher, encoded
from daemon.mqtt.topics import Topics, find_topic_errors
from daemon.service.operator_commands import COMMAND_NAMES, COMMANDS_FOR_ALL, Operators
from daemon.service.rig import Role
from daemon.service.service import Service
from daemon.service.snapshot import Snapshot
from daemon.service.status import InputStatus, LinkStatus
from daemon.tracker.stow import StowSource, WindStow

_NO_LINK = "there is no link to the broker"


class Mqtt:
    """A link and all that uses it.

    It is made before the service, which needs its reasons to stow and its way for the scans; `attach` comes after that.

    Parameters
    ----------
    settings, role
        The configuration: of the tracker, or of the cube's process.
    clock, random, publish
        The service's time, jitter, and where events go.
    speed
        The clock runs this many times as fast as the machine's.
    """

    def __init__(
        self,
        settings: Settings,
        role: Role,
        clock: Clock,
        random: Random,
        publish: Callable[[Record], None],
        speed: float,
    ) -> None:
        self._settings = settings
        self._role = role
        self._clock = clock
        self._speed = speed
        mqtt = settings.mqtt
        name = role.name_or_default(mqtt.name)
        self._tracker_name = "" if role is Role.CUBE else name
        self._topics = Topics(mqtt.prefix, name)
        publish = tag_with_tracker(publish, self._tracker_name)
        self._log_name = ""
        self._unusable = find_topic_errors(settings)
        self._inputs: list[Callable[[float], InputStatus]] = []
        self.link = Link(mqtt, self._topics, clock, random, publish, speed)
        self._feed: ArchiveFeed | None = None
        self._decide_again: Callable[[], None] = lambda: None
        self._telemetry: TelemetryPublisher | None = None
        self._commands: Commands | None = None

    @property
    def status(self) -> LinkStatus:
        """The state of the link and of the safety inputs."""
        now_s = self._clock.monotonic()
        return replace(self.link.status, inputs=tuple(status(now_s) for status in self._inputs))

    def feed_archive(self, directory: Path, random: Random) -> None:
        """Send the records of the process's store to an archive; for one link of a process, before `run`."""
        settings = self._settings
        self._feed = ArchiveFeed(
            self.link,
            self._topics,
            directory,
            self._role,
            settings.mqtt.archive_every_s,
            settings.store.keep_days,
            self._clock,
            random,
            self._speed,
        )

    def stow_sources(self) -> list[StowSource]:
        """Return the reasons to stow that come over the broker, and begin to listen for them."""
        mqtt, safety = self._settings.mqtt, self._settings.safety
        found: list[StowSource] = []
        if self._role is Role.CUBE:
            return found
        if mqtt.wind.topic is not None:
            wind = WindReadings(
                mqtt.wind, safety.stow_wind_m_s, self._clock.monotonic, self._wake, self.link.set_trouble
            )
            self._listen("mqtt.wind", mqtt.wind.topic, wind.take)
            wind_stow = WindStow(safety, wind.strongest_since_last_read, f"the wind on {mqtt.wind.topic}")
            self._inputs.append(partial(_input_status, "wind", mqtt.wind.topic, wind, wind_stow))
            found.append(wind_stow)
        if mqtt.safe.topic is not None:
            safe = SafeInputStow(mqtt.safe, self._clock.monotonic, self._wake, self.link.set_trouble)
            self._listen("mqtt.safe", mqtt.safe.topic, safe.take)
            self._inputs.append(partial(_input_status, "safe", mqtt.safe.topic, safe, safe))
            found.append(safe)
        return found

    def send_scan(self, datagram: bytes) -> None:
        """Hand a signed scan to the trackers; without a connection it is lost, as it would soon be too old."""
        if "bridge.topic" not in self._unusable:
            self.link.send_now(Message(self._settings.bridge.topic, datagram))

    def attach(self, service: Service, see: Callable[[], Snapshot]) -> None:
        """Connect with a service, of which `see` takes snapshots; call it once, before `run`."""
        mqtt, simulated = self._settings.mqtt, service.rig.simulated
        own = [tracker for tracker in service.trackers if tracker.name == self._tracker_name]
        for tracker in own:
            self._decide_again, self._log_name = tracker.control.decide_again, tracker.log_name
        self._telemetry = TelemetryPublisher(
            self.link, self._topics, see, mqtt.state_every_s * self._speed, self._tracker_name, simulated=simulated
        )
        service.bus.subscribe(self._telemetry.note, self._tracker_name)
        if self._feed is not None:
            self._feed.set_alarm_callback(service.cube_alarms.set)
        if own and own[0] is service.trackers[0]:
            # One link hears the scans for all trackers.
            self._receive_scans(service.receiver)
        # A cube alone moves nothing, but its alarms can be acknowledged.
        names = COMMAND_NAMES if own else ("acknowledge",) if self._role is Role.CUBE else ()
        if mqtt.commands and names:
            beside = [tracker for tracker in service.trackers if tracker.name != self._tracker_name]
            operators = Operators(own, self._speed, service.cube_alarms, beside)
            self._commands = Commands(
                operators, partial(self._reply, simulated=simulated), mqtt, self._clock, self._speed
            )
            heard = [(self._topics.command(name), name) for name in names]
            if len(service.trackers) > 1:
                # Each link listens for its own tracker, so that none waits for another's connection.
                heard += [(self._topics.command_of_all(name), name) for name in COMMANDS_FOR_ALL]
            for topic, name in heard:
                self.link.listen(topic, partial(self._commands.take, name), as_published=True)
        if "mqtt.discovery_prefix" not in self._unusable:
            messages = discovery(
                mqtt.discovery_prefix,
                self._topics,
                enabled=mqtt.discovery,
                commands=mqtt.commands,
                tracker=bool(own),
                simulated=simulated,
                dated=mqtt.dated_commands,
            )
            self.link.at_birth(lambda: messages)

    def _receive_scans(self, receiver: BridgeReceiver | None) -> None:
        bridge = self._settings.bridge
        if bridge.transport == "mqtt" and self._role is Role.TRACKER and receiver is not None:
            self._listen("bridge.topic", bridge.topic, partial(self._take_scan, receiver))

    async def run(self) -> None:
        """Work until cancelled; each line in the log from this task names the tracker."""
        CURRENT_TRACKER.set(self._log_name)
        self._report_unusable()
        async with asyncio.TaskGroup() as group:
            group.create_task(self.link.run(), name="mqtt link")
            if self._telemetry is not None:
                group.create_task(self._telemetry.run(), name="mqtt telemetry")
            if self._feed is not None:
                group.create_task(self._feed.run(), name="mqtt archive feed")
            if self._commands is not None:
                group.create_task(self._commands.run(), name="mqtt commands")

    def _listen(self, key: str, topic: str, handler: Handler) -> None:
        """Listen to a topic of the configuration, unless it or another key of the same input cannot be used."""
        if not any(name.startswith(key) for name in self._unusable):
            self.link.listen(topic, handler)

    def _report_unusable(self) -> None:
        """Report once which keys of the configuration cannot be used, and what that costs."""
        mqtt, safety = self._settings.mqtt, self._settings.safety
        costs = {
            "mqtt.prefix": _NO_LINK,
            "mqtt.name": _NO_LINK,
            "mqtt.discovery_prefix": "Home Assistant receives nothing",
        }
        if self._settings.bridge.transport == "mqtt":
            costs["bridge.topic"] = "no scan goes over the broker"
        if self._role is not Role.CUBE and mqtt.wind.topic is not None:
            cost = f"no wind speed is received over MQTT, and {safety.wind_stale_s:g} s of silence stow the tracker"
            costs |= {"mqtt.wind.topic": cost, "mqtt.wind.json_path": cost}
        if self._role is not Role.CUBE and mqtt.safe.topic is not None:
            cost = f"no safe message is received, and {mqtt.safe.stale_s:g} s of silence stow the tracker"
            costs |= {"mqtt.safe.topic": cost, "mqtt.safe.json_path": cost}
        for key, cost in costs.items():
            if key in self._unusable:
                sentence = f"{key}: {self._unusable[key]}; so {cost}: correct it and start again"
                if cost == _NO_LINK:
                    self.link.disable(sentence)
                else:
                    self.link.set_trouble(key, sentence)

    def _wake(self) -> None:
        self._decide_again()

    def _take_scan(self, receiver: BridgeReceiver, message: Incoming) -> None:
        if not message.retained:
            receiver.take(message.payload, f"the topic {message.topic}")

    def _reply(self, found: dict[str, Any], *, simulated: bool) -> None:
        whole = {"time": iso_utc(self._clock.utc()), **found, "simulated": simulated}
        self.link.send(Message(self._topics.reply, encoded(whole), 1), answer=True)


def links(
    settings: Settings, role: Role, clock: Clock, random: Random, publish: Callable[[Record], None], speed: float
) -> dict[str, Mqtt]:
    """Return a link for each tracker by its name, or the link of the cube's process under an empty name.

    Each has a connection of its own, because a connection has one will, and so one availability. Arguments are those of
    `Mqtt`.
    """
    if not settings.mqtt.enabled:
        return {}
    if role is Role.CUBE:
        made = {"": Mqtt(settings, role, clock, random, publish, speed)}
    else:
        made = {name: Mqtt(own, role, clock, random, publish, speed) for name, own in settings.trackers}
    if settings.mqtt.archive and settings.store.directory is not None:
        # The process has one store, whose records bear the names of their trackers.
        next(iter(made.values())).feed_archive(settings.store.directory, random)
    return made


def _input_status(
    name: str, topic: str, source: WindReadings | SafeInputStow, stow: WindStow | SafeInputStow, now_s: float
) -> InputStatus:
    age_s = None if source.heard_s is None else now_s - source.heard_s
    return InputStatus(name, topic, age_s, stow.stowing)
