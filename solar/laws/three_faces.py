"""Three faces and the sun's position for a law that reads four.

Where a face has no reading, or one that the other three contradict, it is given the reading that follows from the light
that explains those three best (:func:`solar.laws.light.light_from_faces`).
"""

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array
from solar.laws.law import Faces, Law
from solar.laws.light import FACES_NEEDED, irradiance_on_faces, is_zenith_usable, light_from_faces, usable_faces


class ThreeFacesLaw(Law):
    """A law that goes on with three faces, or that reads none at all."""

    faces_needed = FACES_NEEDED

    def believes_zenith(self, faces_w_m2: Faces, utc_s: float) -> bool:  # noqa: ARG002
        """Whether the zenith face of a mean [W/m2] can be believed beside the other three."""
        return bool(is_zenith_usable(faces_w_m2))


def fill_missing_face(faces: ArrayLike, sun: ArrayLike, albedo: ArrayLike = 0.2) -> Array:
    """Return the faces; one that tells nothing is replaced by what the light that the other three show puts on it.

    Parameters
    ----------
    faces
        Irradiances [W/m2], shape (..., 4). A face tells nothing if it is NaN or, where all four have a reading, covered
        or dead by what the others read (:func:`solar.laws.light.usable_faces`). Where more than one tells nothing all
        stay as they are.
    sun
        Unit vector(s) to the apparent sun, shape (..., 3).
    albedo
        Of the ground around the cube, shape (...).
    """
    readings, sun = np.asarray(faces, dtype=np.float64), np.asarray(sun, dtype=np.float64)
    read = np.isfinite(readings)
    # With one face missing the other three are all needed, and not judged.
    known = np.where(read.all(axis=-1, keepdims=True), usable_faces(readings, sun), read)
    alone = ~known & (known.sum(axis=-1, keepdims=True) == FACES_NEEDED)
    if not alone.any():
        return readings
    light = light_from_faces(readings, sun, albedo, known)
    return np.where(alone, irradiance_on_faces(light, sun, albedo), readings)
