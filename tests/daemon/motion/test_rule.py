"""What moves without an order, or against a stop, is stopped, told, and blocks until a person has looked."""

import asyncio
import logging
from dataclasses import replace

import pytest

from daemon.base.records import Event, Mode, Move, MoveOutcome, Pose, Target
from drivers.errors import DeviceError, RefusedError
from sim_drivers.pozsol.setup import AxisDrive, Setup
from tests.support.motion import A_PACKET, B_PACKET, STOP_PACKET, alarms, commands_sent, drive_b, lose, show
from tests.support.phases import at_rest, tracking, under_way


async def quiet(rig):
    """Wait for the tracker to stand in TRACKING with its last move long over."""
    await tracking(rig)
    await at_rest(rig)
    await asyncio.sleep(20)


async def moves_for(rig, within_s):
    """Return how long something truly moves from now on, looked at ten times a second [s]."""
    start, last, before = rig.clock.monotonic(), None, rig.truth()
    while rig.clock.monotonic() - start < within_s:
        await asyncio.sleep(0.1)
        now = rig.truth()
        if now != before:
            last = rig.clock.monotonic()
        before = now
    return 0.0 if last is None else last - start


async def cleared(rig):
    rig.motion.clear_faults(shown=rig.motion.concerns)
    await rig.until(lambda: rig.motion.blocked is None, 20, "the release")


@pytest.mark.parametrize("what", ["target", "own_tracking", "re_reference"])
def test_what_moves_by_itself_is_stopped_within_2_s_and_blocks_even_a_stow(run_rig, caplog, what):
    async def scenario(rig):
        await quiet(rig)
        if what == "target":
            drive_b(rig, 85.0)
        else:
            rig.unit.inject(what, rig.clock.monotonic())
        assert 0 < await moves_for(rig, 20) <= 2.0
        assert "without an order" in rig.motion.unexplained
        assert "heliocube clear" in alarms(rig)["unexplained-motion"]
        assert rig.mode is Mode.FAULT
        rig.control.stow("storm")
        with pytest.raises(RefusedError, match="without an order"):
            rig.motion.order(Target(0, 90, "storm"), stow=True)
        with pytest.raises(RefusedError, match="without an order"):
            rig.motion.home()
        stands = rig.truth()
        await asyncio.sleep(1200)
        assert rig.truth() == stands
        rig.control.auto()
        assert rig.motion.concerns
        await cleared(rig)
        assert not alarms(rig)
        await rig.until_mode(Mode.TRACKING, 30)

    rig = run_rig(scenario)
    told = [event for event in rig.of(Event) if event.subject == "alarm" and "without an order" in event.text]
    warned = [r for r in caplog.records if r.levelno == logging.WARNING and "without an order" in r.getMessage()]
    assert len(warned) == 1
    assert [event.text.startswith("cleared ") for event in told] == [False, True]


@pytest.mark.parametrize("lost", [A_PACKET, B_PACKET])
def test_an_axis_that_drives_on_after_a_refused_move_is_stopped(run_rig, monkeypatch, lost):
    async def scenario(rig):
        await quiet(rig)
        lose(rig, monkeypatch, lost)
        rig.motion.order(Target(20, 80, "test"))
        await rig.until(lambda: rig.motion.last_move.target_b_deg == 80, 60, "the refusal")
        assert rig.motion.last_move.outcome is MoveOutcome.REFUSED
        assert await moves_for(rig, 60) == 0.0
        assert rig.motion.unexplained is None

    run_rig(scenario)


def test_each_attempt_of_a_refused_move_ends_with_both_axes_standing(run_rig, monkeypatch):
    async def scenario(rig):
        await quiet(rig)
        lose(rig, monkeypatch, A_PACKET)
        sent = commands_sent(rig, monkeypatch)
        rig.motion.order(Target(20, 80, "test"))
        await rig.until(lambda: rig.motion.last_move.target_b_deg == 80, 60, "the refusal")
        order = [data[:3] if data.startswith(STOP_PACKET) else data[:2] for _, data in sent]
        for at in [at for at, start in enumerate(order) if start == A_PACKET][1:]:
            assert order[at - 1] == STOP_PACKET
        assert order[-1] == STOP_PACKET
        assert order.count(A_PACKET) == 3

    run_rig(scenario)


def test_a_move_that_goes_the_wrong_way_or_elsewhere_is_stopped_and_blocks(run_rig):
    async def scenario(rig):
        await quiet(rig)
        rig.motion.order(Target(rig.motion.pose.a_deg, 80, "test"))
        await asyncio.sleep(3)
        assert rig.motion.target is not None
        drive_b(rig, 20.0)
        assert await moves_for(rig, 20) <= 2.0
        assert rig.motion.last_move.outcome is MoveOutcome.OVERSHOT
        assert "heads for position" in rig.motion.unexplained

    run_rig(scenario)


def test_a_unit_that_does_not_hear_stop_is_told_and_stays_blocked_when_it_hears_again(run_rig, monkeypatch):
    async def scenario(rig):
        await quiet(rig)
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        rig.unit.inject("deaf", rig.clock.monotonic())
        sent = commands_sent(rig, monkeypatch)
        await rig.control.stop("halt")
        await rig.until(lambda: "deaf-to-stop" in alarms(rig), 15, "the alarm")
        assert "supply" in alarms(rig)["deaf-to-stop"]
        stops = len(sent)
        await asyncio.sleep(10)
        assert len(sent) >= stops + 10, "it does not give up"
        assert rig.motion.stands_since_s is None
        rig.unit.repair("deaf", rig.clock.monotonic())
        assert await moves_for(rig, 60) <= 6.0
        assert rig.truth().b_deg > 20, "it did not drive to its old target"
        assert rig.motion.stands_since_s is not None
        rig.control.auto()
        with pytest.raises(RefusedError, match="does not obey"):
            rig.motion.order(Target(0, 90, "storm"), stow=True)
        await cleared(rig)

    run_rig(scenario)


def test_what_moves_at_the_connection_is_stopped_and_blocks_nothing(run_rig):
    async def scenario(rig):
        await quiet(rig)
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(5)
        rig.cables.positioner.link_up = True
        await rig.until(lambda: rig.motion.connected, 10, "the connection")
        assert await moves_for(rig, 5) == 0.0
        assert rig.motion.blocked is None
        await rig.until_mode(Mode.TRACKING, 10)

    run_rig(scenario)


@pytest.mark.parametrize("wish", ["stop", "stow", "hold", "goto"])
@pytest.mark.parametrize("after_s", [0.0, 0.03, 0.1, 0.3, 0.6])
def test_what_is_asked_while_the_link_comes_back_is_what_happens(run_rig, wish, after_s):
    async def scenario(rig):
        await quiet(rig)
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(5)
        opened = rig.positioner.open
        rig.positioner.open = lambda: (setattr(rig, "opened", True), opened())[1]
        rig.opened = False
        rig.cables.positioner.link_up = True
        await rig.until(lambda: rig.opened, 10, "the connection")
        await asyncio.sleep(after_s)
        try:
            if wish == "stop":
                await rig.control.stop("a person")
            elif wish == "goto":
                rig.control.goto(-10, 80, "there")
            else:
                getattr(rig.control, wish)("a person")
        except DeviceError:
            assert wish == "goto" or not rig.motion.connected
            return
        await asyncio.sleep(3)
        stands = rig.truth()
        await asyncio.sleep(120)
        if wish in ("stop", "hold"):
            assert rig.truth() == stands
        else:
            there = (0, 90) if wish == "stow" else (-10, 80)
            assert rig.truth() == (pytest.approx(there[0], abs=1), pytest.approx(there[1], abs=1))
        assert rig.motion.unexplained is None

    run_rig(scenario)


def test_a_button_at_the_unit_stops_motion_and_is_no_unexplained_motion(run_rig):
    async def scenario(rig):
        await quiet(rig)
        drive_b(rig, 85.0)
        await asyncio.sleep(0.1)
        show(rig, button_pressed=True)
        assert await moves_for(rig, 20) <= 2.0
        assert rig.motion.unexplained is None
        assert rig.motion.pressed
        with pytest.raises(RefusedError, match="a button was pressed"):
            rig.motion.order(Target(0, 90, "test"))
        with pytest.raises(RefusedError, match="a button was pressed"):
            rig.motion.home()
        assert "unexplained-motion" not in alarms(rig)

    rig = run_rig(scenario)
    told = [event.text for event in rig.of(Event) if event.subject == "positioner"]
    assert sum("a button is pressed" in text for text in told) == 1


def test_a_button_that_is_held_for_long_blocks_nothing_and_is_no_deafness(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        rig.unit.inject("button", rig.clock.monotonic())
        for _ in range(80):
            await asyncio.sleep(0.5)
            assert rig.motion.unexplained is None
        rig.unit.repair("button", rig.clock.monotonic())
        await asyncio.sleep(20)
        assert rig.motion.unexplained is None
        assert not alarms(rig)

    run_rig(scenario)


def test_a_reference_run_of_the_unit_in_mid_move_leaves_the_count_in_doubt(run_rig):
    async def scenario(rig):
        await under_way(rig)
        rig.unit.inject("re_reference", rig.clock.monotonic())
        await rig.until(lambda: rig.motion.unexplained, 3, "the alarm")
        await asyncio.sleep(10)
        assert "reference run of its own" in rig.motion.doubt

    run_rig(scenario)


def test_a_button_pressed_in_mid_move_ends_the_move(run_rig):
    async def scenario(rig):
        await under_way(rig)
        show(rig, button_pressed=True)
        assert await moves_for(rig, 10) <= 2.0
        assert rig.of(Move)[-1].outcome is MoveOutcome.INTERRUPTED

    run_rig(scenario)


@pytest.mark.parametrize("drive_of_unit", [AxisDrive(), AxisDrive(overshoot_mm=1.0), AxisDrive(speed_mm_s=1.0)])
def test_small_and_large_moves_are_never_taken_for_unexplained(run_rig, drive_of_unit):
    async def scenario(rig):
        await quiet(rig)
        a, b = 0.0, 60.0
        for step in (0.3, 0.7, -0.7, 0.75, 3.0, -0.5, -12.0, 0.6, 20.0, -0.2):
            a, b = a + step, b - step
            rig.motion.order(Target(a, b, "test"))
            await asyncio.sleep(0.7 if step == 3.0 else 60)
            assert rig.motion.unexplained is None

    run_rig(scenario, setup=Setup(drive=drive_of_unit), motion={"deadband_deg": 30})


def test_overcurrent_on_one_axis_stops_the_other(run_rig):
    async def scenario(rig):
        await quiet(rig)
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(3)
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        assert await moves_for(rig, 20) <= 2.0
        assert rig.motion.unexplained is None
        assert "a_overcurrent" in alarms(rig)["positioner-fault"]

    run_rig(scenario, setup=Setup(synchronous=True))


def test_the_axis_that_waits_for_its_turn_does_not_start_when_the_other_one_fails_at_rest(run_rig, monkeypatch):
    async def scenario(rig):
        await quiet(rig)
        sent = commands_sent(rig, monkeypatch)
        rig.unit.inject("b_overcurrent", rig.clock.monotonic())
        await asyncio.sleep(2)
        assert any(data.startswith(STOP_PACKET) for _, data in sent)
        stops = len(sent)
        await asyncio.sleep(600)
        assert len(sent) == stops, "once is enough"

    run_rig(scenario)


def test_while_frozen_nothing_is_ordered_and_what_moves_is_stopped(run_rig):
    async def scenario(rig):
        await under_way(rig)
        await rig.control.stop("Ann works there")
        assert await moves_for(rig, 10) <= 2.0
        for call in (rig.motion.home, lambda: rig.motion.order(Target(0, 60, "test"), stow=True)):
            with pytest.raises(RefusedError, match="Ann works there"):
                call()
        drive_b(rig, 85.0)
        assert await moves_for(rig, 10) <= 2.0
        assert "against a stop (" in rig.motion.unexplained
        assert "Ann works there" in rig.motion.unexplained
        rig.control.auto()
        await cleared(rig)
        rig.motion.order(Target(0, 60, "test"))
        assert await moves_for(rig, 3) > 0

    run_rig(scenario)


def test_freezing_sends_a_stop_even_to_axes_that_seem_to_stand(run_rig, monkeypatch):
    async def scenario(rig):
        await quiet(rig)
        sent = commands_sent(rig, monkeypatch)
        rig.motion.freeze("Ann works there")
        assert rig.motion.stands_since_s is None
        await asyncio.sleep(5)
        assert any(data.startswith(b"$9s") for _, data in sent)
        assert rig.motion.stands_since_s is not None

    run_rig(scenario)


@pytest.mark.parametrize("busy", ["clear", "home", "queued home", "queued target"])
def test_a_stop_is_never_lost_in_what_goes_on(run_rig, busy):
    async def scenario(rig):
        await quiet(rig)
        rig.control.hold("so that control orders nothing")
        if busy == "clear":
            rig.unit.inject("a_overcurrent", rig.clock.monotonic())
            await asyncio.sleep(1)
            rig.motion.clear_faults()
            await asyncio.sleep(0.05)
        elif busy == "queued target":
            rig.motion.order(Target(0, 60, "test"))
        else:
            rig.motion.home()
            await asyncio.sleep(3 if busy == "home" else 0)
        await rig.motion.stop()
        asked_s = rig.clock.monotonic()
        await rig.until(lambda: (rig.motion.stands_since_s or 0) > asked_s - 30 and rig.motion.resting, 3, "rest")
        stands = rig.truth()
        await asyncio.sleep(300)
        assert rig.truth() == stands
        assert rig.motion.connected
        assert not any("lost" in event.text for event in rig.of(Event) if event.subject == "positioner")
        assert not rig.motion.homing

    run_rig(scenario)


def test_a_stow_sends_the_axis_first_that_lays_the_module_flat(run_rig, monkeypatch):
    async def scenario(rig):
        await quiet(rig)
        sent = commands_sent(rig, monkeypatch)
        rig.control.stow("storm")
        await asyncio.sleep(5)
        targets = [data[:2] for _, data in sent if data[:2] in (A_PACKET, B_PACKET)]
        assert targets == [B_PACKET, A_PACKET]

    run_rig(scenario)


def test_a_unit_that_contradicts_the_configuration_moves_nothing(run_rig):
    conflict = "field 74 (holder) says 39.6 mm and the configuration 0: correct instruments.positioner.a_axis"

    async def scenario(rig):
        opened = rig.positioner.open

        async def contradicting():
            return replace(await opened(), setup_conflicts=(conflict,))

        rig.positioner.open = contradicting
        await rig.until_mode(Mode.FAULT, 10)
        assert rig.motion.blocked == conflict
        assert alarms(rig)["positioner-setup"] == conflict
        with pytest.raises(RefusedError, match="holder"):
            rig.motion.order(Target(0, 90, "storm"), stow=True)
        with pytest.raises(RefusedError, match="holder"):
            rig.motion.home()
        assert not rig.of(Move)

    run_rig(scenario)


def test_poses_at_rest_are_told_every_5_s_and_motion_at_once(run_rig):
    async def scenario(rig):
        await quiet(rig)
        before = len(rig.of(Pose))
        await asyncio.sleep(100)
        assert 19 <= len(rig.of(Pose)) - before <= 22
        drive_b(rig, 80.0)
        start_s = rig.clock.monotonic()
        await rig.until(lambda: rig.of(Pose)[-1].time_monotonic_s > start_s, 1.1, "a pose")

    run_rig(scenario)


def test_what_rests_and_says_so_is_read_seldom_and_still_known_by_the_last_half_second(run_rig):
    async def scenario(rig):
        await quiet(rig)
        await asyncio.sleep(10)
        read, reads = rig.positioner.read_telemetry, []

        def counted():
            reads.append(rig.clock.monotonic())
            return read()

        rig.positioner.read_telemetry = counted
        ages_s = []
        for _ in range(100):
            await asyncio.sleep(0.97)
            now_s = rig.clock.monotonic()
            ages_s += [now_s - rig.motion.telemetry.time_monotonic_s, now_s - rig.motion.pose.time_monotonic_s]
        assert len(reads) < 25
        assert max(ages_s) < 0.6
        drive_b(rig, 80.0)
        start_s = rig.clock.monotonic()
        await rig.until(lambda: rig.motion.unexplained, 1.1, "that it moved")
        assert rig.motion.telemetry.time_monotonic_s >= start_s

    run_rig(scenario)


@pytest.mark.parametrize(
    ("fields", "words"),
    [({"a_motor_current_a": 1.9}, "draws more than 1.6 A"), ({"b_motor_current_a": 0.7}, "although it stands")],
)
def test_motor_currents_that_last_are_an_alarm(run_rig, fields, words):
    async def scenario(rig):
        await quiet(rig)
        show(rig, **fields)
        await asyncio.sleep(1)
        assert not alarms(rig)
        await asyncio.sleep(3)
        assert words in alarms(rig)["motor-current"]
        del rig.positioner.read_telemetry
        await asyncio.sleep(3700)
        assert not alarms(rig)

    run_rig(scenario)


# The end of the service


def ended(run_rig, caplog, act):
    """Run until `act` is over, and return what was said about motion at the end, and whether it moves."""

    async def scenario(rig):
        await quiet(rig)
        await act(rig)

    with caplog.at_level(logging.INFO):
        rig = run_rig(scenario)
    now = rig.clock.monotonic()
    said = [record.getMessage() for record in caplog.records if record.name == "heliocube.service"]
    return said[-1], rig.unit.truth(now) != rig.unit.truth(now + 60)


def test_at_the_end_motion_that_nobody_ordered_is_stopped_too(run_rig, caplog):
    async def act(rig):
        drive_b(rig, 85.0)
        await asyncio.sleep(0.2)

    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves


def test_at_the_end_a_move_of_ours_is_stopped_and_shown(run_rig, caplog):
    async def act(rig):
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(3)

    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves


def test_at_the_end_no_new_move_is_taken(run_rig, caplog):
    async def act(rig):
        async def orders():
            while not refused:
                try:
                    rig.motion.order(Target(20, 60, "late"))
                except RefusedError as error:
                    refused.append(error.message)
                await asyncio.sleep(0.01)

        refused = rig.refused = []
        rig.late = asyncio.create_task(orders())
        rigs.append(rig)
        await asyncio.sleep(0.5)

    rigs = []
    said, moves = ended(run_rig, caplog, act)
    assert said == "motion stopped: telemetry shows both axes standing"
    assert not moves
    assert rigs[0].refused == ["the service ends"]


@pytest.mark.parametrize(
    ("trouble", "words"),
    [("deaf", "stop was sent, and no telemetry has shown the axes standing since"), ("unplug", "could not be sent")],
)
def test_at_the_end_nothing_is_said_to_stand_that_was_not_seen_to(run_rig, caplog, trouble, words):
    async def act(rig):
        rig.motion.order(Target(40, 15, "far"))
        await asyncio.sleep(2)
        if trouble == "deaf":
            rig.unit.inject("deaf", rig.clock.monotonic())
        else:
            rig.cables.positioner.link_up = False
        await asyncio.sleep(1)

    said, moves = ended(run_rig, caplog, act)
    assert moves
    assert said.startswith("motion is not known to be stopped: ")
    assert words in said
    assert "last seen " in said
    assert "look at the tracker" in said


def test_at_the_end_a_driver_that_never_answers_does_not_keep_the_service(run_rig, caplog):
    async def act(rig):
        rig.positioner.stop = lambda: asyncio.sleep(1e6)
        rig.end_s = rig.clock.monotonic()
        rigs.append(rig)

    rigs = []
    said, _ = ended(run_rig, caplog, act)
    assert said.startswith("motion is not known to be stopped: ")
    assert rigs[0].clock.monotonic() - rigs[0].end_s < 12


def test_a_host_that_was_busy_for_seconds_does_not_call_a_standing_unit_deaf(run_rig):
    async def scenario(rig):
        halt = rig.positioner.halt

        async def busy_then_halt():
            asyncio.get_running_loop().skip(8.0)
            await halt()

        rig.positioner.halt = busy_then_halt
        await rig.until(lambda: rig.motion.connected, 30, "the connection")
        await asyncio.sleep(10)
        assert "deaf-to-stop" not in alarms(rig)
        assert rig.motion.unexplained is None

    run_rig(scenario)
