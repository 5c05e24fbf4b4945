"""What a tracker can gain: energy ratios of dual axis, single axes and static panels, after Maiga (2022).

A. Maiga, "Theoretical Energy Efficiency Analysis of Solar Tracking Systems", Global Journal of Researches in
Engineering F 22 (3), 2022, asks for the ratio of what two devices receive in a day under a constant beam. The ratios
here are exact under its assumptions, for every latitude, tilt and azimuth deviation; all arguments broadcast.
:mod:`solar.gain.printed` keeps the paper's own closed forms apart, and docs/theory.md says where and why they differ.
:mod:`solar.gain.real_sky` puts the same devices under an atmosphere.
"""

from solar.gain.best_tilt import (
    BestTilt,
    best_tilt_horizontal,
    best_tilt_static,
    best_tilt_vertical,
    tilt_tolerance_deg,
)
from solar.gain.geometry import DAYS, declination_deg, half_day_h
from solar.gain.horizontal import horizontal_energy_h, k_dh
from solar.gain.ratios import Energies, daily, eta_hs, eta_vs, yearly
from solar.gain.static import StaticEnergy, k_ds, static_energy
from solar.gain.vertical import k_dv, vertical_energy_h

__all__ = [
    "DAYS",
    "BestTilt",
    "Energies",
    "StaticEnergy",
    "best_tilt_horizontal",
    "best_tilt_static",
    "best_tilt_vertical",
    "daily",
    "declination_deg",
    "eta_hs",
    "eta_vs",
    "half_day_h",
    "horizontal_energy_h",
    "k_dh",
    "k_ds",
    "k_dv",
    "static_energy",
    "tilt_tolerance_deg",
    "vertical_energy_h",
    "yearly",
]
