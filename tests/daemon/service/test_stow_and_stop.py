"""Wind stows, a person stops and holds, and no move goes past the limits, whatever is under way."""

import asyncio
import json
import math
from pathlib import Path
from random import Random

import pytest

from daemon.base.clock import LoopClock, iso_utc
from daemon.base.process import SystemdNotifier
from daemon.base.records import Bus, Mode, ModeChange, Move, MoveOutcome, Target
from daemon.config.settings import Settings
from daemon.rigs.real import build_positioner
from daemon.service.operator import CommandError, Operator
from daemon.service.operator_commands import Operators, parse
from daemon.service.rig import Rig, Role, TrackerInstruments
from daemon.service.service import Service
from drivers.errors import DeviceError, RefusedError
from tests.support.addresses import free_port
from tests.support.motion import commands_sent
from tests.support.phases import wait_for_long_rest, wait_for_move, wait_for_rest, wait_for_tracking


def test_wind_stows_the_tracker_in_mid_move_and_releases_it_after_900_s_of_calm(run_rig):
    async def scenario(rig):
        await wait_for_move(rig)
        rig.wind_m_s = 16.0
        await rig.until_mode(Mode.STOW, 6)
        await asyncio.sleep(180)
        assert rig.truth() == (pytest.approx(0, abs=1), pytest.approx(90, abs=1))
        rig.wind_m_s = 5.0
        await asyncio.sleep(850)
        assert rig.mode is Mode.STOW
        await rig.until_mode(Mode.TRACKING, 120)

    rig = run_rig(scenario, safety={"stow_at_least_s": 900})
    assert rig.records_of(Move)[0].outcome is MoveOutcome.INTERRUPTED
    assert "16.0 m/s" in next(change.why for change in rig.records_of(ModeChange) if change.after is Mode.STOW)


def test_a_hold_in_the_instant_of_a_gust_does_not_delay_the_wind_stow(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.wind_m_s = 20.0
        # Before anything else has read the wind.
        await Operator(rig.tracker, 1.0).hold("a look", "ana")
        assert rig.mode is Mode.STOW
        assert rig.motion.target is not None

    run_rig(scenario)


def test_hold_stops_a_stow_move_that_still_runs_after_auto_while_the_reference_is_in_doubt(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.power_cycle(rig.clock.monotonic())
        await rig.until(lambda: rig.motion.doubt, 60, "the doubt")
        operator = Operator(rig.tracker, 1.0)
        await operator.stow("a test", "ana")
        await operator.auto("a test", "ana")
        assert (rig.mode, rig.motion.moving) == (Mode.FAULT, True)
        await operator.hold("a test", "ana")
        assert not rig.motion.moving
        assert rig.truth().b_deg < 80.0

    run_rig(scenario, motion={"rehome": "operator"})


@pytest.mark.parametrize("blows", [False, True])
def test_auto_interrupts_a_stow_move_at_once_but_not_while_the_wind_blows(run_rig, blows):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        operator = Operator(rig.tracker, 1.0)
        await operator.stow("a test", "ana")
        if blows:
            rig.wind_m_s = 20.0
        await asyncio.sleep(5)
        assert rig.motion.moving
        await operator.auto("a test", "ana")
        if blows:
            assert rig.motion.moving
            await wait_for_rest(rig)
            assert (rig.mode, rig.truth().b_deg) == (Mode.STOW, pytest.approx(90.0, abs=1.0))
        else:
            await rig.until(lambda: not rig.motion.moving, 2, "rest")
            assert rig.mode is Mode.TRACKING
            assert rig.truth().b_deg < 80.0
            await rig.until(lambda: rig.motion.moving, 300, "the next move of the law")

    rig = run_rig(scenario)
    stow = next(move for move in rig.records_of(Move) if (move.target_a_deg, move.target_b_deg) == (0.0, 90.0))
    assert stow.outcome is (MoveOutcome.ARRIVED if blows else MoveOutcome.INTERRUPTED)


def test_stow_ends_a_reference_run_and_leaves_the_reference_in_doubt(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.control.home()
        await rig.until(lambda: rig.motion.homing, 10, "homing")
        await asyncio.sleep(5)
        rig.control.stow("storm")
        await rig.until_mode(Mode.STOW, 1)
        await rig.until(lambda: not rig.motion.homing, 5, "the end of homing")
        await asyncio.sleep(200)
        assert rig.truth().b_deg == pytest.approx(90, abs=1)
        rig.control.auto()
        await rig.until_mode(Mode.FAULT, 30)
        assert "the reference run of A did not end" in rig.control.why
        rig.control.home()
        await rig.until_mode(Mode.TRACKING, 300)

    run_rig(scenario)


def test_a_restarted_positioner_that_takes_no_target_is_cleared_for_a_stow_and_stays_in_doubt(run_rig):
    async def scenario(rig):
        await wait_for_long_rest(rig)
        rig.unit.inject("a_hall_loss", rig.clock.monotonic())
        await rig.until(lambda: rig.motion.telemetry and rig.motion.telemetry.faults, 7200, "the fault", every_s=1.0)
        # A person switches the unit off and on: the fault is gone, but the axis stays disabled.
        rig.unit.repair("a_hall_loss", rig.clock.monotonic())
        rig.unit.power_cycle(rig.clock.monotonic())
        await asyncio.sleep(60)
        rig.wind_m_s = 30.0
        assert abs(rig.motion.pose.a_deg) > 10.0
        # The axis drove blind for some degrees, so its count arrives before it truly does.
        await rig.until(lambda: abs(rig.motion.pose.a_deg) < 1.0 and rig.truth().b_deg > 89.0, 300, "the stow")
        assert rig.mode is Mode.STOW
        assert "the positioner has restarted" in rig.motion.doubt

    run_rig(scenario, start="2022-10-12T08:30")


def test_a_wind_sensor_that_falls_silent_stows_the_tracker(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        rig.wind_m_s = None
        await asyncio.sleep(250)
        assert rig.mode is Mode.TRACKING
        await rig.until_mode(Mode.STOW, 60)

    run_rig(scenario)


@pytest.mark.parametrize("state", ["idle", "ordering", "moving", "homing", "stowing"])
def test_stop_is_sent_within_200_ms_in_every_state_and_latches(run_rig, monkeypatch, state):
    async def scenario(rig):
        await wait_for_tracking(rig)
        if state == "idle":
            await wait_for_rest(rig)
        elif state == "ordering":
            await wait_for_rest(rig)
            rig.control.goto(30, 50, "test")
            await asyncio.sleep(0.01)
        elif state == "moving":
            await asyncio.sleep(2)
        elif state == "homing":
            await wait_for_rest(rig)
            rig.control.home()
            await rig.until(lambda: rig.motion.homing, 10, "homing")
            await asyncio.sleep(3)
        else:
            rig.control.stow("test")
            await asyncio.sleep(3)
        sent = commands_sent(rig, monkeypatch)
        asked = rig.clock.monotonic()
        await rig.control.stop("test")
        assert sent[0][1].startswith(b"$9s")
        assert sent[0][0] - asked < 0.2
        await asyncio.sleep(3)
        stands = rig.truth()
        await asyncio.sleep(900)
        assert rig.truth() == stands, "it stays where it was stopped"
        assert rig.mode is Mode.HOLD
        rig.control.auto()
        if state == "homing":
            await rig.until_mode(Mode.FAULT, 10)
            assert "the reference run of A did not end" in rig.control.why
            rig.control.clear_faults()
        await rig.until_mode(Mode.TRACKING, 60)

    run_rig(scenario)


def test_a_goto_from_before_a_fault_is_not_carried_out_after_it(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.control.goto(-40, 30, "test")
        await asyncio.sleep(5)
        rig.cables.positioner.link_up = False
        await rig.until_mode(Mode.FAULT, 15)
        with pytest.raises(RefusedError, match="mode fault"):
            rig.control.goto(10, 60, "test")
        rig.cables.positioner.link_up = True
        await rig.until_mode(Mode.HOLD, 30)
        await asyncio.sleep(3)
        stands = rig.truth()
        await asyncio.sleep(600)
        assert rig.truth() == stands

    run_rig(scenario)


def test_goto_moves_to_its_target_and_holds(run_rig):
    async def scenario(rig):
        await wait_for_tracking(rig)
        await wait_for_rest(rig)
        rig.control.goto(-20, 70, "look at the other side")
        await asyncio.sleep(900)
        assert rig.mode is Mode.HOLD
        assert rig.truth() == (pytest.approx(-20, abs=0.9), pytest.approx(70, abs=0.9))

    run_rig(scenario)


@pytest.mark.parametrize("target", [(51, 60), (0, 14.9), (math.nan, 60), (0, math.inf)])
def test_a_target_outside_the_limits_is_refused_by_control_and_by_the_driver(run_rig, target):
    async def scenario(rig):
        await wait_for_tracking(rig)
        with pytest.raises(ValueError, match=r"limits \(A -50..50 deg, B 15..90 deg\)"):
            rig.control.goto(*target, "test")
        with pytest.raises(ValueError, match="limits"):
            await rig.positioner.move_to(*target)

    run_rig(scenario)


def test_besides_the_probes_only_motion_and_setup_call_the_positioners_move_and_home(run_rig):
    """R24: in the service the only caller of the positioner's move and home commands is the runner of Motion.

    `heliocube probe` and `heliocube setup` run only while the service does not, and keep to the driver's limits.
    """

    callers = {
        path.as_posix()
        for path in Path("daemon").rglob("*.py")
        if not path.name.startswith("probe")
        and any(call in path.read_text() for call in ("positioner.move_to(", "positioner.home("))
    }
    assert callers == {"daemon/motion/runs.py", "daemon/commands/setup/first_move.py"}


def test_orders_and_stops_are_refused_before_the_positioner_has_answered(run_rig):
    async def scenario(rig):
        await asyncio.sleep(5)

        with pytest.raises(RefusedError, match="cannot move"):
            rig.motion.order(Target(0, 60, "test"))
        with pytest.raises(DeviceError):
            await rig.control.stop("test")

    run_rig(lambda rig: (setattr(rig.cables.positioner, "link_up", False), scenario(rig))[1])


@pytest.mark.parametrize("asked", ["stop", "maintenance", "hold"])
def test_an_auto_dated_before_the_stop_hold_or_maintenance_that_it_would_end_is_refused(run_rig, asked):
    async def scenario(rig):
        await wait_for_tracking(rig)
        operators = Operators(rig.service.trackers, 1.0)
        await operators.carry_out(parse(asked, b'{"by": "ana@lab"}', "HTTP"))
        since_utc_s = getattr(rig.control.wishes, asked).since_utc_s

        def auto(off_s):
            dated = {"id": "1", "time": iso_utc(since_utc_s + off_s)}
            return operators.carry_out(parse("auto", json.dumps(dated).encode(), "MQTT"))

        with pytest.raises(CommandError, match=r"given before the wish that it would end, .* is .* by ana@lab since"):
            await auto(-2.0)
        assert getattr(rig.control.wishes, asked) is not None
        # A program's times may be rounded to the second.
        await auto(-0.9)
        assert getattr(rig.control.wishes, asked) is None

    run_rig(scenario)


def test_a_stop_that_cannot_be_sent_says_why_the_positioner_cannot_be_reached():
    own = {"driver": "rotctld", "server": f"127.0.0.1:{free_port()}"}
    bridge = {"listen": "127.0.0.1:0"}
    settings = Settings.model_validate({"bridge": bridge, "instruments": {"positioner": own}})

    async def scenario():
        clock, stop = LoopClock(asyncio.get_running_loop().time, 1.7e9), asyncio.Event()
        rig = Rig(None, (TrackerInstruments(build_positioner(settings, clock)),), None, simulated=False)
        service = Service(
            settings, Role.TRACKER, rig, clock, Random(1), Bus(), bytes(range(32)), SystemdNotifier({}, 0)
        )
        running = asyncio.create_task(service.run(stop))
        (tracker,) = service.trackers
        while not tracker.motion.outage.is_down:  # noqa: ASYNC110 - it is told to a log only
            await asyncio.sleep(0.01)
        with pytest.raises(CommandError, match="as soon as the positioner answers: positioner: nothing listens at"):
            await Operator(tracker, 1.0).stop("halt")
        stop.set()
        await running

    asyncio.run(scenario())
