"""What the positioner's own settings may make it do without being told, as far as its slow screens show it."""

from collections.abc import Mapping

# For a position only "off" (stored as 1000) means that there is none: 0 is a place to go to.
_NO_POSITION = ("", "off", "1000", "1000.0")
_NO_DAYS = ("", "off", "0", "0.0")
_SETTINGS = {
    "a night position": ((108, 109), _NO_POSITION),
    "a reference run every few days": ((117, 118), _NO_DAYS),
    "a snow position": ((126, 127), _NO_POSITION),
}
OWN_MOVES = frozenset(code for codes, _ in _SETTINGS.values() for code in codes)
"""The fields that tell of them."""


def own_moves(fields: Mapping[int, str]) -> tuple[str, ...]:
    """Name the settings that are on, with their fields, such as ``a night position (108=-50, 109=off)``."""
    found = []
    for name, (codes, off) in _SETTINGS.items():
        if any(fields.get(code, "").lower() not in off for code in codes):
            found.append(f"{name} ({', '.join(f'{code}={fields[code]}' for code in codes if code in fields)})")
    return tuple(found)
