"""Where `sun-vector` points when the gains are wrong: under overcast, and under a clear sky.

Usage: python tests/measurements/overcast_pointing.py [gain error of each face, as a share; default 0.03]
"""

import sys

import numpy as np

from solar.calibration.selection import clear_sky_ghi
from solar.ephemeris import Site, extraterrestrial_dni, sun_direction
from solar.frames import Array, Limits, angles_within, separation_deg
from solar.laws.paper import sun_vector
from solar.skies.overcast import overcast_factor
from solar.skies.sky import normal_from_tilt, sky

DRAWS = 100_000
NOISE_W_M2 = 0.2
SITE = Site(48.717607, 2.209002, 156.0)
DAYS_UTC_S = 1663718400.0 + 86400.0 * np.arange(-91, 92, 30)
"""From June to December of 2022."""


def overcast_faces(zenith_w_m2: float, brightening: float, albedo: float) -> Array:
    """Return east, south, west, zenith [W/m2] under a closed overcast sky."""
    vertical = float(overcast_factor(90.0, brightening, albedo))
    return zenith_w_m2 * np.array([vertical, vertical, vertical, 1.0])


def overcast_angles(faces: Array, gain_error: float, gain_uncertainty: float, random: np.random.Generator) -> Array:
    """Return B [deg] for each draw of the gains."""
    gains = 1.0 + gain_error * random.standard_normal((DRAWS, 4))
    seen = faces * gains + random.normal(0.0, NOISE_W_M2, (DRAWS, 4))
    _, b_deg = angles_within(sun_vector(seen, gain_uncertainty=gain_uncertainty), Limits())
    return b_deg


def clear_faces(utc_s: Array) -> Array:
    """Return the four faces [W/m2], shape (n, 4), under a clear sky over ground of albedo 0.2."""
    _, dni, dhi = clear_sky_ghi(SITE, utc_s)
    light = sky("haydavies", sun_direction(utc_s, *SITE), dni, dhi, extraterrestrial_dni(utc_s))
    normals = normal_from_tilt(np.array([90.0, 90.0, 90.0, 0.0]), np.array([90.0, 180.0, 270.0, 180.0]), SITE[0])
    faces: Array = np.stack([light.irradiance_on(normal, 0.2) for normal in normals], axis=-1)
    return faces


def clear_change_deg(gain_uncertainty: float) -> float:
    """Return the most by which the threshold turns the law under clear skies with the sun above 5 deg [deg]."""
    worst = 0.0
    for midnight in DAYS_UTC_S:
        utc_s = midnight + 300.0 * np.arange(288)
        sun = sun_direction(utc_s, *SITE)
        up = sun[:, 2] > np.sin(np.radians(5.0))
        faces = clear_faces(utc_s[up])
        before, after = (sun_vector(faces, gain_uncertainty=share) for share in (0.0, gain_uncertainty))
        worst = max(worst, float(np.max(separation_deg(before, after))))
    return worst


def main() -> None:
    """Print the share of draws with B below 45 deg for each sky, without and with the threshold."""
    error = float(sys.argv[1]) if len(sys.argv) > 1 else 0.03
    random = np.random.default_rng(1)
    print(f"{DRAWS} draws of gains that are {100 * error:g} % off, noise {NOISE_W_M2} W/m2")
    print("sky        albedo  I_Z    B < 45 deg without  with the threshold")
    for name, brightening in (("isotropic", 0.0), ("standard", 2.0)):
        for albedo in (0.1, 0.2, 0.3):
            for zenith in (50.0, 200.0):
                faces = overcast_faces(zenith, brightening, albedo)
                shares = [np.mean(overcast_angles(faces, error, share, random) < 45.0) for share in (0.0, 0.03)]
                row = f"{100 * shares[0]:16.2f} %  {100 * shares[1]:17.3f} %"
                print(f"{name:10} {albedo:5.1f} {zenith:6.0f} {row}")
    print(f"clear sky: turned by {clear_change_deg(0.03):.3f} deg at the most")


if __name__ == "__main__":
    main()
