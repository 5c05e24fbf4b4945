"""The first moves, made by the real driver on the simulated unit in virtual time."""

import asyncio
import math
from dataclasses import replace

import pytest

from daemon.base.clock import LoopClock
from daemon.base.timeloop import VirtualTimeLoop
from daemon.commands.setup.first_move import Bounds, Leg, first_move, reason_not_to_move
from daemon.config.settings import Settings
from daemon.rigs.simulated import build_simulated_positioner
from drivers.errors import DeviceError, LinkLostError
from drivers.interfaces import Telemetry
from solar.frames import Limits
from tests.support.motion import STOP_PACKET

NARROW = Limits(-5.0, 5.0, 80.0, 90.0)


def moved(
    press_at=None,
    limits=NARROW,
    ends_beyond_deg=math.inf,
    end=None,
    press_beyond_deg=-math.inf,
    fault=None,
    fault_beyond_deg=-1.0,
    look=lambda _seen: None,
    sent=None,
):
    """Make the first move, with a key pressed after the words of a line; return its result, lines and poses.

    The packets that the unit receives are added to the list `sent`.
    """
    lines, poses, keys = [], [], []
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        clock = LoopClock(runner.get_loop().time, 1.7e9)
        truth, positioner = build_simulated_positioner(Settings(), clock)
        if sent is not None:
            unit = truth.__self__
            feed, unit.feed = unit.feed, lambda data, at_s: (sent.append(data), feed(data, at_s))[1]

        def pressed():
            poses.append(truth(clock.monotonic()))
            if fault is not None and poses[-1].a_deg > fault_beyond_deg:
                truth.__self__.inject(fault, clock.monotonic())
            if poses[-1].a_deg > ends_beyond_deg:
                end()
            said = press_at is not None and any(press_at in line for line in ("", *lines))
            # A key that was pressed stays pressed.
            keys.append(said and (poses[-1].a_deg > press_beyond_deg or any(keys)))
            return keys[-1]

        async def scene():
            if fault is not None and fault_beyond_deg < 0.0:
                truth.__self__.inject(fault, clock.monotonic())
            try:
                found = await first_move(positioner, Bounds(limits, 0.8, 0.3), clock, lines.append, pressed, look)
            except DeviceError as error:
                found = error.message
            except (asyncio.CancelledError, OSError) as error:
                found = type(error).__name__
            before = truth(clock.monotonic())
            assert before.a_deg < 1.5 or ends_beyond_deg == math.inf
            await asyncio.sleep(60.0)
            assert truth(clock.monotonic()) == pytest.approx(before, abs=1e-6), "it moves on"
            return found

        return runner.run(scene()), lines, poses


def test_the_first_move_goes_two_degrees_and_back_and_is_stopped_by_a_key():
    speed, lines, poses = moved(press_at="PRESS", press_beyond_deg=1.0)
    assert speed == pytest.approx(0.75, abs=0.1)
    assert max(pose.a_deg for pose in poses) == pytest.approx(2.0, abs=0.8)
    assert min(pose.b_deg for pose in poses) == pytest.approx(88.0, abs=0.8)
    assert [line for line in lines if "to the west" in line or "steeper" in line]
    assert "stopped by the key" in lines[-1]


@pytest.mark.parametrize(
    ("leg", "axis", "from_deg"),
    [
        ("to the west", "a_deg", 0.0),
        ("to the east", "a_deg", 2.0),
        ("steeper", "b_deg", 90.0),
        ("flatter", "b_deg", 88.0),
    ],
)
def test_a_key_in_any_leg_of_the_first_move_stops_that_leg_and_begins_no_other(leg, axis, from_deg):
    found, lines, poses = moved(press_at=leg)
    assert "stopped by a key" in found
    assert leg in lines[-1]
    assert getattr(poses[-1], axis) == pytest.approx(from_deg, abs=1.0), "half of the way"


def test_a_key_at_the_end_of_a_leg_of_the_first_move_sends_a_stop_as_well():
    sent = []
    found, lines, _ = moved(press_at="arrived", sent=sent)
    assert "stopped by a key" in found
    assert "arrived" in lines[-1]
    assert {data[:3] for data in sent[-2:]} == {STOP_PACKET}, "an axis may still be on its way within the tolerance"


def test_a_key_before_the_first_move_keeps_it_from_beginning():
    found, lines, poses = moved(press_at="")
    assert "stopped by a key" in found
    assert lines == []
    assert {(round(pose.a_deg, 3), round(pose.b_deg, 3)) for pose in poses} == {(0.0, 90.0)}


def test_a_key_pressed_before_the_axis_moves_does_not_prove_the_stop():
    found, lines, _ = moved(press_at="PRESS")
    assert found == "the key came before the axis moved, so the stop is not proven"
    assert "stopped by the key" not in lines[-1]


def test_a_first_move_without_a_pressed_key_reports_the_stop_as_not_proven():
    found, _, poses = moved()
    assert "not proven" in found
    assert max(pose.a_deg for pose in poses) <= 5.8


def lose_the_link():
    raise LinkLostError("positioner", "is gone")


def lose_the_keyboard():
    raise OSError


@pytest.mark.parametrize(
    ("end", "found"),
    [
        (lose_the_link, "is gone"),
        (lose_the_keyboard, "OSError"),
        # As Ctrl-C does.
        (lambda: asyncio.current_task().cancel(), "CancelledError"),
    ],
    ids=["link", "keyboard", "Ctrl-C"],
)
def test_a_lost_link_or_keyboard_and_ctrl_c_in_a_leg_of_the_first_move_halt_the_axes(end, found):
    told, _, poses = moved(ends_beyond_deg=0.5, end=end)
    assert told == found
    assert 0.5 < max(pose.a_deg for pose in poses) < 1.5


def test_a_positioner_whose_count_contradicts_its_end_switch_is_not_moved():
    found, lines, _ = moved(fault="a_switch_closed")
    assert "has to be homed first, because of: axis A shows its low end switch closed" in found
    assert lines == []


def test_a_count_that_comes_into_doubt_during_the_first_move_stops_it():
    found, _, poses = moved(fault="a_switch_closed", fault_beyond_deg=0.3)
    assert found.startswith("it cannot be relied on: axis A shows its low end switch closed")
    assert found.endswith("; it was stopped")
    assert max(pose.a_deg for pose in poses) < 1.9


def test_a_positioner_outside_the_limits_is_not_moved():
    found, lines, _ = moved(limits=Limits(10.0, 20.0, 80.0, 90.0))
    assert "outside the limits" in found
    assert lines == []


def test_a_positioner_that_contradicts_the_configuration_or_is_not_ready_is_not_moved():
    seen = telemetry()
    assert "contradicts" in reason_not_to_move(seen, ("arm 1 is 300 and not 310",), NARROW)
    assert "homed" in reason_not_to_move(replace(seen, was_reset=True), (), NARROW)
    assert "homed" in reason_not_to_move(replace(seen, faults=("a_overcurrent",)), (), NARROW)
    assert "homed" in reason_not_to_move(replace(seen, reference_doubt="the count jumped"), (), NARROW)
    assert "of its own" in reason_not_to_move(replace(seen, autonomous=True), (), NARROW)
    assert "outside" in reason_not_to_move(replace(seen, a_deg=math.nan), (), NARROW)
    assert reason_not_to_move(seen, (), NARROW) is None


def telemetry(a_deg=0.0, b_deg=90.0):
    positions = {"position_a": 1.0, "position_b": 1.0, "destination_a": 1.0, "destination_b": 1.0}
    return Telemetry(time_monotonic_s=0.0, a_deg=a_deg, b_deg=b_deg, **positions)


WEST, STEEPER = Leg("a", 0.0, 2.0, 90.0), Leg("b", 90.0, 88.0, 0.0)


@pytest.mark.parametrize(
    ("leg", "seen", "words"),
    [
        (WEST, telemetry(a_deg=-1.0), "A went the wrong way"),
        (WEST, telemetry(a_deg=3.0), "A went beyond 2.0 deg"),
        (WEST, telemetry(a_deg=1.0, b_deg=89.0), "B moved"),
        (WEST, telemetry(a_deg=math.nan), "A went the wrong way"),
        (WEST, telemetry(a_deg=1.0, b_deg=math.nan), "B moved"),
        (WEST, replace(telemetry(a_deg=1.0), faults=("a_overcurrent",)), "cannot be relied on: a_overcurrent"),
        (WEST, replace(telemetry(a_deg=1.0), button_pressed=True), "button"),
        (STEEPER, telemetry(b_deg=91.0), "B went the wrong way"),
        (STEEPER, telemetry(b_deg=87.0), "B went beyond 88.0 deg"),
        (STEEPER, telemetry(a_deg=1.0, b_deg=89.0), "A moved"),
        (WEST, telemetry(a_deg=2.1), None),
        (STEEPER, telemetry(b_deg=88.0), None),
    ],
)
def test_a_leg_of_the_first_move_objects_to_telemetry_that_does_not_fit_it(leg, seen, words):
    objection = leg.objection(seen, 0.8)
    assert objection is None if words is None else words in objection
