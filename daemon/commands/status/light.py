"""The lines of `heliocube status` on the light that the module has received, and on the law in the shadow."""

from collections.abc import Iterator
from typing import Any

from rich.text import Text

from daemon.commands.status.times import local_and_utc_time


def lines_of_light(state: dict[str, Any], time: str) -> Iterator[tuple[str, Text]]:
    """Yield names and texts of the lines, from a tracker's part of the state at this time."""
    yield from _received(state, time)
    yield from _shadow(state)


def _received(state: dict[str, Any], time: str) -> Iterator[tuple[str, Text]]:
    light = state.get("received")
    if light is None or light["gain"] is None:
        return
    actual, chronometric = _energies(light["actual_kwh_m2"], light["chronometric_kwh_m2"])
    text = f"{100 * light['gain']:+z.1f} % over chronometric: {actual} against {chronometric}"
    yield "received", Text(f"{text} since {local_and_utc_time(light['since'], time)}, a model's result from the faces")


def _shadow(state: dict[str, Any]) -> Iterator[tuple[str, Text]]:
    shadow = state.get("shadow")
    if shadow is None:
        return
    if shadow["failed_why"] is not None:
        yield "shadow", Text(f"{shadow['law']} has failed and is left out: {shadow['failed_why']}")
    elif shadow["gain"] is None:
        yield "shadow", Text(f"{shadow['law']}: nothing to compare yet")
    else:
        travel = f"{shadow['travelled_deg']:.0f} deg instead of {shadow['active_travelled_deg']:.0f}"
        more = f"{100 * abs(shadow['gain']):.1f} % {'more' if shadow['gain'] >= 0 else 'less'}"
        text = f"{shadow['law']} would have received {more} today, for {travel} of travel"
        yield "shadow", Text(f"{text}, a model's result")


def _energies(one_kwh_m2: float, other_kwh_m2: float) -> tuple[str, str]:
    """Return two energies in a unit in which they can be told apart; the unit stands behind the second."""
    if max(one_kwh_m2, other_kwh_m2) < 0.01:
        return f"{1000 * one_kwh_m2:.2f}", f"{1000 * other_kwh_m2:.2f} Wh/m2"
    if max(one_kwh_m2, other_kwh_m2) < 1.0:
        return f"{1000 * one_kwh_m2:.0f}", f"{1000 * other_kwh_m2:.0f} Wh/m2"
    return f"{one_kwh_m2:.2f}", f"{other_kwh_m2:.2f} kWh/m2"
