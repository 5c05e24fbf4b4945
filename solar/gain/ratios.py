"""All devices side by side, for a day or for a year.

Ratios of a year are ratios of yearly sums: the minimum over the days that the paper's scripts print belongs to another
day for each device, so its numbers cannot be put into (51) and (52).
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array
from solar.gain.geometry import DAYS, energy_ratio, sun_path
from solar.gain.horizontal import horizontal_energy_h, k_dh
from solar.gain.static import k_ds, static_energy
from solar.gain.vertical import k_dv, vertical_energy_h


@dataclass(frozen=True, slots=True)
class Energies:
    """What each device receives in the same time, in one unit; the fields broadcast together.

    Attributes
    ----------
    dual
        R_max, a tracker with two axes.
    static, static_abs
        R_S with one face and with |cos theta|.
    vertical
        R_V, a tracker on a vertical axis.
    horizontal
        R_H, the paper's tracker on a north-south axis.
    """

    dual: Array
    static: Array
    static_abs: Array
    vertical: Array
    horizontal: Array

    def apply(self, change: Callable[[Array], Array]) -> "Energies":
        """Return the energies after `change` of each."""
        return Energies(*(change(getattr(self, field.name)) for field in fields(self)))

    @property
    def k_ds_clip(self) -> Array:
        """Dual axis over static with one face; Maiga (2022), (10)."""
        return energy_ratio(self.dual, self.static)

    @property
    def k_ds_abs(self) -> Array:
        """Dual axis over static that is lit from both sides; Maiga (2022), (1), (10)."""
        return energy_ratio(self.dual, self.static_abs)

    @property
    def k_dv(self) -> Array:
        """Dual axis over vertical axis; Maiga (2022), (24)."""
        return energy_ratio(self.dual, self.vertical)

    @property
    def k_dh(self) -> Array:
        """Dual axis over the paper's horizontal axis; Maiga (2022), (48)."""
        return energy_ratio(self.dual, self.horizontal)

    @property
    def eta_vs(self) -> Array:
        """What the vertical axis gains over static with one face; Maiga (2022), (51)."""
        return energy_ratio(self.vertical, self.static) - 1.0

    @property
    def eta_hs(self) -> Array:
        """What the horizontal axis gains over static with one face; Maiga (2022), (52)."""
        return energy_ratio(self.horizontal, self.static) - 1.0


def daily(phi_deg: ArrayLike, beta_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike = 0.0) -> Energies:
    """Return the exact energies [h] of days, every device with the same tilt; Maiga (2022), (1), (10), (15), (29).

    Latitude, tilt, day and azimuth deviation broadcast together. Errors as :func:`solar.gain.static.static_energy`.
    """
    static = static_energy(phi_deg, beta_deg, n, lambda_deg)
    return Energies(
        dual=sun_path(phi_deg, n).max_h,
        static=static.clip_h,
        static_abs=static.abs_h,
        vertical=vertical_energy_h(phi_deg, beta_deg, n),
        horizontal=horizontal_energy_h(phi_deg, beta_deg, n, lambda_deg),
    )


def yearly(phi_deg: ArrayLike, beta_deg: ArrayLike, lambda_deg: ArrayLike = 0.0) -> Energies:
    """Return the exact energies [h] of the year of 365 days; as :func:`daily`, summed over n = 1..365."""
    phi, beta, deviation = (np.asarray(part, dtype=np.float64)[..., None] for part in (phi_deg, beta_deg, lambda_deg))
    return daily(phi, beta, DAYS, deviation).apply(lambda energy: energy.sum(axis=-1))


def eta_vs(
    phi_deg: ArrayLike, beta_deg: ArrayLike, beta_v_deg: ArrayLike, n: ArrayLike, lambda_deg: ArrayLike = 0.0
) -> Array:
    """Return eta_VS = K_DS/K_DV - 1 of single days, each device with its own tilt; Maiga (2022), (51).

    Infinite where the static panel (one face) is never lit, NaN in polar night.
    """
    return _against_static(k_ds(phi_deg, beta_deg, n, lambda_deg), k_dv(phi_deg, beta_v_deg, n))


def eta_hs(
    phi_deg: ArrayLike,
    beta_deg: ArrayLike,
    beta_h_deg: ArrayLike,
    n: ArrayLike,
    lambda_deg: ArrayLike = 0.0,
    lambda_h_deg: ArrayLike = 0.0,
) -> Array:
    """Return eta_HS = K_DS/K_DH - 1 of single days, each device with its own tilt and azimuth; Maiga (2022), (52).

    Infinite where the static panel (one face) is never lit, -1 where the horizontal axis receives nothing, NaN in polar
    night or where neither receives anything.
    """
    return _against_static(k_ds(phi_deg, beta_deg, n, lambda_deg), k_dh(phi_deg, beta_h_deg, n, lambda_h_deg))


def _against_static(k_static: Array, k_single: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return k_static / k_single - 1.0
