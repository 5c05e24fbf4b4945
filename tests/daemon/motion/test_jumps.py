"""A count that jumps, from the bytes on the wire to the rule of motion: it is reported as a jump, not as motion."""

import asyncio
from dataclasses import replace

import pytest

from daemon.base.records import MoveOutcome, Target
from daemon.motion.watch import AxisWatch
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.link import LinkState
from drivers.positioners.pozsol.table import FieldTable
from drivers.positioners.pozsol.watch import PositionerWatch
from drivers.positioners.pozsol.wire import TokenStream
from drivers.settings import PositionerSettings
from tests.support.fake_positioner import FakePositioner, run_motion

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)
STARTS_S = 100.0
SCREEN_S = 0.02
SLOW = b"$'24.00$\x880000$8Micro tracking"


def axis(first, remain, setup, position_mm):
    angle_deg = setup.geometry.angle_at_length(setup.geometry.low_length_mm + position_mm)
    numbers = (first, angle_deg, first + 1, position_mm, first + 2, position_mm, first + 3, remain)
    return b"$%c%.1f$%c%.4f$%c%.4f$%c0.00$%c0.0000" % numbers


def turn(a_mm, b_mm):
    """Return the six screens of one turn."""
    return [
        b"$(10$)20$*30",
        axis(44, 63, A, a_mm),
        axis(48, 64, B, b_mm),
        b"$\xad30$\xae20$\xaf10",
        b"$\xb111$\xb226",
        SLOW,
    ]


def strays(screens, cut):
    """Return the strays of a unit that prints these screens; each is read in two pieces, with a look after each."""
    clock = [STARTS_S]
    stream, table = TokenStream(), FieldTable()
    unit = PositionerWatch(lambda: clock[0], {"a": A, "b": B}, 2.0, None)
    watch, told = AxisWatch(PositionerSettings(position_unit="mm")), []
    for at, screen in enumerate(screens):
        clock[0] = STARTS_S + SCREEN_S * at
        for piece in (screen[:cut], screen[cut:]):
            table.take(stream.feed_tokens(piece), clock[0])
            if at < 12:
                continue
            look = unit.read(LinkState(table.snapshot(), jumped_s=table.jumped_s))
            if at == 12:
                watch.note_rest(look)
            elif anomaly := watch.update(look):
                told.append(anomaly)
    return told


@pytest.mark.parametrize("jumps", [(68.0, 15.0), (8.0, 75.0), (68.0, 75.0)])
def test_a_jump_of_the_count_is_reported_as_a_jump_and_never_as_motion_wherever_a_look_falls(jumps):
    screens = [*turn(8.0, 15.0) * 3, *turn(*jumps) * 4]
    changed = sum(was != now for was, now in zip((8.0, 15.0), jumps, strict=True))
    for cut in range(60):
        told = strays(screens, cut)
        assert [anomaly.is_count_jump for anomaly in told] == [True] * changed, (cut, told)


@pytest.mark.parametrize("moves", [(68.5, 15.0), (68.0, 15.5)])
def test_an_axis_that_moves_right_after_a_jump_of_the_count_is_reported(moves):
    screens = [*turn(8.0, 15.0) * 3, *turn(68.0, 15.0) * 2, *turn(*moves) * 2]
    for cut in range(60):
        told = strays(screens, cut)
        assert told[0].is_count_jump, cut
        assert len(told) > 1, cut
        assert not any(anomaly.is_count_jump for anomaly in told[1:]), (cut, told)
        assert "moved from" in told[1].text


class LatePositioner(FakePositioner):
    """Answers every third look after three seconds, with where it stands by then."""

    async def read_telemetry(self):
        asked_s = self._clock.monotonic()
        if self.looks % 3 == 2:
            await asyncio.sleep(3.0)
        return replace(await super().read_telemetry(), time_monotonic_s=asked_s)


def test_motion_of_an_axis_during_a_late_answer_is_not_taken_for_a_jump_of_the_count():
    async def scenario(rig):
        rig.motion.order(Target(-40.0, 60.0, "test"))
        await rig.until(lambda: rig.moves and rig.moves[-1].outcome is MoveOutcome.ARRIVED, 120.0)
        assert not rig.positioner_events

    run_motion(scenario, make=LatePositioner)


def test_a_jump_of_the_count_during_a_late_answer_is_found():
    async def scenario(rig):
        rig.unit.put(40.0, 60.0)
        await rig.until(lambda: "the count jumped from A +0.0" in (rig.motion.doubt or ""))

    run_motion(scenario, make=LatePositioner)
