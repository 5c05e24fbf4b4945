"""How far a sensor agrees with a reference: the four numbers of Table 1 of Andriamahefa et al. (2023)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike


class Agreement(NamedTuple):
    """Table 1 of Andriamahefa et al. (2023) for one sensor.

    Attributes
    ----------
    mbe_w_m2, mae_w_m2
        Mean bias and mean absolute error, sensor less reference.
    rmbe_percent, rmae_percent
        The same over the reference's mean.
    """

    mbe_w_m2: float
    rmbe_percent: float
    mae_w_m2: float
    rmae_percent: float


def agreement(sensor_w_m2: ArrayLike, reference_w_m2: ArrayLike) -> Agreement:
    """Return MBE = mean(x - r), MAE = mean|x - r| and both over mean(r), for arrays of one shape.

    Pairs with NaN are left out; raises `ValueError` when none is left or the reference's mean is not positive.
    """
    sensor, reference = np.broadcast_arrays(np.asarray(sensor_w_m2, float), np.asarray(reference_w_m2, float))
    both = np.isfinite(sensor) & np.isfinite(reference)
    if not both.any():
        raise ValueError("there is no pair of readings to compare")
    mean = float(np.mean(reference[both]))
    if not mean > 0.0:
        raise ValueError(f"the reference's mean is {mean:g} W/m2, and errors relative to it mean nothing")
    error = sensor[both] - reference[both]
    mbe, mae = float(np.mean(error)), float(np.mean(np.abs(error)))
    return Agreement(mbe, 100.0 * mbe / mean, mae, 100.0 * mae / mean)
