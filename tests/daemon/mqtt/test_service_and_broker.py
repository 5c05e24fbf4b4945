"""The service and a broker, as other clients see them."""

import asyncio

import pytest

from daemon.base.records import Mode
from daemon.mqtt.outbox import Message
from daemon.service.operator import CommandError, Operator
from tests.support.broker import CERTIFICATES
from tests.support.mqtt import SPEED, BrokerRig, needs_mosquitto, observer, run_services, settings_for, until

BASE = "heliocube/tracker"


def broker_rig(port, **sections):
    return BrokerRig(asyncio.get_running_loop(), settings_for(port, **sections), SPEED)


def test_state_scans_decisions_poses_modes_moves_and_events_are_published_as_simulated(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = broker_rig(broker.port)
            async with run_services(rig):
                assert await lab.until(f"{BASE}/status") == "online"
                told = [await lab.until(f"{BASE}/{kind}") for kind in ("state", "scan", "decision", "pose", "mode")]
                assert all(message["simulated"] is True for message in told)
                assert told[1]["east_quality"] == "ok"
                assert told[2]["law"] == "mu-prime"
                moved = await lab.until(f"{BASE}/move")
                assert (moved["outcome"], moved["simulated"]) == ("arrived", True)
                state = await lab.until(f"{BASE}/state", lambda found: found["mode"]["name"] == "tracking")
                assert state["mqtt"]["connected"] is True
                await Operator(rig.tracker, SPEED).hold("a look", "ana")
                event = await lab.until(f"{BASE}/event", lambda found: found["subject"] == "operator")
                assert "a look" in event["text"]
                assert event["simulated"] is True
            assert await lab.until(f"{BASE}/status", lambda word: word == "offline") == "offline"

    run_scaled(scenario)


def test_a_late_subscriber_finds_availability_state_pose_decision_and_mode_retained(broker, run_scaled):
    async def scenario():
        rig = broker_rig(broker.port)
        async with run_services(rig):
            await until(lambda: rig.control.state.decision, "a decision")
            await until(lambda: rig.mqtt.status.waiting == 0, "an empty queue")
            await asyncio.sleep(SPEED)
            async with observer(broker.port) as late:
                for kind in ("status", "state", "pose", "decision", "mode"):
                    await late.until(f"{BASE}/{kind}")
                kept = {message.topic.value.rpartition("/")[2] for message in late.heard if message.retain}
                assert kept >= {"status", "state", "pose", "decision", "mode"}
                assert not kept & {"scan", "event", "move", "reply"}

    run_scaled(scenario)


def test_mqtt_commands_are_answered_and_obey_the_same_rules_as_commands_by_other_ways(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = broker_rig(broker.port)
            async with run_services(rig):
                await rig.until_mode(Mode.TRACKING, 400)
                count = 0

                async def ask(name, payload=b"{}"):
                    nonlocal count
                    await lab.publish(f"{BASE}/command/{name}", payload)
                    reply = await lab.until(f"{BASE}/reply", after=count)
                    count += 1
                    return reply

                outside = await ask("goto", {"a_deg": 70, "b_deg": 60, "id": "7"})
                assert (outside["accepted"], outside["id"]) == (False, "7")
                assert "outside the limits" in outside["text"]
                assert rig.mode is Mode.TRACKING
                assert (await ask("goto", {"a_deg": -10, "b_deg": 60}))["accepted"] is True
                await rig.until(lambda: not rig.motion.moving, 200, "arrival")
                assert rig.motion.pose.a_deg == pytest.approx(-10, abs=1)
                assert (await ask("mode", "stow"))["accepted"] is True
                assert rig.mode is Mode.STOW
                refused = await ask("goto", {"a_deg": 0, "b_deg": 60})
                assert refused["accepted"] is False
                assert "stow" in refused["text"]
                assert (await ask("auto"))["accepted"] is True
                assert rig.mode is not Mode.STOW
                stopped = await ask("stop", {"why": "a person", "by": "ana", "id": "8"})
                assert (stopped["accepted"], stopped["id"]) == (True, "8")
                assert rig.mode is Mode.HOLD
                for name in ("stow", "snow", "hold", "home", "clear", "relearn", "maintenance"):
                    refused = await ask(name)
                    assert (refused["accepted"], refused["done"], refused["state"]) == (False, False, "refused")
                    assert refused["text"].startswith(f"no {name}: the tracker is stopped by ana since ")
                    assert refused["text"].endswith(" UTC: a person; only 'heliocube auto' releases it")
                    with pytest.raises(CommandError) as same:
                        await getattr(Operator(rig.tracker, SPEED), name)("x")
                    assert str(same.value) == refused["text"]
                for name, payload, part in [
                    ("stow", "now!", "JSON"),
                    ("stow", b"\xff\x00", "JSON"),
                    ("stow", {"speed": 1}, "speed"),
                    ("stow", {"why": 5}, "only 'heliocube auto' releases it"),
                    ("stow", b"[" * 5000, "longer"),
                    ("goto", {"a_deg": True, "b_deg": 60}, "degrees"),
                    ("goto", '{"a_deg": NaN, "b_deg": 60}', "limits"),
                    ("goto", f'{{"a_deg": 1{"0" * 400}, "b_deg": 60}}', "limits"),
                    ("mode", "fast", "one of auto"),
                    ("mode", {"mode": "fast"}, "mode"),
                ]:
                    reply = await ask(name, payload)
                    assert reply["accepted"] is False
                    assert part in reply["text"]
                assert rig.mode is Mode.HOLD

    run_scaled(scenario)


def test_a_retained_command_is_ignored_and_the_reply_says_so(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            await lab.publish(f"{BASE}/command/stow", {"why": "long ago"}, retain=True)
            rig = broker_rig(broker.port)
            async with run_services(rig):
                reply = await lab.until(f"{BASE}/reply")
                assert reply["accepted"] is False
                assert "retained" in reply["text"]
                await rig.until_mode(Mode.TRACKING, 400)

    run_scaled(scenario)


def test_with_mqtt_commands_switched_off_a_command_neither_stows_the_tracker_nor_gets_a_reply(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = broker_rig(broker.port, mqtt={"commands": False})
            async with run_services(rig):
                await rig.until_mode(Mode.TRACKING, 400)
                await lab.publish(f"{BASE}/command/stow", {})
                await lab.until(f"{BASE}/scan", after=len(lab.messages_on(f"{BASE}/scan")) + 1)
                assert rig.mode is Mode.TRACKING
                assert not lab.messages_on(f"{BASE}/reply")

    run_scaled(scenario)


def test_tracking_goes_on_after_the_broker_is_killed_and_status_and_state_are_right_on_its_return(broker, run_scaled):
    async def scenario():
        rig = broker_rig(broker.port, mqtt={"queue_messages": 10})
        async with run_services(rig):
            await rig.until_mode(Mode.TRACKING, 400)
            await until(lambda: rig.mqtt.status.connected, "the link")
            broker.kill()
            await until(lambda: rig.mqtt.status.down_why, "the loss")
            await until(lambda: rig.mqtt.status.dropped > 5, "a full queue")
            assert rig.mode is Mode.TRACKING
            assert f"127.0.0.1:{broker.port}" in rig.mqtt.status.down_why
            broker.start()
            await until(lambda: rig.mqtt.status.connected, "the way back")
            async with observer(broker.port) as late:
                assert await late.until(f"{BASE}/status") == "online"
                state = await late.until(f"{BASE}/state")
                assert state["mqtt"]["dropped"] > 5
            told = [event.text for event in rig.records if getattr(event, "subject", "") == "mqtt"]
            assert any("messages were dropped" in text for text in told)

    run_scaled(scenario)


def test_retained_messages_are_right_after_an_outage_that_filled_the_queue_and_emptied_the_broker(broker, run_scaled):
    async def scenario():
        rig = broker_rig(broker.port, mqtt={"queue_messages": 10})
        async with run_services(rig):
            await rig.until_mode(Mode.TRACKING, 400)
            await until(lambda: rig.mqtt.status.waiting == 0, "an empty queue")
            broker.kill()
            await until(lambda: rig.mqtt.status.down_why, "the loss")
            await Operator(rig.tracker, SPEED).hold("x")
            await until(lambda: rig.mqtt.status.dropped > 10, "a queue without the change of mode")
            broker.start()
            async with observer(broker.port) as late:
                assert (await late.until(f"{BASE}/mode"))["after"] == "hold"
                assert (await late.until(f"{BASE}/decision"))["moved"] is True

    run_scaled(scenario)


def test_a_false_offline_status_on_the_broker_is_corrected(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = broker_rig(broker.port)
            async with run_services(rig):
                await lab.until(f"{BASE}/status", lambda word: word == "online")
                heard = len(lab.messages_on(f"{BASE}/status"))
                await lab.publish(f"{BASE}/status", "offline", retain=True)
                assert await lab.until(f"{BASE}/status", lambda word: word == "online", after=heard) == "online"

    run_scaled(scenario)


def test_a_hung_broker_is_noticed_and_the_service_goes_on_and_reconnects(broker, run_scaled):
    async def scenario():
        rig = broker_rig(broker.port)
        async with run_services(rig):
            await until(lambda: rig.mqtt.status.connected, "the link")
            broker.hang()
            try:
                await until(lambda: not rig.mqtt.status.connected, "the silence")
                scans = len(rig.records)
                await asyncio.sleep(3 * SPEED)
                assert len(rig.records) > scans
            finally:
                broker.resume()
            await until(lambda: rig.mqtt.status.connected, "the way back")
            async with observer(broker.port) as late:
                # Meanwhile the broker has published the will of the old connection, whose end it has missed.
                await asyncio.sleep(3 * SPEED)
                assert late.messages_on(f"{BASE}/status")[-1].payload == b"online"

    run_scaled(scenario)


def test_a_hung_broker_is_noticed_by_its_silence_when_there_is_nothing_to_send(broker, run_scaled):
    async def scenario():
        rig = broker_rig(broker.port)
        link = asyncio.create_task(rig.mqtt.link.run())
        try:
            await until(lambda: rig.mqtt.status.connected, "the link")
            await asyncio.sleep(2 * SPEED)
            broker.hang()
            try:
                async with asyncio.timeout(60.0 * SPEED):
                    # The loss is shown at once, and not only when the connection has been closed too.
                    while rig.mqtt.status.connected:  # noqa: ASYNC110 - nothing tells of it
                        await asyncio.sleep(0.0)
                assert rig.mqtt.status.down_why == f"127.0.0.1:{broker.port} does not answer any more"
            finally:
                broker.resume()
        finally:
            link.cancel()
            await asyncio.gather(link, return_exceptions=True)

    run_scaled(scenario)


def test_the_service_stops_in_time_although_the_broker_hangs(broker, run_scaled):
    async def scenario():
        rig = broker_rig(broker.port)
        async with run_services(rig):
            await until(lambda: rig.mqtt.status.connected, "the link")
            broker.hang()
        broker.resume()

    run_scaled(scenario)


@needs_mosquitto
@pytest.mark.parametrize("file", ["svc:wrong", None])
def test_a_wrong_or_missing_password_is_reported_in_one_sentence_and_the_service_goes_on_tracking(
    make_broker, run_scaled, tmp_path, file
):
    broker = make_broker(users={"svc": "secret"}).start()
    credentials = None
    if file is not None:
        credentials = tmp_path / "credentials"
        credentials.write_text(file + "\n")
        credentials.chmod(0o600)

    async def scenario():
        rig = broker_rig(broker.port, mqtt={"credentials_file": credentials})
        async with run_services(rig):
            await rig.until_mode(Mode.TRACKING, 400)
            assert rig.mqtt.status.down_why == (
                f"127.0.0.1:{broker.port} refuses user or password: see mqtt.credentials_file"
            )
            if credentials is not None:
                credentials.write_text("svc:secret")
                await until(lambda: rig.mqtt.status.connected, "the link, once the file was corrected")

    run_scaled(scenario)


def test_a_password_file_that_others_can_read_keeps_the_link_down_while_the_service_tracks(
    broker, run_scaled, tmp_path
):
    credentials = tmp_path / "credentials"
    credentials.write_text("svc:secret")
    credentials.chmod(0o644)

    async def scenario():
        rig = broker_rig(broker.port, mqtt={"credentials_file": credentials})
        async with run_services(rig):
            await rig.until_mode(Mode.TRACKING, 400)
            assert "chmod 640" in rig.mqtt.status.down_why

    run_scaled(scenario)


@needs_mosquitto
def test_a_topic_that_the_access_list_forbids_is_reported_in_one_sentence(make_broker, run_scaled, tmp_path):
    broker = make_broker(users={"svc": "secret"}, acl="user svc\ntopic read lab/#\n").start()
    credentials = tmp_path / "credentials"
    credentials.write_text("svc:secret")
    credentials.chmod(0o600)

    async def scenario():
        rig = broker_rig(broker.port, mqtt={"credentials_file": credentials})
        async with run_services(rig):

            def sentences():
                # Some versions of the broker end the connection, others keep silent.
                return [
                    text for text in (rig.mqtt.status.down_why, *rig.mqtt.status.troubles) if "read and" in (text or "")
                ]

            told = await until(sentences, "a sentence")
            assert "this user read and write heliocube/tracker/#" in told[0]
            await rig.until_mode(Mode.TRACKING, 400)

    run_scaled(scenario)


@needs_mosquitto
def test_tls_connects_with_the_right_authority_and_certificate_and_reports_wrong_ones(make_broker, run_scaled):
    broker = make_broker(tls=True).start()
    own = {"certificate_file": CERTIFICATES / "client.pem", "certificate_key_file": CERTIFICATES / "client.key"}

    async def scenario():
        right = broker_rig(broker.port, mqtt={"tls": True, "ca_file": CERTIFICATES / "ca.pem", **own})
        async with run_services(right):
            await until(lambda: right.mqtt.status.connected, "the link")
        for mqtt, part in [
            ({"ca_file": CERTIFICATES / "other-ca.pem", **own}, "certificate that mqtt.ca_file does not confirm"),
            ({"ca_file": CERTIFICATES / "broker.key", **own}, "mqtt.ca_file"),
            ({"ca_file": CERTIFICATES / "none.pem", **own}, "mqtt.ca_file"),
            ({"ca_file": CERTIFICATES / "ca.pem"}, f"127.0.0.1:{broker.port}"),
        ]:
            rig = broker_rig(broker.port, mqtt={"tls": True, **mqtt})
            async with run_services(rig):
                await until(lambda rig=rig: rig.mqtt.link._backoff._delay_s > 1.0, "a refusal")
                assert part in rig.mqtt.status.down_why
                assert not rig.mqtt.status.connected

    run_scaled(scenario)


@needs_mosquitto
def test_two_services_with_the_same_client_id_do_not_endlessly_disconnect_each_other(broker, run_scaled, log_lines):
    async def scenario():
        first, second = (broker_rig(broker.port, mqtt={"client_id": "same", "name": name}) for name in ("one", "two"))
        async with observer(broker.port) as lab:
            async with run_services(first, second):
                await asyncio.sleep(200)
            births = [
                m
                for name in ("one", "two")
                for m in lab.messages_on(f"heliocube/{name}/status")
                if m.payload == b"online"
            ]
            assert 4 <= len(births) <= 40
            down = [line.getMessage() for line in log_lines() if "broker is down" in line.getMessage()]
            assert any("ended the connection" in line for line in down)
            assert len(down) <= 4

    run_scaled(scenario)


def test_ten_thousand_messages_wait_for_the_broker_and_come_in_order(make_broker, run_scaled):
    broker = make_broker()

    async def scenario():
        rig = broker_rig(broker.port, mqtt={"queue_messages": 10_000})
        for count in range(10_500):
            rig.mqtt.link.send(_numbered(count))
        assert rig.mqtt.status.waiting == 10_000
        assert rig.mqtt.status.dropped == 500
        broker.start()
        async with observer(broker.port, "numbered") as lab:
            serve = asyncio.create_task(rig.mqtt.link.run())
            try:
                await until(lambda: len(lab.heard) >= 10_000, "all that waited", within_s=200)
            finally:
                serve.cancel()
                await asyncio.gather(serve, return_exceptions=True)
            assert [int(message.payload) for message in lab.heard] == list(range(500, 10_500))

    run_scaled(scenario)


def _numbered(count):
    return Message("numbered", str(count).encode(), 0)
