"""What is known of every key of the configuration, read from the models: default, unit, permitted values, meaning."""

import difflib
import json
import re
import sys
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, time
from functools import cache
from inspect import cleandoc
from typing import Any

from pydantic import BaseModel

from daemon.config.plugin_sections import DRIVER, PLUGIN_SECTIONS, PluginSection
from daemon.config.sections import Sections

_LONGEST_VALUE = 60
Drivers = tuple[tuple[str, str], ...]
"""The path of each section that names a driver, and the driver's name."""

_BARE_NAME = re.compile(r"[A-Za-z0-9_-]+")
_UNITS = {
    "w_m2_per_mv": "W/m2 per mV",
    "per_deg": "per deg",
    "deg_per_s": "deg/s",
    "w_m2": "W/m2",
    "mm_s": "mm/s",
    "m_s": "m/s",
    "deg": "deg",
    "mv": "mV",
    "hz": "Hz",
    "s": "s",
    "m": "m",
    "v": "V",
}
# Units that people write by mistake: the quantity, and how many of the quantity's first unit one of this unit is.
_MAGNITUDES = {
    "m_s": ("speed", 1.0),
    "mm_s": ("speed", 1e-3),
    "km_h": ("speed", 1 / 3.6),
    "kmh": ("speed", 1 / 3.6),
    "kph": ("speed", 1 / 3.6),
    "mph": ("speed", 0.44704),
    **dict.fromkeys(("kn", "kt", "kts", "knots"), ("speed", 1852 / 3600)),
    "s": ("time", 1.0),
    "sec": ("time", 1.0),
    "seconds": ("time", 1.0),
    "ms": ("time", 1e-3),
    "min": ("time", 60.0),
    "minutes": ("time", 60.0),
    "h": ("time", 3600.0),
    "hours": ("time", 3600.0),
    "deg": ("angle", 1.0),
    "degrees": ("angle", 1.0),
    "rad": ("angle", 57.29577951308232),
    "m": ("length", 1.0),
    "km": ("length", 1e3),
    "ft": ("length", 0.3048),
    "w_m2": ("irradiance", 1.0),
    "kw_m2": ("irradiance", 1e3),
    "v": ("voltage", 1.0),
    "mv": ("voltage", 1e-3),
    "uv": ("voltage", 1e-6),
}
_UNITS_LONGEST_FIRST = sorted({*_UNITS, *_MAGNITUDES}, key=len, reverse=True)
_FORMAT_WORDS = {
    "path": "a path in quotes",
    "date-time": "a date and time with its UTC offset, without quotes, such as 2022-10-14T06:00:00Z",
    "name": "1 to 32 letters, digits, dots, dashes or underscores, a letter or digit first",
    "listen": 'a numeric address and a port up to 65535, such as "0.0.0.0:20571" or "[::]:20571"',
    "address": 'a numeric address and a port from 1 to 65535, such as "192.168.1.20:20571" or "[fd00::20]:20571"',
    "tracker": "a numeric address, of one machine and not of all in its network, and a port from 1 to 65535, such as"
    ' "192.168.1.20:20571" or "[fd00::20]:20571"',
    "group": 'an IPv4 multicast group and a port, such as "239.255.20.71:20571"',
    "ip": 'a numeric address such as "192.168.1.10"',
    "port": 'a port whose name outlives a replug: "/dev/serial/by-id/...", a link made by a udev rule, or "COM5";'
    " not /dev/ttyACM0, which may be another instrument after the next replug",
    "modbus-line": 'a serial port whose name outlives a replug, such as "/dev/serial/by-id/..." or "COM5",'
    ' "tcp:192.168.1.40:502" for Modbus TCP, or "rtu-over-tcp:192.168.1.40:4001"; not /dev/ttyUSB0, which may be'
    " another adapter after the next replug",
    "visa": 'a VISA name that outlives a replug, such as "ASRL/dev/serial/by-id/...::INSTR", "ASRLCOM5::INSTR" or'
    ' "GPIB0::16::INSTR"; not ASRL/dev/ttyUSB0, which may be another instrument after the next replug',
    "visa-or-socket": 'a VISA name that outlives a replug, such as "GPIB0::9::INSTR" or'
    ' "ASRL/dev/serial/by-id/...::INSTR", or the instrument\'s socket, "TCPIP::192.168.1.60::5025::SOCKET"',
    "server": 'a host and a port, such as "192.168.1.30:31763"',
    "banner": "4 to 80 printable characters of ASCII without $",
    "digital-port": 'an NI device and its port, such as "Dev1/port0"',
    "topic": 'a topic without wildcards in quotes, such as "lab/roof"',
    "level": 'one level of a topic in quotes, such as "roof"',
    "json-path": 'names with full stops between, in quotes, such as "wind.speed", or ""',
    "host": 'a name or an address in quotes, such as "broker.lab" or "192.168.1.5"',
    "clock-time": 'hours and minutes of the day in quotes, such as "22:00"',
    "archive": "the address of a database in quotes, without a password, such as"
    ' "postgresql://archive@db.plant/heliocube"',
    "records": 'topics in quotes that end in /records, such as "+/+/records"',
    "web": 'a web address in quotes, such as "https://tracker.lab/"',
    "ipv4": 'a numeric IPv4 address of this machine, such as "192.168.1.20"',
}


@dataclass(frozen=True, slots=True)
class Key:
    """One key of the file.

    Attributes
    ----------
    path, section, name
        ``safety.stow_wind_m_s`` is ``stow_wind_m_s`` in section ``safety``.
    schema
        The permitted values as JSON Schema.
    default
        None where the key may be left out and has no value then.
    only_for
        The drivers that know the key, if the chosen one does not.
    """

    path: str
    section: str
    name: str
    schema: dict[str, Any]
    default: Any
    only_for: tuple[str, ...] = ()

    @property
    def description(self) -> str:
        """Meaning of the key, in sentences."""
        return "".join(f"{name}: " for name in (", ".join(self.only_for),) if name) + str(self.schema["description"])

    @property
    def example(self) -> str:
        """A value, as TOML writes it, for a key that has no default."""
        value = self.schema["examples"][0]
        return str(value) if self.schema["anyOf"][0].get("format") == "date-time" else toml_value(value)

    @property
    def unit(self) -> str:
        """Unit of the value, from the name's ending; empty where there is none."""
        return _UNITS.get(split_unit(self.name)[1], "")

    @property
    def enum_values(self) -> list[str]:
        """The words that the value may be, if it may be one of a few."""
        return [name for part in self._alternatives for name in part.get("enum", ()) if isinstance(name, str)]

    @property
    def json_types(self) -> set[str]:
        """JSON types of the permitted values."""
        return {str(part["type"]) for part in self._alternatives}

    @property
    def expected(self) -> str:
        """The permitted values in words, with the unit: 'a number from -90 to 90 deg'."""
        return " or ".join(_expected(part, self.unit) for part in self._alternatives)

    @property
    def expected_item(self) -> str:
        """What one item of a list may be, in words."""
        return " or ".join(_expected(part["items"], self.unit) for part in self._alternatives if "items" in part)

    @property
    def _alternatives(self) -> list[dict[str, Any]]:
        parts = self.schema.get("anyOf", [self.schema])
        found = []
        for part in parts:
            if "const" in part:
                found.append({"type": "string", "enum": [part["const"]]})
            elif part.get("type") != "null":
                found.append(part)
        return found


@dataclass(frozen=True, slots=True)
class SettingsTable:
    """One section of the file: its path, what it is about, and its own keys."""

    path: str
    about: str
    keys: tuple[Key, ...]
    only_for: str = ""


def tables(chosen: Drivers = ()) -> dict[str, SettingsTable]:
    """Return all sections by their path, in the order of the models.

    Where drivers know different keys, those of the `chosen` or the default driver come first, then those of the others.
    """
    return _tables(chosen, tuple(sys.path))


@cache
def _tables(chosen: Drivers, _search_path: tuple[str, ...]) -> dict[str, SettingsTable]:
    """Walk through all models, once for each search path: a package that is found there may bring drivers."""
    return {table.path: table for table in _walk(Sections(), "", dict(chosen))}


def keys(chosen: Drivers = ()) -> dict[str, Key]:
    """Return all keys by their path, in the order of the models."""
    return {key.path: key for table in tables(chosen).values() for key in table.keys}


def names_in_section(section: str, chosen: Drivers = ()) -> dict[str, list[str]]:
    """Return the names of the ``keys`` and of the ``sections`` directly inside a section; ``""`` is the file."""
    known = tables(chosen)
    sections = [path for path in known if path and path.rpartition(".")[0] == section]
    return {"keys": [key.name for key in known[section].keys], "sections": [_leaf(path) for path in sections]}


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml_name(name)} = {toml_value(item)}" for name, item in value.items()) + "}"
    if isinstance(value, int | float):
        return str(value)
    if isinstance(value, date | time):
        return value.isoformat()
    text = json.dumps(str(value), ensure_ascii=False)
    return "".join(letter if letter.isprintable() else f"\\u{ord(letter):04X}" for letter in text)


def toml_name(name: str) -> str:
    """Return a key's name as TOML writes it."""
    return name if _BARE_NAME.fullmatch(name) else toml_value(name)


def split_unit(name: str) -> tuple[str, str]:
    """Return the stem and the unit that a key's name ends in, a right or a mistaken one: ``("mean", "min")``."""
    for unit in _UNITS_LONGEST_FIRST:
        if name.endswith(f"_{unit}"):
            return name[: -len(unit) - 1], unit
    return name, ""


def convert_unit(value: Any, unit: str, wanted: str) -> float | None:
    """Return a value in another unit of the same quantity; None where there is none."""
    quantity, factor = _MAGNITUDES.get(unit, ("", 1.0))
    wanted_quantity, wanted_factor = _MAGNITUDES.get(wanted, ("?", 1.0))
    if quantity != wanted_quantity or isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(f"{value * factor / wanted_factor:.10g}")


def parse_quantity(text: str, key: Key) -> float | None:
    """Return the number that ``"54 km/h"`` means for a key, in the key's unit; None where it means none."""
    found = re.fullmatch(r"\s*([-+]?[0-9]+(?:[.,][0-9]+)?)\s*(.*?)\s*", text.replace("−", "-"))
    if found is None:
        return None
    value, unit = float(found[1].replace(",", ".")), found[2].lower().replace("°", "deg").replace("²", "2")
    if unit in ("", key.unit.lower()):
        return value
    return convert_unit(value, unit.replace("/", "_"), split_unit(key.name)[1])


def suggest_path(section: str, name: str, chosen: Drivers = ()) -> str | None:
    """Return the path of the key or section that someone who wrote `name` in `section` most likely meant.

    In this order: the same name elsewhere, the same words in another order, the same name with
    another unit, a misspelling here, one elsewhere.
    """
    written = name.lower().replace("-", "_")
    paths = [*keys(chosen), *[path for path in tables(chosen) if path]]
    here = [path for path in paths if path.rpartition(".")[0] == section]
    near = [path for path in paths if section and path.startswith(f"{section}.") and path not in here]
    ordered = [*here, *near, *[path for path in paths if path not in here and path not in near]]
    for matches in (_same_name, _same_words, _same_stem):
        found = next((path for path in ordered if matches(_leaf(path), written)), None)
        if found:
            return found
    return _closest(written, here, 0.65) or _closest(written, ordered, 0.8)


def _closest(written: str, paths: list[str], cutoff: float) -> str | None:
    by_leaf: dict[str, str] = {}
    for path in paths:
        by_leaf.setdefault(_leaf(path), path)
        by_leaf.setdefault(split_unit(_leaf(path))[0], path)
    found = difflib.get_close_matches(written, by_leaf, 1, cutoff)
    found = found or difflib.get_close_matches(split_unit(written)[0], by_leaf, 1, cutoff)
    return by_leaf[found[0]] if found else None


def _same_name(leaf: str, written: str) -> bool:
    return leaf == written


def _same_stem(leaf: str, written: str) -> bool:
    return split_unit(leaf)[0] == split_unit(written)[0]


def _same_words(leaf: str, written: str) -> bool:
    return sorted(leaf.split("_")) == sorted(written.split("_"))


def _leaf(path: str) -> str:
    return path.rpartition(".")[2]


def _walk(section: BaseModel, path: str, chosen: Mapping[str, str]) -> Iterator[SettingsTable]:
    prefix = f"{path}." if path else ""
    inner = {name: getattr(section, name) for name in type(section).model_fields}
    yield SettingsTable(path, cleandoc(type(section).__doc__ or ""), tuple(_own_keys(section, path)))
    for name, value in inner.items():
        if prefix + name in PLUGIN_SECTIONS:
            yield from _walk_plugged(PLUGIN_SECTIONS[prefix + name], chosen)
        elif isinstance(value, BaseModel):
            yield from _walk(value, prefix + name, chosen)


def _walk_plugged(plugged: PluginSection, chosen: Mapping[str, str]) -> Iterator[SettingsTable]:
    """Yield the tables of one section for all drivers together: each key once, that of the chosen driver first."""
    name = chosen.get(plugged.path, plugged.default)
    drivers = {name: plugged.settings_class(name)(), **{other: kind() for other, kind in plugged.others(name)}}
    first, *more = (_walk(settings, plugged.path, {}) for settings in drivers.values())
    own, *inner = first
    found = {key.name: key for key in own.keys if key.name != DRIVER}
    nested = {table.path: table for table in inner}
    for other, others in zip(list(drivers)[1:], more, strict=True):
        table, *deeper = others
        for key in table.keys:
            known = found.setdefault(key.name, replace(key, only_for=(other,)))
            if known.only_for and other not in known.only_for:
                found[key.name] = replace(known, only_for=(*known.only_for, other))
        for each in deeper:
            nested.setdefault(each.path, replace(each, only_for=other))
    found.pop(DRIVER, None)
    about = " ".join([plugged.about, *(cleandoc(type(each).__doc__ or "") for each in drivers.values())])
    schema = {"type": "string", "enum": list(plugged.names()), "description": about}
    driver = Key(
        path=f"{plugged.path}.{DRIVER}", section=plugged.path, name=DRIVER, schema=schema, default=plugged.default
    )
    yield SettingsTable(plugged.path, plugged.title, (driver, *found.values()))
    yield from nested.values()


def _own_keys(section: BaseModel, path: str) -> Iterator[Key]:
    properties = type(section).model_json_schema()["properties"]
    for name in type(section).model_fields:
        value = getattr(section, name)
        if not isinstance(value, BaseModel):
            yield Key(
                path=f"{path}.{name}" if path else name, section=path, name=name, schema=properties[name], default=value
            )


def _expected(part: dict[str, Any], unit: str) -> str:
    if "enum" in part:
        *others, last = [toml_value(value) for value in part["enum"]]
        return f"{', '.join(others)}{' or ' if others else ''}{last} {unit}".rstrip()
    kind = part["type"]
    if kind in ("number", "integer"):
        noun = "a whole number" if kind == "integer" else "a number"
        return f"{noun}{_range_words(part)} {unit}".rstrip()
    if kind == "boolean":
        return "true or false"
    if kind == "array":
        return f"a list in brackets, each item {_expected(part['items'], unit)}"
    return _FORMAT_WORDS.get(part.get("format", ""), "text in quotes")


def _range_words(part: dict[str, Any]) -> str:
    low, high = part.get("minimum"), part.get("maximum")
    above, below = part.get("exclusiveMinimum"), part.get("exclusiveMaximum")
    start = f" from {low:g}" if low is not None else f" above {above:g}" if above is not None else ""
    if high is not None:
        return f"{start}{' to' if low is not None else ' and up to'} {f'{high:g}' if high < 1e15 else high}"
    if below is not None:
        return f"{start}{' to' if low is not None else ''} below {below:g}"
    return f"{start} up" if low is not None else start


def quoted(value: Any) -> str:
    """Return a value as a file would say it, cut where it is long."""
    return shortened(toml_value(value))


def printable(text: str) -> str:
    """Return the text with a question mark for what a terminal cannot show."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def shortened(text: str) -> str:
    """Return the text, cut where it is long."""
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."


def covers_any(outer: str, ordered: Sequence[str]) -> bool:
    """Tell whether any of some sorted keys is the key `outer` or lies inside it."""
    places = (bisect_left(ordered, beginning) for beginning in (outer, f"{outer}.", f"{outer}["))
    return any(covers(outer, key) for place in places for key in ordered[place : place + 1])


def covers(outer: str, inner: str) -> bool:
    """Tell whether `inner` is the key `outer` or lies inside it."""
    return inner == outer or inner.startswith((f"{outer}.", f"{outer}["))
