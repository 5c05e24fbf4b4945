"""The plug-in for any rotator that Hamlib knows: the settings of its rotctld, and how it is built of them."""

import math
from collections.abc import Iterator
from functools import partial
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.positioners.rotctld.link import RotctldLine, TcpLine
from drivers.positioners.rotctld.mount import FLAT_WITHIN_DEG, Mount, UnreachableError
from drivers.positioners.rotctld.positioner import RotctldPositioner
from drivers.positioners.rotctld.protocol import RotatorState
from drivers.settings import (
    AngleRange,
    HostAndPort,
    PositionerSettings,
    PositionerSurroundings,
    Positive,
    SettingsConflict,
    SettingsError,
)

_FINEST_JITTER_DEG = 0.035
_COUNTS = 1.2
# Long enough for the slowest move to show itself.
_STILL_FACTOR, _SHORTEST_STILL_S = 1.5, 0.6

Azimuth = Annotated[float, Field(ge=-360, le=720)]
Elevation = Annotated[float, Field(ge=-90, le=180)]


class RotctldSettings(PositionerSettings):
    """rotctld: any azimuth-elevation rotator that Hamlib knows, through Hamlib's server."""

    axes_are_angles: ClassVar[bool] = False
    axis_names: ClassVar[tuple[str, str]] = ("azimuth", "elevation")
    has_reference_run: ClassVar[bool] = False

    position_unit: Literal["deg"] = Field("deg", description="What the unit counts positions in.")
    server: HostAndPort | None = Field(
        None, examples=["127.0.0.1:4533"], description="Host and port of Hamlib's rotctld."
    )
    model: int | None = Field(
        None, ge=1, examples=[603], description="Hamlib's number of the rotator; any other is refused."
    )
    resolution_deg: Positive = Field(
        0.1, le=5, description="Step to which the rotator rounds its positions; a smaller change is not motion."
    )
    azimuth_min_deg: Azimuth | None = Field(
        None, examples=[0.0], description="Lowest azimuth of the rotator's range; left out: what rotctld says."
    )
    azimuth_max_deg: Azimuth | None = Field(None, examples=[360.0], description="Highest azimuth, likewise.")
    elevation_min_deg: Elevation | None = Field(None, examples=[0.0], description="Lowest elevation, likewise.")
    elevation_max_deg: Elevation | None = Field(None, examples=[90.0], description="Highest elevation, likewise.")

    def resolution(self) -> float:
        """Return what positions are rounded to."""
        return self.resolution_deg

    def rests_within(self, limits: AngleRange) -> tuple[float, float]:
        """Return how far A and B may be off [deg] by half a step of azimuth and of elevation, or near the zenith.

        The further A is from 0, the more degrees of B that is.
        """
        off_deg = math.hypot(0.5 * self.resolution_deg, 0.5 * self.resolution_deg)
        farthest_deg = max(abs(limits.a_min_deg), abs(limits.a_max_deg))
        return max(off_deg, FLAT_WITHIN_DEG), max(off_deg / math.cos(math.radians(farthest_deg)), FLAT_WITHIN_DEG)

    def exclusive(self) -> dict[str, str | None]:
        """Return the server: a rotator has one tracker."""
        return {"server": self.server}

    def conflicts(self, limits: AngleRange) -> Iterator[SettingsConflict]:  # noqa: ARG002 - its range is one of its own
        """Yield the range that is empty."""
        for axis in ("azimuth", "elevation"):
            low, high = getattr(self, f"{axis}_min_deg"), getattr(self, f"{axis}_max_deg")
            if low is not None and high is not None and not low < high:
                yield SettingsConflict(f"{axis}_min_deg", f"must be below {axis}_max_deg ({high:g} deg)")

    def unreachable(self, a_deg: float, b_deg: float, equator_azimuth_deg: float) -> str | None:
        """Return why the range that is set here does not contain a position, or None; an end left out sets no limit."""
        mount = _mount(self, equator_azimuth_deg, ANYWHERE)
        try:
            mount.place(a_deg, b_deg)
        except UnreachableError as error:
            return f"lies at {error}"
        return None


SETTINGS = RotctldSettings
ANYWHERE = RotatorState(model=0, azimuth_deg=(-360.0, 720.0), elevation_deg=(-90.0, 90.0), kind="")


def build(
    settings: RotctldSettings, surroundings: PositionerSurroundings, line: RotctldLine | None = None
) -> RotctldPositioner:
    """Return the positioner, not yet connected; `SettingsError` if no line is given and none is named."""
    if line is None:
        if settings.server is None:
            raise SettingsError(
                'instruments.positioner.server is missing: name the host and port of rotctld, such as "127.0.0.1:4533"'
            )
        host, _, port = settings.server.rpartition(":")
        line = TcpLine(host.strip("[]"), int(port), surroundings.tap)
    jitter_deg = max(_FINEST_JITTER_DEG, _COUNTS * settings.resolution_deg)
    return RotctldPositioner(
        line,
        surroundings.monotonic,
        surroundings.limits,
        partial(_mount, settings, surroundings.equator_azimuth_deg),
        stow=surroundings.stow,
        model=settings.model,
        reply_within_s=settings.telemetry_stale_s,
        jitter_deg=jitter_deg,
        still_for_s=max(_SHORTEST_STILL_S, _STILL_FACTOR * jitter_deg / settings.slowest_deg_per_s),
    )


def _mount(settings: RotctldSettings, equator_azimuth_deg: float, state: RotatorState) -> Mount:
    """Return the mount: settings outrank rotctld's own limits, which are wrong where it has offsets."""

    def either(own: float | None, said: float) -> float:
        return said if own is None else own

    return Mount(
        azimuth_min_deg=either(settings.azimuth_min_deg, state.azimuth_deg[0]),
        azimuth_max_deg=either(settings.azimuth_max_deg, state.azimuth_deg[1]),
        elevation_min_deg=either(settings.elevation_min_deg, state.elevation_deg[0]),
        elevation_max_deg=either(settings.elevation_max_deg, state.elevation_deg[1]),
        equator_azimuth_deg=equator_azimuth_deg,
    )
