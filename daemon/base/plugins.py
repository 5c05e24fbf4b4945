"""Drivers and laws by name: modules that installed packages offer through entry points."""

import sys
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from types import ModuleType
from typing import Any, cast

from daemon.base.errors import UserError

LAWS = "heliocube.law"
POSITIONERS = "heliocube.positioner"
LOADS = "heliocube.load"
CUBES = "heliocube.cube"


class PluginError(UserError):
    """There is no plug-in of that name, or it cannot be used."""


def names(group: str) -> tuple[str, ...]:
    """Return the names that installed packages offer in a group, sorted; nothing is imported."""
    return tuple(sorted({point.name for point in _entry_points_of(group)}))


def load(group: str, name: str) -> ModuleType:
    """Import the module that is offered under a name in a group, and nothing else.

    Parameters
    ----------
    group
        Such as ``heliocube.law``.
    name
        As the configuration has it.

    Returns
    -------
    A module with ``SETTINGS``, a class made from that of its kind, and ``build``, which makes the law or driver.

    Raises
    ------
    PluginError
        Nobody offers the name, or two packages do; or the module cannot be imported, lacks these contents, or has a key
        without a default.
    """
    kind = group.rpartition(".")[2]
    found = [point for point in _entry_points_of(group) if point.name == name]
    if not found:
        known = ", ".join(names(group)) or "none; reinstall heliocube with 'pip install -e .'"
        raise PluginError(f'there is no {kind} "{name}"; known are {known}')
    if len(found) > 1:
        owners = " and ".join(_owner(point) for point in found)
        raise PluginError(f'the {kind} "{name}" is offered by {owners}; remove one of the packages')

    def wrong(what: str) -> PluginError:
        # To find the owner, all the metadata of its package is read: do so only for a message.
        return PluginError(f'the {kind} "{name}" of {_owner(found[0])} {what}')

    try:
        module = found[0].load()
    # A plug-in that exits must not end a program that only looks for names.
    except (Exception, SystemExit) as error:
        raise wrong(f"cannot be imported: {error}") from error
    if not (hasattr(module, "SETTINGS") and callable(getattr(module, "build", None))):
        raise wrong("is not a module with SETTINGS and build")
    fields = getattr(module.SETTINGS, "model_fields", {})
    if "driver" not in fields:
        raise wrong("has SETTINGS that are not made from the settings class of its kind")
    needed = [key for key, field in fields.items() if field.is_required()]
    if needed:
        raise wrong(f"has no default for its key {needed[0]}, which a file may leave out")
    return module  # type: ignore[no-any-return]


def _entry_points_of(group: str) -> EntryPoints:
    return _entry_points_in(group, tuple(sys.path))


# Looking through all of them takes nine tenths of the time in which settings are built.
@lru_cache
def _entry_points_in(group: str, search_path: tuple[str, ...]) -> EntryPoints:
    return cast("EntryPoints", _all_entry_points(search_path).select(group=group))


@lru_cache
def _all_entry_points(_search_path: tuple[str, ...]) -> Any:
    """Return what all packages offer; reading that takes a tenth of a second, so it is done once per search path."""
    return entry_points()


def _owner(point: EntryPoint) -> str:
    return f"the package {point.dist.name}" if point.dist else point.value
