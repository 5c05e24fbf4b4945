"""Compute every number of docs/theory.md's table of errata again.

Usage: python docs/theory_numbers.py
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from solar import gain
from solar.calibration.selection import clear_sky_ghi
from solar.ephemeris import Site, sun_position
from solar.ephemeris import sun_day as almanac_day
from solar.frames import Array
from solar.gain import printed, real_sky
from solar.gain.geometry import declination_deg, sun_path

PHI, BETA, N = np.arange(0.0, 66.0, 5.0)[:, None, None], np.arange(0.0, 91.0, 5.0)[:, None], gain.DAYS
GREENWICH_JUNE_21_UTC_S = 1687348800.0
_NUMBERS: dict[str, Callable[[], str]] = {}


def numbers() -> Iterator[tuple[str, str]]:
    """Yield each erratum's number in the paper's order, and what it comes to."""
    for number, compute in _NUMBERS.items():
        yield number, compute()


def _erratum(number: str) -> Callable[[Callable[[], str]], Callable[[], str]]:
    def register(compute: Callable[[], str]) -> Callable[[], str]:
        _NUMBERS[number] = compute
        return compute

    return register


def _sun(phi: float | Array, n: float | Array, w: float | Array, east_sign: float = -1.0) -> tuple[Array, Array, Array]:
    """East, north, up of the sun at hour angle `w` [rad]; `east_sign` is +1 in the paper's (A1.6)."""
    p, d = np.radians(phi), np.radians(declination_deg(n))
    east = east_sign * np.cos(d) * np.sin(w)
    north = np.sin(d) * np.cos(p) - np.cos(d) * np.sin(p) * np.cos(w)
    return east, north, np.sin(d) * np.sin(p) + np.cos(d) * np.cos(p) * np.cos(w)


def _breakpoint_h(phi: Array | float, n: Array | float, deviation: float) -> Array:
    """Equation (9), g [h]; NaN where it is complex."""
    p, tangent, cotangent = np.radians(phi), np.tan(np.radians(declination_deg(n))), 1 / np.tan(np.radians(deviation))
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(cotangent**2 + np.sin(p) ** 2 - np.cos(p) ** 2 * tangent**2)
        g: Array = 24.0 / np.pi * np.arctan((root - cotangent) / (np.sin(p) + np.cos(p) * tangent))
    return g


def _share(mask: NDArray[np.bool_]) -> str:
    return f"{100.0 * np.mean(mask):.1f} %"


@_erratum("1")
def _azimuth() -> str:
    noon_utc_s = almanac_day(GREENWICH_JUNE_21_UTC_S, 45.0, 0.0).noon_utc_s
    almanac = sun_position(noon_utc_s - 3 * 3600.0, 45.0, 0.0).azimuth_deg
    right, wrong = (np.degrees(np.arctan2(*_sun(45.0, 172.0, -np.pi / 4, sign)[:2])) % 360.0 for sign in (-1.0, 1.0))
    return f"45 N, 21 June, 9 h: printed {wrong:.1f} deg, right {right:.1f} deg, SPA {almanac:.1f} deg"


@_erratum("2")
def _cotangent() -> str:
    w = -np.pi / 4
    p, tangent = np.radians(45.0), np.tan(np.radians(declination_deg(172.0)))
    printed_value = 0.5 * np.cos(p) * tangent / np.sin(w) - np.sin(p) / np.tan(w)
    right = np.cos(p) * tangent / np.sin(w) - np.sin(p) / np.tan(w)
    return f"same instant: printed {printed_value:.3f}, without the half {right:.3f}"


@_erratum("3")
def _zeros() -> str:
    w = np.pi / 12.0 * _breakpoint_h(PHI, N, 5.0)
    east, north, up = _sun(PHI, N, w, 1.0)
    b, turned = np.radians(BETA), np.radians(5.0)
    cosine = np.cos(b) * up - np.sin(b) * (np.cos(turned) * north - np.sin(turned) * east)
    return f"median of abs(cos theta) at T1, lambda 5: {np.nanmedian(np.abs(cosine)):.2f}"


@_erratum("4")
def _order() -> str:
    after = _share(_breakpoint_h(PHI, N, 5.0) > 0.0)
    below = _share(printed.k_ds_eq11(PHI, BETA, N, 30.0) < 1.0)
    return f"T1 after noon in {after} of days and latitudes; K_DS below 1 in {below} of cells at lambda 30"


@_erratum("5")
def _branches() -> str:
    east, west = (float(printed.k_ds_eq11(45.0, 35.0, 172.0, deviation)) for deviation in (30.0, -30.0))
    exact = float(gain.k_ds(45.0, 35.0, 172.0, 30.0, rear_face=True))
    lost = _share(np.isnan(printed.k_ds_eq11(PHI, BETA, N, 90.0)))
    return f"45 N, beta 35, n 172: K {east:.3f} at +30, {west:.3f} at -30, exact {exact:.3f}; complex in {lost} at 90"


@_erratum("6")
def _limit() -> str:
    above, below = (float(printed.k_ds_eq11(45.0, 35.0, 172.0, deviation)) for deviation in (1e-6, -1e-6))
    exact = float(gain.k_ds(45.0, 35.0, 172.0, rear_face=True))
    return f"45 N, beta 35, n 172: {above:.4f} from above, {below:.4f} from below, exact {exact:.4f}"


@_erratum("7")
def _rear_face() -> str:
    energy = gain.static_energy(PHI, BETA, N)
    return f"light on the back in {_share(energy.abs_h - energy.clip_h > 1e-9)} of cells at lambda 0"


@_erratum("8")
def _south() -> str:
    p, tilt = -PHI, np.radians(-BETA[1:])
    cosine = gain.vertical_energy_h(p, 90.0, N)
    sine = gain.vertical_energy_h(p, 0.0, N)
    by_rule = np.abs(np.sin(tilt) * cosine + np.cos(tilt) * sine)
    exact = gain.vertical_energy_h(p, BETA[1:], N)
    return (
        f"median error of K_DV, exact integrals, beta_V negative: {100 * np.median(np.abs(exact / by_rule - 1)):.0f} %"
    )


@_erratum("9")
def _quartic() -> str:
    change = np.abs(printed.k_dv_eq25(PHI, BETA, N) / printed.script2(PHI, BETA, N) - 1.0)
    return f"largest effect on K_DV: {100.0 * change.max():.2f} %"


@_erratum("10")
def _taylor() -> str:
    day = sun_path(45.0, 81.0)
    a, b = float(day.a), float(day.b)
    printed_x3 = -(a**2) / 2 * (1 + a**2 / 8 + b**2)
    right_x3 = (1 - b**2) / 2 - a**2 / 4 - a**4 / 16 - 0.75 * a**2 * b**2
    return f"45 N, n 81: X3 printed {abs(printed_x3):.3f}, Taylor {right_x3:.3f}"


@_erratum("11")
def _series() -> str:
    error = np.abs(printed.k_dv_eq25(PHI, BETA, N) / gain.k_dv(PHI, BETA, N) - 1.0)
    worst = float(printed.k_dv_eq25(65.0, 90.0, 355.0)), float(gain.k_dv(65.0, 90.0, 355.0))
    return (
        f"error of (25): median {100.0 * np.median(error):.1f} %, largest {100.0 * error.max():.0f} %; "
        f"65 N, beta 90, n 355: {worst[0]:.3f} for {worst[1]:.4f}"
    )


@_erratum("12")
def _axis() -> str:
    beta, elevation = np.radians(np.meshgrid(np.arange(0.0, 91.0), np.arange(0.0, 91.0)))
    # OQ in east, north, up against the axis (0, cos beta, sin beta).
    along = -np.sin(beta) * np.sin(elevation) * np.cos(beta) + np.cos(beta) * np.sin(elevation) * np.sin(beta)
    return f"part of OQ along the tilted north-south axis: {np.abs(along).max():.1f}"


@_erratum("13")
def _doubling() -> str:
    phi, beta, n = (
        np.arange(0.0, 66.0, 13.0)[:, None, None],
        np.arange(0.0, 91.0, 15.0)[:, None],
        np.arange(1.0, 366, 30),
    )
    errors = []
    for deviation in (4.0, 45.0):
        doubled = 2.0 * _morning(phi, beta, n, deviation)
        whole = gain.horizontal_energy_h(phi, beta, n, deviation)
        errors.append(100.0 * np.median(np.abs(doubled / whole - 1.0)))
    return f"median error of R_H: {errors[0]:.1f} % at lambda 4, {errors[1]:.0f} % at 45"


def _morning(phi: Array, beta: Array, n: Array, deviation: float, steps: int = 2000) -> Array:
    """Morning half of the full day's sum [h], by the midpoint rule, with the true azimuth."""
    w0 = sun_path(phi, n).w0
    b, turned = np.radians(beta), np.radians(deviation)
    total = np.zeros(np.broadcast_shapes(w0.shape, beta.shape))
    for share in (np.arange(steps) + 0.5) / steps:
        east, north, up = _sun(phi, n, -w0 * share)
        across, along = np.cos(turned) * east + np.sin(turned) * north, np.cos(turned) * north - np.sin(turned) * east
        total += np.hypot(east, north) * across + up * (np.cos(b) * up - np.sin(b) * along)
    energy: Array = total * w0 / steps * 12.0 / np.pi
    return energy


@_erratum("14")
def _h11() -> str:
    wrong, right = float(printed.k_dh_eq49(0.0, 0.0, 81.0, 0.0)), float(gain.k_dh(0.0, 0.0, 81.0))
    return f"equator, n 81, beta 0, lambda 0, where the tracker faces the sun all day: K {wrong:g}, right {right:g}"


@_erratum("15")
def _h31() -> str:
    day = sun_path(45.0, 172.0)
    a, b, w0, cos_d = float(day.a), float(day.b), float(day.w0), float(day.cos_delta)
    q1, q2 = a * np.sin(np.pi / 4) * 0.5 * cos_d, b / 2.0 * np.sin(np.pi / 4) * 0.5 * cos_d
    h31 = 6.0 / np.pi * (-(2.0 * q1 + q2) + 2.0 * q1 * np.cos(w0) + q2 * np.cos(2.0 * w0))
    w = -w0 * (np.arange(100_000) + 0.5) / 100_000
    east, _, up = _sun(45.0, 172.0, w)
    right = 12.0 / np.pi * float(np.mean(np.sin(np.pi / 4) * 0.5 * up * east)) * w0
    return f"45 N, beta 45, n 172, lambda 30: printed {h31:.4f} h, the morning's integral {right:.4f} h"


@_erratum("16")
def _odd_terms() -> str:
    wrong = [float(printed.k_dh_eq49(45.0, 35.0, 172.0, deviation)) for deviation in (30.0, -30.0)]
    right = [float(gain.k_dh(45.0, 35.0, 172.0, deviation)) for deviation in (30.0, -30.0)]
    return (
        f"45 N, beta 35, n 172, lambda +30 and -30: (49) {wrong[0]:.3f} and {wrong[1]:.3f}, "
        f"full day {right[0]:.3f} and {right[1]:.3f}"
    )


@_erratum("19")
def _range_of_x() -> str:
    return f"45 N, n 172: x goes down to {float(np.cos(sun_path(45.0, 172.0).w0)):.3f}"


@_erratum("20")
def _polar() -> str:
    with np.errstate(invalid="ignore"):
        wrong = float(12 / np.pi * np.arccos(-np.tan(np.radians(70.0)) * np.tan(np.radians(declination_deg(172.0)))))
    return f"70 N, n 172: T0 printed {wrong}, right {float(gain.half_day_h(70.0, 172.0)):g} h"


@_erratum("21")
def _first_row() -> str:
    least = printed.least_eta(printed.script1(PHI, BETA, N, 0.0).k_ds)
    return f"NaN in {int(np.isnan(least).sum())} of {least.size} cells"


@_erratum("22")
def _last_latitude() -> str:
    return f"{np.arange(65)[-1]} deg is the last latitude of 1:65, {np.arange(66)[-1]} of 1:66"


@_erratum("23")
def _script3_x1() -> str:
    a = float(sun_path(65.0, 172.0).a)
    return f"65 N, n 172: X1 {1 - a**2 / 2 - a**4 / 4:.4f} for {1 - a**2 / 2 - a**4 / 8:.4f}"


@_erratum("24")
def _script3_x5() -> str:
    day = sun_path(65.0, 172.0)
    a, b = float(day.a), float(day.b)
    script = -(a**2) / 4 * (1 + b**2 + 3 * a**2 / 16 + 1.25)
    equation = -(a**2) / 4 * (b**2 + 3 * a**2 / 16 + 1.25)
    taylor = 0.375 - b**2 / 4 - b**4 / 8 - 3 * a**2 / 16 - 3 * a**4 / 64 - 0.375 * a**2 * b**2
    return f"65 N, n 172: X5 {script:.3f} in the script, {equation:.3f} by (42), Taylor {taylor:.3f}"


@_erratum("25")
def _script3_h32() -> str:
    script = float(printed.least_eta(printed.script3(30.0, 90.0, N, 4.0)))
    equation = float(printed.least_eta(printed.k_dh_eq49(30.0, 90.0, N, 4.0)))
    return f"30 N, beta 90, lambda 4: smallest eta {script:.2f}, by (49) {equation:.2f}"


@_erratum("26")
def _minima() -> str:
    static, vertical = gain.k_ds(45.0, 35.0, N), gain.k_dv(45.0, 35.0, N)
    days = f"{N[static.argmin()]:.0f} and {N[vertical.argmin()]:.0f}"
    year = float(gain.yearly(45.0, 35.0).eta_vs)
    minima = static.min() / vertical.min() - 1.0
    return f"45 N, beta 35: K_DS and K_DV least on days {days}; quotient of minima {minima:.3f}, of years {year:.3f}"


@_erratum("27")
def _memory() -> str:
    sizes = [8 * k * 365 * 66 * 91 / 1e6 for k in (6, 91)]
    return f"one array of four indices: {sizes[0]:.0f} MB at k = 6, {sizes[1]:.0f} MB at k = 91, 1/k of it used"


@_erratum("VII.1")
def _claim_1() -> str:
    phi, beta = np.arange(0.0, 66.0, 5.0)[:, None], np.arange(1.0, 91.0)
    south, turned = gain.yearly(phi, beta).static, gain.yearly(phi, beta, 5.0).static
    best = gain.best_tilt_static(phi[1:, 0], [0.0]).energy_h, gain.best_tilt_static(phi[1:, 0], [5.0]).energy_h
    first = [int(beta[np.argmax(turned[row] > south[row])]) for row in (1, 2, 4)]
    return (
        f"worse in {_share(turned < south)} of cells at lambda 5; better from tilt {first[0]}, {first[1]}, {first[2]} "
        f"at 5, 10, 20 N; at the best tilt {100.0 * np.max(1.0 - best[1] / best[0]):.2f} % worse at most"
    )


@_erratum("VII.2")
def _claim_2() -> str:
    phi = np.arange(0.0, 66.0)
    vertical, horizontal = gain.best_tilt_vertical(phi).energy_h, gain.best_tilt_horizontal(phi).energy_h
    first = int(phi[np.argmax(vertical > horizontal)])
    script = printed.least_eta(printed.script2(PHI, BETA, N)) < printed.least_eta(printed.script3(PHI, BETA, N, 4.0))
    return f"by the scripts in {_share(script)} of cells; exact, each at its best tilt: from {first} N on"


@_erratum("VII.3")
def _claim_3() -> str:
    phi, beta = np.arange(0.0, 66.0, 5.0)[:, None], np.arange(0.0, 91.0, 5.0)
    straight = gain.yearly(phi, beta)
    shares = [
        np.mean(turned.horizontal / turned.dual)
        for turned in (gain.yearly(phi, beta, deviation) for deviation in (0.0, 30.0, 90.0))
    ]
    better = _share(gain.yearly(phi, beta, 4.0).horizontal > straight.horizontal * (1 + 1e-12))
    script = _share(
        printed.least_eta(printed.script3(PHI, BETA, N, 4.0)) < printed.least_eta(printed.script3(PHI, BETA, N, 0.0))
    )
    return (
        f"by the script better in {script} of cells at lambda 4; exact in {better}; "
        f"mean R_H/R_max {shares[0]:.3f}, {shares[1]:.3f}, {shares[2]:.3f} at 0, 30, 90"
    )


def best_tilts(latitudes_deg: Sequence[float] = tuple(range(0, 91, 10))) -> Iterator[str]:
    """Yield the rows of docs/theory.md's table of best tilts of a vertical axis: by theory, and under two skies."""
    for latitude in map(float, latitudes_deg):
        best = gain.best_tilt_vertical(latitude)
        site = Site(latitude, 0.0, 0.0)
        instants = real_sky.daylight(site, real_sky.year_instants(0.0, 600.0))
        beam = np.full(instants.size, 1000.0), np.zeros(instants.size)
        bare = real_sky.sky_series(site, instants, *beam, "isotropic")
        clear = real_sky.sky_series(site, instants, *clear_sky_ghi(site, instants)[1:])
        true_sun = real_sky.best_tilt_vertical_sky(bare, 0.01, albedo=0.0).best_deg
        sky = real_sky.best_tilt_vertical_sky(clear, 0.01)
        ratio = 2.0 * gain.half_day_h(latitude, N).sum() / best.energy_h
        yield (
            f"| {latitude:.0f} | {best.tilt_deg:.2f} | {ratio:.4f} | {true_sun:.1f} | "
            f"{sky.best_deg:.1f} | {sky.low_deg:.0f} to {sky.high_deg:.0f} |"
        )


if __name__ == "__main__":
    for line in numbers():
        print(": ".join(line))
    for row in best_tilts():
        print(row)
