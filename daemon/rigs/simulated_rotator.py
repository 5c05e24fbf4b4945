"""The simulated rotator behind a simulated rotctld, built as the configuration describes the real one."""

from collections.abc import Callable

from daemon.base.clock import Clock
from daemon.config.settings import Settings
from daemon.rigs.real import positioner_surroundings
from drivers.positioners.rotctld import driver
from drivers.positioners.rotctld.driver import RotctldSettings
from drivers.positioners.rotctld.positioner import RotctldPositioner
from sim_drivers.rotctld.core import RotatorCore, RotatorRange
from sim_drivers.transports import InMemoryRotctld
from solar.frames import Angles, angles_from_direction, direction_from_azimuth, equator_azimuth_deg


def build_rotator(settings: Settings, own: RotctldSettings, clock: Clock) -> RotatorCore:
    """Return the simulated rotator, flat and facing the equator; unless a range is set, its end stop is behind it."""
    equator_deg = equator_azimuth_deg(settings.site.latitude_deg)

    def either(value: float | None, usual: float) -> float:
        return usual if value is None else value

    turns = RotatorRange(
        azimuth_min_deg=either(own.azimuth_min_deg, equator_deg - 180.0),
        azimuth_max_deg=either(own.azimuth_max_deg, equator_deg + 180.0),
        elevation_min_deg=either(own.elevation_min_deg, 0.0),
        elevation_max_deg=either(own.elevation_max_deg, 90.0),
    )
    start = (
        min(max(equator_deg, turns.azimuth_min_deg), turns.azimuth_max_deg),
        min(max(90.0, turns.elevation_min_deg), turns.elevation_max_deg),
    )
    core = RotatorCore(clock.monotonic(), turns, start)
    core.model = own.model or core.model
    return core


def rotator_truth(core: RotatorCore, settings: Settings) -> Callable[[float], Angles]:
    """Return a function for the true angles A and B of a rotator at a monotonic time."""
    latitude_deg = settings.site.latitude_deg

    def truth(now_s: float) -> Angles:
        a_deg, b_deg = angles_from_direction(direction_from_azimuth(*core.position(now_s), latitude_deg))
        return Angles(float(a_deg), float(b_deg))

    return truth


def build_simulated_rotator(
    settings: Settings, own: RotctldSettings, clock: Clock
) -> tuple[Callable[[float], Angles], RotctldPositioner]:
    """Return a function for the angles at which a simulated rotator truly stands, and its driver."""
    core = build_rotator(settings, own, clock)
    line = InMemoryRotctld(core, clock.monotonic)
    return rotator_truth(core, settings), driver.build(own, positioner_surroundings(settings, clock), line)
