"""A configuration file in today's form: its tracker named in a table, and no key under a former name."""

import contextlib
import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import takewhile
from pathlib import Path
from typing import Any

import tomli_w

from daemon.base.errors import UserError
from daemon.base.files import first_free, numbered_paths, rewrite_file, toml_text, write_new
from daemon.base.installation import release
from daemon.config.file import load_settings
from daemon.config.plugin_sections import DRIVER, PLUGIN_SECTIONS
from daemon.config.trackers import NAME_FORM, NAME_IN_WORDS

RENAMED_KEYS = {f"{path}.{each.former}": DRIVER for path, each in PLUGIN_SECTIONS.items() if each.former}
"""Former paths of keys, and the name that each key has in the same section now."""

_HEADER = re.compile(r"\s*\[\[?\s*([^\]]+?)\s*\]")
_KEY = re.compile(r"(\s*)([A-Za-z0-9_-]+)(\s*=.*)", re.DOTALL)


def migrate(path: Path, *, keys_only: bool = False) -> str:
    """Bring a file into today's form, keep the old one beside it, and return in a sentence what was done.

    The name of the old one ends in the name of this release, which tells what has replaced it. Comments and order stay,
    unless the text has keys that cannot be found line by line, such as those of inline tables.

    Parameters
    ----------
    path
        The file.
    keys_only
        Leave a tracker without a name as it is: its name is for people to choose.

    Raises
    ------
    UserError
        The file has mistakes of its own, the name of its tracker cannot be one, or it cannot be written.
    """
    settings = load_settings(path)
    text = toml_text(path)
    before = tomllib.loads(text)
    renamed = [key for key in RENAMED_KEYS if _has(before, key)]
    names = [] if settings.tracker or keys_only else [settings.trackers[0].name]
    if names and re.fullmatch(NAME_FORM, names[0]) is None:
        raise UserError(f"mqtt.name = {names[0]!a}: a tracker's name is {NAME_IN_WORDS}; change it and try again")
    if not renamed and not names:
        return f"{path} is up to date: nothing was changed"
    wanted = _with_keys_renamed(before, "") | ({"tracker": [{"name": name} for name in names]} if names else {})
    found = "".join(_lines(text))
    for name in names:
        found = f"{found.rstrip()}\n\n[[tracker]]\n{tomli_w.dumps({'name': name})}"
    kept = _parses_to(found, wanted)
    kept_text = "" if kept else "; its comments are in the old one only"
    old = _replace(path, found if kept else tomli_w.dumps(wanted))
    done = [f"its tracker is named {name}" for name in names]
    done += [f"{key} is {key.rpartition('.')[0]}.{RENAMED_KEYS[key]} now" for key in renamed]
    return f"{path} is updated: {', '.join(done)}; the old one is {old}{kept_text}"


def backup_path(path: Path) -> Path:
    """Return the path of the copy of a file from before this release first migrated it."""
    return path.with_name(f"{path.name}.before-{release()}")


def list_backups(path: Path) -> list[Path]:
    """Return the paths of the copies of a file from before each migration by this release, the latest first."""
    return list(takewhile(Path.exists, numbered_paths(backup_path(path))))[::-1]


def _replace(path: Path, text: str) -> Path:
    """Write the file and keep the old one; the owner and the mode of the file stay as they are."""
    old = first_free(backup_path(path))
    try:
        write_new(old, path.read_bytes().decode(), path.stat())
        rewrite_file(path, text)
    except OSError as error:
        with contextlib.suppress(OSError):
            old.unlink()
        raise UserError(f"{path} cannot be migrated: {error.strerror}") from None
    return old


def _parses_to(text: str, wanted: Mapping[str, Any]) -> bool:
    try:
        return tomllib.loads(text) == wanted
    except tomllib.TOMLDecodeError:
        return False


def _has(values: Mapping[str, Any], path: str) -> bool:
    """Whether the file, or a tracker's table in it, has a key."""
    *sections, key = path.split(".")
    found: Any = values
    for name in sections:
        found = found.get(name, {}) if isinstance(found, Mapping) else {}
    tables = values.get("tracker", ())
    return key in found or any(_has(table, path) for table in tables if isinstance(table, Mapping))


def _with_keys_renamed(values: Any, section: str) -> Any:
    if isinstance(values, list):
        return [_with_keys_renamed(value, section) for value in values]
    if not isinstance(values, Mapping):
        return values
    return {
        RENAMED_KEYS.get(_place(section, name), name): _with_keys_renamed(value, _place(section, name))
        for name, value in values.items()
    }


def _place(section: str, name: str) -> str:
    """Return the path of a key; inside a tracker's table it is that of the file."""
    path = f"{section}.{name}" if section else name
    return path.removeprefix("tracker.")


def _lines(text: str) -> Iterator[str]:
    section = ""
    for line in text.splitlines(keepends=True):
        header, key = _HEADER.match(line), _KEY.fullmatch(line)
        if header:
            section = header[1].removeprefix("tracker.")
        elif key and f"{section}.{key[2]}" in RENAMED_KEYS:
            yield f"{key[1]}{RENAMED_KEYS[f'{section}.{key[2]}']}{key[3]}"
            continue
        yield line
