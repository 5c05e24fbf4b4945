"""Settings that cannot work: one clear sentence in the log, in the state and as an event, and the service tracks on."""

import asyncio
import os
import signal
from pathlib import Path

import pytest

from daemon.base.records import Decision, Event, Mode
from daemon.commands.file_check import check_file
from daemon.config.file import ConfigError, load_settings
from daemon.service.rig import Role
from tests.support import PATIENCE_S, forks
from tests.support.addresses import free_port
from tests.support.broker import CERTIFICATES
from tests.support.mqtt import SPEED, BrokerRig, needs_mosquitto, observer, run_services, settings_for, until

BASE = "heliocube/tracker"
OWN = {"certificate_file": CERTIFICATES / "client.pem", "certificate_key_file": CERTIFICATES / "client.key"}


def broker_rig(port, role=Role.BOTH, **sections):
    return BrokerRig(asyncio.get_running_loop(), settings_for(port, **sections), SPEED, role)


def told(rig):
    """Return what the state says about the link."""
    status = rig.mqtt.status
    return [*([] if status.connected else [status.down_why]), *status.troubles]


async def is_told_once_and_tracks(rig, log_lines, sentence, mode=Mode.TRACKING):
    await until(lambda: any(sentence in text for text in told(rig)), sentence)
    await rig.until_mode(mode, 400)
    assert any(sentence in text for text in told(rig))
    assert sum(sentence in line.getMessage() for line in log_lines()) == 1
    assert sum(sentence in record.text for record in rig.records_of(Event)) == 1


@pytest.mark.parametrize(
    ("mqtt", "sentence"),
    [
        ({}, "nothing listens at 127.0.0.1:1"),
        ({"host": "no-such-host.invalid"}, "mqtt.host: the name no-such-host.invalid cannot be resolved"),
        ({"tls": True, "ca_file": Path("/none.pem")}, "mqtt.ca_file: there is no file /none.pem"),
        (
            {"credentials_file": Path("/none")},
            "mqtt.credentials_file: there is no file /none: write user:password into it",
        ),
        ({"prefix": "lab/#"}, "mqtt.prefix: 'lab/#' has a wildcard, and a topic has none; so there is no link"),
        ({"name": "a/b"}, "mqtt.name: 'a/b' is more than one level of a topic; so there is no link"),
    ],
)
def test_an_mqtt_link_that_cannot_be_made_is_reported_once_and_the_service_goes_on_tracking(
    run_scaled, log_lines, mqtt, sentence
):
    async def scenario():
        rig = broker_rig(1, mqtt=mqtt)
        async with run_services(rig):
            await is_told_once_and_tracks(rig, log_lines, sentence)
        assert rig.mqtt.status.connections == 0

    run_scaled(scenario)


@needs_mosquitto
@pytest.mark.parametrize(
    ("file", "sentence"),
    [
        ("other-ca.pem", "has a certificate that mqtt.ca_file does not confirm"),
        ("broker.key", "has no certificates in PEM form"),
    ],
)
def test_a_wrong_certificate_authority_is_reported_once_and_the_service_goes_on_tracking(
    make_broker, run_scaled, log_lines, file, sentence
):
    broker = make_broker(tls=True).start()

    async def scenario():
        rig = broker_rig(broker.port, mqtt={"tls": True, "ca_file": CERTIFICATES / file, **OWN})
        async with run_services(rig):
            await is_told_once_and_tracks(rig, log_lines, sentence)

    run_scaled(scenario)


@needs_mosquitto
@pytest.mark.parametrize(
    ("certificate", "mqtt", "sentence"),
    [
        ("expired", {"ca_file": CERTIFICATES / "expired.pem"}, "has a certificate that is out of date by"),
        (
            "broker",
            {"ca_file": CERTIFICATES / "ca.pem", "host": "localhost"},
            "has a certificate for another name than",
        ),
    ],
)
def test_a_broker_certificate_that_is_out_of_date_or_for_another_name_is_reported_as_such(
    make_broker, run_scaled, certificate, mqtt, sentence
):
    broker = make_broker(tls=True, certificate=certificate).start()

    async def scenario():
        rig = broker_rig(broker.port, mqtt={"tls": True, **mqtt, **OWN})
        async with run_services(rig):
            await until(lambda: sentence in (rig.mqtt.status.down_why or ""), sentence)

    run_scaled(scenario)


@needs_mosquitto
@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ("retain_available false", "keeps no retained messages, and the service needs them"),
        ("max_qos 0", "takes no messages of QoS 1, and the service needs them"),
    ],
)
def test_a_broker_without_retained_messages_or_qos_1_is_reported_as_lacking_them(
    make_broker, run_scaled, setting, sentence
):
    broker = make_broker(setting=setting).start()

    async def scenario():
        rig = broker_rig(broker.port)
        async with run_services(rig):
            await until(lambda: "not connected yet" not in told(rig), "a reason")
            assert sentence in told(rig)[0]

    run_scaled(scenario)


def test_a_wrong_discovery_prefix_is_reported_once_and_affects_only_home_assistant(broker, run_scaled, log_lines):
    async def scenario():
        rig = broker_rig(broker.port, mqtt={"discovery_prefix": "ha/+"})
        async with observer(broker.port) as lab, run_services(rig):
            await is_told_once_and_tracks(
                rig, log_lines, "so Home Assistant receives nothing: correct it and start again"
            )
            state = await lab.until(f"{BASE}/state", lambda found: found["mode"]["name"] == "tracking")
            assert "'ha/+' has a wildcard" in state["mqtt"]["troubles"][0]
            assert "'ha/+' has a wildcard" in (await lab.until(f"{BASE}/event"))["text"]

    run_scaled(scenario)


def test_with_a_wrong_bridge_topic_only_the_scans_over_the_broker_are_lost(broker, run_scaled, log_lines):
    bridge = {"transport": "mqtt", "topic": "a/#", "insecure": False, "key_file": "bridge.key"}

    async def scenario():
        cube, both = broker_rig(broker.port, Role.CUBE, bridge=bridge), broker_rig(broker.port, bridge=bridge)
        async with observer(broker.port) as lab, run_services(cube, both):
            await lab.until("heliocube/cube/state", lambda found: found["scan"])
            assert "so no scan goes over the broker" in cube.mqtt.status.troubles[0]
            await both.until_mode(Mode.TRACKING, 400)

    run_scaled(scenario)


@pytest.mark.parametrize(
    ("inputs", "sentence"),
    [
        ({"wind": {"topic": "dome/#"}}, "mqtt.wind.topic: 'dome/#' has a wildcard"),
        ({"wind": {"topic": "dome/one", "json_path": "a..b"}}, "mqtt.wind.json_path: 'a..b' is not a path"),
        ({"safe": {"topic": "dome/+", "stale_s": 150}}, "mqtt.safe.topic: 'dome/+' has a wildcard"),
        ({"safe": {"topic": "dome/one", "stale_s": 150, "json_path": "."}}, "mqtt.safe.json_path: '.' is not a path"),
        (
            {"safe": {"topic": "dome/one", "stale_s": 150, "json_path": "no.where"}},
            "the message has nothing at no.where",
        ),
    ],
)
def test_an_unusable_safety_input_stows_the_tracker_after_its_time_limit_and_not_before(
    broker, run_scaled, log_lines, inputs, sentence
):
    async def scenario():
        rig = broker_rig(broker.port, mqtt=inputs, safety={"wind_stale_s": 150})
        async with observer(broker.port) as lab, run_services(rig):

            async def repeat():
                while True:
                    await lab.publish("dome/one", {"safe": "safe", "wind": 1, "a": {"b": 1}})
                    await asyncio.sleep(5)

            repeating = asyncio.create_task(repeat())
            try:
                await is_told_once_and_tracks(rig, log_lines, sentence, Mode.STARTING)
                await rig.until_mode(Mode.STOW, 200)
                assert not rig.records_of(Decision), "nothing is tracked before the input has been heard"
                assert rig.clock.monotonic() >= 150
                (status,) = rig.mqtt.status.inputs
                assert (status.age_s, status.stowing) == (None, True)
            finally:
                repeating.cancel()
                await asyncio.gather(repeating, return_exceptions=True)

    run_scaled(scenario)


@pytest.mark.system
def test_the_program_starts_with_wrong_topics_and_state_status_log_and_config_check_report_them(broker, tmp_path):
    config = tmp_path / "heliocube.toml"
    config.write_text(
        f"[bridge]\nlisten = '127.0.0.1:0'\n[api]\nlisten = '127.0.0.1:{free_port()}'\n"
        f"[safety]\nwind_stale_s = 86400\n[mqtt]\nenabled = true\nport = {broker.port}\n"
        "[mqtt.wind]\ntopic = 'weather/#'\n[mqtt.safe]\ntopic = 'dome'\njson_path = 'a.'\nstale_s = 86400\n"
    )
    ends = "and 86400 s of silence stow the tracker: correct it and start again"
    no_wind, no_word = f"no wind speed is received over MQTT, {ends}", f"no safe message is received, {ends}"
    sentences = [
        f"mqtt.wind.topic: 'weather/#' has a wildcard, and a topic has none; so {no_wind}",
        f"mqtt.safe.json_path: 'a.' is not a path such as wind.speed or sensors.0.speed; so {no_word}",
    ]

    async def scenario():
        async with observer(broker.port, f"{BASE}/#") as lab:
            state = await lab.until(
                f"{BASE}/state", lambda found: "waiting for the first message" in found["mode"]["why"]
            )
            assert state["mqtt"]["troubles"] == sentences
            for sentence in sentences:
                await lab.until(f"{BASE}/event", lambda found, text=sentence: found["text"] == text)

    with (tmp_path / "log").open("w") as log:
        process = forks.start(["run", "--config", config], stdout=log, stderr=log)
    try:
        asyncio.run(scenario())
        shown = forks.run("status", "--config", config, env=os.environ | {"COLUMNS": "400"}).stdout
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
    log = (tmp_path / "log").read_text()
    for sentence in sentences:
        assert sentence in shown
        assert log.count(sentence) == 1
    assert f"127.0.0.1:{broker.port} since" in shown
    checked = forks.run("config", "check", config)
    assert checked.returncode == 2
    assert 'mqtt.wind.topic = "weather/#": must be a topic without wildcards' in checked.stderr
    assert 'mqtt.safe.json_path = "a.": must be names with full stops between' in checked.stderr


def test_config_check_lists_wrong_topics_together_with_all_other_problems(tmp_path):
    path = tmp_path / "heliocube.toml"
    path.write_text("[site]\nlatitude_deg = 95\n[mqtt]\nprefix = 'a/#'\n[law]\nname = 'mu'\n")
    with pytest.raises(ConfigError) as caught:
        check_file(path)
    assert [problem.partition(" ")[0] for problem in caught.value.problems] == [
        "site.latitude_deg",
        "mqtt.prefix",
        "law.name",
    ]
    for host in ("broker..lan", f"{'x' * 64}.lan", ""):
        path.write_text(f"[mqtt]\nhost = '{host}'\n")
        with pytest.raises(ConfigError, match="must be a name or an address in quotes"):
            check_file(path)
    path.write_text("[mqtt]\nprefix = 'a/#'\n")
    assert load_settings(path).mqtt.prefix == "a/#"
    path.write_text("[mqtt]\nprefix = 5\n")
    with pytest.raises(ConfigError):
        load_settings(path)
