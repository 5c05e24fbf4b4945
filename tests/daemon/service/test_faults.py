"""What goes wrong in the field, and what the tracker does then."""

import asyncio
import itertools
import logging
import math
from dataclasses import replace
from pathlib import Path

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Decision, Event, Mode, ModeChange, Move, MoveOutcome, Pose, Target
from drivers.errors import DeviceError, DriverHungError, RefusedError
from solar.ephemeris import sun_direction
from solar.frames import normal_from_angles, separation_deg
from tests.support.rig import SITE, HandWeather


def modes(bench):
    return [change.after for change in bench.of(ModeChange)]


async def tracking(bench):
    await bench.until_mode(Mode.TRACKING, 120)


async def under_way(bench):
    """Wait for a move to be well on its way."""
    await tracking(bench)
    await bench.until(lambda: bench.motion.target is not None, 5, "a move")
    await asyncio.sleep(3)
    assert bench.motion.target is not None


async def at_rest(bench):
    await bench.until(lambda: not bench.motion.moving, 300, "rest")


def commands_sent(bench, monkeypatch):
    """Record (time, bytes) of everything that reaches the simulated unit."""
    sent, feed = [], bench.unit.feed
    monkeypatch.setattr(bench.unit, "feed", lambda data, now: (sent.append((now, data)), feed(data, now))[1])
    return sent


# The cube is lost


@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter"])
def test_without_the_cube_the_tracker_follows_the_sun_and_comes_back(run_rig, instrument):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        getattr(bench.cables, instrument).link_up = False
        await bench.until_mode(Mode.FALLBACK, 90)
        assert "no good scan" in bench.control.why
        await asyncio.sleep(700)
        sun = sun_direction(bench.clock.utc(), *SITE)
        assert separation_deg(normal_from_angles(*bench.truth()), sun) < 2.5
        getattr(bench.cables, instrument).link_up = True
        await bench.until_mode(Mode.TRACKING, 90)

    bench = run_rig(scenario)
    assert modes(bench) == [Mode.TRACKING, Mode.FALLBACK, Mode.TRACKING]
    told = [event.text for event in bench.of(Event) if event.subject == "cube"]
    assert len(told) == 2
    assert told[0].startswith("the cube is down")
    assert told[1] == "the cube is back"


@pytest.mark.parametrize("out_s", [1, 70])
@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter", "positioner"])
def test_with_the_default_rhythm_it_tracks_again_within_15_s_of_an_instruments_return(run_rig, instrument, out_s):
    async def scenario(bench):
        await tracking(bench)
        await asyncio.sleep(130)
        device = getattr(bench.cables, instrument)
        # Another instant of the scan each time, and another one of the waits between tries.
        for turn in range(5):
            device.link_up = False
            await asyncio.sleep(out_s + 0.9 * turn)
            device.link_up = True
            await asyncio.sleep(15)
            assert bench.mode is Mode.TRACKING
            assert not (bench.motion if instrument == "positioner" else bench.service.acquisition).outage.is_down
            await asyncio.sleep(130)

    run_rig(scenario)


def test_settings_of_the_unit_that_may_move_it_are_told_once(run_rig, caplog):
    async def scenario(bench):
        read = bench.positioner.read_telemetry

        async def with_setting():
            return replace(await read(), own_moves=("a night position (108=-50.0, 109=off)",))

        bench.positioner.read_telemetry = with_setting
        await tracking(bench)
        await asyncio.sleep(600)

    bench = run_rig(scenario)
    told = "the positioner may move by itself: a night position (108=-50.0, 109=off)"
    assert [event.text for event in bench.of(Event)].count(told) == 1
    assert [record.getMessage() for record in caplog.records].count(told) == 1


@pytest.mark.parametrize(("stuck_at_v", "quality"), [(9.9, "over-range"), (0.4, "implausible")])
def test_one_bad_face_is_named_and_never_steers(run_rig, stuck_at_v, quality):
    async def scenario(bench):
        await tracking(bench)
        bench.scene.break_sensor(2, stuck_at_v)
        await bench.until_mode(Mode.FALLBACK, 90)
        assert f"west {quality}" in bench.control.why

    bench = run_rig(scenario)
    assert all(decision.irradiances.west_w_m2 < 200 for decision in bench.of(Decision) if decision.mode == "tracking")


def test_a_meter_that_repeats_itself_to_the_last_digit_is_stale(run_rig):
    async def scenario(bench):
        await tracking(bench)
        frozen = bench.switch.output_voltage(bench.clock.monotonic())
        bench.voltmeter.read_voltage = lambda: asyncio.sleep(0.04, frozen)
        await bench.until_mode(Mode.FALLBACK, 200)
        assert "stale" in bench.control.why

    run_rig(scenario)


def test_darkness_at_noon_is_a_fault_of_the_cube_and_not_night(run_rig):
    async def scenario(bench):
        await bench.until_mode(Mode.FALLBACK, 300)
        assert "daylight" in bench.control.why

    bench = run_rig(scenario, weather=HandWeather(dni=0, dhi=1))
    assert Mode.NIGHT not in modes(bench)


def test_a_late_reply_is_never_credited_to_another_face(run_rig):
    async def scenario(bench):
        await tracking(bench)
        for _ in range(5):
            await asyncio.sleep(0.9)
            bench.meter.reply_delay_s = 2.5
            await asyncio.sleep(3.0)
            bench.meter.reply_delay_s = 0.0
            await asyncio.sleep(20)

    bench = run_rig(scenario)
    scans = [record for record in bench.records if type(record).__name__ == "Scan"]
    truth = bench.scene.irradiances(bench.clock.utc())
    assert any(not scan.ok for scan in scans), "the delays were felt"
    for scan in scans:
        for reading, true in zip(scan.faces, truth, strict=True):
            if reading.quality == "ok":
                assert reading.irradiance_w_m2 == pytest.approx(true, abs=25)


# The positioner is lost


def test_after_a_reconnection_the_first_word_is_stop_and_the_first_move_a_new_decision(run_rig, monkeypatch):
    async def scenario(bench):
        await under_way(bench)
        bench.cables.positioner.link_up = False
        await bench.until_mode(Mode.FAULT, 15)
        assert "unplugged" in bench.control.why
        await asyncio.sleep(70)
        sent = commands_sent(bench, monkeypatch)
        back = bench.clock.monotonic()
        bench.cables.positioner.link_up = True
        await bench.until_mode(Mode.TRACKING, 15)
        await bench.until(lambda: any(data.startswith(b"$.") for _, data in sent), 400, "a move")
        assert sent[0][1].startswith(b"$9s"), f"the first command was {sent[0]}"
        decision = bench.of(Decision)[-1]
        assert decision.time_monotonic_s > back
        assert decision.moved

    bench = run_rig(scenario)
    assert MoveOutcome.LINK_LOST in [move.outcome for move in bench.of(Move)]
    told = [event.text for event in bench.of(Event) if event.subject == "positioner"]
    assert [text.split(":")[0] for text in told][:2] == ["the positioner is down", "the positioner is back"]


def test_a_lost_reference_waits_for_the_operator_and_homing_restores_it(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        bench.unit.power_cycle(bench.clock.monotonic(), keep_position=False)
        await bench.until_mode(Mode.FAULT, 15)
        before = len(bench.of(Move))
        await asyncio.sleep(1200)
        assert len(bench.of(Move)) == before, "nothing moves without a reference"
        assert "home it" in bench.control.why
        bench.control.home()
        await bench.until_mode(Mode.STARTING, 15)
        await bench.until_mode(Mode.TRACKING, 900)
        await asyncio.sleep(400)
        truth, target = bench.truth(), bench.of(Decision)[-1].target
        assert truth.a_deg == pytest.approx(target.a_deg, abs=1.2)
        assert truth.b_deg == pytest.approx(target.b_deg, abs=1.2)

    run_rig(scenario)


def test_with_rehome_automatic_the_tracker_homes_by_itself(run_rig):
    async def scenario(bench):
        await tracking(bench)
        bench.unit.power_cycle(bench.clock.monotonic(), keep_position=True)
        await bench.until(lambda: bench.motion.homing, 30, "homing")
        await bench.until_mode(Mode.TRACKING, 900)

    run_rig(scenario, motion={"rehome": "automatic"})


def test_overcurrent_in_mid_move_stops_is_named_and_waits_to_be_cleared(run_rig):
    async def scenario(bench):
        await under_way(bench)
        bench.unit.inject("a_overcurrent", bench.clock.monotonic())
        await bench.until_mode(Mode.FAULT, 15)
        assert "a_overcurrent" in bench.control.why
        await asyncio.sleep(60)
        bench.control.clear_faults()
        await bench.until_mode(Mode.TRACKING, 30)

    bench = run_rig(scenario)
    assert bench.of(Move)[0].outcome is MoveOutcome.STALLED


def test_a_silent_refusal_is_noticed_explained_and_tried_again_later(run_rig):
    async def scenario(bench):
        bench.unit.inject("undervoltage", bench.clock.monotonic())
        await bench.until_mode(Mode.FAULT, 120)
        assert "supply" in bench.control.why
        bench.unit.repair("undervoltage", bench.clock.monotonic())
        await bench.until_mode(Mode.TRACKING, 650)
        await bench.until(lambda: bench.of(Move)[-1].outcome == "arrived", 300, "a move that arrives")

    bench = run_rig(scenario)
    assert bench.of(Move)[0].outcome is MoveOutcome.REFUSED


def test_an_axis_that_does_not_move_is_a_stall(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        bench.unit.inject("a_hall_loss", bench.clock.monotonic())
        bench.control.goto(20, 60, "test")
        await bench.until_mode(Mode.FAULT, 60)
        await at_rest(bench)

    bench = run_rig(scenario)
    assert bench.of(Move)[-1].outcome in (MoveOutcome.STALLED, MoveOutcome.REFUSED)


def test_the_units_own_tracking_is_switched_off_before_anything_else(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        bench.unit.inject("own_tracking", bench.clock.monotonic())
        await bench.until(lambda: not bench.motion.telemetry.autonomous, 30, "own tracking off")
        await bench.until_mode(Mode.TRACKING, 60)

    run_rig(scenario)


# Stow, stop, hold


def test_wind_stows_in_mid_move_and_releases_after_its_calm(run_rig):
    async def scenario(bench):
        await under_way(bench)
        bench.wind_m_s = 16.0
        await bench.until_mode(Mode.STOW, 6)
        await asyncio.sleep(180)
        assert bench.truth() == (pytest.approx(0, abs=1), pytest.approx(90, abs=1))
        bench.wind_m_s = 5.0
        await asyncio.sleep(850)
        assert bench.mode is Mode.STOW
        await bench.until_mode(Mode.TRACKING, 120)

    bench = run_rig(scenario, safety={"stow_at_least_s": 900})
    assert bench.of(Move)[0].outcome is MoveOutcome.INTERRUPTED
    assert "16.0 m/s" in next(change.why for change in bench.of(ModeChange) if change.after is Mode.STOW)


def test_stow_ends_a_homing_run_and_leaves_a_doubt(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        bench.control.home()
        await bench.until(lambda: bench.motion.homing, 10, "homing")
        await asyncio.sleep(5)
        bench.control.stow("storm")
        await bench.until_mode(Mode.STOW, 1)
        await bench.until(lambda: not bench.motion.homing, 5, "the end of homing")
        await asyncio.sleep(200)
        assert bench.truth().b_deg == pytest.approx(90, abs=1)
        bench.control.auto()
        await bench.until_mode(Mode.FAULT, 30)
        assert "the reference run of A did not end" in bench.control.why
        bench.control.home()
        await bench.until_mode(Mode.TRACKING, 300)

    run_rig(scenario)


def test_a_wind_sensor_that_falls_silent_stows(run_rig):
    async def scenario(bench):
        await tracking(bench)
        bench.wind_m_s = None
        await asyncio.sleep(250)
        assert bench.mode is Mode.TRACKING
        await bench.until_mode(Mode.STOW, 60)

    run_rig(scenario)


@pytest.mark.parametrize("state", ["idle", "ordering", "moving", "homing", "stowing"])
def test_stop_is_sent_within_200_ms_in_every_state_and_latches(run_rig, monkeypatch, state):
    async def scenario(bench):
        await tracking(bench)
        if state == "idle":
            await at_rest(bench)
        elif state == "ordering":
            await at_rest(bench)
            bench.control.goto(30, 50, "test")
            await asyncio.sleep(0.01)
        elif state == "moving":
            await asyncio.sleep(2)
        elif state == "homing":
            await at_rest(bench)
            bench.control.home()
            await bench.until(lambda: bench.motion.homing, 10, "homing")
            await asyncio.sleep(3)
        else:
            bench.control.stow("test")
            await asyncio.sleep(3)
        sent = commands_sent(bench, monkeypatch)
        asked = bench.clock.monotonic()
        await bench.control.stop("test")
        assert sent[0][1].startswith(b"$9s")
        assert sent[0][0] - asked < 0.2
        await asyncio.sleep(3)
        stands = bench.truth()
        await asyncio.sleep(900)
        assert bench.truth() == stands, "it stays where it was stopped"
        assert bench.mode is Mode.HOLD
        bench.control.auto()
        if state == "homing":
            await bench.until_mode(Mode.FAULT, 10)
            assert "the reference run of A did not end" in bench.control.why
            bench.control.clear_faults()
        await bench.until_mode(Mode.TRACKING, 60)

    run_rig(scenario)


def test_a_goto_from_before_a_fault_is_not_carried_out_after_it(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        bench.control.goto(-40, 30, "test")
        await asyncio.sleep(5)
        bench.cables.positioner.link_up = False
        await bench.until_mode(Mode.FAULT, 15)
        with pytest.raises(RefusedError, match="mode fault"):
            bench.control.goto(10, 60, "test")
        bench.cables.positioner.link_up = True
        await bench.until_mode(Mode.HOLD, 30)
        await asyncio.sleep(3)
        stands = bench.truth()
        await asyncio.sleep(600)
        assert bench.truth() == stands

    run_rig(scenario)


def test_goto_moves_there_and_holds(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        bench.control.goto(-20, 70, "look at the other side")
        await asyncio.sleep(900)
        assert bench.mode is Mode.HOLD
        assert bench.truth() == (pytest.approx(-20, abs=0.9), pytest.approx(70, abs=0.9))

    run_rig(scenario)


@pytest.mark.parametrize("target", [(51, 60), (0, 14.9), (math.nan, 60), (0, math.inf)])
def test_nothing_outside_the_limits_gets_past_any_door(run_rig, target):
    async def scenario(bench):
        await tracking(bench)
        with pytest.raises(ValueError, match=r"limits \(A -50..50 deg, B 15..90 deg\)"):
            bench.control.goto(*target, "test")
        with pytest.raises(ValueError, match="limits"):
            await bench.positioner.move_to(*target)

    run_rig(scenario)


def test_every_way_to_move_goes_through_one_guard(run_rig):
    """R24: in the service the only caller of the positioner's move and home commands is the runner of Motion.

    `heliocube probe` is a command of its own, run while the service is not, and holds to the driver's limits.
    """

    callers = {
        path.name
        for path in Path("daemon").rglob("*.py")
        if not path.name.startswith("probe")
        and any(call in path.read_text() for call in ("positioner.move_to(", "positioner.home("))
    }
    assert callers == {"runs.py"}


def test_before_the_positioner_is_there_every_order_is_refused(run_rig):
    async def scenario(bench):
        await asyncio.sleep(5)

        with pytest.raises(RefusedError, match="cannot move"):
            bench.motion.order(Target(0, 60, "test"))
        with pytest.raises(DeviceError):
            await bench.control.stop("test")

    run_rig(lambda bench: (setattr(bench.cables.positioner, "link_up", False), scenario(bench))[1])


# The clock


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 86400.0, -86400.0])
def test_a_step_of_the_clock_moves_nothing_and_changes_no_rhythm(run_rig, step_s):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        await asyncio.sleep(400)
        await at_rest(bench)
        before = bench.clock.monotonic()
        bench.clock.step_s = step_s
        await asyncio.sleep(590)
        during = [record for record in bench.of(Decision) if record.time_monotonic_s > before]
        gaps = [b.time_monotonic_s - a.time_monotonic_s for a, b in itertools.pairwise(during)]
        assert gaps == pytest.approx([300.0] * len(gaps), abs=0.1)
        assert not [move for move in bench.of(Move) if move.time_monotonic_s > before]

    # An even sky: only the clock could make this tracker move.
    bench = run_rig(scenario, weather=HandWeather(dni=0, dhi=200))
    assert any("the clock was set by" in event.text for event in bench.of(Event))


def test_after_a_step_the_chronometric_law_waits(run_rig):
    async def scenario(bench):
        await tracking(bench)
        await at_rest(bench)
        await asyncio.sleep(10)
        bench.clock.step_s = 7200.0
        moves = len(bench.of(Move))
        await asyncio.sleep(880)
        assert len(bench.of(Move)) == moves
        await asyncio.sleep(400)
        assert len(bench.of(Move)) > moves, "a clock that has settled is believed"

    run_rig(scenario, law={"name": "chronometric"})


# The program itself


@pytest.mark.parametrize("part", ["control", "motion", "acquisition", "watchdog"])
def test_a_part_that_dies_is_named_and_stops_the_service_and_the_axes(run_rig, caplog, part):
    class BrokenError(Exception):
        pass

    def breaking(bench):
        async def die():
            await under_way(bench)
            owner = {
                "control": (bench.control, "tick"),
                "motion": (bench.positioner, "read_telemetry"),
                "acquisition": (bench.multiplexer, "select"),
                "watchdog": (bench.service._watchdog, "_status"),
            }[part]

            def fail(*_args):
                raise BrokenError(part)

            setattr(*owner, fail)
            await asyncio.sleep(60)

        return die()

    benches = []

    def remember(bench):
        benches.append(bench)
        return breaking(bench)

    with pytest.raises(BaseExceptionGroup), caplog.at_level(logging.ERROR):
        run_rig(remember)
    assert f"the task '{part}' died" in caplog.text
    unit = benches[0].unit
    now = benches[0].clock.monotonic()
    assert unit.truth(now + 5) == unit.truth(now + 60), "the axes were stopped"


def test_a_day_without_the_positioner_writes_few_lines(run_rig, caplog):
    async def scenario(bench):
        await tracking(bench)
        bench.cables.positioner.link_up = False
        await asyncio.sleep(24 * 3600)
        bench.cables.positioner.link_up = True
        await asyncio.sleep(60)

    with caplog.at_level(logging.INFO):
        run_rig(scenario, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130, "fallback_after_s": 600})
    lines = [r for r in caplog.records if "positioner" in r.getMessage() and r.levelno >= logging.INFO]
    assert 2 <= len(lines) <= 20


def test_poses_tell_where_the_tracker_truly_stands(run_rig):
    async def scenario(bench):
        await under_way(bench)
        await at_rest(bench)

    bench = run_rig(scenario)
    pose = bench.of(Pose)[-1]
    assert (pose.a_deg, pose.b_deg) == (
        pytest.approx(bench.truth().a_deg, abs=0.06),
        pytest.approx(bench.truth().b_deg, abs=0.06),
    )


@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter", "positioner"])
def test_a_driver_of_which_too_many_calls_never_return_ends_the_service_at_rest_with_one_sentence(run_rig, instrument):
    async def scenario(bench):
        await bench.until(lambda: bench.motion.moving, 200, "a move")

        async def hung():
            raise DriverHungError(instrument, "8 calls of its driver never returned")

        getattr(bench, instrument).open = hung
        getattr(bench.cables, instrument).link_up = False
        ended = "the service ends, and has to be started anew"
        await bench.until(lambda: any(ended in event.text for event in bench.of(Event)), 30, "the end")
        if instrument != "positioner":
            await asyncio.sleep(2)
            before = bench.truth()
            await asyncio.sleep(60)
            assert bench.truth() == before
            assert bench.of(Move)[-1].outcome is MoveOutcome.INTERRUPTED

    with pytest.raises(UserError, match=rf"{instrument}: 8 calls .* never returned: the service ends, and has to be"):
        run_rig(scenario)
