"""The commented configuration file and the reference document, both made from the models."""

import textwrap
from collections.abc import Iterator, Mapping
from inspect import cleandoc
from pathlib import Path
from typing import Any, Literal

from daemon.config import keys, rules
from daemon.config.keys import Drivers, Key, SettingsTable

Role = Literal["both", "cube", "tracker"]

FILE_NAME = "heliocube.toml"
KEY_FILE_NAME = "bridge.key"
TOKEN_FILE_NAME = "api.token"  # noqa: S105 - the name of a file

_WIDTH = 100
_NOT_READ = {
    "both": (),
    "cube": (
        "instruments.positioner",
        "instruments.positioner.a_axis",
        "instruments.positioner.b_axis",
        "load",
        "law",
        "windows",
        "limits",
        "rows",
        "motion",
        "safety",
        "mqtt.wind",
        "mqtt.safe",
    ),
    "tracker": ("instruments.cube", "instruments.multiplexer", "instruments.voltmeter"),
}
_HEADINGS = {
    "both": "cube and tracker in one process",
    "cube": "the machine of the cube",
    "tracker": "the machine of the tracker",
}
_TRACKERS = """\
## [[tracker]]

Several trackers in one process, with a table for each. Without such a table there is one tracker, with the sections
above as they are.

- Each tracker has the name of its table. The sections above hold for it, except for what its table says differently:
  `site`, `law`, `windows`, `limits`, `rows`, `motion`, `safety`, `load`, and `positioner` for `instruments.positioner`.
- The rules below hold for each tracker's resulting settings. No two real trackers share a port, and all stand on the
  same side of the equator as `site` and the cube.
- Each tracker keeps its files in a folder of its name in `store.directory`. Its topics are below `mqtt.prefix` and its
  name.
- If a tracker without a table has kept a stop, a storm or a doubt, that holds for every tracker that gets a table,
  until a person releases it. So a new line in the file, or another name, releases no stopped tracker.

```toml
[[tracker]]
name = "east"                   # 1 to 32 letters, digits, dashes or underscores, a letter or digit first
[tracker.limits]
a_max_deg = 40.0
[tracker.positioner]
port = "/dev/heliocube-positioner-east"

[[tracker]]
name = "west"
[tracker.law]
driver = "chronometric"
[tracker.positioner]
port = "/dev/heliocube-positioner-west"
```
"""
_INTRODUCTION = """\
# Configuration

The service reads one TOML file.

- `heliocube config init DIR` writes one in which every key is explained, with a new bridge key and a new token of the
  local interface beside it.
- `heliocube config check FILE` lists all mistakes of a file at once, among them missing addresses and a folder that
  cannot be written to. It says in which roles a real rig can run; `--role tracker` asks for one role only. Without
  FILE it takes the one in `HELIOCUBE_CONFIG`.
- `heliocube run` lists the same mistakes and refuses to start. It starts only if nothing but topics and JSON paths is
  wrong ([why](decisions/0011-a-wrong-topic-does-not-stop-the-tracker.md)). Then, while a safety input cannot be heard,
  the tracker does not track, and after that input's time limit it is stowed.
- `heliocube config migrate FILE` updates a file: its tracker gets a table of its own, and keys get their present names.
  The old file is kept beside it, as `FILE.before-RELEASE`. A file of an earlier version also works without an update.
  An upgrade runs this command with `--keys-only`, which leaves a tracker without a name as it is.

A key that is left out has its default. Units are in the names: `_s` seconds, `_deg` degrees, `_w_m2` W/m2, `_m_s` m/s,
`_mv` millivolts. Unknown keys are errors. Relative paths start from the folder of the file. Times carry their UTC
offset and stand without quotes: `2022-10-14T06:00:00Z`.

This page is made from the models in `daemon/config/`; regenerate it with `python -m daemon.config.template`.
"""


def render_config(role: Role, values: Mapping[str, Any] | None = None, chosen: Drivers = ()) -> str:
    """Return a commented TOML file with every key that a role reads, at its default.

    Parameters
    ----------
    role
        ``both``, ``cube`` or ``tracker``.
    values
        Values in place of defaults, by the key's path.
    chosen
        Drivers in place of the usual ones, whose keys the file then has.
    """
    skipped = _NOT_READ[role]
    tables = [
        table
        for table in keys.tables(chosen).values()
        if table.path and not table.only_for and not any(f"{table.path}.".startswith(f"{path}.") for path in skipped)
    ]
    blocks = [_heading(role), *[_block(table, values or {}) for table in tables]]
    return "\n\n".join(blocks) + "\n"


def reference() -> str:
    """Return docs/configuration.md."""
    parts = [_INTRODUCTION]
    for table in keys.tables().values():
        if table.path:
            rows = [_row(key) for key in table.keys]
            head = ["| Key | Default | Takes | Meaning |", "|---|---|---|---|"]
            parts.append("\n".join([f"## [{table.path}]\n\n{table.about}\n", *head, *rows]) + "\n")
    parts.append(_TRACKERS)
    sentences = [f"- {' '.join(cleandoc(rule.__doc__ or '').split())}" for rule in rules.RULES]
    parts.append("\n".join(["## Rules between keys\n", *sentences]) + "\n")
    return "\n".join(parts)


def _heading(role: Role) -> str:
    text = f"heliocube: {_HEADINGS[role]}."
    if _NOT_READ[role]:
        text += f" Sections that this role does not read are left out: {', '.join(_NOT_READ[role])}."
    lines = [
        text,
        "Every key stands here with its default. A key that is left out, or stands behind a #, has that default.",
        "Units are in the names. Relative paths start from the folder of this file.",
        f"After a change: heliocube config check {FILE_NAME}",
    ]
    return "\n".join(_comment(line) for line in lines)


def _block(table: SettingsTable, values: Mapping[str, Any]) -> str:
    rule = "# " + "-" * (_WIDTH - 2)
    lines = [] if "." in table.path else [rule]
    lines += [_comment(table.about), f"[{table.path}]"]
    for key in table.keys:
        lines += ["", *_entry(key, values)]
    return "\n".join(lines)


def _entry(key: Key, values: Mapping[str, Any]) -> Iterator[str]:
    value = values.get(key.path, key.default)
    yield _comment(f"{key.description} Takes {key.expected}.")
    unused = "#" if key.only_for and key.path not in values else ""
    yield f"#{key.name} = {key.example}" if value is None else f"{unused}{key.name} = {keys.toml_value(value)}"


def _comment(text: str) -> str:
    lines = textwrap.wrap(" ".join(text.split()), _WIDTH - 2, break_long_words=False, break_on_hyphens=False)
    return "\n".join(f"# {line}" for line in lines)


def _row(key: Key) -> str:
    default = "none" if key.default is None else f"`{keys.toml_value(key.default)}`"
    return f"| `{key.name}` | {default} | {key.expected} | {key.description} |"


if __name__ == "__main__":
    (Path(__file__).resolve().parents[2] / "docs" / "configuration.md").write_text(reference(), encoding="utf-8")
