"""Sections of the file whose keys belong to a driver or a law that is chosen by name.

The section names it with `driver`; the rest of the section is validated by the settings class of that plug-in. Keys of
other plug-ins of the same kind may stand beside them, so that changing the name is changing one line: they are checked
by the class that knows them and have no effect. Plug-ins that are not chosen are imported for such keys only.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple, cast

from pydantic import BaseModel, ValidationError, create_model

from daemon.base import plugins
from drivers.settings import LoadSettings

DEFAULT_LAW = "mu-prime"
FALLBACK_LAW = "chronometric"
"""This law points by ephemeris alone, and so can do without good readings."""

DRIVER = "driver"
MULTIPLEXED = "multiplexed"
"""The cube's driver whose keys stand in sections of their own."""
PYRANOMETERS = "modbus-pyranometers"
LABJACK = "labjack"
SCANNING_METER = "scanning-meter"
ROTCTLD = "rotctld"
Loc = tuple[int | str, ...]


class SectionProblem(NamedTuple):
    """One thing that is wrong in a section.

    Attributes
    ----------
    loc
        Where, inside the section; empty for the section itself.
    value
        What stands there.
    kind
        ``unknown`` for a key that nobody knows, ``value`` for a value that the key does not take, ``other`` for the
        rest.
    reason
        The rest of the sentence for ``other``.
    """

    loc: Loc
    value: Any
    kind: Literal["unknown", "value", "other"]
    reason: str = ""


@dataclass(frozen=True, slots=True)
class PluginSection:
    """One such section.

    Attributes
    ----------
    path
        In the file.
    group
        Of the entry points.
    default
        The name where the file has none.
    title
        What the section is, for the reference.
    about
        What the name chooses.
    built_in
        Settings classes of names that are no plug-in, such as ``none``.
    former
        What `driver` was called before; it still is understood.
    """

    path: str
    group: str
    default: str
    title: str
    about: str
    built_in: Mapping[str, type[BaseModel]]
    former: str = ""

    def names(self) -> tuple[str, ...]:
        """Return every name that may be chosen."""
        return (*self.built_in, *plugins.names(self.group))

    def complete(self, name: str) -> str:
        """Return the only name that begins like this, such as ``modbus-pyranometers`` for ``modbus``, or `name`."""
        found = [known for known in self.names() if known.startswith(name)]
        return found[0] if len(found) == 1 else name

    def settings_class(self, name: str) -> type[BaseModel]:
        """Return the settings class behind a name; raises `PluginError` where there is none."""
        if name in self.built_in:
            return self.built_in[name]
        return cast("type[BaseModel]", plugins.load(self.group, name).SETTINGS)

    def others(self, name: str) -> Iterator[tuple[str, type[BaseModel]]]:
        """Import everything else of the kind that can be imported, and yield its names and settings classes."""
        for other in self.names():
            if other != name:
                try:
                    yield other, self.settings_class(other)
                except plugins.PluginError:
                    continue

    def defaults(self) -> Any:
        """Return the section that a file without it has."""
        return _open(self.settings_class(self.default)).model_validate({DRIVER: self.default})

    def validate(self, given: Any) -> Any:
        """Return the settings for a table of the file; settings stay as they are. Raises `ValueError` for mistakes."""
        if not isinstance(given, dict):
            return given
        settings, wrong = self.read(given)
        if wrong:
            raise ValueError("; ".join(f"{'.'.join(map(str, each.loc))} = {each.value!r}" for each in wrong))
        return settings

    def read(self, given: Any) -> tuple[BaseModel, list[SectionProblem]]:
        """Return the settings of what is right in a section, and everything that is wrong with it."""
        if isinstance(given, BaseModel):
            return given, []
        if not isinstance(given, dict):
            return self.defaults(), [SectionProblem((), given, "value")]
        rest = dict(given)
        said = [key for key in (DRIVER, self.former) if key in rest]
        chosen = [rest.pop(key) for key in said] or [self.default]
        if len(said) > 1:
            reason = f"is the earlier name of {self.path}.{DRIVER}, which is set too; remove one of the two"
            return self.defaults(), [SectionProblem((self.former,), chosen[1], "other", reason)]
        name, at = chosen[0], (said or [DRIVER])[0]
        if name not in self.names():
            return self.defaults(), [SectionProblem((at,), name, "value")]
        try:
            kind = self.settings_class(name)
        except plugins.PluginError as error:
            return self.defaults(), [SectionProblem((at,), name, "other", str(error))]
        wrong = [*_wrong(kind, _known_to(kind, rest)), *self._wrong_for_others(name, _unknown_to(kind, rest))]
        right = _without(rest, [each.loc for each in wrong])
        return _open(kind).model_validate({**right, DRIVER: name}), wrong

    def table_with_changes(self, settings: BaseModel, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the table that says what the settings say, with some values changed."""
        renamed = {DRIVER if key == self.former else key: value for key, value in values.items()}
        return {**dump_explicit_values(settings), **renamed}

    def with_driver(self, settings: BaseModel, name: str) -> Any:
        """Return the settings with another name and everything else that the file has said."""
        return self.validate({**dump_explicit_values(settings), DRIVER: name})

    def _wrong_for_others(self, name: str, values: dict[str, Any]) -> Iterator[SectionProblem]:
        if not values:
            return
        classes = [kind for _, kind in self.others(name)]
        for key, value in values.items():
            kind = next((each for each in classes if key in each.model_fields), None)
            if kind is None:
                yield SectionProblem((key,), value, "unknown")
            else:
                yield from _wrong(kind, {key: value})


class NoLoadSettings(LoadSettings):
    """none: the module is in open circuit."""


class SimulatedLoadSettings(LoadSettings):
    """simulated: goes with simulated instruments."""


LAW = PluginSection(
    path="law",
    group=plugins.LAWS,
    default=DEFAULT_LAW,
    title="The pointing law and its parameters.",
    about="Which law points the tracker.",
    built_in={},
    former="name",
)

POSITIONER = PluginSection(
    path="instruments.positioner",
    group=plugins.POSITIONERS,
    default="pozsol",
    title="The positioner: how it is connected, and what the service may expect of its motion.",
    about="Which positioner it is.",
    built_in={},
)

LOAD = PluginSection(
    path="load",
    group=plugins.LOADS,
    default="none",
    title="The electronic load that traces I-V curves of the tracker's module, which is in open circuit otherwise.",
    about="Whether there is a load, and which; a real one needs real instruments.",
    built_in={"none": NoLoadSettings, "simulated": SimulatedLoadSettings},
)

CUBE = PluginSection(
    path="instruments.cube",
    group=plugins.CUBES,
    default=MULTIPLEXED,
    title="What reads the cube's four faces.",
    about="Which driver reads the faces; gains, plausibility and rhythm are those of [cube] for every driver.",
    built_in={},
)

PLUGIN_SECTIONS = {each.path: each for each in (LAW, CUBE, POSITIONER, LOAD)}
"""All sections of this kind, by their path."""


def law_names() -> tuple[str, ...]:
    """Return the names of all laws that are installed."""
    return LAW.names()


def dump_explicit_values(settings: BaseModel) -> dict[str, Any]:
    """Return what the file says in such a section, without the defaults."""
    return settings.model_dump(exclude_unset=True)


def validate_plugin_sections(
    raw: Mapping[str, Any],
) -> tuple[dict[str, Any], tuple[tuple[str, str], ...], list[tuple[str, SectionProblem]]]:
    """Put settings in place of all such sections of a file.

    Returns
    -------
    The tables; path and name of each section's driver; and what is wrong, with the path of its section.
    """
    tables = dict(raw)
    chosen, wrong = [], []
    for plugged in PLUGIN_SECTIONS.values():
        *outer, last = plugged.path.split(".")
        table: Any = tables
        for name in outer:
            inner = table.get(name, {})
            table[name] = dict(inner) if isinstance(inner, dict) else inner
            table = table[name]
        if not isinstance(table, dict):
            # The check of the table around this one reports it.
            continue
        settings, found = plugged.read(table.get(last, {}))
        table[last] = settings
        chosen.append((plugged.path, str(getattr(settings, DRIVER))))
        wrong += [(plugged.path, each) for each in found]
    return tables, tuple(chosen), wrong


@lru_cache
def _open(kind: type[BaseModel]) -> type[BaseModel]:
    """Return a settings class that keeps the keys of other plug-ins."""
    opened = create_model(
        kind.__name__,
        __base__=kind,
        __module__=kind.__module__,
        __doc__=kind.__doc__,
        __cls_kwargs__={"extra": "allow"},
    )
    # Another process that unpickles the class by its name would find the class that it was made from.
    setattr(opened, "__reduce__", _reduce_for_pickle)  # noqa: B010
    return opened


def _reduce_for_pickle(settings: BaseModel) -> tuple[Any, ...]:
    return _blank_settings, (type(settings).__bases__[0],), settings.__getstate__()


def _blank_settings(kind: type[BaseModel]) -> BaseModel:
    opened = _open(kind)
    return opened.__new__(opened)


def _known_to(kind: type[BaseModel], values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key in kind.model_fields}


def _unknown_to(kind: type[BaseModel], values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key not in kind.model_fields}


def _wrong(kind: type[BaseModel], values: dict[str, Any]) -> Iterator[SectionProblem]:
    try:
        kind.model_validate(values)
    except ValidationError as error:
        for item in error.errors(include_url=False, include_context=False):
            yield SectionProblem(
                item["loc"], item["input"], "unknown" if item["type"] == "extra_forbidden" else "value"
            )


def _without(values: dict[str, Any], locs: Collection[Loc]) -> dict[str, Any]:
    """Return a table without the values at some places."""
    kept: dict[str, Any] = {}
    inside_of: dict[int | str, list[Loc]] = {}
    for loc in locs:
        if loc:
            inside_of.setdefault(loc[0], []).append(loc[1:])
    for name, value in values.items():
        inside = inside_of.get(name)
        if not inside:
            kept[name] = value
        elif isinstance(value, dict) and all(inside):
            kept[name] = _without(value, inside)
    return kept
