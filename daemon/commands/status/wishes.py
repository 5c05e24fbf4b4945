"""What `heliocube status` says of what persons asked for."""

from collections.abc import Iterator
from typing import Any

from rich.text import Text

from daemon.commands.status.times import moment


def lines_of_wishes(state: dict[str, Any], time: str) -> Iterator[tuple[str, Text]]:
    """Yield names and texts of the lines, each with its person and beginning, by a tracker's part of the state."""
    for name, wish in (state["wishes"] or {}).items():
        for each in [] if wish is None else _everybodys(wish):
            also = "" if each is wish else "also"
            by = f" by {each['by']}" if each["by"] else ""
            since = "" if each["since"] is None else f" since {moment(each['since'], time)}"
            yield name, Text(f"{also}{by}{since}: {each['why']}".strip())


def after_reasons(why: str, wish: dict[str, Any]) -> str:
    """Return what comes in the reason of a mode after those of everybody who asked for it."""
    for each in _everybodys(wish):
        why = why.partition(each["why"])[2]
    return why


def _everybodys(wish: dict[str, Any]) -> list[dict[str, Any]]:
    # A service of an earlier version shows the last one alone.
    return [wish, *wish.get("also", [])]
