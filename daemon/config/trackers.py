"""The trackers of one process: the sections of the file hold for each of them, but for what its own table says."""

import difflib
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from pydantic import Field

from daemon.config.plugin_sections import DRIVER, PLUGIN_SECTIONS, dump_explicit_values
from daemon.config.section import Section
from drivers.settings import canonical_address
from solar.frames import equator_azimuth_deg

if TYPE_CHECKING:
    from daemon.config.sections import Sections

NAME_FORM = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$"
NAME_IN_WORDS = "1 to 32 letters, digits, dashes or underscores, a letter or digit first"


class TrackerTable(Section):
    """One tracker: its name, and what of these sections differs from the file's own."""

    name: Annotated[str, Field(pattern=NAME_FORM)]
    site: dict[str, Any] = Field(default_factory=dict)
    law: dict[str, Any] = Field(default_factory=dict)
    windows: dict[str, Any] = Field(default_factory=dict)
    limits: dict[str, Any] = Field(default_factory=dict)
    rows: dict[str, Any] = Field(default_factory=dict)
    motion: dict[str, Any] = Field(default_factory=dict)
    safety: dict[str, Any] = Field(default_factory=dict)
    positioner: dict[str, Any] = Field(default_factory=dict)
    load: dict[str, Any] = Field(default_factory=dict)


TRACKER_SECTIONS = tuple(name for name in TrackerTable.model_fields if name != "name")
# The path in the file of a section that is elsewhere in a tracker's table.
_PATHS_IN_FILE = {"positioner": "instruments.positioner"}
# Sections that all trackers of a process share; a newcomer may look for them in the trackers' tables.
_SHARED = ("cube", "bridge")


class Clash(NamedTuple):
    """What keeps a tracker out of a process with others: its key, the key's value, and why."""

    tracker: str
    key: str
    value: str | float
    reason: str


def values_of(settings: "Sections") -> dict[str, Any]:
    """Return the values of settings by section, without trackers' tables and without the defaults of drivers."""
    raw = settings.model_dump(exclude={"tracker"})
    for path in PLUGIN_SECTIONS:
        *outer, last = path.split(".")
        table, section = raw, settings
        for name in outer:
            table, section = table[name], getattr(section, name)
        table[last] = dump_explicit_values(getattr(section, last))
    return raw


def remove_keys(table: dict[str, Any], path: str, values: Mapping[str, Any]) -> None:
    """Remove the keys in `values` from a tracker's table; they are those of the section that has `path` in the file."""
    section = path_in_tracker_table(path)
    own = table.get(section)
    if isinstance(own, dict):
        gone = _with_former_name(path, values)
        table[section] = {name: value for name, value in own.items() if name not in gone}


def merge_tracker_table(raw: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a file as they hold for the tracker of a table."""
    found = dict(raw)
    for section in TRACKER_SECTIONS:
        if section in table:
            home = _PATHS_IN_FILE.get(section, section)
            _lay_over(found, home.split("."), table[section], _with_former_name(home, table[section]))
    return found


def _with_former_name(path: str, values: Any) -> frozenset[str]:
    """Return the names of the keys that a section's values decide; `driver` and its former name decide each other."""
    names = frozenset(values) if isinstance(values, Mapping) else frozenset()
    aliases = {DRIVER, PLUGIN_SECTIONS[path].former} if path in PLUGIN_SECTIONS else set()
    return names | aliases if names & aliases else names


def path_in_tracker_table(path: str) -> str:
    """Return the path of a key in a tracker's table: ``positioner.port`` for ``instruments.positioner.port``."""
    for section, home in _PATHS_IN_FILE.items():
        if path == home or path.startswith(f"{home}."):
            return section + path[len(home) :]
    return path


def unknown_section_remedy(name: str) -> str:
    """Return the remedy for a name that is not one of a tracker's sections."""
    if name in _SHARED:
        return (
            "the trackers of a process have one cube and one bridge: write this outside their tables; a tracker"
            " with another cube needs a file and a process of its own"
        )
    found = difflib.get_close_matches(name.rpartition(".")[2].lower(), TRACKER_SECTIONS, 1)
    return f"did you mean {found[0]}?" if found else f"a tracker has {', '.join(TRACKER_SECTIONS)}"


def clashes(latitude_deg: float, trackers: Sequence[tuple[str, "Sections"]]) -> Iterator[Clash]:
    """Yield each port of real instruments that two trackers share, and each tracker across the equator."""
    owners: dict[str, tuple[str, str]] = {}
    for name, settings in trackers:
        ports = {f"load.{key}": value for key, value in settings.load.exclusive().items()}
        if settings.instruments.kind == "real":
            ports |= {f"positioner.{key}": value for key, value in settings.instruments.positioner.exclusive().items()}
        for key, value in ports.items():
            if value is not None:
                other, theirs = owners.setdefault(canonical_address(value), (name, key))
                if other != name:
                    what = "that" if theirs == key else f"the {theirs}"
                    reason = f"is {what} of the tracker {other} already; each needs one of its own"
                    yield Clash(name, key, value, reason)
        own_deg = settings.site.latitude_deg
        if equator_azimuth_deg(own_deg) != equator_azimuth_deg(latitude_deg):
            # The cube's faces, SunSpec and the records of a run hold for one side of the equator.
            reason = (
                f"is on the other side of the equator than the cube and site.latitude_deg ({latitude_deg:g} deg);"
                " correct the wrong one, or give this tracker a file and a process of its own"
            )
            yield Clash(name, "site.latitude_deg", own_deg, reason)


def _lay_over(found: dict[str, Any], path: Sequence[str], values: Any, decided: Collection[str]) -> None:
    """Put values into a table inside `found`, which is changed; tables inside it are copied first.

    Parameters
    ----------
    decided
        Keys of the table that lose their old values, whether there is a new value for them or not.
    """
    first, *rest = path
    before = found.get(first)
    inner = dict(before) if isinstance(before, Mapping) else {}
    if rest:
        _lay_over(inner, rest, values, decided)
        found[first] = inner
    elif isinstance(values, Mapping):
        kept = {name: value for name, value in inner.items() if name not in decided or isinstance(value, Mapping)}
        for name, value in values.items():
            if isinstance(value, Mapping):
                _lay_over(kept, [name], value, frozenset(value))
            else:
                kept[name] = value
        found[first] = kept
    else:
        # The check of the section reports a value that is not a table.
        found[first] = values
