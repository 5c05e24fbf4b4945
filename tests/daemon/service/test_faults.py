"""What goes wrong in the field, and what the tracker does then."""

import asyncio
import itertools
import logging
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from daemon.base.errors import UserError
from daemon.base.records import Decision, Event, Mode, ModeChange, Move, MoveOutcome, Pose, Target
from drivers.errors import DeviceError, DriverHungError, RefusedError
from solar.ephemeris import sun_direction
from solar.frames import normal_from_angles, separation_deg
from tests.support.rig import SITE, HandWeather


def modes(rig):
    return [change.after for change in rig.of(ModeChange)]


async def tracking(rig):
    await rig.until_mode(Mode.TRACKING, 120)


async def under_way(rig):
    """Wait for a move to be well on its way."""
    await tracking(rig)
    await rig.until(lambda: rig.motion.target is not None, 5, "a move")
    await asyncio.sleep(3)
    assert rig.motion.target is not None


async def at_rest(rig):
    await rig.until(lambda: not rig.motion.moving, 300, "rest")


def commands_sent(rig, monkeypatch):
    """Record (time, bytes) of everything that reaches the simulated unit."""
    sent, feed = [], rig.unit.feed
    monkeypatch.setattr(rig.unit, "feed", lambda data, now: (sent.append((now, data)), feed(data, now))[1])
    return sent


# The cube is lost


@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter"])
def test_without_the_cube_the_tracker_follows_the_sun_and_comes_back(run_rig, instrument):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        getattr(rig.cables, instrument).link_up = False
        await rig.until_mode(Mode.FALLBACK, 90)
        assert "no good scan" in rig.control.why
        await asyncio.sleep(700)
        sun = sun_direction(rig.clock.utc(), *SITE)
        assert separation_deg(normal_from_angles(*rig.truth()), sun) < 2.5
        getattr(rig.cables, instrument).link_up = True
        await rig.until_mode(Mode.TRACKING, 90)

    rig = run_rig(scenario)
    assert modes(rig) == [Mode.TRACKING, Mode.FALLBACK, Mode.TRACKING]
    told = [event.text for event in rig.of(Event) if event.subject == "cube"]
    assert len(told) == 2
    assert told[0].startswith("the cube is down")
    assert told[1] == "the cube is back"


@pytest.mark.parametrize(("silence_s", "moves"), [(150, 0), (285, 0), (420, 1)])
def test_a_short_gap_is_not_worth_a_swing_to_the_sun(run_rig, silence_s, moves):
    async def scenario(rig):
        await tracking(rig)
        await asyncio.sleep(900)
        await at_rest(rig)
        before = len(rig.of(Move))
        rig.cables.voltmeter.link_up = False
        await asyncio.sleep(silence_s)
        assert rig.mode is Mode.FALLBACK
        rig.cables.voltmeter.link_up = True
        await rig.until_mode(Mode.TRACKING, 60)
        swung = [move for move in rig.of(Move)[before:] if move.target_b_deg < 75]
        assert len(swung) == moves

    run_rig(scenario, law={"driver": "optimal"}, weather=HandWeather(dni=0, dhi=150), start="2022-12-21T11:00")


def test_the_reason_for_fallback_names_what_the_bridge_refuses_and_says_so_no_more_afterwards(run_rig):
    async def scenario(rig):
        await tracking(rig)
        sender = rig.service.sender
        key, sender._key = sender._key, bytes(32)
        await rig.until_mode(Mode.FALLBACK, 90)
        change = rig.of(ModeChange)[-1]
        assert re.search(r"no good scan for \d+ s; the bridge refused \d+ forged since; the latest is", change.why)
        assert change.why.endswith("was not signed with this receiver's key: give both sides the same key file")
        assert rig.control.state.why.startswith("no good scan")
        sender._key = key
        await rig.until_mode(Mode.TRACKING, 90)
        rig.cables.voltmeter.link_up = False
        await rig.until_mode(Mode.FALLBACK, 90)
        assert "refused" not in rig.control.why

    run_rig(scenario)


@pytest.mark.parametrize("out_s", [1, 70])
@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter", "positioner"])
def test_with_the_default_rhythm_it_tracks_again_within_15_s_of_an_instruments_return(run_rig, instrument, out_s):
    async def scenario(rig):
        await tracking(rig)
        await asyncio.sleep(130)
        device = getattr(rig.cables, instrument)
        # Another instant of the scan each time, and another one of the waits between tries.
        for turn in range(5):
            device.link_up = False
            await asyncio.sleep(out_s + 0.9 * turn)
            device.link_up = True
            await asyncio.sleep(15)
            assert rig.mode is Mode.TRACKING
            assert not (rig.motion if instrument == "positioner" else rig.service.acquisition).outage.is_down
            await asyncio.sleep(130)

    run_rig(scenario)


def test_settings_of_the_unit_that_may_move_it_are_told_once(run_rig, caplog):
    async def scenario(rig):
        read = rig.positioner.read_telemetry

        async def with_setting():
            return replace(await read(), own_moves=("a night position (108=-50.0, 109=off)",))

        rig.positioner.read_telemetry = with_setting
        await tracking(rig)
        await asyncio.sleep(600)

    rig = run_rig(scenario)
    told = "the positioner may move by itself: a night position (108=-50.0, 109=off)"
    assert [event.text for event in rig.of(Event)].count(told) == 1
    assert [record.getMessage() for record in caplog.records].count(told) == 1


@pytest.mark.parametrize(("stuck_at_v", "quality"), [(9.9, "over-range"), (0.4, "implausible")])
def test_one_bad_face_is_named_and_never_steers(run_rig, stuck_at_v, quality):
    async def scenario(rig):
        await tracking(rig)
        rig.scene.break_sensor(2, stuck_at_v)
        await rig.until_mode(Mode.FALLBACK, 90)
        assert f"west {quality}" in rig.control.why

    rig = run_rig(scenario)
    assert all(decision.irradiances.west_w_m2 < 200 for decision in rig.of(Decision) if decision.mode == "tracking")


def test_a_meter_that_repeats_itself_to_the_last_digit_is_stale(run_rig):
    async def scenario(rig):
        await tracking(rig)
        frozen = rig.switch.output_voltage(rig.clock.monotonic())
        rig.voltmeter.read_voltage = lambda: asyncio.sleep(0.04, frozen)
        await rig.until_mode(Mode.FALLBACK, 200)
        assert "stale" in rig.control.why

    run_rig(scenario)


def test_darkness_at_noon_is_a_fault_of_the_cube_and_not_night(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.FALLBACK, 300)
        assert "daylight" in rig.control.why

    rig = run_rig(scenario, weather=HandWeather(dni=0, dhi=1))
    assert Mode.NIGHT not in modes(rig)


def test_a_late_reply_is_never_credited_to_another_face(run_rig):
    async def scenario(rig):
        await tracking(rig)
        for _ in range(5):
            await asyncio.sleep(0.9)
            rig.meter.reply_delay_s = 2.5
            await asyncio.sleep(3.0)
            rig.meter.reply_delay_s = 0.0
            await asyncio.sleep(20)

    rig = run_rig(scenario)
    scans = [record for record in rig.records if type(record).__name__ == "Scan"]
    truth = rig.scene.irradiances(rig.clock.utc())
    assert any(not scan.ok for scan in scans), "the delays were felt"
    for scan in scans:
        for reading, true in zip(scan.faces, truth, strict=True):
            if reading.quality == "ok":
                assert reading.irradiance_w_m2 == pytest.approx(true, abs=25)


# The positioner is lost


def test_after_a_reconnection_the_first_word_is_stop_and_the_first_move_a_new_decision(run_rig, monkeypatch):
    async def scenario(rig):
        await under_way(rig)
        rig.cables.positioner.link_up = False
        await rig.until_mode(Mode.FAULT, 15)
        assert "unplugged" in rig.control.why
        await asyncio.sleep(70)
        sent = commands_sent(rig, monkeypatch)
        back = rig.clock.monotonic()
        rig.cables.positioner.link_up = True
        await rig.until_mode(Mode.TRACKING, 15)
        await rig.until(lambda: any(data.startswith(b"$.") for _, data in sent), 400, "a move")
        assert sent[0][1].startswith(b"$9s"), f"the first command was {sent[0]}"
        decision = rig.of(Decision)[-1]
        assert decision.time_monotonic_s > back
        assert decision.moved

    rig = run_rig(scenario)
    assert MoveOutcome.LINK_LOST in [move.outcome for move in rig.of(Move)]
    told = [event.text for event in rig.of(Event) if event.subject == "positioner"]
    assert [text.split(":")[0] for text in told][:2] == ["the positioner is down", "the positioner is back"]


def test_a_lost_reference_waits_for_the_operator_and_homing_restores_it(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        rig.unit.power_cycle(rig.clock.monotonic(), keep_position=False)
        await rig.until_mode(Mode.FAULT, 15)
        before = len(rig.of(Move))
        await asyncio.sleep(1200)
        assert len(rig.of(Move)) == before, "nothing moves without a reference"
        assert "home it" in rig.control.why
        rig.control.home()
        await rig.until_mode(Mode.STARTING, 15)
        await rig.until_mode(Mode.TRACKING, 900)
        await asyncio.sleep(400)
        truth, target = rig.truth(), rig.of(Decision)[-1].target
        assert truth.a_deg == pytest.approx(target.a_deg, abs=1.2)
        assert truth.b_deg == pytest.approx(target.b_deg, abs=1.2)

    run_rig(scenario)


def test_with_rehome_automatic_the_tracker_homes_by_itself(run_rig):
    async def scenario(rig):
        await tracking(rig)
        rig.unit.power_cycle(rig.clock.monotonic(), keep_position=True)
        await rig.until(lambda: rig.motion.homing, 30, "homing")
        await rig.until_mode(Mode.TRACKING, 900)

    run_rig(scenario, motion={"rehome": "automatic"})


def test_overcurrent_in_mid_move_stops_is_named_and_waits_to_be_cleared(run_rig):
    async def scenario(rig):
        await under_way(rig)
        rig.unit.inject("a_overcurrent", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 15)
        assert "a_overcurrent" in rig.control.why
        await asyncio.sleep(60)
        rig.control.clear_faults()
        await rig.until_mode(Mode.TRACKING, 30)

    rig = run_rig(scenario)
    assert rig.of(Move)[0].outcome is MoveOutcome.STALLED


def test_a_silent_refusal_is_noticed_explained_and_tried_again_later(run_rig):
    async def scenario(rig):
        rig.unit.inject("undervoltage", rig.clock.monotonic())
        await rig.until_mode(Mode.FAULT, 120)
        assert "supply" in rig.control.why
        rig.unit.repair("undervoltage", rig.clock.monotonic())
        await rig.until_mode(Mode.TRACKING, 650)
        await rig.until(lambda: rig.of(Move)[-1].outcome == "arrived", 300, "a move that arrives")

    rig = run_rig(scenario)
    assert rig.of(Move)[0].outcome is MoveOutcome.REFUSED


def test_an_axis_that_does_not_move_is_a_stall(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        rig.unit.inject("a_hall_loss", rig.clock.monotonic())
        rig.control.goto(20, 60, "test")
        await rig.until_mode(Mode.FAULT, 60)
        await at_rest(rig)

    rig = run_rig(scenario)
    assert rig.of(Move)[-1].outcome in (MoveOutcome.STALLED, MoveOutcome.REFUSED)


def test_the_units_own_tracking_is_switched_off_before_anything_else(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        rig.unit.inject("own_tracking", rig.clock.monotonic())
        await rig.until(lambda: not rig.motion.telemetry.autonomous, 30, "own tracking off")
        await rig.until_mode(Mode.TRACKING, 60)

    run_rig(scenario)


# Stow, stop, hold


def test_wind_stows_in_mid_move_and_releases_after_its_calm(run_rig):
    async def scenario(rig):
        await under_way(rig)
        rig.wind_m_s = 16.0
        await rig.until_mode(Mode.STOW, 6)
        await asyncio.sleep(180)
        assert rig.truth() == (pytest.approx(0, abs=1), pytest.approx(90, abs=1))
        rig.wind_m_s = 5.0
        await asyncio.sleep(850)
        assert rig.mode is Mode.STOW
        await rig.until_mode(Mode.TRACKING, 120)

    rig = run_rig(scenario, safety={"stow_at_least_s": 900})
    assert rig.of(Move)[0].outcome is MoveOutcome.INTERRUPTED
    assert "16.0 m/s" in next(change.why for change in rig.of(ModeChange) if change.after is Mode.STOW)


def test_stow_ends_a_homing_run_and_leaves_a_doubt(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
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


def test_a_wind_sensor_that_falls_silent_stows(run_rig):
    async def scenario(rig):
        await tracking(rig)
        rig.wind_m_s = None
        await asyncio.sleep(250)
        assert rig.mode is Mode.TRACKING
        await rig.until_mode(Mode.STOW, 60)

    run_rig(scenario)


@pytest.mark.parametrize("state", ["idle", "ordering", "moving", "homing", "stowing"])
def test_stop_is_sent_within_200_ms_in_every_state_and_latches(run_rig, monkeypatch, state):
    async def scenario(rig):
        await tracking(rig)
        if state == "idle":
            await at_rest(rig)
        elif state == "ordering":
            await at_rest(rig)
            rig.control.goto(30, 50, "test")
            await asyncio.sleep(0.01)
        elif state == "moving":
            await asyncio.sleep(2)
        elif state == "homing":
            await at_rest(rig)
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
        await tracking(rig)
        await at_rest(rig)
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


def test_goto_moves_there_and_holds(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        rig.control.goto(-20, 70, "look at the other side")
        await asyncio.sleep(900)
        assert rig.mode is Mode.HOLD
        assert rig.truth() == (pytest.approx(-20, abs=0.9), pytest.approx(70, abs=0.9))

    run_rig(scenario)


@pytest.mark.parametrize("target", [(51, 60), (0, 14.9), (math.nan, 60), (0, math.inf)])
def test_nothing_outside_the_limits_gets_past_any_door(run_rig, target):
    async def scenario(rig):
        await tracking(rig)
        with pytest.raises(ValueError, match=r"limits \(A -50..50 deg, B 15..90 deg\)"):
            rig.control.goto(*target, "test")
        with pytest.raises(ValueError, match="limits"):
            await rig.positioner.move_to(*target)

    run_rig(scenario)


def test_every_way_to_move_goes_through_one_guard(run_rig):
    """R24: in the service the only caller of the positioner's move and home commands is the runner of Motion.

    `heliocube probe` and `heliocube setup` are commands of their own, run while the service is not, and hold to the
    driver's limits.
    """

    callers = {
        path.as_posix()
        for path in Path("daemon").rglob("*.py")
        if not path.name.startswith("probe")
        and any(call in path.read_text() for call in ("positioner.move_to(", "positioner.home("))
    }
    assert callers == {"daemon/motion/runs.py", "daemon/commands/setup/first_move.py"}


def test_before_the_positioner_is_there_every_order_is_refused(run_rig):
    async def scenario(rig):
        await asyncio.sleep(5)

        with pytest.raises(RefusedError, match="cannot move"):
            rig.motion.order(Target(0, 60, "test"))
        with pytest.raises(DeviceError):
            await rig.control.stop("test")

    run_rig(lambda rig: (setattr(rig.cables.positioner, "link_up", False), scenario(rig))[1])


# The clock


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 86400.0, -86400.0])
def test_a_step_of_the_clock_moves_nothing_and_changes_no_rhythm(run_rig, step_s):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        await asyncio.sleep(400)
        await at_rest(rig)
        before = rig.clock.monotonic()
        rig.clock.step_s = step_s
        await asyncio.sleep(590)
        during = [record for record in rig.of(Decision) if record.time_monotonic_s > before]
        gaps = [b.time_monotonic_s - a.time_monotonic_s for a, b in itertools.pairwise(during)]
        assert gaps == pytest.approx([300.0] * len(gaps), abs=0.1)
        assert not [move for move in rig.of(Move) if move.time_monotonic_s > before]

    # An even sky: only the clock could make this tracker move.
    rig = run_rig(scenario, weather=HandWeather(dni=0, dhi=200))
    assert any("the clock was set by" in event.text for event in rig.of(Event))


def test_after_a_step_the_chronometric_law_waits(run_rig):
    async def scenario(rig):
        await tracking(rig)
        await at_rest(rig)
        await asyncio.sleep(10)
        rig.clock.step_s = 7200.0
        moves = len(rig.of(Move))
        await asyncio.sleep(880)
        assert len(rig.of(Move)) == moves
        await asyncio.sleep(400)
        assert len(rig.of(Move)) > moves, "a clock that has settled is believed"

    run_rig(scenario, law={"name": "chronometric"})


# The program itself


@pytest.mark.parametrize("part", ["control", "motion", "acquisition", "watchdog"])
def test_a_part_that_dies_is_named_and_stops_the_service_and_the_axes(run_rig, caplog, part):
    class BrokenError(Exception):
        pass

    def breaking(rig):
        async def die():
            await under_way(rig)
            owner = {
                "control": (rig.control, "tick"),
                "motion": (rig.positioner, "read_telemetry"),
                "acquisition": (rig.multiplexer, "select"),
                "watchdog": (rig.service._watchdog, "_status"),
            }[part]

            def fail(*_args):
                raise BrokenError(part)

            setattr(*owner, fail)
            await asyncio.sleep(60)

        return die()

    rigs = []

    def remember(rig):
        rigs.append(rig)
        return breaking(rig)

    with pytest.raises(BaseExceptionGroup), caplog.at_level(logging.ERROR):
        run_rig(remember)
    assert f"the task '{part}' died" in caplog.text
    unit = rigs[0].unit
    now = rigs[0].clock.monotonic()
    assert unit.truth(now + 5) == unit.truth(now + 60), "the axes were stopped"


def test_half_a_day_without_the_positioner_writes_few_lines(run_rig, caplog):
    async def scenario(rig):
        await tracking(rig)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(13 * 3600)
        rig.cables.positioner.link_up = True
        await asyncio.sleep(60)

    with caplog.at_level(logging.INFO):
        run_rig(scenario, cube={"scan_every_s": 60}, safety={"scan_stale_s": 130, "fallback_after_s": 600})
    lines = [r for r in caplog.records if "positioner" in r.getMessage() and r.levelno >= logging.INFO]
    assert 2 <= len(lines) <= 20


def test_poses_tell_where_the_tracker_truly_stands(run_rig):
    async def scenario(rig):
        await under_way(rig)
        await at_rest(rig)

    rig = run_rig(scenario)
    pose = rig.of(Pose)[-1]
    assert (pose.a_deg, pose.b_deg) == (
        pytest.approx(rig.truth().a_deg, abs=0.06),
        pytest.approx(rig.truth().b_deg, abs=0.06),
    )


@pytest.mark.parametrize("instrument", ["multiplexer", "voltmeter", "positioner"])
def test_a_driver_of_which_too_many_calls_never_return_ends_the_service_at_rest_with_one_sentence(run_rig, instrument):
    async def scenario(rig):
        await rig.until(lambda: rig.motion.moving, 200, "a move")

        async def hung():
            raise DriverHungError(instrument, "8 calls of its driver never returned")

        getattr(rig, instrument).open = hung
        getattr(rig.cables, instrument).link_up = False
        ended = "the service ends, and has to be started anew"
        await rig.until(lambda: any(ended in event.text for event in rig.of(Event)), 30, "the end")
        if instrument != "positioner":
            await asyncio.sleep(2)
            before = rig.truth()
            await asyncio.sleep(60)
            assert rig.truth() == before
            assert rig.of(Move)[-1].outcome is MoveOutcome.INTERRUPTED

    with pytest.raises(UserError, match=rf"{instrument}: 8 calls .* never returned: the service ends, and has to be"):
        run_rig(scenario)
