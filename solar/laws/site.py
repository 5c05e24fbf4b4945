"""What the cube's own readings teach of its site: the ground's albedo and the sensors' relative gains.

In steady beam the sun's known direction fixes what the lit faces must read relative to each other:

    (I_E - I_W)/(I_S - I_W) = s_E/s_S     with the west face in shade, and the mirror image in the afternoon

so the gains of east and west relative to south are seen; their common factor is not, and is set so that the three
multiply to 1. The vertical intercept h (what a face without beam reads) and the zenith face give the albedo,

    rho = (2 h - 1.2 (I_Z - B s_z))/I_Z

where a tenth of the diffuse light is left to the horizon, which is brighter than the vault under a clear sky. The
zenith sensor's gain is in rho too: one equation cannot tell them apart, and for pointing it need not. At the end of
each day the law takes a small step towards what its sums show, inside bounds. A day on which a face was left out
teaches nothing: the face may have read wrong before that was found, and what it taught would outlast the fault.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array, stack_components

ALBEDO_RANGE = (0.0, 0.9)
GAIN_RANGE = (0.93, 1.07)
_STEP = 0.2
_FULL_STEP_S = 3600.0
_BEAM_W_M2 = 300.0
_BEAM_SHARE = 0.7
_HORIZON_SHARE = 0.1
_LIT_COSINE = 0.3
_LIGHT_W_M2 = 50.0
_MOST_LEFT_OUT_S = 600.0


@dataclass(frozen=True, slots=True)
class LearnedSite:
    """Albedo of the ground and gains of the vertical faces; readings are divided by their gain.

    Arrays of the law's shape, or floats.
    """

    albedo: Any = 0.2
    gain_east: Any = 1.0
    gain_south: Any = 1.0
    gain_west: Any = 1.0

    def to_dict(self) -> dict[str, float]:
        """Return plain numbers for JSON; for one tracker only."""
        return {name: float(getattr(self, name)) for name in _NAMES}


_NAMES = ("albedo", "gain_east", "gain_south", "gain_west")


class DaySums(NamedTuple):
    """Weighted sums of one day: seconds and second-weighted values, each of the law's shape.

    In `left_out_s` seconds some faces had readings and others none.
    """

    albedo_s: Array
    albedo: Array
    east_s: Array
    east: Array
    west_s: Array
    west: Array
    left_out_s: Array


class SiteLearning:
    """Learns slowly, from its own data, inside bounds.

    Parameters
    ----------
    shape
        Of the readings, without the four faces.
    learned
        To begin with.
    """

    def __init__(self, shape: tuple[int, ...] = (), learned: LearnedSite | None = None) -> None:
        self._shape = shape
        self.learned = learned or LearnedSite()
        self._sums = zero_sums(shape)

    def corrected(self, faces: ArrayLike) -> Array:
        """Return the faces [W/m2], shape (..., 4), divided by their gains."""
        corrected = np.array(faces, dtype=np.float64)
        corrected[..., :3] /= stack_components(self.learned.gain_east, self.learned.gain_south, self.learned.gain_west)
        return corrected

    def observe(
        self, faces: Array, sun: Array, usable: NDArray[np.bool_], beam_w_m2: Array, elapsed_s: ArrayLike
    ) -> None:
        """Add corrected faces, with the beam they were found to show, to the day's sums."""
        clear = usable.all(axis=-1) & (beam_w_m2 > _BEAM_W_M2) & (beam_w_m2 * sun[..., 2] > _BEAM_SHARE * faces[..., 3])
        missing = np.isnan(faces)
        left_out = missing.any(axis=-1) & ~missing.all(axis=-1)
        if not (clear | left_out).any():
            return
        added = _sums_of(np.where(usable, faces, 0.0), sun, beam_w_m2, np.where(clear, elapsed_s, 0.0))
        added = added._replace(left_out_s=np.where(left_out, elapsed_s, 0.0))
        # Add readings of many instants, shape (n, *shape), one after the other, so that the sum does not depend on how
        # many are taken in at once.
        parts = np.array(added).reshape(len(added), -1, *self._shape)
        sums = np.concatenate((np.array(self._sums)[:, None], parts), axis=1)
        self._sums = DaySums(*np.cumsum(sums, axis=1)[:, -1])

    def end_of_day(self) -> None:
        """Take a step towards what the day showed, and begin another."""
        self.learned = update_learned(self.learned, self._sums)
        self._sums = zero_sums(self._shape)

    def reset(self) -> None:
        """Forget everything."""
        self.learned = LearnedSite()
        self._sums = zero_sums(self._shape)


def zero_sums(shape: tuple[int, ...]) -> DaySums:
    """Return the sums of a day that has not begun."""
    return DaySums(*(np.zeros(shape) for _ in DaySums._fields))


def _sums_of(faces: Array, sun: Array, beam: Array, seconds: Array) -> DaySums:
    """Return what readings of shape (..., 4) add to a day's sums; zero where they stand for no seconds."""
    east, south, west, zenith = (faces[..., face] for face in range(4))
    east_s, east_log = _log_ratio(east - west, south - west, sun[..., 1], sun[..., 0], seconds)
    west_s, west_log = _log_ratio(west - east, south - east, -sun[..., 1], sun[..., 0], seconds)
    shaded = np.minimum(east, west)
    diffuse = zenith - beam * sun[..., 2]
    albedo = (2.0 * (shaded - _HORIZON_SHARE * diffuse) - diffuse) / np.maximum(zenith, _LIGHT_W_M2)
    return DaySums(
        albedo_s=seconds,
        albedo=seconds * albedo,
        east_s=east_s,
        east=east_s * east_log,
        west_s=west_s,
        west=west_s * west_log,
        left_out_s=np.zeros_like(seconds),
    )


def update_learned(learned: LearnedSite, sums: DaySums) -> LearnedSite:
    """Return what is known after a day with these sums: at most a fifth of the way to what it showed."""
    teaches = np.where(sums.left_out_s > _MOST_LEFT_OUT_S, 0.0, 1.0)
    sums = DaySums(*(teaches * total for total in sums))
    albedo = _step_towards(np.asarray(learned.albedo), sums.albedo_s, sums.albedo)
    # The readings were corrected: what they show of the gains is what is left to correct.
    east = np.log(learned.gain_east / learned.gain_south)
    west = np.log(learned.gain_west / learned.gain_south)
    east, west = _step_towards(east, sums.east_s, sums.east, east), _step_towards(west, sums.west_s, sums.west, west)
    south = -(east + west) / 3.0
    low, high = GAIN_RANGE
    return LearnedSite(
        np.clip(albedo, *ALBEDO_RANGE),
        np.clip(np.exp(south + east), low, high),
        np.clip(np.exp(south), low, high),
        np.clip(np.exp(south + west), low, high),
    )


def _step_towards(now: Array, seconds: Array, total: Array, base: Array | float = 0.0) -> Array:
    """Go from `now` towards `base` plus the day's mean, by a share that grows with the seconds behind it."""
    mean = np.divide(total, seconds, out=np.zeros_like(total), where=seconds > 0.0)
    share = _STEP * np.minimum(seconds / _FULL_STEP_S, 1.0)
    result: Array = now + share * (base + mean - now)
    return result


def _log_ratio(lit: Array, south: Array, cosine: Array, south_cosine: Array, seconds: Array) -> tuple[Array, Array]:
    """Return seconds, and the log of the factor by which `lit` over `south` is too much; both less the shaded face."""
    valid = (seconds > 0.0) & (cosine > _LIT_COSINE) & (south_cosine > _LIT_COSINE)
    valid &= (lit > _LIGHT_W_M2) & (south > _LIGHT_W_M2)
    ratio = np.where(valid, lit * south_cosine, 1.0) / np.where(valid, south * cosine, 1.0)
    return np.where(valid, seconds, 0.0), np.log(ratio)
