"""What a process is made of: its role, and the instruments that the role needs."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from drivers.interfaces import Cube, ElectronicLoad, Positioner


class Role(StrEnum):
    """What one process does."""

    CUBE = "cube"
    TRACKER = "tracker"
    BOTH = "both"

    def name_or_default(self, name: str | None) -> str:
        """Return the name of the only tracker, or of the cube in a process without one; `name` is that of [mqtt]."""
        return name or (Role.CUBE if self is Role.CUBE else Role.TRACKER).value


@dataclass(frozen=True, slots=True)
class TrackerInstruments:
    """The instruments of one tracker.

    Attributes
    ----------
    positioner
        Its drive.
    load
        The electronic load on its module, or None.
    has_fixed_start_pose
        The positioner is a simulated one that begins at one and the same place whenever it is started: its earlier
        place of rest tells nothing.
    """

    positioner: Positioner
    load: ElectronicLoad | None = None
    has_fixed_start_pose: bool = False


@dataclass(frozen=True, slots=True)
class Rig:
    """The instruments of one process, real or simulated.

    Attributes
    ----------
    cube
        None where the role has no cube.
    trackers
        The instruments of each tracker, in the order of the settings' trackers; empty where the role has none.
    wind_speed_m_s
        Latest wind speed [m/s]; None where there is no wind sensor at all.
    simulated
        True if any instrument is simulated, in this process or at a bench: all records are marked as simulated then.
    sky_text
        One line about the simulated sky for displays, or None.
    clock_synchronised
        Whether anything has synchronised the machine's clock; None where that is not known or there is no such clock.
    has_persistent_clock
        Whether the clock goes on while no service runs; a simulated clock does not.
    """

    cube: Cube | None
    trackers: tuple[TrackerInstruments, ...]
    wind_speed_m_s: Callable[[], float | None] | None
    simulated: bool
    sky_text: Callable[[], str] | None = None
    clock_synchronised: Callable[[], bool | None] = lambda: None
    has_persistent_clock: bool = False
