"""The next reference run knows where the axes stood before a restart of the service."""

import asyncio
import json

import pytest

from daemon.base.state import StateFolder
from daemon.motion.place import KeptPlace
from tests.daemon.motion.test_home_again import stuck_on_its_way
from tests.support.phases import wait_for_long_rest
from tests.support.rig import ServiceRig

FILE_NAME = "place.json"


async def stopped_where_it_began(rig):
    await rig.until(lambda: rig.motion.connected, 30, "the connection")
    await rig.control.stop("a test")
    await asyncio.sleep(10)


async def homed_after_its_count_was_lost(rig):
    """Let the unit restart and lose its count unseen by the service, and B's switch stick on the reference run."""
    rig.unit.power_cycle(rig.clock.monotonic())
    await rig.until(lambda: rig.motion.doubt, 60, "the mark of the restart")
    await stuck_on_its_way(rig)


@pytest.fixture
def kept(run_rig, tmp_path, monkeypatch):
    """The folder of a service that ended with its axes where those of the next service begin."""
    monkeypatch.setattr(ServiceRig, "has_fixed_start_pose", False)
    run_rig(stopped_where_it_began, store={"directory": tmp_path})
    (tmp_path / "operator.json").unlink()
    return tmp_path


def test_a_switch_stuck_on_the_reference_run_after_service_and_unit_restarted_is_not_believed(run_rig, kept):
    run_rig(homed_after_its_count_was_lost, store={"directory": kept}, motion={"rehome": "operator"})


@pytest.mark.parametrize("text", ["", "{", '{"a": 1e999, "b": 2.0}', '{"a": "near", "b": 2.0}'])
def test_a_kept_place_that_cannot_be_read_is_logged_and_hinders_nothing(run_rig, kept, caplog, text):
    (kept / FILE_NAME).write_text(text)
    run_rig(wait_for_long_rest, store={"directory": kept})
    assert f"{FILE_NAME} cannot be read" in caplog.text
    json.loads((kept / FILE_NAME).read_text())


def test_the_place_follows_the_axes_and_is_not_written_while_they_rest(run_rig, kept):
    begun = json.loads((kept / FILE_NAME).read_text())

    async def scenario(rig):
        await wait_for_long_rest(rig)
        written = (kept / FILE_NAME).stat().st_mtime_ns, (kept / FILE_NAME).read_bytes()
        assert json.loads(written[1]) != begun
        seen = rig.motion.telemetry
        assert json.loads(written[1]) == pytest.approx({"a": seen.position_a, "b": seen.position_b}, abs=0.1)
        await rig.control.stop("a test")
        await asyncio.sleep(600)
        assert ((kept / FILE_NAME).stat().st_mtime_ns, (kept / FILE_NAME).read_bytes()) == written

    run_rig(scenario, store={"directory": kept})


def rested_elsewhere(kept):
    """Change the record of where B rested: 50 units from where it begins now."""
    places = json.loads((kept / FILE_NAME).read_text())
    (kept / FILE_NAME).write_text(json.dumps({**places, "b": places["b"] - 50.0}))


def test_a_count_that_is_not_where_the_axes_rested_before_the_restart_is_in_doubt(run_rig, kept):
    async def scenario(rig):
        await rig.until(lambda: rig.motion.doubt, 60, "the doubt")
        assert "axis B has the count" in rig.motion.doubt
        assert "it was moved by hand, or its count is lost" in rig.motion.doubt

    rested_elsewhere(kept)
    run_rig(scenario, store={"directory": kept}, motion={"rehome": "operator"})


def test_a_place_kept_without_a_tracker_name_is_taken_for_that_of_the_only_tracker(run_rig, kept):
    async def scenario(rig):
        await rig.until(lambda: rig.motion.doubt, 60, "the doubt")
        assert "it was moved by hand, or its count is lost" in rig.motion.doubt

    rested_elsewhere(kept)
    run_rig(scenario, store={"directory": kept}, motion={"rehome": "operator"}, tracker=[{"name": "east"}])
    assert not (kept / FILE_NAME).exists(), "it is not to be read again by one without a name"


def test_a_place_kept_without_a_tracker_name_is_dropped_when_there_are_several_trackers(run_rig, kept):
    async def scenario(rig):
        await asyncio.sleep(60)
        assert [tracker.motion.doubt for tracker in rig.service.trackers] == [None] * 2

    rested_elsewhere(kept)
    tables = [{"name": "east"}, {"name": "west"}]
    run_rig(scenario, store={"directory": kept}, motion={"rehome": "operator"}, tracker=tables)
    assert not (kept / FILE_NAME).exists()


def test_a_simulated_positioner_that_begins_anew_is_not_compared_with_the_kept_place(run_rig, kept, monkeypatch):
    monkeypatch.setattr(ServiceRig, "has_fixed_start_pose", True)
    rested_elsewhere(kept)
    run_rig(wait_for_long_rest, store={"directory": kept})


def test_the_kept_place_is_erased_before_a_target_is_sent(run_rig, kept, monkeypatch):
    async def scenario(rig):
        move_to, found = rig.positioner.move_to, []

        async def move_and_look(*target, first):
            found.append((kept / FILE_NAME).read_text())
            await move_to(*target, first=first)

        monkeypatch.setattr(rig.positioner, "move_to", move_and_look)
        await wait_for_long_rest(rig)
        assert {text.strip() for text in found} == {"{}"}

    run_rig(scenario, store={"directory": kept})


def test_an_axis_that_stays_keeps_its_place_while_the_other_moves(run_rig, kept):
    def places():
        return json.loads((kept / FILE_NAME).read_text())

    async def scenario(rig):
        await wait_for_long_rest(rig)
        rested, pose = places(), rig.motion.telemetry
        rig.control.goto(pose.a_deg - 20.0, pose.b_deg, "a test")
        await rig.until(lambda: abs(rig.motion.telemetry.a_deg - pose.a_deg) > 5.0, 120, "A on its way")
        assert places() == {"b": rested["b"]}
        rig.motion.home()
        await rig.until(lambda: rig.motion.homing, 60, "the reference run")
        await asyncio.sleep(1)
        assert places() == {}

    run_rig(scenario, store={"directory": kept})


@pytest.mark.parametrize(("step_deg", "stays"), [(0.8, True), (1.6, False)])
def test_a_step_too_small_to_matter_leaves_both_places_kept(run_rig, kept, step_deg, stays):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rested, pose = (kept / FILE_NAME).read_text(), rig.motion.telemetry
        rig.control.goto(pose.a_deg - step_deg, pose.b_deg - step_deg, "a test")
        await rig.until(lambda: rig.motion.moving, 60, "the move")
        assert (kept / FILE_NAME).read_text() == (rested if stays else "{}")
        await rig.until(lambda: (kept / FILE_NAME).read_text() not in (rested, "{}"), 60, "the new places")

    run_rig(scenario, store={"directory": kept})


def test_after_a_person_has_cleared_a_doubt_the_kept_places_raise_none_at_a_restart(run_rig, kept):
    async def cleared(rig):
        await wait_for_long_rest(rig)
        await stuck_on_its_way(rig)
        rig.unit.repair("b_switch_closed", rig.clock.monotonic())
        await rig.control.stop("a test")
        rig.motion.clear_faults()
        await asyncio.sleep(20)
        places, seen = json.loads((kept / FILE_NAME).read_text()), rig.motion.telemetry
        assert rig.motion.doubt is None
        assert places == pytest.approx({"a": seen.position_a, "b": seen.position_b}, abs=0.1)
        # What a new process knows: the kept places, and the unit as it stands.
        rig.cables.positioner.link_up = False
        restarted = rig.build_driver(rig.unit, rig.service.settings)
        KeptPlace(StateFolder(kept), restarted, None, has_fixed_start_pose=False)
        await restarted.open()
        assert (await restarted.read_telemetry()).reference_doubt == ""
        await restarted.close()

    run_rig(cleared, store={"directory": kept}, motion={"rehome": "operator"})
