"""Numbers of the fits under clear sky, to all digits that are stable: they show every weight and every omission.

They are the program's own results, for a sky that is made here. Whether the fits are right is for the other tests of
this folder.
"""

import numpy as np
import pytest

from solar.calibration.anchor import fit_clear_sky_response
from solar.calibration.attitude import Attitude, face_normals
from solar.calibration.level import KnownResponse
from solar.calibration.selection import clear_sky_ghi
from solar.calibration.shape import fit_relative_calibration
from solar.ephemeris import Site, extraterrestrial_dni, sun_direction
from solar.skies.sky import sky

SITE = Site(48.7, 2.2, 156.0)
DAY_S = 86400.0
# Two days of May, every 20 minutes from 6 to 18 h.
UTC_S = np.concatenate([1_652_594_400.0 + day * DAY_S + 1200.0 * np.arange(37) for day in range(2)])
STANDING = Attitude(3.0, 1.0, -0.7)
GAINS = np.array([1.03, 0.97, 1.02, 0.98])


def faces_of(model, standing=STANDING):
    """Return the readings of a turned and leaning cube, with scatter, one instant in cloud and another in haze."""
    sun, extra = sun_direction(UTC_S, *SITE), extraterrestrial_dni(UTC_S)
    _, dni, dhi = clear_sky_ghi(SITE, UTC_S, 0.12)
    dni[20], dhi[20] = 0.5 * dni[20], 3.0 * dhi[20]
    overhead = sky(model, sun, dni, dhi, extra)
    normals = face_normals(standing, SITE.latitude_deg)
    seen = np.stack([overhead.irradiance_on(normal[None, :], 0.25) for normal in normals], axis=-1)
    faces = GAINS * seen * np.random.default_rng(3).normal(1.0, 0.004, seen.shape)
    faces[50] *= [1.0, 1.3, 1.0, 1.0]
    return faces


@pytest.mark.parametrize(
    ("model", "kept", "numbers"),
    [
        (
            "perez1990",
            56,
            (
                1.0469,
                0.976557,
                1.038,
                1.0,
                2.97223,
                0.532887,
                -0.679818,
                0.257534,
                0.980422,
                0.00229779,
                887.561,
                51.3208,
                97.2851,
            ),
        ),
        (
            "haydavies",
            55,
            (
                1.05305,
                0.980357,
                1.02794,
                1.0,
                2.87029,
                0.756997,
                -0.520268,
                0.255023,
                0.0,
                0.00173408,
                901.708,
                41.4953,
                102.737,
            ),
        ),
    ],
)
def test_the_fit_of_the_shape_under_clear_sky_has_the_pinned_values(model, kept, numbers):
    found = fit_relative_calibration(UTC_S, faces_of(model), SITE, model=model, vertical=1.02)
    assert found.utc_s.size == found.beam_w_m2.size == kept
    got = [*found.response, *found.attitude, found.albedo, found.horizon, found.residual]
    got += [found.beam_w_m2.mean(), found.uniform_w_m2.mean(), found.dhi_w_m2.mean()]
    assert got == pytest.approx(numbers, rel=2e-4, abs=1e-6)


def test_the_clear_sky_anchor_has_the_pinned_values():
    rng = np.random.default_rng(5)
    ghi, dni, dhi = clear_sky_ghi(SITE, UTC_S, np.where(UTC_S[37] > UTC_S, 0.08, 0.2), 2.0)
    overhead = sky("perez1990", sun_direction(UTC_S, *SITE), dni, dhi, extraterrestrial_dni(UTC_S))
    zenith = 0.98 * ghi * rng.normal(1.0, 0.005, ghi.size)
    beam = 1.02 * (overhead.dni_w_m2 + overhead.circumsolar_w_m2) * rng.normal(1.0, 0.01, ghi.size)
    found = fit_clear_sky_response(UTC_S, zenith, beam, SITE)
    assert list(found) == pytest.approx([0.967865, 1.00425, 0.0196703, 0.0227566, 0.0218973], rel=2e-4)
    tied = fit_clear_sky_response(
        UTC_S, zenith, beam, SITE, zenith=KnownResponse(0.98, 0.004), vertical=KnownResponse(1.01, 0.008)
    )
    assert list(tied) == pytest.approx([0.979509, 1.01013, 0.00394998, 0.0074689, 0.00831133], rel=2e-4)


@pytest.mark.parametrize(
    ("standing", "which", "bound_deg"),
    [
        (Attitude(36.0, 1.0, -0.7), 0, 30.0),
        (Attitude(-36.0, 1.0, -0.7), 0, -30.0),
        (Attitude(3.0, -25.0, -0.7), 1, -20.0),
        (Attitude(3.0, 1.0, 25.0), 2, 20.0),
        (Attitude(3.0, 1.0, -25.0), 2, -20.0),
    ],
)
def test_the_fitted_attitude_of_an_implausibly_turned_cube_ends_at_its_bound(standing, which, bound_deg):
    found = fit_relative_calibration(UTC_S, faces_of("haydavies", standing), SITE, model="haydavies", vertical=1.02)
    assert found.attitude[which] == pytest.approx(bound_deg, abs=0.01)
