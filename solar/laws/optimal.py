"""The pointing law `optimal`: the same object live, in replay and in the benchmark.

At every reading the light is estimated from the faces (:mod:`solar.laws.light`) and remembered twice, over a few
minutes and over twelve. What is expected of the next minutes lies between the two: near the quick memory while the sky
is steady, near the slow one while it varies, for a beam that comes and goes is worth its mean. The pose that collects
the expected light best is known in closed form, with the sun where it will be halfway through the rest that follows.
The tracker goes there, but for the last degrees that do not pay, only when the expected gain [W/m2] exceeds the price
of the move: many times an hour under broken clouds, hardly ever under an even sky. As the day's budget of moves and
degrees is used up faster than the daylight, the price rises; the budget itself is never exceeded. Among neighbours the
best pose is the one that collects most with their shade in it (:mod:`solar.laws.in_rows`).

Everything is an array of one shape: () for one tracker, (n,) for n days or sites at once.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from solar.frames import Array, Limits, angles_within, bounded
from solar.laws.in_rows import best_poses_of_group, taken_by_neighbours
from solar.laws.light import Light, aim_vector, dot_with_normal, economical_pose, without_unreachable_beam
from solar.laws.memory import BoolArray, Expectation, LightMemory, OptimalSettings
from solar.laws.site import LearnedSite, SiteLearning
from solar.rows.group import TrackerGroup

_SUNNY_W_M2 = 500.0
_LEAST_LEFT = 1e-3
_MOST_PRESSURE = 100.0


class Choice(NamedTuple):
    """What the law decides.

    Attributes
    ----------
    a_deg, b_deg
        Where the tracker should stand; without `move` its present pose.
    move
        Whether moving there is worth it.
    gain_w_m2
        Gain that is expected of the best pose over the present one.
    price_w_m2
        What the gain had to exceed.
    vector
        The direction of the best pose before limits, shape (..., 3), of any length.
    """

    a_deg: Array
    b_deg: Array
    move: BoolArray
    gain_w_m2: Array
    price_w_m2: Array
    vector: Array


class OptimalLaw:
    """Stateful pointing law on readings of the cube.

    Parameters
    ----------
    settings
        The law's weights and budget.
    limits
        Of the tracker.
    shape
        Of every array that goes in and comes out.
    learned
        Albedo and gains to begin with, from :meth:`SiteLearning.learned` of an earlier run or the default.
    group
        The tracker and the neighbours that it shares the beam with; None for a tracker alone.

    Attributes
    ----------
    memory
        Memory of the light. Trackers that hear the same readings may share one.
    """

    def __init__(
        self,
        settings: OptimalSettings,
        limits: Limits,
        shape: tuple[int, ...] = (),
        learned: LearnedSite | None = None,
        group: TrackerGroup | None = None,
    ) -> None:
        self._settings = settings
        self._group = group
        self._limits = limits
        self._shape = shape
        self.memory = LightMemory(settings, shape, learned)
        self.new_day()

    def new_day(self) -> None:
        """Take over what the past day taught of the site, and open a new budget."""
        self.site.end_of_day()
        self.reset_budget()

    def reset_budget(self) -> None:
        """Begin the day's budget: nothing has been travelled yet."""
        self._travelled_deg = np.zeros(self._shape)
        self._moves = np.zeros(self._shape)

    @property
    def site(self) -> SiteLearning:
        """What the site has taught."""
        return self.memory.site

    @property
    def light(self) -> Light:
        """What the newest readings show; NaN where they show nothing."""
        return self.memory.light

    @property
    def travelled_deg(self) -> Array:
        """Degrees ordered since the day began, A and B added."""
        return self._travelled_deg

    @property
    def moves(self) -> Array:
        """Moves ordered since the day began."""
        return self._moves

    def observe(self, faces: ArrayLike, sun: ArrayLike, elapsed_s: ArrayLike) -> None:
        """Take in readings, as :meth:`LightMemory.observe`."""
        self.memory.observe(faces, sun, elapsed_s)

    def expect(self, thrift: ArrayLike = 1.0) -> Expectation:
        """Return what is expected of the sky, as :meth:`LightMemory.expect`."""
        return self.memory.expect(thrift)

    def decide(
        self,
        a_deg: ArrayLike,
        b_deg: ArrayLike,
        sun: ArrayLike,
        daylight_left: ArrayLike,
        later: ArrayLike | None = None,
    ) -> Choice:
        """Choose where to stand, and book the move if there is one; parameters as for `choose`."""
        choice = self.choose(a_deg, b_deg, sun, daylight_left, later)
        distance = np.abs(choice.a_deg - np.asarray(a_deg)) + np.abs(choice.b_deg - np.asarray(b_deg))
        self.book(distance, choice.move)
        return choice

    def choose(
        self,
        a_deg: ArrayLike,
        b_deg: ArrayLike,
        sun: ArrayLike,
        daylight_left: ArrayLike,
        later: ArrayLike | None = None,
    ) -> Choice:
        """Choose where to stand; the caller has to `book` the move that comes of it.

        Parameters
        ----------
        a_deg, b_deg
            Where the tracker stands or is on its way to.
        sun
            Unit vector(s) to the sun `lead_s` from now, shape (*shape, 3).
        daylight_left
            Share of the day's light hours that is still to come, 0..1.
        later
            The sun `rest_s` from now, like `sun`: the neighbours' shade is the mean of both. None for `sun` alone.
        """
        thrift = self._thrift(np.asarray(daylight_left, dtype=np.float64))
        expected = self.expect(thrift)
        a, b = np.asarray(a_deg, dtype=np.float64), np.asarray(b_deg, dtype=np.float64)
        sun = np.asarray(sun, dtype=np.float64)
        vector = aim_vector(without_unreachable_beam(expected.light, sun, self._limits), sun, self.site.learned.albedo)
        # Where the light is unknown the tracker follows the sun, with gains weighed as on a sunny day.
        vector = np.where(expected.known[..., None], vector, _SUNNY_W_M2 * sun)
        alone = angles_within(vector, self._limits)
        per_degree = thrift * self._settings.price_per_degree_w_m2
        best_a, best_b = economical_pose(vector, (a, b), alone[0], per_degree, self._limits)
        shade_w_m2 = np.zeros(self._shape)
        if self._group is not None:
            beam = np.where(expected.known, expected.light.beam, _SUNNY_W_M2)
            suns = [sun] if later is None else [sun, np.asarray(later, dtype=np.float64)]
            best = best_poses_of_group(self._group, vector, beam, suns, alone, self._limits)
            # Stop short of the best pose only where neither pose has shade: the last degree may be what ends it.
            shaded = (taken_by_neighbours(self._group, beam, suns, best_a, best_b) > 0.0) | (best[0] != alone[0])
            shaded = shaded | (best[1] != alone[1])
            best_a, best_b = np.where(shaded, best[0], best_a), np.where(shaded, best[1], best_b)
            here, there = (taken_by_neighbours(self._group, beam, suns, *pose) for pose in ((a, b), (best_a, best_b)))
            shade_w_m2 = here - there
        distance = np.abs(best_a - a) + np.abs(best_b - b)
        gain = dot_with_normal(vector, best_a, best_b) - dot_with_normal(vector, a, b) + shade_w_m2
        price = thrift * (self._settings.price_per_move_w_m2 + self._settings.price_per_degree_w_m2 * distance)
        move = (gain > price) & (sun[..., 2] > 0.0) & self.affords(distance)
        return Choice(
            a_deg=np.where(move, best_a, a),
            b_deg=np.where(move, best_b, b),
            move=move,
            gain_w_m2=gain,
            price_w_m2=price,
            vector=vector,
        )

    def book(self, distance_deg: ArrayLike, move: ArrayLike = True) -> None:
        """Charge moves to the day's budget: degrees travelled or ordered, A and B added [deg]."""
        self._travelled_deg = self._travelled_deg + np.where(move, distance_deg, 0.0)
        self._moves = self._moves + np.asarray(move)

    def resume(self, travelled_deg: ArrayLike, moves: ArrayLike) -> None:
        """Go on with a day whose budget has been used up to here."""
        self._travelled_deg = np.broadcast_to(np.asarray(travelled_deg, dtype=np.float64), self._shape)
        self._moves = np.broadcast_to(np.asarray(moves, dtype=np.float64), self._shape)

    def _thrift(self, daylight_left: Array) -> Array:
        """Return what prices are multiplied by: the setting, and more when the daylight outlasts the budget."""
        settings = self._settings
        spent = np.maximum(
            self._travelled_deg / max(settings.travel_per_day_deg, _LEAST_LEFT),
            self._moves / max(settings.moves_per_day, 1),
        )
        left = np.maximum(1.0 - spent, _LEAST_LEFT)
        pressure = bounded(bounded(daylight_left, 0.0, 1.0) / left, 1.0, _MOST_PRESSURE)
        return settings.thrift * pressure**settings.pacing

    def affords(self, distance_deg: ArrayLike) -> BoolArray:
        """Tell whether one more move of this length [deg] stays within the day's budget."""
        settings = self._settings
        result: BoolArray = (self._travelled_deg + np.asarray(distance_deg) <= settings.travel_per_day_deg) & (
            self._moves + 1 <= settings.moves_per_day
        )
        return result
