"""What a law wants kept or shown, checked and in numbers of Python: anybody may have written it, and with numpy."""

import json
from collections.abc import Mapping
from typing import Any


def checked_kept(found: object) -> dict[str, Any] | None:
    """Return what a law wants kept as it will be read again; `TypeError` for what no file of kept state holds."""
    if found is None:
        return None
    if not isinstance(found, Mapping):
        raise TypeError(f"what it wants kept is {found!r}, no mapping")
    kept: dict[str, Any] = json.loads(json.dumps(dict(found), default=float))
    return kept


def checked_shown(found: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return what a law shows of itself; an error of Python's for what is no mapping of mappings of numbers."""
    return {str(part): {str(name): float(value) for name, value in of.items()} for part, of in found.items()}
