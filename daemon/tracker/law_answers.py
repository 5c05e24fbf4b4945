"""What a law wants kept or shown, checked and in plain Python numbers: anybody may have written the law, with numpy."""

import json
from collections.abc import Mapping
from typing import Any


def checked_kept(found: object) -> dict[str, Any] | None:
    """Return what a law wants kept, in the form in which it will be read again; `TypeError` if no file can hold it."""
    if found is None:
        return None
    if not isinstance(found, Mapping):
        raise TypeError(f"what it wants to keep is {found!r}, not a mapping")
    kept: dict[str, Any] = json.loads(json.dumps(dict(found), default=float))
    return kept


def checked_shown(found: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return what a law shows of itself; raises an error unless it is a mapping of mappings of numbers."""
    return {str(part): {str(name): float(value) for name, value in of.items()} for part, of in found.items()}
