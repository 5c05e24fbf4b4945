"""Weather of one kind after another: a clear morning before an overcast noon."""

import itertools
from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from sim_drivers.weather import BLEND_S, Conditions, Weather, smoothstep
from solar.frames import Array


class WeatherInParts:
    """Several weathers in turn, each blending into the next over 4 min about its beginning.

    Parameters
    ----------
    parts
        When each begins [s UTC], rising, and the weather itself; the first one is also the weather before.

    Raises
    ------
    ValueError
        There is no part, or they are not in the order of time.
    """

    def __init__(self, parts: Sequence[tuple[float, Weather]]) -> None:
        if not parts:
            raise ValueError("weather in parts needs one part at least")
        begins = [begin_utc_s for begin_utc_s, _ in parts]
        if not all(one < other for one, other in itertools.pairwise(begins)):
            raise ValueError(f"the parts of the weather must begin one after another, not at {begins}")
        self._parts = tuple(parts)

    def covers(self, utc_s: Array) -> NDArray[np.bool_]:
        """Tell for each instant whether every part has weather for it."""
        covered: NDArray[np.bool_] = np.all([weather.covers(utc_s) for _, weather in self._parts], axis=0)
        return covered

    def at(self, utc_s: Array) -> Conditions:
        """Return the weather at instants of shape (n,)."""
        now = self._parts[0][1].at(utc_s)
        values = {field.name: getattr(now, field.name) for field in fields(Conditions)}
        for begin_utc_s, weather in self._parts[1:]:
            then = weather.at(utc_s)
            share = smoothstep((np.asarray(utc_s) - begin_utc_s) / BLEND_S + 0.5)
            values = {name: value + share * (getattr(then, name) - value) for name, value in values.items()}
        return Conditions(**values)
