"""What irradiance can be: whatever lies outside marks a missing value, such as -9999, or is damage."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# A pyranometer's thermal offset at night is above the one, the sun between bright clouds below the other.
LOWEST_W_M2, HIGHEST_W_M2 = -50.0, 2500.0


def possible(irradiance_w_m2: ArrayLike) -> NDArray[np.bool_]:
    """Tell which irradiances can be, in an array of the same shape; NaN cannot."""
    values = np.asarray(irradiance_w_m2, dtype=np.float64)
    found: NDArray[np.bool_] = (values >= LOWEST_W_M2) & (values <= HIGHEST_W_M2)
    return found
