"""From a TOML file to settings, or to one list of everything that is wrong with it."""

import difflib
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

from pydantic import BaseModel, ValidationError

from daemon.base.errors import UserError
from daemon.base.files import parse_toml, toml_text
from daemon.base.words import pluralise
from daemon.config import keys, rules
from daemon.config.keys import Drivers
from daemon.config.plugin_sections import DRIVER, PLUGIN_SECTIONS, SectionProblem, validate_plugin_sections
from daemon.config.section import resolve_path
from daemon.config.sections import Sections
from daemon.config.settings import NamedSettings, Settings
from daemon.config.trackers import (
    NAME_FORM,
    NAME_IN_WORDS,
    TRACKER_SECTIONS,
    TrackerTable,
    clashes,
    merge_tracker_table,
    path_in_tracker_table,
    remove_keys,
    unknown_section_remedy,
)

if TYPE_CHECKING:
    from daemon.config.section import Section

# At most this many wrong keys of a section get a remedy: a file of another program may have thousands of keys.
_MOST_REMEDIES = 20
_AND_MORE = ": more is wrong here; correct what is listed above first"
_MOST_TRACKERS = 64
# These paths start from the file's folder if they are relative, so that the folder can be moved as a whole.
_PATHS = (
    ("bridge", "key_file"),
    ("store", "directory"),
    ("cube", "calibration_file"),
    ("api", "token_file"),
    ("mqtt", "ca_file"),
    ("mqtt", "certificate_file"),
    ("mqtt", "certificate_key_file"),
    ("mqtt", "credentials_file"),
    ("archive", "password_file"),
    ("simulation", "weather"),
)
_SLASHES = "write paths in 'single quotes' or with forward slashes"
_HINTS = (
    ("Unescaped", _SLASHES),
    ("Invalid hex", _SLASHES),
    ("Invalid value", "text needs quotes; true and false are lower case; the decimal sign is a point"),
    ("Expected newline", "one key to a line; text needs quotes; the decimal sign is a point"),
    ("Expected '='", "a line is: key = value"),
    ("Cannot overwrite", "this key is already set above"),
    ("Cannot declare", "this section is already above"),
)


class ConfigError(UserError):
    """The configuration cannot be used; the message lists every problem, one to a line.

    Parameters
    ----------
    source
        What was read: the file, or where else the values came from.
    problems
        One line each: key, value, reason, remedy.
    """

    def __init__(self, source: str, problems: list[str]) -> None:
        super().__init__("\n  ".join([f"{source} has {pluralise(len(problems), 'problem')}:", *problems]))
        self.problems = tuple(problems)


class _Problem(NamedTuple):
    """One line of the list, and the known key that an unknown one was probably meant to be."""

    key: str
    reason: str
    meant: str | None = None


def load_settings(path: Path) -> Settings:
    """Read the settings from a TOML file; relative paths in it are meant from the file's folder.

    Whether topics and JSON paths can be used is not checked here: see `daemon.mqtt.topics`.

    Raises
    ------
    ConfigError
        With all problems of the file.
    """
    return _with_whole_paths(_settings(_read(path), str(path)), path.parent, str(path))


def load_settings_with_topics(path: Path, unusable: Callable[[Settings], Iterable[str]]) -> Settings:
    """Read a file like `load_settings`; the keys that `unusable` names are problems too. Raises `ConfigError`."""
    return _with_whole_paths(_settings(_read(path), str(path), unusable), path.parent, str(path))


def override(settings: Settings, changes: Mapping[str, Mapping[str, Any]], to_come: Collection[str] = ()) -> Settings:
    """Return the settings with some keys changed, as the command line and the library do; raises `ConfigError`.

    Parameters
    ----------
    changes
        New values by section and key: ``{"law": {"driver": "flat"}}``.
    to_come
        Keys that get their value later: rules that involve one of them are not checked.
    """
    raw = settings.model_dump()
    for section, values in changes.items():
        if section in PLUGIN_SECTIONS:
            raw[section] = PLUGIN_SECTIONS[section].table_with_changes(getattr(settings, section), values)
        else:
            raw[section] |= values
        for table in raw["tracker"]:
            # The changes hold for every tracker, whatever its own table says.
            remove_keys(table, section, values)
    return _settings(raw, "what was asked for", to_come=to_come)


def with_loopback_bridge(settings: Settings, *, insecure: bool = False) -> Settings:
    """Return the settings with the bridge inside one process, on whatever loopback port is free.

    Parameters
    ----------
    settings
        Taken as they are but for the bridge.
    insecure
        Leave scans unsigned: for a process that lives some seconds and moves nothing.
    """
    changes = {"listen": "127.0.0.1:0", "send_to": (), "multicast_group": None, "insecure": insecure}
    if insecure:
        changes["key_file"] = None
    inside = settings.bridge.model_copy(update=changes)
    return settings.model_copy(update={"bridge": inside})


def _read(path: Path) -> dict[str, Any]:
    try:
        text = toml_text(path)
    except FileNotFoundError:
        raise ConfigError(
            str(path), ["there is no such file; 'heliocube config init DIR' writes a commented one"]
        ) from None
    except OSError as error:
        raise ConfigError(str(path), [f"the file cannot be read: {error.strerror}"]) from None
    except ValueError as error:
        raise ConfigError(str(path), [str(error)]) from None
    try:
        return parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(str(path), [_syntax_problem(str(error), text)]) from None
    except ValueError as error:
        raise ConfigError(str(path), [str(error)]) from None


def _syntax_problem(message: str, text: str) -> str:
    hint = next((f" ({hint})" for start, hint in _HINTS if message.startswith(start)), "")
    reason, _, place = message.partition(" (at ")
    reason = reason[0].lower() + re.sub(r"\('(.+?)',?\)", lambda names: names[1].replace("', '", "."), reason[1:])
    lines = text.split("\n")
    found = re.match(r"line (\d+), column (\d+)", place)
    line, column = (int(found[1]), int(found[2])) if found else (len(lines), len(lines[-1]) + 1)
    return f"line {line}, column {column}: {reason} in: {keys.shortened(keys.printable(lines[line - 1].strip()))}{hint}"


def _settings(
    raw: dict[str, Any],
    source: str,
    unusable: Callable[[Settings], Iterable[str]] = lambda _: (),
    to_come: Collection[str] = (),
) -> Settings:
    tables = raw.get("tracker", ())
    raw = {name: value for name, value in raw.items() if name != "tracker"}
    settings, problems = _settings_and_problems(raw, unusable, to_come)
    problems += _tracker_problems(raw, tables, problems, settings.site.latitude_deg)
    if problems:
        order = {key: place for place, key in enumerate(_paths_in(raw, ""))}
        problems.sort(key=lambda problem: order.get(problem.key.partition("[")[0], len(order)))
        raise ConfigError(source, [problem.key + problem.reason for problem in problems])
    return settings.model_copy(update={"tracker": tuple(TrackerTable.model_validate(table) for table in tables)})


def _tracker_problems(
    raw: dict[str, Any], tables: Any, known: Collection[_Problem], latitude_deg: float
) -> Iterator[_Problem]:
    """Yield what is wrong with the tables of trackers, and with the settings that they make."""
    if not isinstance(tables, list | tuple) or not all(isinstance(table, dict) for table in tables):
        yield _Problem("tracker", ": a tracker is a table of a list; write [[tracker]], once for each")
        return
    if len(tables) > _MOST_TRACKERS:
        yield _Problem("tracker", f": these are {len(tables)} trackers; a process drives at most {_MOST_TRACKERS}")
        return
    found: list[NamedSettings] = []
    names: set[str] = set()
    for number, table in enumerate(tables):
        name = table.get("name")
        if not isinstance(name, str) or not re.fullmatch(NAME_FORM, name):
            shown = "" if name is None else f" = {keys.quoted(name)}"
            yield _Problem(f"tracker[{number}].name", f"{shown}: every tracker has a name, {NAME_IN_WORDS}")
            continue
        if name.lower() in names:
            yield _Problem(f"tracker[{number}].name", f" = {keys.quoted(name)}: is the name of another tracker already")
        names.add(name.lower())
        settings, problems = _settings_and_problems(merge_tracker_table(raw, table))
        found.append(NamedSettings(name, settings))
        for key in table.keys() - {"name", *TRACKER_SECTIONS}:
            yield _Problem(f"tracker[{name}].{key}", f": a tracker has no such section; {unknown_section_remedy(key)}")
        for problem in problems:
            if problem not in known:
                yield _Problem(f"tracker[{name}].{path_in_tracker_table(problem.key)}", problem.reason)
    for clash in clashes(latitude_deg, found):
        yield _Problem(f"tracker[{clash.tracker}].{clash.key}", f" = {keys.quoted(clash.value)}: {clash.reason}")


def _settings_and_problems(
    raw: dict[str, Any], unusable: Callable[[Settings], Iterable[str]] = lambda _: (), to_come: Collection[str] = ()
) -> tuple[Settings, list[_Problem]]:
    """Return the settings of all that is right in the sections of a file, and everything that is wrong with them."""
    tables, chosen, wrong_in_drivers = validate_plugin_sections(raw)
    unknown = [name for name in raw if name not in Sections.model_fields]
    problems = [_unknown_key_problem("", name, raw[name], chosen) for name in unknown[:_MOST_REMEDIES]]
    problems += [_Problem(keys.toml_name(name), ": there is no such key") for name in unknown[_MOST_REMEDIES:]]
    for number, (path, each) in enumerate(wrong_in_drivers):
        problems.append(_driver_problem(path, each, chosen) if number < _MOST_REMEDIES else _Problem(path, _AND_MORE))
    sections: dict[str, Any] = {}
    for name, field in Sections.model_fields.items():
        given = tables.get(name, {})
        if isinstance(given, BaseModel):
            sections[name] = given
            continue
        kind = cast("type[Section]", field.annotation)
        try:
            sections[name] = kind.model_validate(given)
        except ValidationError as error:
            found = {problem.key: problem for problem in _problems(error, name, chosen)}
            problems += found.values()
            # The rules between keys are still worth checking for the keys that are right.
            sections[name] = kind.model_validate(_without_wrong_keys(given, name, sorted(found), chosen))
    settings = Settings.model_construct(**sections)
    problems += [_Problem(key, _wrong_value_text(key, _value_of(settings, key), chosen)) for key in unusable(settings)]
    wrong = {key.partition("[")[0] for each in problems for key in (each.key, each.meant) if key}.union(to_come)
    for conflict in rules.conflicts(settings):
        if not any(keys.covers(key, part) for key in wrong for part in (conflict.key, *conflict.others)):
            shown = keys.quoted(_value_of(settings, conflict.key))
            default = "" if _is_given(raw, conflict.key) else " (default)"
            problems.append(_Problem(conflict.key, f" = {shown}{default}: {conflict.reason}"))
    return settings, problems


def _problems(error: ValidationError, section: str, chosen: Drivers) -> Iterator[_Problem]:
    for number, item in enumerate(error.errors(include_url=False, include_context=False)):
        if number >= _MOST_REMEDIES:
            yield _Problem(_path((section, *item["loc"]), chosen), _AND_MORE)
            continue
        kind: Literal["unknown", "value"] = "unknown" if item["type"] == "extra_forbidden" else "value"
        yield _problem((section, *item["loc"]), item["input"], kind, chosen)


def _driver_problem(section: str, wrong: SectionProblem, chosen: Drivers) -> _Problem:
    """Return what is wrong in a section that belongs to a driver."""
    if wrong.kind == "other":
        path = _joined(section, ".".join(str(part) for part in wrong.loc))
        return _Problem(path, f" = {keys.quoted(wrong.value)}: {wrong.reason}")
    loc: tuple[int | str, ...] = (*section.split("."), *wrong.loc)
    former = PLUGIN_SECTIONS[section].former
    if wrong.kind == "value" and wrong.loc == (former,):
        # The former key takes the same values as the key that replaces it.
        return _Problem(f"{section}.{former}", _wrong_value_text(f"{section}.{DRIVER}", wrong.value, chosen))
    if wrong.kind == "unknown" and [str(part).lower() for part in wrong.loc] == [former]:
        meant = f"{section}.{DRIVER}"
        reason = f" = {keys.quoted(wrong.value)}: there is no such key; did you mean {meant}?"
        return _Problem(_joined(section, str(wrong.loc[0])), reason, meant)
    return _problem(loc, wrong.value, wrong.kind, chosen)


def _problem(loc: tuple[int | str, ...], value: Any, kind: Literal["unknown", "value"], chosen: Drivers) -> _Problem:
    if kind == "unknown":
        return _unknown_key_problem(_path(loc[:-1], chosen), str(loc[-1]), value, chosen)
    path = _path(loc, chosen)
    return _Problem(path, _wrong_value_text(path, value, chosen))


def _path(loc: tuple[int | str, ...], chosen: Drivers) -> str:
    """Return the key's path; what pydantic adds behind it to name the part of a union is dropped."""
    path, known = str(loc[0]), keys.keys(chosen)
    for part in loc[1:]:
        if path in known:
            return f"{path}[{part}]" if isinstance(part, int) else path
        path = f"{path}.{part}"
    return path


def _wrong_value_text(path: str, value: Any, chosen: Drivers) -> str:
    key = keys.keys(chosen).get(path.partition("[")[0])
    if key is None:
        return f" = {keys.quoted(value)}: must be a section of its own, [{path}]"
    if "[" in path:
        return f" = {keys.quoted(value)}: must be {key.expected_item}"
    return f" = {keys.quoted(value)}: must be {key.expected}{_hint(key, value)}"


def _hint(key: keys.Key, value: Any) -> str:
    if not isinstance(value, str):
        return ""
    names = difflib.get_close_matches(value.lower(), key.enum_values, 1)
    if names:
        return f'; did you mean "{names[0]}"?'
    if key.json_types & {"number", "integer"}:
        number = keys.parse_quantity(value, key)
        return "" if number is None else f"; did you mean {number:.10g}, without quotes?"
    if key.json_types == {"boolean"} and value.lower() in ("true", "false"):
        return f"; did you mean {value.lower()}, without quotes?"
    if key.json_types == {"array"}:
        return f"; did you mean {keys.toml_value([value])}?"
    return ""


def _joined(section: str, name: str) -> str:
    written = keys.toml_name(name)
    return f"{section}.{written}" if section else written


def _unknown_key_problem(section: str, name: str, value: Any, chosen: Drivers) -> _Problem:
    if not section and name == "trackers":
        return _Problem(name, ": there is no such key; did you mean [[tracker]], once for each?")
    what = "there is no such section" if isinstance(value, dict) else "there is no such key"
    meant = keys.suggest_path(section, name, chosen)
    if meant is None:
        kind = "sections" if isinstance(value, dict) or not section else "keys"
        known = keys.names_in_section(section, chosen)[kind]
        where = f"the {kind} of [{section}] are" if section else f"the {kind} are"
        remedy = f"{where} {', '.join(known)}" if known else f"[{section}] has no {kind}"
    else:
        wanted, unit = keys.split_unit(meant)[1], keys.split_unit(name)[1]
        number = keys.convert_unit(value, unit, wanted) if unit != wanted else None
        remedy = f"did you mean {meant}{'' if number is None else f' = {number:.10g}'}?"
    shown = "" if isinstance(value, dict) else f" = {keys.quoted(value)}"
    return _Problem(_joined(section, name), f"{shown}: {what}; {remedy}", meant)


def _without_wrong_keys(given: Any, section: str, wrong: Sequence[str], chosen: Drivers) -> dict[str, Any]:
    """Return what is right in a section of the file; `wrong` is sorted, as both may have thousands of keys."""
    if not isinstance(given, dict) or section in wrong:
        return {}
    kept = {}
    for name, value in given.items():
        path = _joined(section, name)
        if isinstance(value, dict) and path in keys.tables(chosen):
            kept[name] = _without_wrong_keys(value, path, wrong, chosen)
        elif not keys.covers_any(path, wrong):
            kept[name] = value
    return kept


def _value_of(settings: Settings, path: str) -> Any:
    value: Any = settings
    key, _, index = path.partition("[")
    for name in key.split("."):
        value = getattr(value, name)
    return value[int(index[:-1])] if index else value


def _is_given(raw: dict[str, Any], path: str) -> bool:
    return path.partition("[")[0] in _paths_in(raw, "")


def _paths_in(raw: dict[str, Any], section: str) -> list[str]:
    paths = []
    for name, value in raw.items():
        path = _joined(section, name)
        paths.append(path)
        if isinstance(value, dict):
            paths += _paths_in(value, path)
    return paths


def _with_whole_paths(settings: Settings, folder: Path, source: str) -> Settings:
    changed: dict[str, Section] = {}
    problems = []
    for section, name in _PATHS:
        path = getattr(getattr(settings, section), name)
        if isinstance(path, Path):
            try:
                values = {name: resolve_path(folder, path)}
            except ValueError as error:
                problems.append(f"{section}.{name} = {keys.quoted(str(path))}: {ascii(str(error))[1:-1]}")
                continue
            changed[section] = changed.get(section, getattr(settings, section)).model_copy(update=values)
    if problems:
        raise ConfigError(source, problems)
    return settings.model_copy(update=changed)
