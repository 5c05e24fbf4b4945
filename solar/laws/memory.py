"""What the law `optimal` weighs, and how it remembers the light: over a few minutes and over twelve minutes.

Where a tracker points has no part in it: trackers that hear the same readings remember the same light.
"""

import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solar.frames import Array
from solar.laws.light import FACES_NEEDED, Light, is_beam_observable, light_from_faces, usable_faces
from solar.laws.site import LearnedSite, SiteLearning

BoolArray = NDArray[np.bool_]

THRIFT_RANGE = (0.1, 100.0)
"""Least and greatest weight of wear against harvest."""


@dataclass(frozen=True, slots=True)
class OptimalSettings:
    """What the law weighs, and what it may not exceed.

    Attributes
    ----------
    quick_half_life_s, slow_half_life_s
        Of the two memories of the beam.
    diffuse_half_life_s
        Of the quick memory of the diffuse light, which changes less than the beam; the slow one is for both.
    variability_weight, slow_share_max
        The slow memory's share of the expected light is `variability_weight` times the beam's relative deviation
        between the two memories, averaged over the slow one's time, and at most `slow_share_max`.
    lead_s
        How far ahead of the last reading the sun is taken.
    rest_s
        How far ahead a pose should still be out of the neighbours' shade.
    price_per_degree_w_m2, price_per_move_w_m2
        Irradiance that a move must be expected to gain, per degree travelled (A and B added) and per move; an axis goes
        only as far as its last degree gains the price per degree.
    thrift
        What both prices are multiplied by, 0.1 to 100: the one knob between harvest and wear. A varying sky is
        also taken at its slower mean, the more so the thriftier.
    travel_per_day_deg, moves_per_day
        The day's budget.
    pacing
        How steeply prices rise when the budget is used faster than the daylight.
    forget_after_s
        A gap in the readings after which the memory starts again.
    """

    quick_half_life_s: float = 100.0
    diffuse_half_life_s: float = 400.0
    slow_half_life_s: float = 720.0
    variability_weight: float = 0.3
    slow_share_max: float = 0.8
    lead_s: float = 240.0
    rest_s: float = 600.0
    price_per_degree_w_m2: float = 0.025
    price_per_move_w_m2: float = 0.15
    thrift: float = 1.0
    travel_per_day_deg: float = 1300.0
    moves_per_day: int = 250
    pacing: float = 6.0
    forget_after_s: float = 900.0

    def __post_init__(self) -> None:
        """Raise `ValueError` for a thrift out of its range: at 0 the tracker runs after every flicker of the light."""
        low, high = THRIFT_RANGE
        if not (low <= self.thrift <= high):
            raise ValueError(f"thrift is {self.thrift:g}, not in {low:g}..{high:g}")


class Expectation(NamedTuple):
    """What the law knows of the sky.

    Attributes
    ----------
    light
        Expected over the next minutes.
    beam_variability
        Relative deviation of the beam between quick and slow memory, averaged: 0 for an even sky.
    known
        Whether there is anything to go by: at least three good faces not long ago.
    """

    light: Light
    beam_variability: Array
    known: BoolArray


class LightMemory:
    """What the readings have shown of the light and taught of the site.

    Parameters
    ----------
    settings
        Half-lives and weights.
    shape
        Of every array that goes in and comes out.
    learned
        Albedo and gains to begin with.

    Attributes
    ----------
    site
        What the site has taught.
    light
        What the newest readings show; NaN where they show nothing.
    """

    def __init__(
        self, settings: OptimalSettings, shape: tuple[int, ...] = (), learned: LearnedSite | None = None
    ) -> None:
        self._settings = settings
        self._shape = shape
        self.site = SiteLearning(shape, learned)
        quick_s = (settings.quick_half_life_s, settings.diffuse_half_life_s, settings.diffuse_half_life_s)
        self._half_lives_s = np.array((quick_s, [settings.slow_half_life_s] * 3)).reshape(2, 3, *[1] * len(shape))
        # Quick and slow, each of beam, uniform part and horizon.
        self._light = np.zeros((2, 3, *shape))
        self._deviation = np.zeros(shape)
        self._since_good_s = np.full(shape, np.inf)
        self.light = Light(*np.full((3, *shape), np.nan))

    def copied(self) -> "LightMemory":
        """Return a memory that can be changed without this one; no array is ever changed in its place."""
        made = copy.copy(self)
        made.site = copy.copy(self.site)
        return made

    def observe(self, faces: ArrayLike, sun: ArrayLike, elapsed_s: ArrayLike) -> None:
        """Take in the mean faces [W/m2], shape (*shape, 4), of the last `elapsed_s` seconds.

        `sun` (*shape, 3) is the unit vector to the apparent sun in the middle of that time. Any reading may be NaN. All
        three may have one more axis in front: means that followed each other, the oldest first.
        """
        faces, sun, elapsed = (np.asarray(value, dtype=np.float64) for value in (faces, sun, elapsed_s))
        if faces.ndim == len(self._shape) + 1:
            faces, sun, elapsed = faces[None], sun[None], elapsed[None]
        elapsed = np.broadcast_to(elapsed, faces.shape[:-1])
        faces = self.site.corrected(faces)
        usable = usable_faces(faces, sun)
        enough = (usable.sum(axis=-1) >= FACES_NEEDED) & (sun[..., 2] > 0.0)
        good = enough & is_beam_observable(usable, sun)
        lights = np.array(light_from_faces(faces, sun, self.site.learned.albedo, usable)).swapaxes(0, 1)
        shares = 1.0 - 0.5 ** (elapsed[:, None, None] / self._half_lives_s)
        for each in zip(lights, good, enough & ~good, elapsed, shares, strict=True):
            self._remember(*each)
        self.light = Light(*np.where(good[-1], lights[-1], np.nan))
        self.site.observe(faces, sun, usable, lights[:, 0], elapsed)

    def _remember(self, light: Array, good: BoolArray, blind: BoolArray, elapsed: Array, shares: Array) -> None:
        """Move each memory by its share towards the light of one reading, and all the way after a gap."""
        age_s = self._since_good_s + elapsed
        shares = np.where(good & ~(age_s <= self._settings.forget_after_s), 1.0, shares)
        self._light = self._light + shares * (np.where(good, light, self._light) - self._light)
        deviation = np.where(good, np.abs(self._light[0, 0] - self._light[1, 0]), self._deviation)
        self._deviation = self._deviation + shares[1, 0] * (deviation - self._deviation)
        # A dead face may have passed for a dull dawn in the minutes before this reading: forget those too.
        self._since_good_s = np.where(good, 0.0, np.where(blind, np.inf, age_s))

    def expect(self, thrift: ArrayLike = 1.0) -> Expectation:
        """Return what is expected of the sky; with more `thrift` a varying one is taken at its slower mean."""
        settings = self._settings
        # The scale keeps the unrest of a sky without beam at zero instead of at the noise of the sensors.
        quick, slow = self._light
        unrest = self._deviation / (slow[0] + 0.1 * slow[1] + 10.0)
        share = np.minimum(settings.variability_weight * np.sqrt(thrift) * unrest, settings.slow_share_max)
        light = Light(*((1.0 - share) * quick + share * slow))
        return Expectation(light, unrest, self._since_good_s <= settings.forget_after_s)
