"""JSON objects in which no name stands twice: nobody knows which of the two values is meant."""

from typing import Any


class DuplicateNameError(ValueError):
    """A name stands twice in one object.

    Parameters
    ----------
    name
        As it is to be shown: ASCII, quoted, short.
    """

    def __init__(self, name: str) -> None:
        super().__init__(f"{name} stands twice")
        self.name = name


def reject_duplicate_names(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the pairs as an object, as `object_pairs_hook` of `json`; `DuplicateNameError` if a name stands twice."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise DuplicateNameError(ascii(name)[:40])
        found[name] = value
    return found
