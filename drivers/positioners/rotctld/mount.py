"""An azimuth-elevation mount under the tracker's angles: where it has to point, and whether it gets there.

The module's normal lies along the rotator's beam. In the tracker's frame (i to the equator's side, j east, k up) the
normal is (cos A cos B, -sin A, cos A sin B), Andriamahefa et al. (2023), equation (13). Azimuth counts from north
through east, and i points south in the northern hemisphere and north in the southern one.
"""

from dataclasses import dataclass
from math import atan2, cos, degrees, hypot, radians, sin
from typing import NamedTuple

TURN_DEG = 360.0
FLAT_WITHIN_DEG = 0.5
"""So near to the zenith the azimuth means nothing, and the rotator keeps the one that it has."""
OVERTRAVEL_DEG = 5.0
"""How far beyond its range a rotator may be seen, by its run-out and by the steps of its count."""


class RotatorPosition(NamedTuple):
    """Where a rotator points, in its own count [deg]."""

    azimuth_deg: float
    elevation_deg: float


class UnreachableError(Exception):
    """The rotator's range does not contain a position; the text is a clause that says where it lies."""


def position_from_angles(a_deg: float, b_deg: float, equator_azimuth_deg: float) -> RotatorPosition:
    """Return azimuth (0 to 360, of no meaning at the zenith) and elevation of the normal at the angles A and B [deg].

    `equator_azimuth_deg` is where the frame's first axis points: 180 south, 0 north.
    """
    a, b = radians(a_deg), radians(b_deg)
    east, north = -sin(a), cos(radians(equator_azimuth_deg)) * cos(a) * cos(b)
    azimuth_deg = degrees(atan2(east, north)) % TURN_DEG
    return RotatorPosition(azimuth_deg, degrees(atan2(cos(a) * sin(b), hypot(east, north))))


def angles(azimuth_deg: float, elevation_deg: float, equator_azimuth_deg: float) -> tuple[float, float]:
    """Return A and B [deg] of an azimuth and elevation; B is beyond 90 where these point away from the equator."""
    azimuth, elevation = radians(azimuth_deg), radians(elevation_deg)
    east = cos(elevation) * sin(azimuth)
    equatorward = cos(radians(equator_azimuth_deg)) * cos(elevation) * cos(azimuth)
    up = sin(elevation)
    return degrees(atan2(-east, hypot(equatorward, up))), degrees(atan2(up, equatorward))


@dataclass(frozen=True, slots=True)
class Mount:
    """A rotator's range [deg], ends included, and the hemisphere it stands in.

    Attributes
    ----------
    azimuth_min_deg, azimuth_max_deg
        May span more or less than a turn, and begin anywhere: 0 to 360, -180 to 180, -180 to 450.
    elevation_min_deg, elevation_max_deg
        More than 90 is never used.
    equator_azimuth_deg
        Where the tracker's frame looks: 180 south, 0 north.
    """

    azimuth_min_deg: float
    azimuth_max_deg: float
    elevation_min_deg: float
    elevation_max_deg: float
    equator_azimuth_deg: float

    def place(self, a_deg: float, b_deg: float, here: RotatorPosition | None = None) -> RotatorPosition:
        """Return where the rotator has to go for the angles A and B; `UnreachableError` if it cannot.

        Of several turns that show the same direction it always takes the same one, so that cables are wound no further
        with time. At the zenith the azimuth of `here` is kept.
        """
        wanted = position_from_angles(a_deg, b_deg, self.equator_azimuth_deg)
        if wanted.elevation_deg >= 90.0 - FLAT_WITHIN_DEG:
            elevation_deg = min(90.0, self.elevation_max_deg)
            held_deg = (self.azimuth_min_deg + self.azimuth_max_deg) / 2 if here is None else here.azimuth_deg
            azimuth_deg: float | None = self.nearest(RotatorPosition(held_deg, elevation_deg)).azimuth_deg
            reached = elevation_deg >= 90.0 - FLAT_WITHIN_DEG
        else:
            elevation_deg = wanted.elevation_deg
            azimuth_deg = self._in_best_turn(wanted.azimuth_deg)
            reached = self.elevation_min_deg <= elevation_deg <= self.elevation_max_deg
        if azimuth_deg is None or not reached:
            where = f"azimuth {wanted.azimuth_deg:z.1f}, elevation {wanted.elevation_deg:z.1f} deg"
            raise UnreachableError(f"{where}, but the rotator turns {self}")
        return RotatorPosition(azimuth_deg, elevation_deg)

    def unwrap_azimuth(self, azimuth_deg: float, before_deg: float | None = None) -> float:
        """Return a reported azimuth in the turn that the range counts in, for rotators that report another turn.

        `before_deg` is what was returned last: a rotator that rests a little beyond one end of its range has not gone
        to the other end.
        """
        beyond_deg = 0.0 if before_deg is None else OVERTRAVEL_DEG
        low_deg, high_deg = self.azimuth_min_deg - beyond_deg, self.azimuth_max_deg + beyond_deg
        turns_deg = [azimuth_deg + turn_deg for turn_deg in _TURNS if low_deg <= azimuth_deg + turn_deg <= high_deg]
        if before_deg is None or not turns_deg:
            return turns_deg[0] if turns_deg else azimuth_deg
        return min(turns_deg, key=lambda each_deg: abs(each_deg - before_deg))

    def nearest(self, here: RotatorPosition) -> RotatorPosition:
        """Return the position in the range that is nearest to `here`, which may lie outside."""
        return RotatorPosition(
            min(max(here.azimuth_deg, self.azimuth_min_deg), self.azimuth_max_deg),
            min(max(here.elevation_deg, self.elevation_min_deg), self.elevation_max_deg),
        )

    def __str__(self) -> str:
        return (
            f"azimuth {self.azimuth_min_deg:g} to {self.azimuth_max_deg:g} and"
            f" elevation {self.elevation_min_deg:g} to {self.elevation_max_deg:g} deg"
        )

    def _in_best_turn(self, azimuth_deg: float) -> float | None:
        """Return the azimuth in the turn that holds the whole day, or else nearest to the middle of the range.

        If two hold it, it is the one without negative azimuths: Yaesu's controllers, which Hamlib gives -180 to 450,
        take -20 for 340 and then report 340, to which nobody sent them.
        """
        relative_deg = (azimuth_deg - self.equator_azimuth_deg + 180.0) % TURN_DEG - 180.0
        count_deg = self.equator_azimuth_deg + relative_deg
        inside = [turn for turn in _TURNS if self.azimuth_min_deg <= count_deg + turn <= self.azimuth_max_deg]
        middle_deg = (self.azimuth_min_deg + self.azimuth_max_deg) / 2
        if not inside:
            return None
        best = min(
            inside,
            key=lambda turn: (
                not self._holds_the_day(turn),
                self.equator_azimuth_deg + turn < 90.0,
                abs(self.equator_azimuth_deg + turn - middle_deg),
            ),
        )
        return count_deg + best

    def _holds_the_day(self, turn_deg: float) -> bool:
        noon_deg = self.equator_azimuth_deg + turn_deg
        return self.azimuth_min_deg <= noon_deg - 90.0 and noon_deg + 90.0 <= self.azimuth_max_deg


_TURNS = (0.0, TURN_DEG, -TURN_DEG)
