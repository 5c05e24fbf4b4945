"""The lines of `heliocube status` on the wishes of persons."""

from collections.abc import Iterator
from typing import Any

from rich.text import Text

from daemon.commands.status.times import local_and_utc_time


def lines_of_wishes(state: dict[str, Any], time: str) -> Iterator[tuple[str, Text]]:
    """Yield names and texts of the lines from a tracker's part of the state: who asked, since when, and why."""
    for name, wish in (state["wishes"] or {}).items():
        for each in [] if wish is None else _wishes_of_all(wish):
            also = "" if each is wish else "also"
            by = f" by {each['by']}" if each["by"] else ""
            since = "" if each["since"] is None else f" since {local_and_utc_time(each['since'], time)}"
            yield name, Text(f"{also}{by}{since}: {each['why']}".strip())


def strip_wish_reasons(why: str, wish: dict[str, Any]) -> str:
    """Return the part of a mode's reason that follows the reasons of all who asked for it."""
    for each in _wishes_of_all(wish):
        why = why.partition(each["why"])[2]
    return why


def _wishes_of_all(wish: dict[str, Any]) -> list[dict[str, Any]]:
    # A service of an earlier version sends only the last wish.
    return [wish, *wish.get("also", [])]
