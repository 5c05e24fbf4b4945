"""What irradiance can be: whatever lies outside marks a missing value, such as -9999, or is damage."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.ephemeris import Site, sun_position
from solar.frames import Array

# A pyranometer's thermal offset at night is above the one, the sun between bright clouds below the other.
LOWEST_W_M2, HIGHEST_W_M2 = -50.0, 2500.0
# Under thick clouds there is several times as much.
_HIGH_SUN_DEG, _DARKEST_W_M2 = 20.0, 2.0


def possible(irradiance_w_m2: ArrayLike) -> NDArray[np.bool_]:
    """Tell which irradiances can be, in an array of the same shape; NaN cannot."""
    values = np.asarray(irradiance_w_m2, dtype=np.float64)
    found: NDArray[np.bool_] = (values >= LOWEST_W_M2) & (values <= HIGHEST_W_M2)
    return found


def kilowatts_note(name: str, of: str, highest_w_m2: float, utc_s: Array, site: Site) -> str | None:
    """Return in a sentence that measurements look like kW/m2, as the sky is too dark under a high sun, or None.

    `name` and `of` are how it calls them, `highest_w_m2` is the highest among them, NaN without any, and `utc_s` are
    their times [s], shape (n,).
    """
    if not highest_w_m2 < _DARKEST_W_M2 or not np.any(sun_position(utc_s, *site).elevation_deg > _HIGH_SUN_DEG):
        return None
    return f"{name} has at most {highest_w_m2:.3g} W/m2 {of} by day: if it is in kW/m2, multiply it by 1000"
