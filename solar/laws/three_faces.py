"""Three faces and the sun's position for a law that reads four.

The light that explains three faces best (:func:`solar.laws.light.light_from_faces`) tells what the fourth would read.
"""

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array
from solar.laws.light import FACES_NEEDED, light_from_faces, on_faces


def completed(faces: ArrayLike, sun: ArrayLike, albedo: ArrayLike = 0.2) -> Array:
    """Return the faces, and for the one without a reading what the light behind the other three puts on it.

    Parameters
    ----------
    faces
        Irradiances [W/m2], shape (..., 4); NaN for none. Where more than one has none it stays as it is.
    sun
        Unit vector(s) to the apparent sun, shape (..., 3).
    albedo
        Of the ground around the cube, shape (...).
    """
    readings, sun = np.asarray(faces, dtype=np.float64), np.asarray(sun, dtype=np.float64)
    known = np.isfinite(readings)
    alone = ~known & (known.sum(axis=-1, keepdims=True) == FACES_NEEDED)
    if not alone.any():
        return readings
    light = light_from_faces(readings, sun, albedo, known)
    return np.where(alone, on_faces(light, sun, albedo), readings)
