"""How far a cube stands from level and square: its yaw and its lean.

The cube is rigid, so three angles say where all its faces look. The rotation is written in the frame of
:mod:`solar.frames` by components alone, so that it holds in both hemispheres.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import FACE_NORMALS, Array, azimuth_from_direction


class Attitude(NamedTuple):
    """The misalignment of a cube [deg].

    Attributes
    ----------
    yaw_deg
        Turn about the vertical, clockwise seen from above: the east face looks to 90 deg + yaw.
    lean_equator_deg, lean_east_deg
        Components of the zenith face's lean: towards the equator (i) and towards the east (j).
    """

    yaw_deg: float
    lean_equator_deg: float
    lean_east_deg: float

    @property
    def tilt_deg(self) -> float:
        """Angle between the zenith face's normal and the vertical."""
        return float(np.hypot(self.lean_equator_deg, self.lean_east_deg))


def attitude(yaw_deg: float, tilt_deg: float, tilt_azimuth_deg: float, latitude_deg: float) -> Attitude:
    """Return the attitude of a cube turned by `yaw_deg` whose zenith face leans by `tilt_deg` towards an azimuth A.

    Lean = tilt (-+cos A, sin A) in the frame (i, j), - in the northern hemisphere.
    """
    azimuth = np.radians(tilt_azimuth_deg)
    equatorward = -np.cos(azimuth) if latitude_deg >= 0 else np.cos(azimuth)
    return Attitude(yaw_deg, float(tilt_deg * equatorward), float(tilt_deg * np.sin(azimuth)))


def rotation(turned: ArrayLike, latitude_deg: float) -> Array:
    """Return the matrices, shape (..., 3, 3), that carry directions in the cube to directions at the site.

    R = R_lean R_yaw. R_lean turns in the plane of the vertical k and the horizontal direction h of the lean, by the
    tilt t: R_lean = 1 + sin t (h k' - k h') + (cos t - 1)(h h' + k k'), which is Rodrigues' formula in components. With
    the lean l = t h it needs no h: sin t h = l sin(t)/t, and (cos t - 1) h h' = -l l' (sin(t/2) / (t/2))^2 / 2.

    Parameters
    ----------
    turned
        One attitude, or many, shape (..., 3), in the order of `Attitude`.
    """
    clockwise, equator, east = np.moveaxis(np.radians(np.asarray(turned, dtype=np.float64)), -1, 0)
    if latitude_deg < 0:
        clockwise = -clockwise
    cosine, sine = np.cos(clockwise), np.sin(clockwise)
    tilt = np.hypot(equator, east)
    along, across = -0.5 * np.sinc(tilt / (2.0 * np.pi)) ** 2, np.sinc(tilt / np.pi)
    ii, ij, jj = 1.0 + along * equator * equator, along * equator * east, 1.0 + along * east * east
    rows = [
        [ii * cosine - ij * sine, ii * sine + ij * cosine, across * equator],
        [ij * cosine - jj * sine, ij * sine + jj * cosine, across * east],
        [-across * (equator * cosine - east * sine), -across * (equator * sine + east * cosine), np.cos(tilt)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def face_normals(turned: ArrayLike, latitude_deg: float) -> Array:
    """Return the faces' unit normals R n at the site, shape (..., 4, 3): east, south, west, zenith; R of `rotation`."""
    return np.asarray(FACE_NORMALS @ np.swapaxes(rotation(turned, latitude_deg), -1, -2), dtype=np.float64)


def face_orientations(turned: Attitude, latitude_deg: float) -> tuple[Array, Array]:
    """Return where each R n looks, two arrays of shape (4,): azimuth from North clockwise and tilt [deg]."""
    azimuth, elevation = azimuth_from_direction(face_normals(turned, latitude_deg), latitude_deg)
    return azimuth, 90.0 - elevation


def to_site(direction: ArrayLike, turned: Attitude, latitude_deg: float) -> Array:
    """Return direction(s) d that the cube sees, shape (..., 3), as they are at the site: R d with R of `rotation`."""
    return np.asarray(np.asarray(direction, dtype=np.float64) @ rotation(turned, latitude_deg).T, dtype=np.float64)
