"""After a change of the release nothing moves by itself: the tracker holds, or does what persons had asked for."""

import asyncio

import pytest

from daemon.base.records import Mode
from daemon.service.operator import Operator
from tests.daemon.tracker.days import FEWER_SCANS
from tests.support.rig import ServiceRig

CHANGED = "the program was changed from 0.1.0 to 0.2.0, and nobody has checked the tracker since"


@pytest.fixture
def upgraded(run_rig, tmp_path, monkeypatch):
    """Run a scenario on a rig whose program has changed since its last start."""
    monkeypatch.setattr(ServiceRig, "hold_why", CHANGED)
    return lambda scenario: run_rig(scenario, store={"directory": tmp_path}, **FEWER_SCANS)


@pytest.fixture
def restarted(run_rig, tmp_path, monkeypatch):
    """Run a scenario on the same rig, with the same program."""

    def run(scenario):
        monkeypatch.setattr(ServiceRig, "hold_why", None)
        return run_rig(scenario, store={"directory": tmp_path}, **FEWER_SCANS)

    return run


def alarms(rig):
    return {alarm.name for alarm in rig.tracker.alarms.active}


async def moves_nothing(rig, for_s):
    stood = rig.truth()
    await asyncio.sleep(for_s)
    assert rig.truth() == stood


def test_after_a_change_of_release_the_tracker_holds_with_an_alarm_until_auto_even_over_restarts(upgraded, restarted):
    async def held(rig):
        await rig.until_mode(Mode.HOLD, 60)
        await moves_nothing(rig, 900)
        assert rig.tracker.control.why.endswith(CHANGED)
        assert "release-changed" in alarms(rig)
        assert "hold-forgotten" not in alarms(rig)

    upgraded(held)
    restarted(held)

    async def released(rig):
        await rig.until_mode(Mode.HOLD, 60)
        answer = await Operator(rig.tracker, 1.0).auto("ana")
        assert f": {CHANGED}" in answer.text
        await rig.until_mode(Mode.TRACKING, 120)
        assert "release-changed" not in alarms(rig)

    restarted(released)

    async def goes_to_work(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        assert not alarms(rig)

    restarted(goes_to_work)


@pytest.mark.parametrize(("command", "mode"), [("stop", Mode.HOLD), ("stow", Mode.STOW), ("snow", Mode.SNOW)])
def test_a_stop_stow_or_snow_asked_for_before_a_change_of_release_stays_in_force(upgraded, restarted, command, mode):
    async def asks(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await getattr(Operator(rig.tracker, 1.0), command)("repair", "ana")

    restarted(asks)

    async def stands(rig):
        await rig.until_mode(mode, 60)
        await asyncio.sleep(700)
        wishes = rig.tracker.control.wishes
        assert (rig.mode, getattr(wishes, command).by, wishes.held_by_program) == (mode, "ana", None)
        assert "release-changed" not in alarms(rig)

    upgraded(stands)


def test_a_storm_stows_a_tracker_held_after_a_change_of_release_and_it_holds_there_afterwards(upgraded):
    async def scenario(rig):
        await rig.until_mode(Mode.HOLD, 60)
        rig.wind_m_s = 20.0
        await rig.until_mode(Mode.STOW, 60)
        await asyncio.sleep(300)
        assert rig.truth() == (pytest.approx(0, abs=0.9), pytest.approx(90, abs=0.9))
        rig.wind_m_s = 1.0
        await rig.until_mode(Mode.HOLD, 3 * 3600)
        await moves_nothing(rig, 900)

    upgraded(scenario)
