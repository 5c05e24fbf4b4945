"""The laws of the benchmark: each steers the trackers of many days at once."""

import numpy as np

from solar.energy import DaylightWeather, Steer
from solar.ephemeris import sun_direction
from solar.frames import Array, Limits, angles_within
from solar.laws import paper as laws
from solar.laws.light import light_from_faces, usable_faces
from solar.laws.optimal import OptimalLaw, OptimalSettings
from solar.laws.site import Learned, SiteLearning

PAPER_EVERY_S = 300.0
PAPER_MEAN_S = 120.0


def fixed(weather: DaylightWeather, tilt_deg: float) -> Steer:
    """Stand still: a plane that never moves after dawn, tilted towards the equator; the limits do not hold for it."""
    days = weather.shape[1]
    return lambda _step, _a, _b: (np.zeros(days), np.full(days, 90.0 - tilt_deg))


def chronometric(weather: DaylightWeather, limits: Limits) -> Steer:
    """Follow the sun itself, at every step."""
    a_deg, b_deg = angles_within(weather.gridded(weather.sun, np.nan), limits)
    return lambda step, a, b: _or_stay(a_deg[step], b_deg[step], a, b)


def from_faces(
    weather: DaylightWeather,
    faces: Array,
    limits: Limits,
    law: str,
    every_s: float = PAPER_EVERY_S,
    mean_s: float = PAPER_MEAN_S,
) -> Steer:
    """Run the paper's cycle: every `every_s`, from the mean of the last `mean_s`, in force from the next step on."""
    grid = weather.gridded(faces, np.nan)
    count = max(round(mean_s / weather.step_s), 1)
    mean = grid.copy()
    for back in range(1, count):
        mean[back:] += grid[:-back]
    mean /= count
    if law == "mu-prime":
        direction = laws.mu_prime(mean)
    else:
        direction = laws.complete_poleward(laws.sun_vector(mean), weather.gridded(weather.sun, np.nan))
    a_deg, b_deg = angles_within(direction, limits)
    every = max(round(every_s / weather.step_s), 1)

    def steer(step: int, a: Array, b: Array) -> tuple[Array, Array]:
        return _or_stay(a_deg[step - 1], b_deg[step - 1], a, b) if step > 0 and step % every == 0 else (a, b)

    return steer


def optimal(
    weather: DaylightWeather, faces: Array, limits: Limits, settings: OptimalSettings, start: Learned | None = None
) -> Steer:
    """Run the law of :mod:`solar.laws.optimal`; what each day teaches of the site serves the days after it."""
    days = weather.shape[1]
    grid = weather.gridded(faces, np.nan)
    sun = weather.gridded(weather.sun, 0.0)
    ahead = weather.gridded(sun_direction(weather.utc_s + settings.lead_s, *weather.site), 0.0)
    light = weather.gridded(np.ones(len(weather.utc_s)), 0.0)
    left = 1.0 - np.cumsum(light, axis=0) / np.maximum(light.sum(axis=0), 1.0)
    law = OptimalLaw(settings, limits, (days,), learned_by_day(weather, faces, start))

    def steer(step: int, a: Array, b: Array) -> tuple[Array, Array]:
        if step == 0:
            return a, b
        law.observe(grid[step - 1], sun[step - 1], weather.step_s)
        choice = law.decide(a, b, ahead[step - 1], left[step - 1])
        return choice.a_deg, choice.b_deg

    return steer


def learned_by_day(weather: DaylightWeather, faces: Array, start: Learned | None = None) -> Learned:
    """Return what is known of the site on the morning of each day, arrays of shape (days,).

    What the faces teach does not depend on where the tracker points, so this can be known before it is driven.
    """
    site = SiteLearning(learned=start)
    known = [site.learned]
    order = np.argsort(weather.day, kind="stable")
    ends = np.cumsum(np.bincount(weather.day, minlength=weather.shape[1]))[:-1]
    for rows in np.split(order, ends)[:-1]:
        sun = weather.sun[rows]
        corrected = site.corrected(faces[rows])
        usable = usable_faces(corrected, sun)
        beam = light_from_faces(corrected, sun, site.learned.albedo, usable).beam
        site.observe(corrected, sun, usable, beam, weather.step_s)
        site.end_of_day()
        known.append(site.learned)
    return Learned(*(np.array([float(getattr(each, name)) for each in known]) for name in Learned.__slots__))


def _or_stay(a_deg: Array, b_deg: Array, a_now: Array, b_now: Array) -> tuple[Array, Array]:
    known = np.isfinite(a_deg) & np.isfinite(b_deg)
    return np.where(known, a_deg, a_now), np.where(known, b_deg, b_now)
