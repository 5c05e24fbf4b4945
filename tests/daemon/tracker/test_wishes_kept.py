"""What an operator asked for survives a restart."""

import asyncio
import json

import pytest

from daemon.base.records import Mode, ModeChange, Move
from tests.support.phases import wait_for_move


@pytest.mark.parametrize(
    ("ask", "mode", "why"),
    [
        (lambda control: control.hold("repair"), Mode.HOLD, "repair"),
        (lambda control: control.stop("repair"), Mode.HOLD, "repair"),
        (lambda control: control.stow("repair"), Mode.STOW, "repair"),
        (
            lambda control: control.goto(10, 60, "repair"),
            Mode.HOLD,
            "repair; a restart has ended the goto to A 10, B 60 deg: give it again to go there",
        ),
        (lambda control: control.goto(0, 90, "it stood so at the start"), Mode.HOLD, "it stood so at the start"),
    ],
)
def test_a_hold_stop_stow_or_goto_survives_a_restart_without_a_move_until_auto_releases_it(
    run_rig, tmp_path, ask, mode, why
):
    async def first(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        asked = ask(rig.control)
        if asked is not None:
            await asked
        await rig.until_mode(mode, 10)

    async def second(rig):
        await asyncio.sleep(900)
        assert rig.mode is mode
        assert rig.control.why.endswith(why)
        assert rig.records_of(ModeChange)[-1].why == rig.control.why
        assert not rig.records_of(Move), "it stood flat, which is where it is stowed, and nothing else was wanted"
        rig.control.auto()
        await rig.until_mode(Mode.TRACKING, 30)

    async def third(rig):
        await rig.until_mode(Mode.TRACKING, 120)

    for scenario in (first, second, third):
        run_rig(scenario, store={"directory": tmp_path})


@pytest.mark.parametrize("name", ["stop", "maintenance"])
def test_a_stop_or_maintenance_is_in_the_file_while_it_is_still_being_sent_over_a_slow_link(run_rig, tmp_path, name):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.cables.positioner.write_s = 0.9
        asking = asyncio.create_task(getattr(rig.control, name)("a hand near the actuator"))
        await asyncio.sleep(0.01)
        assert json.loads((tmp_path / "operator.json").read_text())[name]["why"] == "a hand near the actuator"
        assert not asking.done()
        rig.control.auto()
        await asking
        assert json.loads((tmp_path / "operator.json").read_text()) == {}

    run_rig(scenario, store={"directory": tmp_path})


def test_a_garbled_operator_file_keeps_the_tracker_stopped(run_rig, tmp_path):
    (tmp_path / "operator.json").write_text('{"stop": 1')

    async def scenario(rig):
        await asyncio.sleep(600)
        assert rig.mode is Mode.HOLD
        assert "cannot be read" in rig.control.why
        assert not rig.records_of(Move)

    run_rig(scenario, store={"directory": tmp_path})


def test_a_disk_that_cannot_be_written_does_not_prevent_a_stow(run_rig, tmp_path):
    (tmp_path / "file").write_text("")

    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        rig.control.stow("storm")
        await rig.until_mode(Mode.STOW, 1)

    run_rig(scenario, store={"directory": tmp_path / "file" / "folder"})
