"""What a tilted plane receives under a closed overcast sky: the ceiling of any gain by lying flat.

Radiance goes with 1 + b cos(zenith angle): b = 0 is the isotropic sky, b = 2 the standard overcast sky of Moon &
Spencer (1942), three times as bright at the zenith as at the horizon. The integral over the part of the vault that a
plane sees is that of Steven & Unsworth (1980), Quarterly Journal of the Royal Meteorological Society 106, 57.
"""

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array

ISOTROPIC, STANDARD = 0.0, 2.0


def overcast_factor(tilt_deg: ArrayLike, brightening: float = STANDARD, albedo: float = 0.2) -> Array:
    """Return the irradiance on a plane at a tilt of 0..90 deg as a share of the horizontal one.

    Parameters
    ----------
    tilt_deg
        From the horizontal.
    brightening
        b.
    albedo
        Of the Lambertian ground.
    """
    tilt = np.radians(np.asarray(tilt_deg, dtype=np.float64))
    seen = (1.0 + np.cos(tilt)) / 2.0
    missing = np.sin(tilt) - tilt * np.cos(tilt) - np.pi * (1.0 - np.cos(tilt)) / 2.0
    uneven: Array = 2.0 * brightening / (np.pi * (3.0 + 2.0 * brightening)) * missing
    return seen + uneven + albedo * (1.0 - np.cos(tilt)) / 2.0
