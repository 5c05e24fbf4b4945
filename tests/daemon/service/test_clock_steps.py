"""A clock that is set moves nothing and changes no rhythm."""

import asyncio
import itertools

import pytest

from daemon.base.records import Decision, Event, Move
from tests.support.phases import at_rest, tracking
from tests.support.rig import HandWeather


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 86400.0, -86400.0])
def test_a_step_of_the_clock_moves_nothing_and_changes_no_rhythm(run_rig, step_s):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        await asyncio.sleep(400)
        await at_rest(rig)
        before = rig.clock.monotonic()
        rig.clock.step_s = step_s
        await asyncio.sleep(590)
        during = [record for record in rig.of(Decision) if record.time_monotonic_s > before]
        gaps = [b.time_monotonic_s - a.time_monotonic_s for a, b in itertools.pairwise(during)]
        assert gaps == pytest.approx([300.0] * len(gaps), abs=0.1)
        assert not [move for move in rig.of(Move) if move.time_monotonic_s > before]

    # An even sky: only the clock could make this tracker move.
    rig = run_rig(scenario, weather=HandWeather(dni=0, dhi=200))
    assert any("the clock was set by" in event.text for event in rig.of(Event))


def test_after_a_step_the_chronometric_law_waits(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        await asyncio.sleep(10)
        rig.clock.step_s = 7200.0
        moves = len(rig.of(Move))
        await asyncio.sleep(880)
        assert len(rig.of(Move)) == moves
        await asyncio.sleep(400)
        assert len(rig.of(Move)) > moves, "a clock that has settled is believed"

    run_rig(scenario, law={"name": "chronometric"})
