"""What the positioner's own settings may make it do without being told, as far as its slow screens show it."""

from collections.abc import Mapping

_SETTINGS = {
    "a night position": (108, 109),
    "a reference run every few days": (117, 118),
    "a snow position": (126, 127),
}
OWN_MOVES = frozenset(code for codes in _SETTINGS.values() for code in codes)
"""The fields that tell of them."""
_OFF = ("", "off", "0", "0.0")


def own_moves(fields: Mapping[int, str]) -> tuple[str, ...]:
    """Name the settings that are on, with their fields, such as ``a night position (108=-50, 109=off)``."""
    found = []
    for name, codes in _SETTINGS.items():
        if any(fields.get(code, "") not in _OFF for code in codes):
            found.append(f"{name} ({', '.join(f'{code}={fields[code]}' for code in codes if code in fields)})")
    return tuple(found)
