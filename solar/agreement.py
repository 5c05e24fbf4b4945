"""How far readings agree with a reference: the numbers of Table 1 of Andriamahefa et al. (2023)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike


class Agreement(NamedTuple):
    """How far readings are from their reference, as in Table 1 of Andriamahefa et al. (2023).

    Attributes
    ----------
    pairs
        How many pairs there are.
    mbe, mae
        Mean bias and mean absolute error, reading less reference, in the unit of both.
    rmbe_percent, rmae_percent
        The same over the reference's mean.
    """

    pairs: int
    mbe: float
    rmbe_percent: float
    mae: float
    rmae_percent: float


def agreement(readings: ArrayLike, references: ArrayLike) -> Agreement:
    """Return MBE = mean(x - r), MAE = mean|x - r| and both over mean(r), for arrays of one shape and one unit.

    Pairs with NaN are left out; raises `ValueError` when none is left, when the reference's mean is not positive, or
    when the shapes differ.
    """
    reading, reference = np.asarray(readings, dtype=np.float64), np.asarray(references, dtype=np.float64)
    if reading.shape != reference.shape:
        raise ValueError(f"arrays of one shape are needed, not of shapes {reading.shape} and {reference.shape}")
    both = np.isfinite(reading) & np.isfinite(reference)
    if not both.any():
        raise ValueError("there is no pair of readings to compare")
    mean = float(np.mean(reference[both]))
    if not mean > 0.0:
        raise ValueError(f"the reference's mean is {mean:g}, and errors relative to it mean nothing")
    error = reading[both] - reference[both]
    mbe, mae = float(np.mean(error)), float(np.mean(np.abs(error)))
    return Agreement(
        pairs=int(both.sum()),
        mbe=mbe,
        rmbe_percent=100.0 * mbe / mean,
        mae=mae,
        rmae_percent=100.0 * mae / mean,
    )
