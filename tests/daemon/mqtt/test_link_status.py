"""The link as a monitoring system and a person at the terminal see it."""

import asyncio
import io
import re

from rich.console import Console

from daemon.api.metrics import Metrics
from daemon.base.records import Mode
from daemon.commands.status.screen import render
from daemon.service.recent import RecentRecords
from daemon.service.snapshot import snapshot
from daemon.service.state import state_json
from tests.support.mqtt import SPEED, BrokerRig, observer, report_safe_inputs, run_services, settings_for, until


def seen_of(rig):
    """Return the metrics by name and label, and the lines of the status."""
    seen = snapshot(rig.service, RecentRecords(), SPEED, None, {rig.tracker.name: rig.mqtt.status})
    metrics = Metrics(seen, {}).text().decode()
    values = dict(line.rsplit(" ", 1) for line in metrics.splitlines() if line.startswith("heliocube_mqtt"))
    shown = io.StringIO()
    Console(width=200, file=shown).print(render(state_json(seen)))
    return {name: float(value) for name, value in values.items()}, shown.getvalue()


def test_metrics_and_status_show_the_mqtt_link_its_queue_its_losses_and_the_safety_inputs(broker, run_scaled):
    inputs = {"wind": {"topic": "weather"}, "safe": {"topic": "weather", "json_path": "ok", "stale_s": 3600}}

    async def scenario():
        rig = BrokerRig(
            asyncio.get_running_loop(), settings_for(broker.port, mqtt={"queue_messages": 10, **inputs}), SPEED
        )
        metrics, shown = seen_of(rig)
        assert (
            metrics['heliocube_mqtt_up{tracker="tracker"}'],
            metrics['heliocube_mqtt_connections_total{tracker="tracker"}'],
        ) == (0, 0)
        assert 'heliocube_mqtt_input_age_seconds{input="wind",tracker="tracker"}' not in metrics
        assert re.search(r"mqtt +not connected since .+: not connected yet; 0 messages waiting", shown)
        assert re.search(r"wind +nothing heard yet on weather", shown)
        async with run_services(rig):
            async with observer(broker.port) as lab:
                await until(lambda: rig.service.acquisition.ready, "the cube")
                await until(lambda: rig.mqtt.status.sent > 6, "the link")
                await lab.publish("weather", "30")
                await rig.until_mode(Mode.STOW, 100)
            metrics, shown = seen_of(rig)
            assert (
                metrics['heliocube_mqtt_up{tracker="tracker"}'],
                metrics['heliocube_mqtt_connections_total{tracker="tracker"}'],
            ) == (1, 1)
            assert metrics['heliocube_mqtt_sent_total{tracker="tracker"}'] > 5
            assert metrics['heliocube_mqtt_received_total{tracker="tracker"}'] >= 2
            assert metrics['heliocube_mqtt_dropped_total{tracker="tracker"}'] == 0
            assert metrics['heliocube_mqtt_troubles{tracker="tracker"}'] == 1
            assert metrics['heliocube_mqtt_input_stowing{input="wind",tracker="tracker"}'] == 1
            assert metrics['heliocube_mqtt_input_stowing{input="safe",tracker="tracker"}'] == 0
            assert 0 <= metrics['heliocube_mqtt_input_age_seconds{input="wind",tracker="tracker"}'] < 100
            assert re.search(rf"mqtt +127.0.0.1:{broker.port} since .+ UTC\)?, \d+ messages sent, \d+ received", shown)
            assert re.search(r"wind +heard [\d.]+ s ago on weather  STOW", shown)
            assert "mqtt.safe of weather cannot be used: the message has nothing at ok" in shown
            broker.kill()
            await until(lambda: rig.mqtt.status.dropped > 5, "a full queue")
            metrics, shown = seen_of(rig)
            assert metrics['heliocube_mqtt_up{tracker="tracker"}'] == 0
            assert metrics['heliocube_mqtt_waiting{tracker="tracker"}'] == 10
            assert metrics['heliocube_mqtt_dropped_total{tracker="tracker"}'] > 5
            assert re.search(
                rf"not connected since .+: .*127.0.0.1:{broker.port}.*; 10 messages waiting, \d+ dropped since \d",
                shown,
            )
            broker.start()
            await until(lambda: rig.mqtt.status.connections == 2, "the way back")
            assert seen_of(rig)[0]['heliocube_mqtt_connections_total{tracker="tracker"}'] == 2

    run_scaled(scenario)


def test_wind_and_safety_may_come_on_one_topic(broker, run_scaled):
    inputs = {"wind": {"topic": "weather", "json_path": "wind"}, "safe": {"topic": "weather", "json_path": "ok"}}

    async def scenario():
        rig = BrokerRig(asyncio.get_running_loop(), settings_for(broker.port, mqtt=inputs), SPEED)
        async with observer(broker.port) as lab, run_services(rig):
            await report_safe_inputs(rig, lab, {"weather": {"wind": 3, "ok": "safe"}})
            await rig.until_mode(Mode.TRACKING, 400)

    run_scaled(scenario)


def test_a_message_that_one_handler_fails_on_is_reported_once_and_other_handlers_still_get_it(
    broker, run_scaled, log_lines
):
    async def scenario():
        rig = BrokerRig(asyncio.get_running_loop(), settings_for(broker.port), SPEED)
        heard = []

        def take(message):
            if message.payload != b"good":
                raise RecursionError(message.payload.decode())

        for handler in (take, lambda message: heard.append(message.payload)):
            rig.mqtt.link.listen("lab/topic", handler)
        async with observer(broker.port) as lab, run_services(rig):
            await until(lambda: rig.mqtt.status.connected, "the link")
            for payload in (b"bad", b"good", b"bad"):
                await lab.publish("lab/topic", payload)
            await until(lambda: len(heard) == 3, "all messages")
            sentence = "a message on lab/topic cannot be used: RecursionError('bad')"
            assert rig.mqtt.status.troubles == (sentence,)
            assert [line.getMessage() for line in log_lines()].count(sentence) == 1
            await lab.publish("lab/topic", b"good")
            await until(lambda: not rig.mqtt.status.troubles, "the end of the trouble")
            assert rig.mqtt.status.connections == 1

    run_scaled(scenario)
