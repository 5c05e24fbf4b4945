"""Writes the table of docs/alarms.md from `daemon.base.alarms.kinds`, which the service itself shows.

Run `python docs/alarms_table.py` after a change; a test compares.
"""

from pathlib import Path

from daemon.base.alarms.kinds import KINDS, AlarmKind

PAGE = Path(__file__).parent / "alarms.md"
_BEGIN, _END = "<!-- the table: docs/alarms_table.py -->\n", "<!-- its end -->\n"


def page() -> str:
    """Return the page with the table as it should be."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(_BEGIN)
    return f"{before}{_BEGIN}{table()}{_END}{rest.partition(_END)[2]}"


def table() -> str:
    """Return the table in Markdown."""
    head = "| Alarm | Severity | Latched | Cause | Effect | Remedy |\n|---|---|---|---|---|---|\n"
    return head + "".join(_row(kind) for kind in KINDS.values())


def _row(kind: AlarmKind) -> str:
    cells = (f"`{kind.name}`", kind.severity, "yes" if kind.latched else "", kind.cause, kind.effect, kind.remedy)
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
