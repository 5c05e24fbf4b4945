"""The range of possible irradiance: a value outside it marks a missing one, such as -9999, or is damaged."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.ephemeris import Site, sun_position
from solar.frames import Array

# A pyranometer's thermal offset at night is above the lower bound, the sun between bright clouds below the upper one.
LOWEST_W_M2, HIGHEST_W_M2 = -50.0, 2500.0
# With the sun this high even thick clouds let several times 2 W/m2 through.
_HIGH_SUN_DEG, _DARKEST_W_M2 = 20.0, 2.0


def is_possible(irradiance_w_m2: ArrayLike) -> NDArray[np.bool_]:
    """Tell which irradiances can be, in an array of the same shape; NaN cannot."""
    values = np.asarray(irradiance_w_m2, dtype=np.float64)
    found: NDArray[np.bool_] = (values >= LOWEST_W_M2) & (values <= HIGHEST_W_M2)
    return found


def kilowatts_note(name: str, of: str, highest_w_m2: float, utc_s: Array, site: Site) -> str | None:
    """Return a sentence that says that measurements look like kW/m2, too dark for a high sun; None if they do not.

    `name` and `of` name the measurements in the sentence, `highest_w_m2` is the highest of them (NaN if there are
    none), and `utc_s` are their times [s], shape (n,).
    """
    if not highest_w_m2 < _DARKEST_W_M2 or not np.any(sun_position(utc_s, *site).elevation_deg > _HIGH_SUN_DEG):
        return None
    return f"{name} has at most {highest_w_m2:.3g} W/m2 {of} by day: if it is in kW/m2, multiply it by 1000"
