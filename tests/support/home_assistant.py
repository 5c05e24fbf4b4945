"""What Home Assistant documents of device discovery, as data, and a check of a document against it.

The keys are those of https://www.home-assistant.io/integrations/mqtt/#device-discovery-payload and of the pages of the
platforms, .../integrations/sensor.mqtt/, binary_sensor.mqtt/, select.mqtt/ and button.mqtt/. Device classes and their
units are from .../integrations/sensor/#device-class, binary_sensor/#device-class and button/#device-class; of the units
only those that every version since 2024.11 knows.
"""

import re

TEXT, NUMBER, TRUTH, LIST, TABLE = str, int, bool, list, dict

AVAILABILITY = {
    "availability": LIST,
    "availability_mode": TEXT,
    "availability_template": TEXT,
    "availability_topic": TEXT,
    "payload_available": TEXT,
    "payload_not_available": TEXT,
}
DOCUMENT = AVAILABILITY | {
    "device": TABLE,
    "origin": TABLE,
    "components": TABLE,
    "state_topic": TEXT,
    "command_topic": TEXT,
    "qos": NUMBER,
    "encoding": TEXT,
}
DEVICE = {
    "identifiers": LIST,
    "connections": LIST,
    "name": TEXT,
    "manufacturer": TEXT,
    "model": TEXT,
    "model_id": TEXT,
    "serial_number": TEXT,
    "hw_version": TEXT,
    "sw_version": TEXT,
    "suggested_area": TEXT,
    "configuration_url": TEXT,
    "via_device": TEXT,
}
ORIGIN = {"name": TEXT, "sw_version": TEXT, "support_url": TEXT}
ENTITY = AVAILABILITY | {
    "platform": TEXT,
    "unique_id": TEXT,
    "name": TEXT,
    "icon": TEXT,
    "qos": NUMBER,
    "encoding": TEXT,
    "device_class": TEXT,
    "entity_category": TEXT,
    "enabled_by_default": TRUTH,
    "json_attributes_topic": TEXT,
    "json_attributes_template": TEXT,
}
PLATFORMS = {
    "sensor": ENTITY
    | {
        "state_topic": TEXT,
        "value_template": TEXT,
        "unit_of_measurement": TEXT,
        "state_class": TEXT,
        "suggested_display_precision": NUMBER,
        "options": LIST,
        "expire_after": NUMBER,
        "force_update": TRUTH,
        "last_reset_value_template": TEXT,
    },
    "binary_sensor": ENTITY
    | {
        "state_topic": TEXT,
        "value_template": TEXT,
        "payload_on": TEXT,
        "payload_off": TEXT,
        "off_delay": NUMBER,
        "expire_after": NUMBER,
        "force_update": TRUTH,
    },
    "select": ENTITY
    | {
        "command_topic": TEXT,
        "command_template": TEXT,
        "state_topic": TEXT,
        "value_template": TEXT,
        "options": LIST,
        "optimistic": TRUTH,
        "retain": TRUTH,
    },
    "button": ENTITY | {"command_topic": TEXT, "command_template": TEXT, "payload_press": TEXT, "retain": TRUTH},
}
# The document's own state topic serves components without one.
REQUIRED = {
    "sensor": {"unique_id", "state_topic"},
    "binary_sensor": {"unique_id", "state_topic"},
    "select": {"unique_id", "command_topic", "options"},
    "button": {"unique_id", "command_topic"},
}
SHARED = {"state_topic", "command_topic", *AVAILABILITY}
UNITS = {
    "irradiance": {"W/m²", "BTU/(h⋅ft²)"},
    "voltage": {"V", "mV"},
    "current": {"A", "mA"},
    "wind_speed": {"ft/s", "km/h", "kn", "m/s", "mph"},
    "enum": {None},
}
CLASSES = {
    "sensor": set(UNITS),
    "binary_sensor": {
        "battery",
        "battery_charging",
        "carbon_monoxide",
        "cold",
        "connectivity",
        "door",
        "garage_door",
        "gas",
        "heat",
        "light",
        "lock",
        "moisture",
        "motion",
        "moving",
        "occupancy",
        "opening",
        "plug",
        "power",
        "presence",
        "problem",
        "running",
        "safety",
        "smoke",
        "sound",
        "tamper",
        "update",
        "vibration",
        "window",
    },
    "select": set(),
    "button": {"identify", "restart", "update"},
}
# An entity that is only read cannot be a setting.
CATEGORIES = {
    "sensor": {"diagnostic"},
    "binary_sensor": {"diagnostic"},
    "select": {"config", "diagnostic"},
    "button": {"config", "diagnostic"},
}
STATE_CLASSES = {"measurement", "measurement_angle", "total", "total_increasing"}


def discovery_errors(topic, document):
    """Return what Home Assistant would refuse, one line each."""
    found = []
    if not re.fullmatch(r"[^+#]+/device/([A-Za-z0-9_-]+/)?[A-Za-z0-9_-]+/config", topic):
        found.append(f"{topic} is no discovery topic")
    found += _keys("", document, DOCUMENT, {"device", "origin", "components"})
    device, origin = document.get("device", {}), document.get("origin", {})
    found += _keys("device.", device, DEVICE, set())
    if not (device.get("identifiers") or device.get("connections")):
        found.append("device has neither identifiers nor connections")
    found += _keys("origin.", origin, ORIGIN, {"name"})
    if "availability" in document and "availability_topic" in document:
        found.append("availability and availability_topic exclude each other")
    shared = SHARED & document.keys()
    for key, component in document.get("components", {}).items():
        found += _component(key, component, shared)
    return found


def _component(key, component, shared):
    platform = component.get("platform")
    if platform not in PLATFORMS:
        return [f"{key}.platform is {platform}"]
    if set(component) == {"platform"}:
        return []  # removes the entity
    found = _keys(f"{key}.", component, PLATFORMS[platform], REQUIRED[platform] - shared)
    device_class, unit = component.get("device_class"), component.get("unit_of_measurement")
    if device_class is not None and device_class not in CLASSES[platform]:
        found.append(f"{key}.device_class is {device_class}")
    if component.get("entity_category", "diagnostic") not in CATEGORIES[platform]:
        found.append(f"{key}.entity_category is {component['entity_category']}")
    if component.get("qos", 0) not in (0, 1, 2):
        found.append(f"{key}.qos is {component['qos']}")
    if component.get("retain"):
        found.append(f"{key}.retain would make every command a retained one, which is ignored")
    if "options" in component and not (component["options"] and all(isinstance(o, str) for o in component["options"])):
        found.append(f"{key}.options are {component['options']}")
    for name, text in component.items():
        if name.endswith("topic") and (not text or re.search(r"[+#\0]", text)):
            found.append(f"{key}.{name} is {text!r}")
        if name.endswith("template") and text.count("{{") != text.count("}}"):
            found.append(f"{key}.{name} is {text!r}")
    if platform == "sensor":
        if device_class in UNITS and unit not in UNITS[device_class]:
            found.append(f"{key}.unit_of_measurement is {unit} with {device_class}")
        if component.get("state_class", "measurement") not in STATE_CLASSES:
            found.append(f"{key}.state_class is {component['state_class']}")
        of_words = {"state_class", "unit_of_measurement"} & component.keys()
        if ("options" in component) != (device_class == "enum") or (device_class == "enum" and of_words):
            found.append(f"{key}.options belong to the class enum, which has neither state class nor unit")
    return found


def _keys(place, table, documented, required):
    found = [f"{place}{name} is missing" for name in sorted(required - table.keys())]
    for name, value in table.items():
        if name not in documented:
            found.append(f"{place}{name} is not documented")
        elif not isinstance(value, documented[name]) or (isinstance(value, bool) and documented[name] is not TRUTH):
            found.append(f"{place}{name} is {value!r}")
    return found
