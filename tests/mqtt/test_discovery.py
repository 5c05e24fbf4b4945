"""Home Assistant's view: what appears, that it is well-formed, and that nothing stays behind."""

import asyncio
import json
import re

import pytest

from daemon.mqtt.discovery import discovery
from daemon.mqtt.topics import Topics
from daemon.records import Mode

from .conftest import SPEED, MqttBench, observer, serving, settings_for

TOPICS = Topics("lab/rig", "roof tracker")
TOPIC = "homeassistant/device/lab_rig_roof_tracker/config"

# From Home Assistant's documentation of its MQTT integration: the keys of each platform, required ones first.
COMMON = {"name", "unique_id", "entity_category", "icon", "qos", "enabled_by_default", "device_class"}
KEYS = {
    "sensor": (
        {"value_template"},
        COMMON | {"state_topic", "state_class", "unit_of_measurement", "options", "suggested_display_precision"},
    ),
    "binary_sensor": ({"value_template"}, COMMON | {"state_topic", "payload_on", "payload_off"}),
    "select": ({"command_topic", "options"}, COMMON | {"value_template", "state_topic", "command_template"}),
    "button": ({"command_topic"}, COMMON | {"payload_press", "command_template"}),
}
UNITS = {"irradiance": {"W/m²", "BTU/(h⋅ft²)"}, "voltage": {"V", "mV", "µV", "kV", "MV"}, "enum": {None}}
BINARY_CLASSES = {"problem", "connectivity", "moving", "safety", "running", "power"}
DEVICE = {"identifiers", "name", "manufacturer", "model", "sw_version"}
DOCUMENT = {
    "device", "origin", "components", "availability_topic", "payload_available", "payload_not_available", "state_topic",
    "qos",
}  # fmt: skip


def document(**what):
    whole = {"enabled": True, "commands": True, "tracker": True, "simulated": True} | what
    (message,) = discovery("homeassistant", TOPICS, **whole)
    assert (message.topic, message.retain) == (TOPIC, True)
    return json.loads(message.payload)


def check_component(key, found):
    platform = found["platform"]
    required, optional = KEYS[platform]
    keys = set(found) - {"platform"}
    assert keys >= required | {"unique_id", "name"}, key
    assert keys <= required | optional, key
    device_class, unit = found.get("device_class"), found.get("unit_of_measurement")
    if platform == "sensor":
        if device_class is not None:
            assert unit in UNITS[device_class], key
        assert ("options" in found) == (device_class == "enum"), key
        assert ("state_class" in found) == (unit is not None), key
    elif platform == "binary_sensor" and device_class is not None:
        assert device_class in BINARY_CLASSES
    assert found.get("entity_category") in (None, "diagnostic", "config")
    assert not re.search(r"[+#]", found.get("command_topic", ""))


def test_the_document_is_of_the_form_that_home_assistant_asks_for():
    found = document()
    assert re.fullmatch(r"homeassistant/device/[A-Za-z0-9_-]+/config", TOPIC)
    assert set(found) == DOCUMENT
    assert set(found["device"]) == DEVICE
    assert found["origin"]["name"]
    for key, component in found["components"].items():
        check_component(key, component)
    names = [component["unique_id"] for component in found["components"].values()]
    assert len(set(names)) == len(names)
    platforms = {component["platform"] for component in found["components"].values()}
    assert platforms == {"sensor", "binary_sensor", "select", "button"}
    assert found["components"]["mode"]["options"] == [mode.value for mode in Mode]


@pytest.mark.parametrize("simulated", [True, False])
def test_a_simulation_bears_its_name(simulated):
    assert ("SIMULATED" in document(simulated=simulated)["device"]["name"]) is simulated


def test_without_commands_or_without_a_tracker_their_entities_are_removed_and_not_forgotten():
    all_of_them = document()["components"]
    without = document(commands=False)["components"]
    assert set(without) == set(all_of_them)
    gone = {key for key, component in without.items() if set(component) == {"platform"}}
    assert gone == {key for key, component in all_of_them.items() if component["platform"] in ("select", "button")}
    cube = document(tracker=False)["components"]
    assert set(cube["mode"]) == {"platform"}
    assert set(cube["command"]) == {"platform"}
    assert cube["irradiance_east"]["device_class"] == "irradiance"


def test_it_appears_by_itself_and_vanishes_when_it_is_switched_off(broker, scaled):
    topic = "homeassistant/device/heliocube_tracker/config"

    async def scenario():
        for switched_on in (True, False):
            settings = settings_for(broker.port, mqtt={"discovery": switched_on})
            rig = MqttBench(asyncio.get_running_loop(), settings, SPEED)
            async with observer(broker.port) as lab, serving(rig):
                await lab.until("heliocube/tracker/scan")
            async with observer(broker.port) as late:
                await late.until("heliocube/tracker/status")
                await asyncio.sleep(SPEED / 2)
                assert bool(late.on(topic)) is switched_on

    scaled(scenario)


def test_every_template_finds_its_value_in_the_state_and_every_button_is_a_command(broker, scaled):
    async def scenario():
        async with observer(broker.port) as lab:
            rig = MqttBench(asyncio.get_running_loop(), settings_for(broker.port), SPEED)
            async with serving(rig):
                found = await lab.until("homeassistant/device/heliocube_tracker/config")
                tracking = await lab.until("heliocube/tracker/state", lambda s: s["mode"]["name"] == "tracking")
                first = await lab.until("heliocube/tracker/state")
                components = found["components"]
                for component in components.values():
                    for path in re.findall(r"value_json((?:\.\w+)+)", component.get("value_template", "")):
                        _follow(tracking, path)
                values = {key: _rendered(component, tracking) for key, component in components.items()}
                assert values["mode"] == "tracking"
                assert values["command"] == "auto"
                assert values["connected"] == "ON"
                assert values["readings"] == "OFF"
                assert 0 < values["irradiance_zenith"] < 1500
                assert values["angle_b"] == pytest.approx(tracking["tracker"]["pose"]["b_deg"])
                assert _rendered(components["irradiance_east"], {**first, "scan": None}) is None
                assert _rendered(components["readings"], {**first, "scan": None}) == "ON"
                button = components["press_stow"]
                await lab.say(button["command_topic"], button["payload_press"])
                assert (await lab.until("heliocube/tracker/reply"))["accepted"] is True
                await rig.until_mode(Mode.STOW, 100)

    scaled(scenario)


def _follow(found, path):
    for name in path.strip(".").split("."):
        assert name in found, path
        found = found[name]
    return found


class _Dotted(dict):
    """Lets Python read the templates, whose expressions are Python's as well but for dots and `none`."""

    def __getattr__(self, name):
        value = self[name]
        return _Dotted(value) if isinstance(value, dict) else value


def _rendered(component, state):
    template = component.get("value_template")
    if template is None:
        return None
    expression = re.fullmatch(r"\{\{ (.*) \}\}", template)[1]
    return eval(expression, {"value_json": _Dotted(state), "none": None})
