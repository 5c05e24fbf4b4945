"""heliocube for notebooks: the sun, the pointing laws, recorded readings and simulated days.

::

    import heliocube

    faces = [[310.0, 620.0, 150.0, 540.0]]  # east, south, west, zenith [W/m2]
    a_deg, b_deg = heliocube.angles_within(heliocube.mu_prime(faces), heliocube.Limits())

What is named here is kept from version to version; the packages behind it (`solar`, `daemon` and so on) may change.
Each name loads what it needs when it is first used, so that ``import heliocube`` costs nothing. docs/library.md has
worked examples.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daemon.studies.notebook import UserError, read_faces, read_store, replay, simulate
    from daemon.studies.samples import sample
    from solar.ephemeris import Site, SunPosition, sun_day, sun_direction, sun_position
    from solar.frames import (
        Angles,
        Limits,
        angles_from_direction,
        angles_within,
        normal_from_angles,
        separation_deg,
    )
    from solar.laws.paper import chronometric, mu_prime, sun_vector

    __version__: str

__all__ = [
    "Angles",
    "Limits",
    "Site",
    "SunPosition",
    "UserError",
    "__version__",
    "angles_from_direction",
    "angles_within",
    "chronometric",
    "mu_prime",
    "normal_from_angles",
    "read_faces",
    "read_store",
    "replay",
    "sample",
    "separation_deg",
    "simulate",
    "sun_day",
    "sun_direction",
    "sun_position",
    "sun_vector",
]

_HOMES = {
    "daemon.studies.notebook": ("UserError", "read_faces", "read_store", "replay", "simulate"),
    "daemon.studies.samples": ("sample",),
    "solar.ephemeris": ("Site", "SunPosition", "sun_day", "sun_direction", "sun_position"),
    "solar.frames": (
        "Angles",
        "Limits",
        "angles_from_direction",
        "angles_within",
        "normal_from_angles",
        "separation_deg",
    ),
    "solar.laws.paper": ("chronometric", "mu_prime", "sun_vector"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load what a public name stands for, at its first use."""
    if name == "__version__":
        found: Any = import_module("importlib.metadata").version("heliocube")
    elif name in _HOME_OF:
        found = getattr(import_module(_HOME_OF[name]), name)
    else:
        raise AttributeError(f"heliocube has no '{name}'; it has {', '.join(__all__)}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
