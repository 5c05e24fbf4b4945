"""What moves without an order, or against a stop, is stopped, told, and blocks until a person has looked."""

import asyncio
import logging
from dataclasses import replace

import pytest

from daemon.base.records import Event, Mode, Move, MoveOutcome, Pose, Target
from drivers.errors import DeviceError, RefusedError
from sim_drivers.pozsol.setup import AxisDrive, Setup
from tests.daemon.service.test_faults import at_rest, commands_sent, tracking, under_way
from tests.support.motion import A_PACKET, B_PACKET, STOP_PACKET, alarms, drive_b, lose, show


async def quiet(bench):
    """Wait for the tracker to stand in TRACKING with its last move long over."""
    await tracking(bench)
    await at_rest(bench)
    await asyncio.sleep(20)


async def moves_for(bench, within_s):
    """Return how long something truly moves from now on, looked at ten times a second [s]."""
    start, last, before = bench.clock.monotonic(), None, bench.truth()
    while bench.clock.monotonic() - start < within_s:
        await asyncio.sleep(0.1)
        now = bench.truth()
        if now != before:
            last = bench.clock.monotonic()
        before = now
    return 0.0 if last is None else last - start


async def cleared(bench):
    bench.motion.clear_faults(shown=bench.motion.concerns)
    await bench.until(lambda: bench.motion.blocked is None, 20, "the release")


@pytest.mark.parametrize("what", ["target", "own_tracking", "re_reference"])
def test_what_moves_by_itself_is_stopped_within_2_s_and_blocks_even_a_stow(run_rig, caplog, what):
    async def scenario(bench):
        await quiet(bench)
        if what == "target":
            drive_b(bench, 85.0)
        else:
            bench.unit.inject(what, bench.clock.monotonic())
        assert 0 < await moves_for(bench, 20) <= 2.0
        assert "without an order" in bench.motion.unexplained
        assert "heliocube clear" in alarms(bench)["unexplained-motion"]
        assert bench.mode is Mode.FAULT
        bench.control.stow("storm")
        with pytest.raises(RefusedError, match="without an order"):
            bench.motion.order(Target(0, 90, "storm"), stow=True)
        with pytest.raises(RefusedError, match="without an order"):
            bench.motion.home()
        stands = bench.truth()
        await asyncio.sleep(1200)
        assert bench.truth() == stands
        bench.control.auto()
        assert bench.motion.concerns
        await cleared(bench)
        assert not alarms(bench)
        await bench.until_mode(Mode.TRACKING, 30)

    bench = run_rig(scenario)
    told = [event for event in bench.of(Event) if event.subject == "alarm" and "without an order" in event.text]
    warned = [r for r in caplog.records if r.levelno == logging.WARNING and "without an order" in r.getMessage()]
    assert len(warned) == 1
    assert [event.text.startswith("over: ") for event in told] == [False, True]


@pytest.mark.parametrize("lost", [A_PACKET, B_PACKET])
def test_an_axis_that_drives_on_after_a_refused_move_is_stopped(run_rig, monkeypatch, lost):
    async def scenario(bench):
        await quiet(bench)
        lose(bench, monkeypatch, lost)
        bench.motion.order(Target(20, 80, "test"))
        await bench.until(lambda: bench.motion.last_move.target_b_deg == 80, 60, "the refusal")
        assert bench.motion.last_move.outcome is MoveOutcome.REFUSED
        assert await moves_for(bench, 60) == 0.0
        assert bench.motion.unexplained is None

    run_rig(scenario)


def test_each_attempt_of_a_refused_move_ends_with_both_axes_standing(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        lose(bench, monkeypatch, A_PACKET)
        sent = commands_sent(bench, monkeypatch)
        bench.motion.order(Target(20, 80, "test"))
        await bench.until(lambda: bench.motion.last_move.target_b_deg == 80, 60, "the refusal")
        order = [data[:3] if data.startswith(STOP_PACKET) else data[:2] for _, data in sent]
        for at in [at for at, start in enumerate(order) if start == A_PACKET][1:]:
            assert order[at - 1] == STOP_PACKET
        assert order[-1] == STOP_PACKET
        assert order.count(A_PACKET) == 3

    run_rig(scenario)


def test_a_move_that_goes_the_wrong_way_or_elsewhere_is_stopped_and_blocks(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.order(Target(bench.motion.pose.a_deg, 80, "test"))
        await asyncio.sleep(3)
        assert bench.motion.target is not None
        drive_b(bench, 20.0)
        assert await moves_for(bench, 20) <= 2.0
        assert bench.motion.last_move.outcome is MoveOutcome.OVERSHOT
        assert "heads for position" in bench.motion.unexplained

    run_rig(scenario)


def test_a_unit_that_does_not_hear_stop_is_told_and_stays_blocked_when_it_hears_again(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        bench.unit.inject("deaf", bench.clock.monotonic())
        sent = commands_sent(bench, monkeypatch)
        await bench.control.stop("halt")
        await bench.until(lambda: "deaf-to-stop" in alarms(bench), 15, "the alarm")
        assert "supply" in alarms(bench)["deaf-to-stop"]
        stops = len(sent)
        await asyncio.sleep(10)
        assert len(sent) >= stops + 10, "it does not give up"
        assert bench.motion.stands_since_s is None
        bench.unit.repair("deaf", bench.clock.monotonic())
        assert await moves_for(bench, 60) <= 6.0
        assert bench.truth().b_deg > 20, "it did not drive to its old target"
        assert bench.motion.stands_since_s is not None
        bench.control.auto()
        with pytest.raises(RefusedError, match="does not obey"):
            bench.motion.order(Target(0, 90, "storm"), stow=True)
        await cleared(bench)

    run_rig(scenario)


def test_what_moves_at_the_connection_is_stopped_and_blocks_nothing(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        bench.cables.positioner.link_up = False
        await asyncio.sleep(5)
        bench.cables.positioner.link_up = True
        await bench.until(lambda: bench.motion.connected, 10, "the connection")
        assert await moves_for(bench, 5) == 0.0
        assert bench.motion.blocked is None
        await bench.until_mode(Mode.TRACKING, 10)

    run_rig(scenario)


@pytest.mark.parametrize("wish", ["stop", "stow", "hold", "goto"])
@pytest.mark.parametrize("after_s", [0.0, 0.03, 0.1, 0.3, 0.6])
def test_what_is_asked_while_the_link_comes_back_is_what_happens(run_rig, wish, after_s):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        bench.cables.positioner.link_up = False
        await asyncio.sleep(5)
        opened = bench.positioner.open
        bench.positioner.open = lambda: (setattr(bench, "opened", True), opened())[1]
        bench.opened = False
        bench.cables.positioner.link_up = True
        await bench.until(lambda: bench.opened, 10, "the connection")
        await asyncio.sleep(after_s)
        try:
            if wish == "stop":
                await bench.control.stop("a person")
            elif wish == "goto":
                bench.control.goto(-10, 80, "there")
            else:
                getattr(bench.control, wish)("a person")
        except DeviceError:
            assert wish == "goto" or not bench.motion.connected
            return
        await asyncio.sleep(3)
        stands = bench.truth()
        await asyncio.sleep(120)
        if wish in ("stop", "hold"):
            assert bench.truth() == stands
        else:
            there = (0, 90) if wish == "stow" else (-10, 80)
            assert bench.truth() == (pytest.approx(there[0], abs=1), pytest.approx(there[1], abs=1))
        assert bench.motion.unexplained is None

    run_rig(scenario)


def test_a_button_at_the_unit_stops_motion_and_is_no_unexplained_motion(run_rig):
    async def scenario(bench):
        await quiet(bench)
        drive_b(bench, 85.0)
        await asyncio.sleep(0.1)
        show(bench, button_pressed=True)
        assert await moves_for(bench, 20) <= 2.0
        assert bench.motion.unexplained is None
        assert bench.motion.pressed
        with pytest.raises(RefusedError, match="a button was pressed"):
            bench.motion.order(Target(0, 90, "test"))
        with pytest.raises(RefusedError, match="a button was pressed"):
            bench.motion.home()
        assert "unexplained-motion" not in alarms(bench)

    bench = run_rig(scenario)
    told = [event.text for event in bench.of(Event) if event.subject == "positioner"]
    assert sum("a button is pressed" in text for text in told) == 1


def test_a_button_that_is_held_for_long_blocks_nothing_and_is_no_deafness(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        bench.unit.inject("button", bench.clock.monotonic())
        for _ in range(80):
            await asyncio.sleep(0.5)
            assert bench.motion.unexplained is None
        bench.unit.repair("button", bench.clock.monotonic())
        await asyncio.sleep(20)
        assert bench.motion.unexplained is None
        assert not alarms(bench)

    run_rig(scenario)


def test_a_reference_run_of_the_unit_in_mid_move_leaves_the_count_in_doubt(run_rig):
    async def scenario(bench):
        await under_way(bench)
        bench.unit.inject("re_reference", bench.clock.monotonic())
        await bench.until(lambda: bench.motion.unexplained, 3, "the alarm")
        await asyncio.sleep(10)
        assert "reference run of its own" in bench.motion.doubt

    run_rig(scenario)


def test_a_button_pressed_in_mid_move_ends_the_move(run_rig):
    async def scenario(bench):
        await under_way(bench)
        show(bench, button_pressed=True)
        assert await moves_for(bench, 10) <= 2.0
        assert bench.of(Move)[-1].outcome is MoveOutcome.INTERRUPTED

    run_rig(scenario)


@pytest.mark.parametrize("drive_of_unit", [AxisDrive(), AxisDrive(overshoot_mm=1.0), AxisDrive(speed_mm_s=1.0)])
def test_small_and_large_moves_are_never_taken_for_unexplained(run_rig, drive_of_unit):
    async def scenario(bench):
        await quiet(bench)
        a, b = 0.0, 60.0
        for step in (0.3, 0.7, -0.7, 0.75, 3.0, -0.5, -12.0, 0.6, 20.0, -0.2):
            a, b = a + step, b - step
            bench.motion.order(Target(a, b, "test"))
            await asyncio.sleep(0.7 if step == 3.0 else 60)
            assert bench.motion.unexplained is None

    run_rig(scenario, setup=Setup(drive=drive_of_unit), motion={"deadband_deg": 30})


def test_overcurrent_on_one_axis_stops_the_other(run_rig):
    async def scenario(bench):
        await quiet(bench)
        bench.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(3)
        bench.unit.inject("a_overcurrent", bench.clock.monotonic())
        assert await moves_for(bench, 20) <= 2.0
        assert bench.motion.unexplained is None
        assert "a_overcurrent" in alarms(bench)["positioner-fault"]

    run_rig(scenario, setup=Setup(synchronous=True))


def test_the_axis_that_waits_for_its_turn_does_not_start_when_the_other_one_fails_at_rest(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        sent = commands_sent(bench, monkeypatch)
        bench.unit.inject("b_overcurrent", bench.clock.monotonic())
        await asyncio.sleep(2)
        assert any(data.startswith(STOP_PACKET) for _, data in sent)
        stops = len(sent)
        await asyncio.sleep(600)
        assert len(sent) == stops, "once is enough"

    run_rig(scenario)


def test_while_frozen_nothing_is_ordered_and_what_moves_is_stopped(run_rig):
    async def scenario(bench):
        await under_way(bench)
        await bench.control.stop("Ann works there")
        assert await moves_for(bench, 10) <= 2.0
        for call in (bench.motion.home, lambda: bench.motion.order(Target(0, 60, "test"), stow=True)):
            with pytest.raises(RefusedError, match="Ann works there"):
                call()
        drive_b(bench, 85.0)
        assert await moves_for(bench, 10) <= 2.0
        assert "against a stop (" in bench.motion.unexplained
        assert "Ann works there" in bench.motion.unexplained
        bench.control.auto()
        await cleared(bench)
        bench.motion.order(Target(0, 60, "test"))
        assert await moves_for(bench, 3) > 0

    run_rig(scenario)


@pytest.mark.parametrize("busy", ["clear", "home", "queued home", "queued target"])
def test_a_stop_is_never_lost_in_what_goes_on(run_rig, busy):
    async def scenario(bench):
        await quiet(bench)
        bench.control.hold("so that control orders nothing")
        if busy == "clear":
            bench.unit.inject("a_overcurrent", bench.clock.monotonic())
            await asyncio.sleep(1)
            bench.motion.clear_faults()
            await asyncio.sleep(0.05)
        elif busy == "queued target":
            bench.motion.order(Target(0, 60, "test"))
        else:
            bench.motion.home()
            await asyncio.sleep(3 if busy == "home" else 0)
        await bench.motion.stop()
        asked_s = bench.clock.monotonic()
        await bench.until(lambda: (bench.motion.stands_since_s or 0) > asked_s - 30 and bench.motion.resting, 3, "rest")
        stands = bench.truth()
        await asyncio.sleep(300)
        assert bench.truth() == stands
        assert bench.motion.connected
        assert not any("lost" in event.text for event in bench.of(Event) if event.subject == "positioner")
        assert not bench.motion.homing

    run_rig(scenario)


def test_a_stow_sends_the_axis_first_that_lays_the_module_flat(run_rig, monkeypatch):
    async def scenario(bench):
        await quiet(bench)
        sent = commands_sent(bench, monkeypatch)
        bench.control.stow("storm")
        await asyncio.sleep(5)
        targets = [data[:2] for _, data in sent if data[:2] in (A_PACKET, B_PACKET)]
        assert targets == [B_PACKET, A_PACKET]

    run_rig(scenario)


def test_a_unit_that_contradicts_the_configuration_moves_nothing(run_rig):
    conflict = "field 74 (holder) says 39.6 mm and the configuration 0: correct instruments.positioner.a_axis"

    async def scenario(bench):
        opened = bench.positioner.open

        async def contradicting():
            return replace(await opened(), setup_conflicts=(conflict,))

        bench.positioner.open = contradicting
        await bench.until_mode(Mode.FAULT, 10)
        assert bench.motion.blocked == conflict
        assert alarms(bench)["positioner-setup"] == conflict
        with pytest.raises(RefusedError, match="holder"):
            bench.motion.order(Target(0, 90, "storm"), stow=True)
        with pytest.raises(RefusedError, match="holder"):
            bench.motion.home()
        assert not bench.of(Move)

    run_rig(scenario)


def test_poses_at_rest_are_told_every_5_s_and_motion_at_once(run_rig):
    async def scenario(bench):
        await quiet(bench)
        before = len(bench.of(Pose))
        await asyncio.sleep(100)
        assert 19 <= len(bench.of(Pose)) - before <= 22
        drive_b(bench, 80.0)
        start_s = bench.clock.monotonic()
        await bench.until(lambda: bench.of(Pose)[-1].time_monotonic_s > start_s, 1.1, "a pose")

    run_rig(scenario)


@pytest.mark.parametrize(
    ("fields", "words"),
    [({"a_motor_current_a": 1.9}, "draws more than 1.6 A"), ({"b_motor_current_a": 0.7}, "although it stands")],
)
def test_motor_currents_that_last_are_an_alarm(run_rig, fields, words):
    async def scenario(bench):
        await quiet(bench)
        show(bench, **fields)
        await asyncio.sleep(1)
        assert not alarms(bench)
        await asyncio.sleep(3)
        assert words in alarms(bench)["motor-current"]
        del bench.positioner.read_telemetry
        await asyncio.sleep(3700)
        assert not alarms(bench)

    run_rig(scenario)


# The end of the service


def ended(run_rig, caplog, act):
    """Run until `act` is over, and return what was said about motion at the end, and whether it moves."""

    async def scenario(bench):
        await quiet(bench)
        await act(bench)

    with caplog.at_level(logging.INFO):
        bench = run_rig(scenario)
    now = bench.clock.monotonic()
    said = [record.getMessage() for record in caplog.records if record.name == "heliocube.service"]
    return said[-1], bench.unit.truth(now) != bench.unit.truth(now + 60)


def test_at_the_end_motion_that_nobody_ordered_is_stopped_too(run_rig, caplog):
    async def act(bench):
        drive_b(bench, 85.0)
        await asyncio.sleep(0.2)

    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves


def test_at_the_end_a_move_of_ours_is_stopped_and_shown(run_rig, caplog):
    async def act(bench):
        bench.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(3)

    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves


def test_at_the_end_no_new_move_is_taken(run_rig, caplog):
    async def act(bench):
        async def orders():
            while not refused:
                try:
                    bench.motion.order(Target(20, 60, "late"))
                except RefusedError as error:
                    refused.append(error.message)
                await asyncio.sleep(0.01)

        refused = bench.refused = []
        bench.late = asyncio.create_task(orders())
        benches.append(bench)
        await asyncio.sleep(0.5)

    benches = []
    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves
    assert benches[0].refused == ["the service ends"]


@pytest.mark.parametrize(
    ("trouble", "words"),
    [("deaf", "stop was sent, and no telemetry has shown the axes standing since"), ("unplug", "could not be sent")],
)
def test_at_the_end_nothing_is_said_to_stand_that_was_not_seen_to(run_rig, caplog, trouble, words):
    async def act(bench):
        bench.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        if trouble == "deaf":
            bench.unit.inject("deaf", bench.clock.monotonic())
        else:
            bench.cables.positioner.link_up = False
        await asyncio.sleep(1)

    said, moves = ended(run_rig, caplog, act)
    assert moves
    assert said.startswith("motion is not known to be stopped: ")
    assert words in said
    assert "last seen " in said
    assert "look at the tracker" in said


def test_at_the_end_a_driver_that_never_answers_does_not_keep_the_service(run_rig, caplog):
    async def act(bench):
        bench.positioner.stop = lambda: asyncio.sleep(1e6)
        bench.end_s = bench.clock.monotonic()
        benches.append(bench)

    benches = []
    said, _ = ended(run_rig, caplog, act)
    assert said.startswith("motion is not known to be stopped: ")
    assert benches[0].clock.monotonic() - benches[0].end_s < 12


def test_a_host_that_was_busy_for_seconds_does_not_call_a_standing_unit_deaf(run_rig):
    async def scenario(bench):
        halt = bench.positioner.halt

        async def busy_then_halt():
            asyncio.get_running_loop().skip(8.0)
            await halt()

        bench.positioner.halt = busy_then_halt
        await bench.until(lambda: bench.motion.connected, 30, "the connection")
        await asyncio.sleep(10)
        assert "deaf-to-stop" not in alarms(bench)
        assert bench.motion.unexplained is None

    run_rig(scenario)
