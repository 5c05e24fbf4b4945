"""How near to the bound any pointing by minute data could come, and what a lateral term of the light is worth.

    python -m tests.measurements.ceilings LAT,LON,ALT WEATHER... [--sky SKY] [--prices 1,2,4] [--without-trees]

The script prints which share of the bound's gain over ideal chronometric each of these has, and its travel:

- pointing by the light of the same minute, as the faces show it: with moves at once and at the drive's speed, and with
  a lateral term of the diffuse light that uses the fourth face;
- pointing by the light of the minute before;
- pointing by boosted trees that predict the next minute, or the mean of the next five, from the history of the faces.
  They are fitted on every second day and judged on the others, with moves at once and with the prices of `optimal`,
  beside `optimal` on the same days;
- a plan that knows the light of the day beforehand and pays for each degree.

The trees need scikit-learn, which the project itself does not use: `pip install scikit-learn`, or leave them out.
"""

import argparse
from pathlib import Path

import numpy as np

from daemon.studies.energy.benchmark import IDEAL_DRIVE, Assumptions, read_minute_weather, steer_of, under_sky
from daemon.studies.inputs import parse_site
from solar.energy import Drive, arrange_daylight
from solar.ephemeris import Site, sun_direction
from solar.frames import FACE_NORMALS, Limits, normal_from_angles
from solar.laws.light import Light, aim_vector, light_from_faces
from solar.laws.memory import Expectation, OptimalSettings
from solar.laws.optimal import OptimalLaw
from solar.laws.optimal_live import daylight_left
from solar.laws.steer import steer_towards

ALBEDO = 0.2
LIMITS = Limits()
TERMS = Assumptions(ALBEDO, LIMITS, Drive())
GRID_DEG = 2.5
LATERAL_PRIOR = 1.0
LATERAL_ON_TILTS = 1.5
"""What a plane of moderate tilt gets of a lateral gradient, per sine of its tilt: it sees more sky than a wall does."""
HALF_LIVES_MIN = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0)


def days_of(files, site, sky):
    """Return the weather of one file, or of all, under a sky."""
    minutes = read_minute_weather(files, site)
    return under_sky(arrange_daylight(minutes.utc_s, minutes.dni_w_m2, minutes.dhi_w_m2, site), sky, TERMS)


def share_pct(days, energy, chosen):
    """Return the share of the bound's gain."""
    clock = days.chronometric_kwh_m2
    return 100.0 * float((energy - clock)[chosen].sum() / (days.bound_kwh_m2 - clock)[chosen].sum())


def say(name, days, done, chosen=None):
    """Print one line, for the days with light unless others are chosen."""
    lit = days.weather.day_types() >= 0
    chosen = lit if chosen is None else lit & chosen
    share, travel = share_pct(days, done.energy_kwh_m2, chosen), done.travel_deg[chosen].mean()
    print(f"{name:68} {share:6.1f} % {travel:6.0f} deg/day {done.moves[chosen].mean():5.0f} moves", flush=True)


def with_lateral(days):
    """Return the direction of the best pose if the light has a lateral gradient too: four unknowns, four faces."""
    sun, faces = days.weather.sun, days.faces
    across = np.maximum(np.hypot(sun[:, 0], sun[:, 1]), 1e-4)
    aside = np.stack([-sun[:, 1] / across, sun[:, 0] / across, np.zeros(len(sun))], axis=-1)
    rows = []
    for normal in FACE_NORMALS[:3]:
        beam = np.maximum(sun @ normal, 0.0) + 0.5 * ALBEDO * sun[:, 2]
        ones = np.ones(len(sun))
        rows.append(np.stack([beam, 0.5 * (1.0 + ALBEDO) * ones, ones, aside @ normal], axis=-1))
    rows.append(np.stack([sun[:, 2], ones, 0.0 * ones, 0.0 * ones], axis=-1))
    each = np.stack(rows, axis=1)
    normal_equations = np.einsum("nfi,nfj->nij", each, each) + np.diag([1e-6, 1e-6, 0.02, LATERAL_PRIOR])
    lateral = np.linalg.solve(normal_equations, np.einsum("nfi,nf->ni", each, faces)[..., None])[:, 3, 0]
    light = light_from_faces(faces, sun, ALBEDO)
    return aim_vector(light, sun, ALBEDO) + LATERAL_ON_TILTS * lateral[:, None] * aside


def remembered(values, half_life_min):
    """Return the exponential mean of (steps, days), NaN where there is no weather."""
    mean, means = np.full(values.shape[1], np.nan), np.empty_like(values)
    share = 1.0 - 0.5 ** (1.0 / half_life_min)
    for step, now in enumerate(values):
        mean = np.where(np.isfinite(mean), np.where(np.isfinite(now), mean + share * (now - mean), mean), now)
        means[step] = mean
    return means


def mean_ahead(values, minutes):
    """Return the mean of (steps, days) over so many steps from each on, without the unknown ones."""
    total, known = np.zeros_like(values), np.zeros_like(values)
    for later in range(minutes):
        there = np.full_like(values, np.nan)
        there[: len(values) - later] = values[later:]
        total, known = total + np.nan_to_num(there), known + np.isfinite(there)
    return total / np.maximum(known, 1.0)


def by_trees(days, minutes=1):
    """Return the light that trees expect from each minute on, averaged over some, and which days are new to them."""
    from sklearn.ensemble import HistGradientBoostingRegressor  # noqa: PLC0415 - only where it is asked for

    weather = days.weather
    light = light_from_faces(days.faces, weather.sun, ALBEDO)
    grids = [weather.gridded(part, np.nan) for part in light]
    told = []
    for grid in grids:
        told += [grid, *(remembered(grid, half_life) for half_life in HALF_LIVES_MIN)]
    told += [remembered(np.abs(grids[0] - told[4]), 10.0), weather.gridded(weather.sun[:, 2], np.nan)]
    before = np.stack([np.vstack([np.full((1, each.shape[1]), np.nan), each[:-1]]) for each in told], axis=-1)
    unseen = np.arange(weather.shape[1]) % 2 == 1
    fitted = ~unseen[weather.day]
    asked = before[weather.step, weather.day]
    expected = []
    for grid in grids:
        part = mean_ahead(grid, minutes)[weather.step, weather.day]
        trees = HistGradientBoostingRegressor(max_iter=200, learning_rate=0.06, min_samples_leaf=200, random_state=1)
        trees.fit(asked[fitted], part[fitted])
        expected.append(trees.predict(asked))
    beam, uniform, horizon = expected
    return Light(np.maximum(beam, 0.0), np.maximum(uniform, 0.0), horizon), unseen


class Foretold(OptimalLaw):
    """`optimal` with its prices and its budget, but the light that it expects is given, not remembered."""

    def expect(self, thrift=1.0):
        """Return the light that was given."""
        return self.told


def priced(days, light, thrift):
    """Steer by the light expected for each minute, and pay for each move."""
    weather, settings = days.weather, OptimalSettings(thrift=thrift)
    law = Foretold(settings, LIMITS, (weather.shape[1],))
    expected = [weather.gridded(part, np.nan) for part in light]
    ahead = weather.gridded(sun_direction(weather.utc_s + settings.lead_s, *weather.site), 0.0)
    left = daylight_left(weather)

    def steer(step, a, b):
        now = Light(*(part[step] for part in expected))
        law.told = Expectation(Light(*map(np.nan_to_num, now)), np.zeros(weather.shape[1]), np.isfinite(now.beam))
        choice = law.decide(a, b, ahead[step], left[step])
        return choice.a_deg, choice.b_deg

    return steer


def foreseen(days, price):
    """Plan each day with all its light known, a degree costing `price` W min/m2; poses on a grid of 2.5 deg."""
    a_deg = np.arange(LIMITS.a_min_deg, LIMITS.a_max_deg + 0.1, GRID_DEG)
    b_deg = np.arange(LIMITS.b_min_deg, LIMITS.b_max_deg + 0.1, GRID_DEG)
    weather = days.weather
    steps, count = weather.shape
    worth = np.zeros((steps, count, a_deg.size, b_deg.size), dtype=np.float32)
    for i, a in enumerate(a_deg):
        normals = normal_from_angles(np.full(b_deg.size, a), b_deg)[:, None, :]
        for j, normal in enumerate(normals):
            worth[weather.step, weather.day, i, j] = days.light.irradiance_on(normal, ALBEDO)
    for step in range(steps - 2, -1, -1):
        best = worth[step + 1].copy()
        for axis in (1, 2):
            along = np.moveaxis(best, axis, 0)
            for at in range(1, len(along)):
                np.maximum(along[at], along[at - 1] - price * GRID_DEG, out=along[at])
            for at in range(len(along) - 2, -1, -1):
                np.maximum(along[at], along[at + 1] - price * GRID_DEG, out=along[at])
        worth[step] += best

    def steer(step, a, b):
        far = np.abs(a_deg[None, :, None] - a[:, None, None]) + np.abs(b_deg[None, None, :] - b[:, None, None])
        best = (worth[step] - price * far).reshape(count, -1).argmax(axis=1)
        return a_deg[best // b_deg.size], b_deg[best % b_deg.size]

    return steer


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", help="LAT,LON,ALT in degrees and metres")
    parser.add_argument("weather", nargs="+", type=Path, help="weather files, as `heliocube energy` takes them")
    parser.add_argument("--sky", default="perez1990", help="model of the sky (default: %(default)s)")
    parser.add_argument(
        "--prices",
        default="0.5,1,2,4",
        help="prices of a degree in W min/m2, for the plan that knows the day (default: %(default)s)",
    )
    parser.add_argument("--without-trees", action="store_true", help="leave out the trees, which need scikit-learn")
    arguments = parser.parse_args()
    site = Site(*parse_site(arguments.site))
    days = days_of(arguments.weather, site, arguments.sky)
    print(f"{days.weather.shape[1]} days, sky {arguments.sky}")
    for law in ("mu-prime", "optimal"):
        say(law, days, days.run(steer_of(law, days.weather, days.faces, TERMS), TERMS.drive))
    now = aim_vector(light_from_faces(days.faces, days.weather.sun, ALBEDO), days.weather.sun, ALBEDO)
    lateral = with_lateral(days)
    say("the same minute's light, moves at once", days, days.run(steer_towards(days.weather, now, LIMITS), IDEAL_DRIVE))
    say("the same with a lateral term", days, days.run(steer_towards(days.weather, lateral, LIMITS), IDEAL_DRIVE))
    say("the same minute's light, 0.9 deg/s", days, days.run(steer_towards(days.weather, now, LIMITS), Drive()))
    say(
        "the light of the minute before, moves at once",
        days,
        days.run(steer_towards(days.weather, now, LIMITS, 1), IDEAL_DRIVE),
    )
    say("the same with a lateral term", days, days.run(steer_towards(days.weather, lateral, LIMITS, 1), IDEAL_DRIVE))
    if not arguments.without_trees:
        for minutes in (1, 5):
            light, unseen = by_trees(days, minutes)
            expected = aim_vector(light, days.weather.sun, ALBEDO)
            name, steer = f"trees for {minutes} min, days not fitted on", steer_towards(days.weather, expected, LIMITS)
            say(f"{name}, moves at once", days, days.run(steer, IDEAL_DRIVE), unseen)
            for thrift in (0.5, 1.0, 2.0, 4.0):
                done = days.run(priced(days, light, thrift), Drive())
                say(f"{name}, optimal's prices, thrift {thrift:g}, 0.9 deg/s", days, done, unseen)
        steer = steer_of("optimal", days.weather, days.faces, TERMS)
        say("optimal on the same days, 0.9 deg/s", days, days.run(steer, Drive()), unseen)
    # A plan needs all poses of all minutes, 200 MB for a month: so file by file.
    months = [days_of([path], site, arguments.sky) for path in arguments.weather]
    for price in map(float, arguments.prices.split(",")):
        done = [each.run(foreseen(each, price), Drive()) for each in months]
        gain = sum(
            float((one.energy_kwh_m2 - each.chronometric_kwh_m2).sum()) for one, each in zip(done, months, strict=True)
        )
        room = sum(float((each.bound_kwh_m2 - each.chronometric_kwh_m2).sum()) for each in months)
        lit = np.concatenate([each.weather.day_types() >= 0 for each in months])
        travel, moves = (
            np.concatenate([getattr(one, of) for one in done])[lit].mean() for of in ("travel_deg", "moves")
        )
        name = f"the day known beforehand, {price:g} W min/m2 a degree, 0.9 deg/s"
        print(f"{name:68} {100.0 * gain / room:6.1f} % {travel:6.0f} deg/day {moves:5.0f} moves", flush=True)


if __name__ == "__main__":
    main()
