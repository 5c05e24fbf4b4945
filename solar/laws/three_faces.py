"""Three faces and the sun's position for a law that reads four.

The light that explains three faces best (:func:`solar.laws.light.light_from_faces`) tells what the fourth would read.
"""

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import FACE_NORMALS, Array
from solar.laws.light import irradiance_on, light_from_faces

FACES_NEEDED = 3


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
    by_the_others = np.stack([irradiance_on(light, sun, albedo, normal) for normal in FACE_NORMALS], axis=-1)
    return np.where(alone, by_the_others, readings)
