"""What a rule between keys finds wrong."""

from typing import NamedTuple


class Conflict(NamedTuple):
    """Keys that do not go together: the one to blame first, and what is wrong with it."""

    key: str
    reason: str
    others: tuple[str, ...] = ()
