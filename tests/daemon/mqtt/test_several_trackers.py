"""Two trackers of one process on a broker: topics, commands, availability and a device for each."""

import asyncio
import json
import logging

from daemon.base.process import LineFormatter
from daemon.base.records import Mode
from tests.support.mqtt import SPEED, BrokerRig, observer, run_services, settings_for, until


def test_each_tracker_has_its_own_topics_commands_and_device(broker, run_scaled):
    settings = settings_for(broker.port, tracker=[{"name": "east"}, {"name": "west"}])

    async def scenario():
        rig = BrokerRig(asyncio.get_running_loop(), settings, SPEED)
        east, west = rig.service.trackers
        async with observer(broker.port) as lab:
            async with run_services(rig):
                both = (east, west)
                await until(lambda: all(t.control.mode is Mode.TRACKING for t in both), "tracking of both")
                for name in ("east", "west"):
                    assert await lab.until(f"heliocube/{name}/status") == "online"
                    found = await lab.until(f"homeassistant/device/heliocube_{name}/config")
                    assert (found["device"]["name"], found["state_topic"]) == (
                        f"{name} (SIMULATED)",
                        f"heliocube/{name}/state",
                    )
                await lab.publish("heliocube/west/command/hold", {"why": "test"})
                reply = await lab.until("heliocube/west/reply")
                assert reply["accepted"]
                await lab.until("heliocube/west/state", lambda state: state["mode"]["name"] == "hold")
                assert (east.control.mode, west.control.mode) == (Mode.TRACKING, Mode.HOLD)
                state = await lab.until("heliocube/east/state", lambda state: state["mode"]["name"] == "tracking")
                assert (state["tracker"]["connected"], state["tracker"]["name"]) == (True, "east")
                await lab.publish("heliocube/west/command/hold", {"tracker": "east"})
                refused = await lab.until("heliocube/west/reply", lambda reply: not reply["accepted"])
                assert refused["text"] == "this is for west, but the body names the tracker 'east'"
                for name in ("east", "west"):
                    modes = [json.loads(message.payload) for message in lab.messages_on(f"heliocube/{name}/mode")]
                    assert {mode["tracker"] for mode in modes} == {name}
                    await lab.until(f"heliocube/{name}/scan")
            for name in ("east", "west"):
                await lab.until(f"heliocube/{name}/status", lambda word: word == "offline")

    run_scaled(scenario)


def test_log_lines_about_an_mqtt_link_name_its_tracker(broker, run_scaled, caplog):
    caplog.set_level(logging.INFO, "heliocube")
    wind, lines = {"wind": {"topic": "lab/wind"}}, []
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(LineFormatter(journal=True).format(record))
    settings = settings_for(broker.port, mqtt=wind, tracker=[{"name": "east"}, {"name": "west"}])

    async def scenario():
        rig = BrokerRig(asyncio.get_running_loop(), settings, SPEED)
        async with observer(broker.port) as lab, run_services(rig):
            await until(lambda: all(link.connected for link in rig.statuses.values()), "both links")
            await lab.publish("lab/wind", "gusty")
            await until(lambda: all(link.troubles for link in rig.statuses.values()), "a trouble of both")

    logging.getLogger("heliocube").addHandler(handler)
    try:
        run_scaled(scenario)
    finally:
        logging.getLogger("heliocube").removeHandler(handler)
    for text in ("connected to the MQTT broker", "mqtt.wind of lab/wind cannot be used"):
        assert {line.rpartition(" ")[2] for line in lines if text in line} == {"tracker=east", "tracker=west"}


def test_one_stop_message_stops_every_tracker_and_each_stays_stopped_until_its_own_auto(broker, run_scaled):
    settings = settings_for(broker.port, tracker=[{"name": name} for name in ("east", "west", "north")])

    async def scenario():
        rig = BrokerRig(asyncio.get_running_loop(), settings, SPEED)
        modes = {tracker.name: tracker.control for tracker in rig.service.trackers}
        async with observer(broker.port) as lab, run_services(rig):
            await until(lambda: {each.mode for each in modes.values()} == {Mode.TRACKING}, "tracking of all")
            await lab.publish("heliocube/command/stop", {"why": "fire", "id": "7"})
            for name in modes:
                reply = await lab.until(f"heliocube/{name}/reply")
                assert (reply["id"], reply["command"], reply["accepted"]) == ("7", "stop", True)
            assert {each.mode for each in modes.values()} == {Mode.HOLD}
            await lab.publish("heliocube/command/stow", {"why": "storm"})
            refused = await lab.until("heliocube/west/reply", lambda reply: reply["command"] == "stow")
            assert not refused["accepted"]
            await lab.publish("heliocube/command/auto", {})
            await lab.publish("heliocube/east/command/auto", {})
            await until(lambda: modes["east"].mode is Mode.TRACKING, "the release of one")
            assert (modes["west"].mode, modes["north"].mode) == (Mode.HOLD, Mode.HOLD)

    run_scaled(scenario)


def test_a_stop_on_the_topic_of_one_tracker_that_names_another_tracker_stops_both(broker, run_scaled):
    settings = settings_for(broker.port, tracker=[{"name": "east"}, {"name": "west"}])

    async def scenario():
        rig = BrokerRig(asyncio.get_running_loop(), settings, SPEED)
        both = rig.service.trackers
        async with observer(broker.port) as lab, run_services(rig):
            await until(lambda: all(t.control.mode is Mode.TRACKING for t in both), "tracking of both")
            await lab.publish("heliocube/west/command/stop", {"tracker": "east"})
            reply = await lab.until("heliocube/west/reply")
            assert [tracker.control.wishes.stop is not None for tracker in both] == [True, True]
            assert not reply["accepted"]
            start = "this is for west, but the body names the tracker 'east'; so the stop is for all: all 2 trackers:\n"
            assert reply["text"].startswith(start)

    run_scaled(scenario)
