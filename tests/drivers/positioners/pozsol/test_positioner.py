"""The positioner's driver on the simulated unit, in virtual time: halts, refusals, doubts."""

import asyncio
import itertools
import math
from dataclasses import replace

import pytest

from daemon.base.timeloop import VirtualTimeLoop
from drivers.errors import LinkLostError, RefusedError, StillMovingError
from drivers.positioners.pozsol.geometry import AxisSetup, Triangle
from drivers.positioners.pozsol.link import LinkState
from drivers.positioners.pozsol.positioner import PozsolPositioner
from drivers.positioners.pozsol.table import FieldTable
from drivers.positioners.pozsol.watch import FAST_FIELDS, SLOW_FIELDS, PositionerWatch
from drivers.positioners.pozsol.wire import BUTTON_BIT, RESET_BIT, Field
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import Setup
from sim_drivers.transports import InMemoryStream
from solar.frames import Angles

A = AxisSetup(Triangle(300.0, 300.0, 90.0, -52.0), -50.0, 50.0)
B = AxisSetup(Triangle(300.0, 300.0, 37.5, 13.0), 15.0, 90.0)


def on_unit(scenario, setup=None):
    """Run a scenario with an open driver, its unit, and a function that returns the time."""

    async def scene():
        now = asyncio.get_running_loop().time
        core = PositionerCore(now(), setup)
        positioner = PozsolPositioner(InMemoryStream(core, now), now, A, B)
        await positioner.open()
        await scenario(positioner, core, now)

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


def test_halt_returns_quickly_for_a_standing_unit_and_waits_until_a_moving_unit_stands():
    async def scenario(positioner, core, now):
        start_s = now()
        await positioner.halt()
        assert now() - start_s < 0.6
        await positioner.move_to(-30.0, 45.0)
        await asyncio.sleep(5.0)
        start_s = now()
        await positioner.halt()
        assert now() - start_s < 1.0
        stands = core.truth(now())
        await asyncio.sleep(60.0)
        assert core.truth(now()) == pytest.approx(stands, abs=0.01)

    on_unit(scenario)


def test_a_target_is_not_reported_as_refused_when_its_telemetry_comes_late():
    async def scene():
        now = asyncio.get_running_loop().time
        line = InMemoryStream(PositionerCore(now()), now)
        positioner = PozsolPositioner(line, now, A, B)
        await positioner.open()
        moving = asyncio.create_task(positioner.move_to(-30.0, 45.0))
        await asyncio.sleep(0.15)
        line.silent = True
        await asyncio.sleep(1.7)
        assert not moving.done()
        line.silent = False
        await moving

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


def test_halt_sends_stop_twice_even_if_the_machine_was_busy_for_a_second():
    async def scene():
        late_s, sent, loop = [0.0], [], asyncio.get_running_loop()

        def now():
            return loop.time() + late_s[0]

        line = InMemoryStream(PositionerCore(now()), now)
        positioner, send = PozsolPositioner(line, now, A, B), line.send
        await positioner.open()

        async def counted(packet):
            sent.append(packet)
            await send(packet)

        line.send = counted
        loop.call_later(0.05, late_s.__setitem__, 0, 1.0)
        await positioner.halt()
        # The first packet of a connection is lost.
        assert sent == [b"$9s\r"] * 2

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


def test_commands_are_spaced_from_the_end_of_a_previous_command_that_took_long_to_send():
    async def scene():
        now, times = asyncio.get_running_loop().time, []
        line = InMemoryStream(PositionerCore(now()), now)
        positioner, send = PozsolPositioner(line, now, A, B), line.send
        await positioner.open()

        async def slowly(packet):
            begun_s = now()
            await asyncio.sleep(0.5)
            await send(packet)
            times.append((begun_s, now()))

        line.send = slowly
        await positioner.move_to(-30.0, 45.0)
        assert len(times) > 2
        assert all(begun_s - ended_s >= 0.06 for (_, ended_s), (begun_s, _) in itertools.pairwise(times))

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scene())


def test_disable_autonomy_switches_own_tracking_off_and_returns_only_when_both_axes_stand():
    async def scenario(positioner, core, now):
        core.inject("own_tracking", now())
        await asyncio.sleep(10.0)
        assert (await positioner.read_telemetry()).autonomous
        before = core.truth(now())
        await asyncio.sleep(1.0)
        assert core.truth(now()) != pytest.approx(before, abs=0.1), "it drives by itself"
        await positioner.disable_autonomy()
        assert not (await positioner.read_telemetry()).autonomous
        stands = core.truth(now())
        await asyncio.sleep(60.0)
        assert core.truth(now()) == pytest.approx(stands, abs=0.01)

    on_unit(scenario, Setup(own_target=lambda _now: Angles(-40.0, 20.0)))


def test_halt_reports_a_unit_that_ignores_stops_as_still_moving_after_12_s():
    async def scenario(positioner, core, now):
        await positioner.move_to(-40.0, 45.0)
        core.inject("deaf", now())
        start_s = now()
        with pytest.raises(StillMovingError, match="keeps moving after 12 s of stops"):
            await positioner.halt()
        assert 11.0 < now() - start_s < 14.0

    on_unit(scenario)


def test_a_move_is_refused_when_the_configured_geometry_has_no_position_for_the_target():
    async def scenario(positioner, core, now):
        flat = replace(A, geometry=Triangle(300.0, 300.0, 90.0, -52.0, 290.0))
        positioner = PozsolPositioner(InMemoryStream(core, now), now, flat, B)
        assert "a_axis cannot be right" in (await positioner.open()).setup_conflicts[0]
        with pytest.raises(RefusedError, match="no position for"):
            await positioner.move_to(0.0, 45.0)

    on_unit(scenario)


@pytest.mark.parametrize(("deaf_axis", "other"), [("a", "b_deg"), ("b", "a_deg")])
def test_a_move_is_refused_and_the_other_axis_stopped_when_one_axis_does_not_take_its_target(deaf_axis, other):
    async def scenario(positioner, core, now):
        core.inject(f"{deaf_axis}_ignores_targets", now())
        with pytest.raises(RefusedError, match="did not take the target"):
            await positioner.move_to(-30.0, 45.0)
        await asyncio.sleep(1.0)
        stands = getattr(core.truth(now()), other)
        await asyncio.sleep(60.0)
        assert getattr(core.truth(now()), other) == pytest.approx(stands, abs=0.01)

    on_unit(scenario)


def test_a_move_is_refused_and_neither_axis_moves_while_one_axis_reports_a_fault():
    async def scenario(positioner, core, now):
        core.inject("a_overcurrent", now())
        stands = core.truth(now())
        with pytest.raises(RefusedError, match=r"is not given the target .*: it reports a_overcurrent"):
            await positioner.move_to(-30.0, 45.0)
        await asyncio.sleep(30.0)
        assert core.truth(now()) == stands

    on_unit(scenario)


def test_a_stopped_reference_run_leaves_a_reference_doubt_of_its_axis_until_it_is_cleared():
    async def scenario(positioner, core, now):
        await positioner.home("a")
        await asyncio.sleep(3.0)
        assert (await positioner.read_telemetry()).homing
        await positioner.stop()
        await asyncio.sleep(2.0)
        seen = await positioner.read_telemetry()
        assert (seen.homing, seen.reference_doubt) == (False, "the reference run of A did not end")
        assert (await positioner.clear_faults()).reference_doubt == "the reference run of A did not end"
        assert (await positioner.read_telemetry()).reference_doubt == ""

    on_unit(scenario)


def test_the_doubt_after_a_restart_ends_once_both_axes_have_been_homed():
    async def scenario(positioner, core, now):
        core.power_cycle(now())
        assert "has restarted" in (await positioner.read_telemetry()).reference_doubt
        for axis, doubt in (("a", "the positioner has restarted"), ("b", "")):
            await positioner.home(axis)
            for _ in range(200):
                await asyncio.sleep(1.0)
                await positioner.read_telemetry()
            assert (await positioner.read_telemetry()).reference_doubt == doubt

    on_unit(scenario)


def test_the_link_is_lost_when_axis_fields_are_older_than_2_s_or_slow_fields_older_than_8_s():
    texts = dict.fromkeys(FAST_FIELDS, b"0.0") | {Field.SUPPLY: b"24.00", Field.STATUS: b"0000", Field.MODE: b"ok"}
    clock = [0.0]

    def look(ages_s):
        clock[0] = 100.0
        table, watch = FieldTable({}), PositionerWatch(lambda: clock[0], {"a": A, "b": B}, 2.0, None)
        for field, text in texts.items():
            table.take([b"%c%b" % (field, text)], 100.0 - ages_s.get(field, 0.0))
        return watch.read(LinkState(table.snapshot()))

    assert look({}).supply_v == 24.0
    for field in (*FAST_FIELDS, *SLOW_FIELDS):
        limit_s = 2.0 if field in FAST_FIELDS else 8.0
        assert look({field: limit_s - 0.1})
        with pytest.raises(LinkLostError, match=rf"has been silent for {limit_s + 0.1:.1f} s"):
            look({field: limit_s + 0.1})
    with pytest.raises(LinkLostError, match=r"has been silent for 2\.1 s"):
        look(dict.fromkeys(FAST_FIELDS, 2.1) | dict.fromkeys(SLOW_FIELDS, 4.0))


REST = dict.fromkeys(FAST_FIELDS, b"0.0") | {Field.SUPPLY: b"24.00", Field.STATUS: b"0000", Field.MODE: b"ok"}


def at_rest(clock, **texts):
    """Return a watch, and the values that a unit reported at second 100."""
    table, watch = FieldTable({}), PositionerWatch(lambda: clock[0], {"a": A, "b": B}, 2.0, None)
    told = REST | {Field[name]: text for name, text in texts.items()}
    table.take([b"%c%b" % (field, text) for field, text in told.items()], 100.0)
    return watch, table.snapshot()


def looks(status, *times_s, **texts):
    """Yield the readings of a unit that reports all of this at second 100, and the same again at each time."""
    clock = [100.0]
    watch, values = at_rest(clock, STATUS=status, **texts)
    for time_s in times_s:
        clock[0] = max(time_s, 100.0)
        yield watch.read(LinkState(values, time_s))


def test_repeated_telemetry_carries_the_time_of_its_last_repetition():
    for look, time_s in zip(looks(b"0000", 100.0, 101.0, 250.0), (100.0, 101.0, 250.0), strict=True):
        assert (look.time_monotonic_s, look.status_monotonic_s) == (time_s, time_s)
    (alone,) = looks(b"0000", -math.inf)
    assert (alone.time_monotonic_s, alone.status_monotonic_s) == (100.0, 100.0)


def test_an_end_switch_closed_far_from_its_position_is_reported_although_nothing_else_changes():
    first, second = looks(b"%d" % (1 << 19), 100.0, 101.0, A_POSITION=b"200.0")
    assert first.reference_doubt == ""
    assert "low end switch closed although its count is 200" in second.reference_doubt


def test_a_restarted_unit_counts_as_a_lost_link_until_it_is_opened_again():
    watch, values = at_rest([100.0])
    restarted = LinkState(values, 101.0, restarted_s=100.5)
    with pytest.raises(LinkLostError, match="has restarted: it prints its banner"):
        watch.read(restarted)
    watch.start(100.5)
    assert watch.read(restarted).reference_doubt == "the positioner has restarted"


def test_the_position_of_an_axis_stays_known_after_a_restart_has_set_its_count_to_zero():
    watch, values = at_rest([100.0], A_POSITION=b"30.0")
    watch.read(LinkState(values, 100.0))
    _, lost = at_rest([100.0], A_POSITION=b"0.0", STATUS=b"%d" % (1 << RESET_BIT))
    watch.read(LinkState(lost, 100.0))
    assert watch.standing()[0] == pytest.approx(30.0, abs=0.1)


BUTTON = b"%d" % (1 << BUTTON_BIT)


@pytest.mark.parametrize(
    ("before", "after", "doubt", "stands"),
    [
        ({}, {}, "axis A has the count 0, and had 30 when it was seen last", 30.0),
        ({"A_DESTINATION": b"-20.0"}, {"A_DESTINATION": b"-20.0"}, "", 0.0),
        ({}, {"STATUS": BUTTON}, "", 0.0),
    ],
    ids=["told nothing", "on its way", "a button"],
)
def test_a_count_that_changed_during_silence_is_in_doubt_unless_a_move_or_a_button_explains_it(
    before, after, doubt, stands
):
    watch, values = at_rest([100.0], **{"A_POSITION": b"30.0", "A_DESTINATION": b"30.0"} | before)
    watch.read(LinkState(values, 100.0))
    _, lost = at_rest([100.0], **{"A_POSITION": b"0.0"} | after)
    seen = watch.read(LinkState(lost, 100.0, moved_unseen_s=100.0))
    assert seen.reference_doubt.startswith(doubt) if doubt else seen.reference_doubt == ""
    assert watch.standing()[0] == pytest.approx(stands, abs=0.1)


def test_a_jump_of_the_count_is_not_reported_again_once_it_has_been_forgiven():
    watch, values = at_rest([100.0])
    jumped = LinkState(values, 100.0, jumped_s=99.0)
    assert watch.read(jumped).reference_doubt == "the positioner's count has jumped"
    watch.forgive(watch.reference.kinds)
    assert watch.read(jumped._replace(values=dict(values))).reference_doubt == ""


def test_recall_sets_the_position_of_an_axis_only_where_one_is_known():
    now = iter(range(100)).__next__
    positioner = PozsolPositioner(InMemoryStream(PositionerCore(0.0), now), now, A, B)
    assert positioner.standing() == (None, None)
    positioner.recall(50.0, None, "")
    assert positioner.standing() == (50.0, None)


def test_repeated_s_gives_a_time_only_for_the_last_reading_and_only_while_nothing_has_changed():
    watch, values = at_rest([100.0])
    assert watch.repeated_s(None, LinkState(values, 100.0)) is None, "nobody has looked"
    seen = watch.read(LinkState(values, 100.0))
    again = LinkState(values, 101.0)
    assert watch.repeated_s(seen, again) == 101.0
    assert watch.repeated_s(replace(seen), again) is None, "another look"
    assert watch.repeated_s(seen, LinkState(dict(values), 101.0)) is None, "something has come"
    assert watch.repeated_s(seen, LinkState(values, 101.0, jumped_s=100.5)) is None
    assert watch.repeated_s(seen, LinkState(values, 101.0, restarted_s=100.5)) is None
    watch.begin_reference_run("a", seen, 101.0)
    assert watch.repeated_s(watch.read(again), again) is None, "a run ends by time alone"


def test_a_reference_run_trusts_the_starting_count_only_of_an_axis_that_is_not_in_doubt():
    watch, values = at_rest([100.0], A_POSITION=b"30.0", B_POSITION=b"40.0")
    seen = watch.read(LinkState(values, 100.0))
    watch.reference.note("x", "A was turned by hand", "a")
    a, b = (watch.begin_reference_run(axis, seen, 101.0) for axis in ("a", "b"))
    assert (a.start, a.trusted) == (30.0, False)
    assert (b.start, b.trusted) == (40.0, True)
