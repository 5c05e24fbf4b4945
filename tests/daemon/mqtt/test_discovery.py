"""Home Assistant's view: which entities appear, that they are well-formed, and that none stays behind."""

import asyncio
import json
import re

import pytest
from jinja2.nativetypes import NativeEnvironment

from daemon.base.records import Mode
from daemon.mqtt.discovery import discovery
from daemon.mqtt.topics import Topics
from daemon.tracker.wishes import Wishes
from tests.support import home_assistant
from tests.support.mqtt import SPEED, BrokerRig, observer, run_services, settings_for

TOPICS = Topics("lab/rig", "roof tracker")
TOPIC = "homeassistant/device/lab_rig_roof_tracker/config"


def document(**what):
    whole = {"enabled": True, "commands": True, "tracker": True, "simulated": True} | what
    (message,) = discovery("homeassistant", TOPICS, **whole)
    assert (message.topic, message.retain) == (TOPIC, True)
    return json.loads(message.payload)


@pytest.mark.parametrize("what", [{}, {"commands": False}, {"tracker": False}, {"simulated": False}])
def test_the_discovery_document_has_the_form_that_home_assistant_documents(what):
    assert home_assistant.discovery_errors(TOPIC, document(**what)) == []


def test_the_discovery_document_has_every_kind_of_entity_with_unique_names():
    components = document()["components"]
    names = [component["unique_id"] for component in components.values()]
    assert len(set(names)) == len(names)
    assert {component["platform"] for component in components.values()} == {
        "sensor",
        "binary_sensor",
        "select",
        "button",
    }
    assert components["mode"]["options"] == [mode.value for mode in Mode]
    assert components["command"]["options"] == ["auto", "hold", "stow", "snow", "maintenance"]
    for name in ("stow", "stop", "hold", "auto", "acknowledge"):
        button = components[f"press_{name}"]
        assert button["command_topic"] == TOPICS.command(name)
        assert json.loads(button["payload_press"]).keys() == {"why"}
    assert {key for key, component in components.items() if component.get("entity_category") == "diagnostic"} == {
        "simulated",
        "dropped",
        "why",
        "supply",
        "motor_current_a",
        "motor_current_b",
        "alarm_text",
        "alarm_remedy",
        "faces_not_used",
    }


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda d: d.pop("origin"), "origin is missing"),
        (lambda d: d.update(colour="red"), "colour is not documented"),
        (lambda d: d["device"].pop("identifiers"), "device has neither identifiers nor connections"),
        (lambda d: d["components"]["dropped"].pop("unique_id"), "dropped.unique_id is missing"),
        (lambda d: d["components"]["supply"].update(unit_of_measurement="A"), "supply.unit_of_measurement"),
        (lambda d: d["components"]["supply"].update(entity_category="config"), "supply.entity_category"),
        (lambda d: d["components"]["supply"].update(device_class="tension"), "supply.device_class"),
        (lambda d: d["components"]["mode"].update(state_class="measurement"), "mode.options"),
        (lambda d: d["components"]["command"].pop("command_topic"), "command.command_topic is missing"),
        (lambda d: d["components"]["command"].update(retain=True), "command.retain"),
        (lambda d: d["components"]["press_stow"].update(command_topic="a/#"), "press_stow.command_topic"),
        (lambda d: d["components"]["fault"].update(platform="lamp"), "fault.platform"),
        (lambda d: d.pop("state_topic"), "dropped.state_topic is missing"),
    ],
)
def test_the_checker_of_discovery_documents_finds_faults_that_home_assistant_would_refuse(change, part):
    found = document()
    change(found)
    assert part in "\n".join(home_assistant.discovery_errors(TOPIC, found))


@pytest.mark.parametrize("simulated", [True, False])
def test_the_device_name_says_simulated_only_in_a_simulation(simulated):
    assert ("SIMULATED" in document(simulated=simulated)["device"]["name"]) is simulated


def test_without_commands_or_without_a_tracker_their_entities_are_listed_as_removed():
    all_of_them = document()["components"]
    without = document(commands=False)["components"]
    assert set(without) == set(all_of_them)
    gone = {key for key, component in without.items() if set(component) == {"platform"}}
    assert gone == {key for key, found in all_of_them.items() if found["platform"] in ("select", "button")} | {"reply"}
    cube = document(tracker=False)["components"]
    assert set(cube["mode"]) == {"platform"}
    assert set(cube["command"]) == set(cube["press_stop"]) == {"platform"}
    assert cube["press_acknowledge"]["command_topic"] == TOPICS.command("acknowledge")
    assert set(document(tracker=False, commands=False)["components"]["press_acknowledge"]) == {"platform"}
    assert cube["irradiance_east"]["device_class"] == "irradiance"


def test_the_home_assistant_device_appears_by_itself_and_vanishes_when_discovery_is_off(broker, run_scaled):
    topic = "homeassistant/device/heliocube_tracker/config"

    async def scenario():
        for switched_on in (True, False):
            settings = settings_for(broker.port, mqtt={"discovery": switched_on})
            rig = BrokerRig(asyncio.get_running_loop(), settings, SPEED)
            async with observer(broker.port) as lab, run_services(rig):
                await lab.until("heliocube/tracker/scan")
            async with observer(broker.port) as late:
                await late.until("heliocube/tracker/status")
                await asyncio.sleep(SPEED / 2)
                assert bool(late.messages_on(topic)) is switched_on

    run_scaled(scenario)


def test_every_home_assistant_template_finds_its_value_in_the_state_and_buttons_send_commands(broker, run_scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = BrokerRig(asyncio.get_running_loop(), settings_for(broker.port), SPEED)
            async with run_services(rig):
                found = await lab.until("homeassistant/device/heliocube_tracker/config")
                tracking = await lab.until("heliocube/tracker/state", lambda s: s["mode"]["name"] == "tracking")
                first = await lab.until("heliocube/tracker/state")
                components = found["components"]
                for component in components.values():
                    # A component with a topic of its own is not read from the state.
                    if "state_topic" in component:
                        continue
                    for path in re.findall(r"value_json((?:\.\w+)+)", component.get("value_template", "")):
                        _follow(tracking, path)
                values = {key: _rendered(found, tracking) for key, found in components.items() if key != "reply"}
                assert values["mode"] == "tracking"
                assert values["command"] == "auto"
                assert values["connected"] == "ON"
                assert (values["alarm"], values["alarm_text"]) == ("OFF", "none")
                assert (values["unacknowledged"], values["alarm_remedy"]) == ("OFF", "none")
                for mode in ("hold", "stow", "snow", "maintenance", "fault"):
                    found_mode = _rendered(components["command"], {**tracking, "mode": {"name": mode}})
                    assert found_mode == ("auto" if mode == "fault" else mode)
                for mode, at_stow, shown in [("stow", False, "OFF"), ("stow", True, "ON"), ("tracking", True, "OFF")]:
                    seen = {**tracking, "mode": {"name": mode}, "at_stow": at_stow}
                    assert _rendered(components["stowed"], seen) == shown
                assert values["readings"] == "OFF"
                assert 0 < values["irradiance_zenith"] < 1500
                assert values["angle_b"] == pytest.approx(tracking["tracker"]["pose"]["b_deg"])
                assert _rendered(components["irradiance_east"], {**first, "scan": None}) is None
                assert _rendered(components["readings"], {**first, "scan": None}) == "ON"
                assert _rendered(components["faces_not_used"], {**first, "scan": None}) == "no scan"
                assert values["faces_not_used"] == "none"
                for face, quality in (("south", "implausible"), ("west", "over-range")):
                    tracking["scan"]["faces"][face]["quality"] = quality
                assert _rendered(components["faces_not_used"], tracking) == "south implausible, west over-range"
                assert _rendered(components["irradiance_south"], tracking) is None
                assert _rendered(components["irradiance_east"], tracking) is not None
                button = components["press_stow"]
                await lab.publish(button["command_topic"], button["payload_press"])
                assert (await lab.until(components["reply"]["state_topic"]))["accepted"] is True
                await rig.until_mode(Mode.STOW, 100)
                await lab.publish(components["press_hold"]["command_topic"], "{}")
                refused = await lab.until("heliocube/tracker/reply", lambda reply: not reply["accepted"])
                assert _rendered(components["reply"], refused).startswith("hold refused: no hold while the tracker is")
                assert _rendered(components["reply"], {**refused, "accepted": True}).startswith("hold: no hold")
                assert len(_rendered(components["reply"], {**refused, "text": "a" * 300})) == 255

    run_scaled(scenario)


ALARMS = [
    {"name": "positioner-down", "state": "raised", "text": "the positioner has not answered: it is not plugged in"},
    {"name": "cube-face", "state": "acknowledged", "text": "the south face reads next to nothing"},
    {"name": "move-failed", "state": "cleared", "text": "a move failed"},
]
MANY = [{"name": "cube-face", "state": "raised", "text": f"{number} more"} for number in range(12)]


@pytest.mark.parametrize(("alarms", "shown"), [
    ([], "none"),
    (ALARMS, f"{ALARMS[0]['text']}; {ALARMS[1]['text']}; over: a move failed"),
    ([ALARMS[0], {**ALARMS[0], "name": "reference"}], ALARMS[0]["text"]),
    ([{**ALARMS[0], "text": "a" * 300}], "a" * 255),
    ([{**ALARMS[0], "text": "a" * 300}, *ALARMS[1:]], "a" * 220 + "; also cube-face, over: move-failed"),
    ([{**ALARMS[0], "text": "a" * 300}, *MANY], "a" * 242 + "; and 12 more"),
])  # fmt: skip
def test_the_alarm_text_lists_all_alarms_as_far_as_255_characters_of_home_assistant_allow(alarms, shown):
    assert _rendered(document()["components"]["alarm_text"], {"alarms": alarms}) == shown
    assert len(shown) <= 255


@pytest.mark.parametrize(("state", "waiting", "shown"), [
    ("raised", 1, ("ON", "ON")),
    ("acknowledged", 0, ("ON", "OFF")),
    ("cleared", 1, ("OFF", "ON")),
])  # fmt: skip
def test_the_two_alarm_sensors_together_show_each_state_of_an_alarm(state, waiting, shown):
    components, found = document()["components"], {"alarms": [{**ALARMS[0], "state": state}], "unacknowledged": waiting}
    assert tuple(_rendered(components[name], found) for name in ("alarm", "unacknowledged")) == shown


@pytest.mark.parametrize(("mode", "wish", "shown"), [
    ("fault", "stop", "hold"),
    ("fault", "buttons", "hold"),
    ("starting", "hold", "hold"),
    ("fault", "stow", "stow"),
    ("fault", "snow", "snow"),
    ("stow", "hold", "stow"),
    ("fault", None, "auto"),
    ("tracking", None, "auto"),
])  # fmt: skip
def test_the_command_entity_shows_what_a_person_asked_for_even_while_a_fault_prevents_it(mode, wish, shown):
    wishes = {name: {"why": "x"} if name == wish else None for name in Wishes.model_fields}
    state = {"mode": {"name": mode}, "wishes": wishes}
    assert _rendered(document()["components"]["command"], state) == shown


def test_an_angle_of_zero_is_shown_without_a_sign():
    state = {"tracker": {"pose": {"a_deg": -0.0, "b_deg": 90.0, "stale": False}}}
    assert str(_rendered(document()["components"]["angle_a"], state)) == "0.0"


@pytest.mark.parametrize(
    ("moving", "homing", "shown"), [(False, False, "OFF"), (True, False, "ON"), (False, True, "ON")]
)
def test_the_moving_sensor_is_also_on_during_a_reference_run(moving, homing, shown):
    state = {"tracker": {"moving": moving, "homing": homing}}
    assert _rendered(document()["components"]["moving"], state) == shown


def _follow(found, path):
    for name in path.strip(".").split("."):
        assert name in found, path
        found = found[name]
    return found


def _rendered(component, state):
    template = component.get("value_template")
    return None if template is None else NativeEnvironment().from_string(template).render(value_json=state)
