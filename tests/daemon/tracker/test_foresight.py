"""The next decision, foreseen before it falls."""

import asyncio

import pytest

from daemon.base.records import Decision, Mode, Pose
from daemon.tracker.pointing import NamedLaw, PoseAndTarget, ask_law, preview_decision
from solar.ephemeris import Site
from solar.frames import Limits, normal_from_angles, separation_deg
from solar.laws.flat import FlatLaw, FlatSettings
from solar.laws.law import TrackerFacts
from tests.support.rig import SITE, ManualWeather

SOON_S = 12


async def soon(rig):
    """Wait until shortly before a decision, and return the foreseen and the real decision."""
    await rig.until_mode(Mode.TRACKING, 120)
    await asyncio.sleep(400)
    await rig.until(lambda: 2 < rig.control.state.next_decision_s < SOON_S, 400, "the time before a decision")
    foreseen, decided = rig.control.preview_decision(), len(rig.records_of(Decision))
    await rig.until(lambda: len(rig.records_of(Decision)) > decided, 60, "the decision")
    return foreseen, rig.records_of(Decision)[-1]


@pytest.mark.parametrize("law", ["mu-prime", "sun-vector", "chronometric", "optimal", "flat"])
def test_the_foreseen_decision_agrees_with_the_decision_that_follows(run_rig, law):
    async def scenario(rig):
        foreseen, decision = await soon(rig)
        assert (foreseen.law, foreseen.moves) == (decision.law, decision.moved)
        apart_deg = separation_deg(
            normal_from_angles(foreseen.target.a_deg, foreseen.target.b_deg),
            normal_from_angles(decision.target.a_deg, decision.target.b_deg),
        )
        assert float(apart_deg) < 0.2
        assert foreseen.target.why[:24] == decision.target.why[:24]

    run_rig(scenario, law={"name": law})


def test_an_even_sky_is_named_as_the_reason_to_lie_flat(run_rig):
    async def scenario(rig):
        foreseen, decision = await soon(rig)
        assert decision.target.why == "mu-prime: the sky is even: lying flat collects most"
        assert foreseen.target.why == decision.target.why
        assert not foreseen.moves, "it lies flat already"

    run_rig(scenario, weather=ManualWeather(dni=0, dhi=150))


class Restless(FlatLaw):
    """A law that gives another direction each time it is asked."""

    turns = 0

    def direction(self, now, to_sun):
        self.turns += 1
        return normal_from_angles(5.0 * self.turns, 60.0)


class Bolted(Restless):
    """A law that cannot be copied."""

    def __deepcopy__(self, memo):
        raise TypeError("no copies")


@pytest.mark.parametrize(("kind", "foreseen_deg"), [(Restless, 5.0), (Bolted, None)])
def test_asking_for_the_foreseen_decision_does_not_change_what_the_law_answers(kind, foreseen_deg):
    facts = TrackerFacts(site=Site(*SITE), limits=Limits(), scan_every_s=5.0, decide_every_s=300.0, utc_s=0.0)
    chosen = NamedLaw("restless", kind(FlatSettings(), facts))
    stands = PoseAndTarget(Pose(0.0, 0.0, 0.0, 60.0, moving=False), None)
    for _ in range(3):
        found = preview_decision(chosen, None, stands, 0.0, 0.6, sun_known=True, may_move=True)
        assert (found.target.a_deg if found else None) == (foreseen_deg and pytest.approx(foreseen_deg))
    assert ask_law(chosen, None, stands, 0.0, sun_known=True).target.a_deg == pytest.approx(5.0)


def test_no_decision_is_foreseen_while_the_tracker_is_stopped(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await rig.control.stop("test")
        await rig.until_mode(Mode.HOLD, 20)
        assert rig.control.preview_decision() is None

    run_rig(scenario)
