"""Scans from a cube in one network to a tracker in another, over the broker."""

import asyncio

import pytest

from daemon.base.records import Mode, Quality, Scan
from daemon.commands.file_check import check_file
from daemon.config.file import ConfigError
from daemon.service.rig import Role
from tests.support.mqtt import SPEED, BrokerRig, observer, run_services, settings_for, until

TOPIC = "site/cube/bridge"
KEYED = {"transport": "mqtt", "topic": TOPIC, "insecure": False, "key_file": "bridge.key"}


def broker_rig(port, role, mqtt=(), **bridge):
    settings = settings_for(port, bridge=KEYED | bridge, mqtt=dict(mqtt))
    return BrokerRig(asyncio.get_running_loop(), settings, SPEED, role)


def test_trackers_follow_a_cube_over_the_broker_and_refuse_repeated_forged_or_malformed_messages(broker, run_scaled):
    async def scenario():
        cube, tracker = broker_rig(broker.port, Role.CUBE), broker_rig(broker.port, Role.TRACKER)
        field = broker_rig(broker.port, Role.TRACKER, mqtt={"name": "field"})
        async with observer(broker.port) as lab:
            async with run_services(cube, tracker, field):
                await tracker.until_mode(Mode.TRACKING, 500)
                assert len(tracker.records_of(Scan)) >= 3
                assert tracker.records_of(Scan)[0].session == cube.records_of(Scan)[0].session
                await field.until_mode(Mode.TRACKING, 500)
                assert {scan.session for scan in field.records_of(Scan)} == {cube.records_of(Scan)[0].session}
                assert cube.service.sender is None
                sent = lab.messages_on(TOPIC)
                assert all(message.payload.count(b".") == 2 and not message.retain for message in sent)
                for name, payload in [
                    ("duplicate", sent[-1].payload),
                    ("forged", sent[-1].payload[:-4] + b"AAAA"),
                    ("malformed", b"{}"),
                    ("oversized", b"x" * 3000),
                ]:
                    await lab.publish(TOPIC, payload)
                    refused = tracker.service.receiver
                    await until(lambda name=name, seen=refused: getattr(seen.statistics, name), name)
                await lab.publish("heliocube/cube/command/acknowledge", b'{"by": "lab"}')
                assert (await lab.until("heliocube/cube/reply"))["text"] == "there is nothing to acknowledge"
                assert "the topic site/cube/bridge" in tracker.service.receiver.statistics.last_refusal
            await until(
                lambda: {m.payload for m in lab.messages_on("heliocube/cube/status")} == {b"online", b"offline"},
                "offline",
            )

    run_scaled(scenario)


def test_a_tracker_ignores_a_retained_scan(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            async with run_services(broker_rig(broker.port, Role.CUBE)):
                await lab.until(TOPIC)
            await lab.publish(TOPIC, lab.messages_on(TOPIC)[-1].payload, retain=True)
            tracker = broker_rig(broker.port, Role.TRACKER)
            async with run_services(tracker):
                await until(lambda: tracker.mqtt.status.connected, "the link")
                await asyncio.sleep(SPEED)
                assert not tracker.records_of(Scan)
                assert tracker.service.receiver.statistics.refused == 0

    run_scaled(scenario)


def test_a_tracker_in_the_same_process_as_its_cube_gets_scans_without_a_broker(broker, run_scaled):
    broker.kill()

    async def scenario():
        rig = broker_rig(broker.port, Role.BOTH)
        async with run_services(rig):
            await rig.until_mode(Mode.TRACKING, 500)
            assert all(face.quality is Quality.OK for face in rig.records_of(Scan)[-1].faces)

    run_scaled(scenario)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[bridge]\ntransport = 'mqtt'\nkey_file = 'k'", 'bridge.transport = "mqtt": needs mqtt.enabled = true'),
        ("[bridge]\ntransport = 'mqtt'\n[mqtt]\nenabled = true", "bridge.key_file must name a key"),
        ("[bridge]\ntopic = 'site/#'", 'bridge.topic = "site/#": must be a topic without wildcards'),
        ("[mqtt]\nprefix = 'lab/+'", 'mqtt.prefix = "lab/+": must be a topic without wildcards'),
        ("[mqtt]\nname = 'a/b'", 'mqtt.name = "a/b": must be one level of a topic'),
        ("[mqtt]\nhost = 'mqtt://x'", 'mqtt.host = "mqtt://x": must be a name or an address'),
        ("[mqtt.wind]\ntopic = 'wind'", 'mqtt.wind.topic = "wind": protects nothing without mqtt.enabled'),
        ("[mqtt.wind]\njson_path = 'a..b'", 'mqtt.wind.json_path = "a..b": must be names with full stops'),
        ("[mqtt]\nca_file = 'ca.pem'", "has no effect without mqtt.tls"),
        ("[mqtt.safe]\nunsafe = 'safe'", "must differ from mqtt.safe.safe"),
        ("[mqtt]\nenabled = true\n[mqtt.wind]\ntopic = 'w/#'", 'mqtt.wind.topic = "w/#": must be a topic without'),
    ],
)
def test_config_check_refuses_an_unusable_mqtt_setting_in_one_sentence_with_the_remedy(tmp_path, text, part):
    path = tmp_path / "heliocube.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        check_file(path)
    (problem,) = caught.value.problems
    assert part in problem
