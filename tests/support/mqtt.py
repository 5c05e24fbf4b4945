"""Fixtures: a broker, an observer who hears everything, and the service between them on a fast clock."""

import asyncio
import contextlib
import json
import logging
import math
from datetime import UTC, datetime
from random import Random

import aiomqtt
import pytest

from daemon.base.process import SystemdNotifier
from daemon.base.timeloop import ScaledTimeLoop
from daemon.config.settings import Settings
from daemon.mqtt.companion import links
from daemon.service.recent import RecentRecords
from daemon.service.rig import Rig, Role, TrackerInstruments
from daemon.service.service import Service
from daemon.service.snapshot import snapshot
from tests.support import PATIENCE_S
from tests.support.broker import MOSQUITTO, UNTESTED_WITH_AMQTT, Broker
from tests.support.rig import KEY, ManualWeather, ServiceRig

# Fast enough for minutes to pass in seconds, slow enough for a busy machine to answer in time.
SPEED = 20.0

needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason=f"amqtt has no {UNTESTED_WITH_AMQTT}")


@pytest.fixture
def broker(tmp_path):
    made = Broker(tmp_path).start()
    yield made
    made.close()


@pytest.fixture
def make_broker(tmp_path):
    """Make a broker with users, an access list, TLS or a limit of messages."""
    made = []

    def make(**how):
        made.append(Broker(tmp_path, **how))
        return made[-1]

    yield make
    for one in made:
        one.close()


class Observer:
    """Another client of the broker, which hears everything and may publish."""

    def __init__(self, client):
        self.client = client
        self.heard = []

    async def listen(self):
        with contextlib.suppress(aiomqtt.MqttError):
            async for message in self.client.messages:
                self.heard.append(message)

    async def publish(self, topic, payload=b"", retain=False):
        if not isinstance(payload, bytes | str):
            payload = json.dumps(payload)
        # No limit of aiomqtt's own: that uses `asyncio.wait_for`, which may swallow a cancellation on Python 3.11.
        async with asyncio.timeout(10 * SPEED):
            await self.client.publish(topic, payload, qos=1, retain=retain, timeout=math.inf)

    def messages_on(self, topic):
        return [message for message in self.heard if message.topic.value == topic]

    async def until(self, topic, holds=lambda _: True, after=0):
        """Return the first payload on a topic for which `holds`; JSON is decoded."""

        def found():
            for message in self.messages_on(topic)[after:]:
                if holds(told := _read(message.payload)):
                    return [told]
            return None

        return (await until(found, f"a message on {topic} in {[m.topic.value for m in self.heard][-20:]}"))[0]


def _read(payload):
    try:
        return json.loads(payload)
    except ValueError:
        return payload.decode()


async def until(condition, what, within_s=PATIENCE_S):
    """Wait, in real time, until a condition returns something true, and return that."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + within_s * getattr(loop, "speed", 1.0)
    while not (found := condition()):
        assert loop.time() < deadline, f"{what} did not come within {within_s} s"
        await asyncio.sleep(0.02)
    return found


async def report_safe_inputs(rig, lab, messages):
    """Say by topic that all is safe, until every safety input has heard it: the tracker tracks only then."""
    for _ in range(100):
        for topic, payload in messages.items():
            await lab.publish(topic, payload)
        await asyncio.sleep(0.1 * SPEED)
        if all(item.age_s is not None for item in rig.mqtt.status.inputs):
            return
    raise AssertionError(f"nothing was heard: {rig.mqtt.status}")


@contextlib.asynccontextmanager
async def observer(port, topic="#", **how):
    async with aiomqtt.Client("127.0.0.1", port, timeout=10 * SPEED, **how) as client:
        await client.subscribe(topic, qos=1, timeout=10 * SPEED)
        made = Observer(client)
        listening = asyncio.create_task(made.listen())
        try:
            yield made
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)


class BrokerRig(ServiceRig):
    """The rig with a broker."""

    def __init__(self, loop, settings, speed, role=Role.BOTH, start="2022-10-12T10:00"):
        super().__init__(loop, settings, datetime.fromisoformat(start).replace(tzinfo=UTC), ManualWeather(), role)
        self.links = links(settings, role, self.clock, Random(1), self.bus.publish, speed)
        self.mqtt = next(iter(self.links.values()))
        recent = RecentRecords()
        self.bus.subscribe(recent.note)
        tracker, cube = role is not Role.CUBE, role is not Role.TRACKER
        self.service = Service(
            settings,
            role,
            Rig(
                self.cube if cube else None,
                tuple(TrackerInstruments(one) for one in (self.positioner, *self.others)) if tracker else (),
                lambda: self.wind_m_s,
                simulated=True,
            ),
            self.clock,
            Random(1),
            self.bus,
            KEY,
            SystemdNotifier({}, 0),
            1.0,
            stow_sources={name: link.stow_sources() for name, link in self.links.items()},
            send_beyond=self.mqtt.send_scan if settings.bridge.transport == "mqtt" else None,
        )
        for link in self.links.values():
            link.attach(self.service, lambda: snapshot(self.service, recent, speed, None, self.statuses))

    async def run_until(self, stop):
        await self.service.run(stop, *(link.run() for link in self.links.values()))

    @property
    def statuses(self):
        return {name: link.status for name, link in self.links.items()}


def settings_for(port, **sections):
    """Return settings with a broker; `mqtt` and `bridge` add keys to their sections."""
    mqtt = {"enabled": True, "port": port, "keepalive_s": 2} | sections.pop("mqtt", {})
    bridge = {"listen": "127.0.0.1:0", "send_to": ()} | sections.pop("bridge", {})
    return Settings.model_validate({"mqtt": mqtt, "bridge": bridge, **sections})


@contextlib.asynccontextmanager
async def run_services(*rigs):
    """Run services, and end them as a signal does."""
    stop = asyncio.Event()
    tasks = [asyncio.create_task(rig.run_until(stop)) for rig in rigs]
    try:
        yield
    finally:
        stop.set()
        await asyncio.gather(*tasks)


@pytest.fixture
def run_scaled():
    """Run a scenario on a loop that is `SPEED` times as fast as the machine's clock."""

    def run(scenario):
        with asyncio.Runner(loop_factory=lambda: ScaledTimeLoop(SPEED)) as runner:
            runner.run(scenario())

    return run


@pytest.fixture
def log_lines(caplog):
    """The lines of the log that an operator sees: INFO and above."""
    caplog.set_level(logging.INFO, "heliocube")
    return lambda: [record for record in caplog.records if record.name.startswith("heliocube")]
