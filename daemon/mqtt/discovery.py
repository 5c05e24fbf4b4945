"""Home Assistant's discovery: one retained message that makes a device with all its entities appear, or vanish.

The form is that of Home Assistant's device discovery, which it knows since 2024.11.
"""

import re
from importlib.metadata import version
from typing import Any

from daemon.base.records import FACES, Mode
from daemon.mqtt.link import OFFLINE, ONLINE
from daemon.mqtt.outbox import Message
from daemon.mqtt.telemetry import encoded
from daemon.mqtt.topics import Topics
from daemon.service.command_bodies import MODES

_NOT_IN_AN_ID = re.compile(r"[^A-Za-z0-9_-]")
_PRESS = '{"why":"a button in Home Assistant"}'
_DATED = '{{{}, "id": "{{{{ utcnow().timestamp() }}}}", "time": "{{{{ utcnow().isoformat() }}}}"}}'
# Home Assistant takes the word None for "unknown".
_ON_OFF = "{{{{ 'ON' if {} else 'OFF' }}}}"
# Home Assistant takes no state of more than 255 letters: then the first alarm has its text, and the others are only
# named or counted.
_ALARM_TEXT = (
    "{% set all = namespace(texts=[], names=[]) %}{% for alarm in value_json.alarms %}"
    "{% set over = 'over: ' if alarm.state == 'cleared' else '' %}{% if over ~ alarm.text not in all.texts %}"
    "{% set all.texts = all.texts + [over ~ alarm.text] %}{% set all.names = all.names + [over ~ alarm.name] %}"
    "{% endif %}{% endfor %}"
    "{% set texts = all.texts | join('; ') or 'none' %}{% set names = all.names[1:] | join(', ') %}"
    "{% set rest = '; also ' ~ names if names | length <= 120 else '; and ' ~ (all.names | length - 1) ~ ' more' %}"
    "{% set rest = rest if names else '' %}"
    "{{ texts if texts | length <= 255 else all.texts[0][:255 - rest | length] ~ rest }}"
)


def discovery(
    prefix: str, topics: Topics, *, enabled: bool, commands: bool, tracker: bool, simulated: bool, dated: bool = False
) -> list[Message]:
    """Return the message to publish at each connection: the device, or with `enabled` False the one that removes it.

    Parameters
    ----------
    prefix
        Home Assistant's own, normally ``homeassistant``.
    topics
        Of this process.
    commands, tracker
        Whether commands are taken, and whether there is a tracker at all. Entities that need what is not there are
        removed, in case an earlier run has announced them.
    dated
        Whether commands have to bear an identifier and a time, which Home Assistant then adds.
    simulated
        Shown in the device's name.
    """
    node = _NOT_IN_AN_ID.sub("_", topics.base)
    topic = f"{prefix}/device/{node}/config"
    if not enabled:
        return [Message(topic, b"", 1, retain=True)]
    orders = _commands(topics, dated=dated)
    orders["reply"] = _reply(topics)
    known = _CUBE | _TRACKER | orders
    offered = known if tracker else _CUBE | {key: orders[key] for key in _ORDERS_OF_A_CUBE}
    if not commands:
        offered = {key: entity for key, entity in offered.items() if key not in orders}
    components: dict[str, dict[str, Any]] = {}
    for key, found in known.items():
        if key in offered:
            # Some versions of Home Assistant do not pass the document's own quality of service on to its components.
            components[key] = {**found, "unique_id": f"{node}_{key}", "qos": 1}
        else:
            components[key] = {"platform": found["platform"]}
    note = " (SIMULATED)" if simulated else ""
    payload = {
        "device": {
            "identifiers": [node],
            "name": f"{topics.name}{note}",
            "manufacturer": "heliocube",
            "model": f"sun tracker{note}" if tracker else f"radiometric cube{note}",
            "sw_version": version("heliocube"),
        },
        "origin": {"name": "heliocube", "sw_version": version("heliocube")},
        "availability_topic": topics.status,
        "payload_available": ONLINE.decode(),
        "payload_not_available": OFFLINE.decode(),
        "state_topic": topics.state,
        "components": components,
    }
    return [Message(topic, encoded(payload), 1, retain=True)]


def _sensor(name: str, template: str, unit: str | None, device_class: str | None = None, **more: Any) -> dict[str, Any]:
    found = {"platform": "sensor", "name": name, "value_template": f"{{{{ {template} }}}}", **more}
    if unit is not None:
        found |= {"unit_of_measurement": unit, "state_class": "measurement", "suggested_display_precision": 1}
    if device_class is not None:
        found["device_class"] = device_class
    return found


def _binary(name: str, condition: str, device_class: str | None = None, **more: Any) -> dict[str, Any]:
    found = {"platform": "binary_sensor", "name": name, "value_template": _ON_OFF.format(condition), **more}
    return found if device_class is None else {**found, "device_class": device_class}


def _face(name: str) -> dict[str, Any]:
    scan = "value_json.scan"
    value = f"{scan}.faces.{name}.irradiance_w_m2 if {scan} and {scan}.faces.{name}.quality == 'ok' else none"
    return _sensor(f"Irradiance {name}", value, "W/m²", "irradiance")


def _bad_faces() -> dict[str, Any]:
    """Return the sensor that names each face that is not used, with its quality."""
    faces = {name: f"value_json.scan.faces.{name}.quality" for name in FACES}
    each = [f"('{name} ' + {quality} + ', ' if {quality} != 'ok' else '')" for name, quality in faces.items()]
    bad = f"(({' + '.join(each)})[:-2] or 'none') if value_json.scan else 'no scan'"
    return _sensor("Faces not used", bad, None, None, **_DIAGNOSTIC)


def _pose(axis: str) -> dict[str, Any]:
    pose = "value_json.tracker.pose"
    # Home Assistant would show -0.0.
    return _sensor(f"Angle {axis.upper()}", f"{pose}.{axis}_deg + 0 if {pose} and not {pose}.stale else none", "°")


def _motor(axis: str) -> dict[str, Any]:
    value = f"value_json.tracker.motor_current_a.{axis}"
    return _sensor(f"Motor current {axis.upper()}", value, "A", "current", **_DIAGNOSTIC)


def _reply(topics: Topics) -> dict[str, Any]:
    """Return the sensor that tells what came of the last command: nothing else in Home Assistant shows a refusal."""
    text = "(value_json.command ~ (': ' if value_json.accepted else ' refused: ') ~ value_json.text)[:255]"
    topic = {"state_topic": topics.reply, "json_attributes_topic": topics.reply}
    return _sensor("Last reply", text, None, None, **topic, force_update=True)


def _commands(topics: Topics, *, dated: bool) -> dict[str, dict[str, Any]]:
    kept = [mode for mode in MODES if mode != "auto"]
    # In a fault, and at the start, a person's wish is in force all the same.
    mode, wishes = "value_json.mode.name", "value_json.wishes"
    held = f"'hold' if {wishes}.stop or {wishes}.buttons or {wishes}.hold"
    wished = f"{held} else 'stow' if {wishes}.stow else 'snow' if {wishes}.snow else 'auto'"
    chosen = f"{mode} if {mode} in {kept} else {wished}"
    select = {
        "platform": "select",
        "name": "Command",
        "options": list(MODES),
        "command_topic": topics.command("mode"),
        "value_template": f"{{{{ {chosen} }}}}",
        **({"command_template": _DATED.format('"mode": "{{ value }}"')} if dated else {}),
    }
    buttons = {
        f"press_{name}": {
            "platform": "button",
            "name": label,
            "icon": f"mdi:{icon}",
            "command_topic": topics.command(name),
            "payload_press": _PRESS,
            **({"command_template": _DATED.format(_PRESS.strip("{}"))} if dated else {}),
        }
        for name, label, icon in (
            ("stow", "Stow", "weather-windy"),
            ("stop", "Stop", "stop"),
            ("hold", "Hold", "pause"),
            ("auto", "Track", "weather-sunny"),
            ("acknowledge", "Acknowledge alarms", "bell-check"),
        )
    }
    return {"command": select, **buttons}


_ORDERS_OF_A_CUBE = ("press_acknowledge", "reply")
_DIAGNOSTIC = {"entity_category": "diagnostic"}
_CUBE = {
    **{f"irradiance_{name}": _face(name) for name in FACES},
    "sun_elevation": _sensor("Sun elevation", "value_json.sun_elevation_deg", "°"),
    "faces_not_used": _bad_faces(),
    "readings": _binary("Cube readings", "not value_json.scan or value_json.scan.stale", "problem"),
    "simulated": _binary("Simulated", "value_json.simulated", **_DIAGNOSTIC),
    # The sensor "unacknowledged" shows alarms that are over but wait for a person: the two together show an alarm's
    # three states.
    "alarm": _binary("Alarm", "value_json.alarms | rejectattr('state', 'eq', 'cleared') | list", "problem"),
    "alarm_text": {"platform": "sensor", "name": "Alarm text", "value_template": _ALARM_TEXT, **_DIAGNOSTIC},
    "alarm_remedy": _sensor(
        "Alarm remedy", "value_json.alarms[0].remedy[:255] if value_json.alarms else 'none'", None, None, **_DIAGNOSTIC
    ),
    "unacknowledged": _binary("Alarm unacknowledged", "value_json.unacknowledged", "problem"),
    "dropped": _sensor("Messages dropped", "value_json.mqtt.dropped", None, None, **_DIAGNOSTIC),
}
_TRACKER = {
    "mode": _sensor("Mode", "value_json.mode.name", None, "enum", options=[mode.value for mode in Mode]),
    "why": _sensor("Reason", "value_json.mode.why[:255]", None, None, **_DIAGNOSTIC),
    "angle_a": _pose("a"),
    "angle_b": _pose("b"),
    "supply": _sensor("Supply", "value_json.tracker.supply_v", "V", "voltage", **_DIAGNOSTIC),
    "motor_current_a": _motor("a"),
    "motor_current_b": _motor("b"),
    "connected": _binary("Positioner", "value_json.tracker.connected", "connectivity"),
    "wind": _sensor("Wind", "value_json.wind_m_s", "m/s", "wind_speed"),
    "stow_release": _sensor("Calm until release", "value_json.stow_release_in_s", "s"),
    "moving": _binary("Moving", "value_json.tracker.moving or value_json.tracker.homing", "moving"),
    # Both are needed: the mode alone only says where the tracker was told to go, and it lies flat under clouds as well.
    "stowed": _binary("Stowed", "value_json.mode.name == 'stow' and value_json.at_stow"),
    "fault": _binary("Fault", "value_json.mode.name == 'fault'", "problem"),
}
