"""The service on a simulated rotator behind a simulated rotctld, in virtual time."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace

import pytest

from daemon.base.records import Event, Mode, Move, MoveOutcome
from daemon.config.file import ConfigError, load_settings
from daemon.rigs.campaign import rig as handled
from daemon.rigs.real import positioner_surroundings
from daemon.rigs.simulated_rotator import build_rotator, rotator_truth
from daemon.service.operator import Operator
from drivers.errors import RefusedError
from drivers.positioners.rotctld import driver
from sim_drivers.transports import InMemoryRotctld
from tests.support import rig as rigs
from tests.support.motion import alarms


class RotatorRig(rigs.ServiceRig):
    """The rig with a rotator in place of the POZSOL unit."""

    def build_driver(self, unit, settings):
        own = settings.instruments.positioner
        self.rotator = build_rotator(settings, own, self.clock)
        self.unit = SimpleNamespace(truth=rotator_truth(self.rotator, settings))
        line = InMemoryRotctld(self.rotator, self.clock.monotonic)
        self.cables.positioners.append(line)
        return driver.build(own, positioner_surroundings(settings, self.clock), line)

    @property
    def operator(self):
        return Operator(self.tracker, 1.0)

    def stands_within(self, a_deg, b_deg):
        return self.truth() == pytest.approx((a_deg, b_deg), abs=0.8)


@pytest.fixture
def run_rotator(run_rig, monkeypatch):
    monkeypatch.setattr(rigs, "ServiceRig", RotatorRig)
    monkeypatch.setattr(handled, "build_unit", lambda *_: None)

    def run(scenario, *, positioner=None, **sections):
        sections["instruments"] = {"positioner": {"driver": "rotctld"} | (positioner or {})}
        return run_rig(scenario, **sections)

    return run


async def until_tracked(rig):
    await rig.until_mode(Mode.TRACKING, 300)
    await rig.until(lambda: rig.records_of(Move), 600, "the end of a move", every_s=0.5)
    assert rig.records_of(Move)[-1].outcome is MoveOutcome.ARRIVED
    target = rig.records_of(Move)[-1]
    assert rig.stands_within(target.target_a_deg, target.target_b_deg)


@pytest.mark.parametrize(
    "positioner",
    [{}, {"azimuth_min_deg": -180.0, "azimuth_max_deg": 450.0}, {"azimuth_min_deg": -180.0, "azimuth_max_deg": 180.0}],
    ids=["its stop in the north", "more than a turn", "its stop in the south"],
)
def test_the_service_tracks_with_a_rotator_of_any_azimuth_range(run_rotator, positioner):
    async def scenario(rig):
        await until_tracked(rig)
        assert rig.motion.identity.simulated
        assert not alarms(rig)

    run_rotator(scenario, positioner=positioner)


def test_a_long_turn_of_the_rotator_around_its_azimuth_stop_arrives_and_raises_no_alarm(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        for a_deg in (5.0, -5.0):
            await rig.operator.goto(a_deg, 45.0, "look")
            await rig.until(lambda wanted=a_deg: rig.stands_within(wanted, 45.0), 150, "the turn", every_s=0.5)
        await rig.until(lambda: rig.records_of(Move)[-1].target_a_deg == -5.0, 30, "the end of the move")
        assert rig.records_of(Move)[-1].outcome is MoveOutcome.ARRIVED
        # 346 deg of azimuth, at 6 deg/s.
        assert 55.0 < rig.records_of(Move)[-1].duration_s < 70.0
        assert not alarms(rig)

    run_rotator(scenario, positioner={"azimuth_min_deg": -180.0, "azimuth_max_deg": 180.0})


def test_a_rotator_resting_just_beyond_one_azimuth_end_is_not_taken_to_be_at_the_other_end(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        await rig.operator.goto(0.0, 45.0, "look")
        await rig.until(lambda: rig.stands_within(0.0, 45.0), 150, "the noon", every_s=0.5)
        await rig.until(lambda: rig.motion.is_idle, 30, "rest")
        await asyncio.sleep(15.0)
        rig.rotator.turn(180.1, 45.0, rig.clock.monotonic())
        await asyncio.sleep(5.0)
        assert not alarms(rig)
        rig.rotator.faults.add("stopless")
        await rig.operator.stop("enough")
        await asyncio.sleep(5.0)
        assert rig.rotator.position(rig.clock.monotonic())[0] == pytest.approx(180.0, abs=0.2)
        assert rig.motion.unexplained_motion is None

    run_rotator(scenario, positioner={"azimuth_min_deg": -180.0, "azimuth_max_deg": 180.0})


def test_strong_wind_stows_the_rotator_flat_without_turning_its_azimuth(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        azimuth_deg = rig.rotator.position(rig.clock.monotonic())[0]
        rig.wind_m_s = 25.0
        await rig.until_mode(Mode.STOW, 10)
        await rig.until(lambda: rig.stands_within(0.0, 90.0), 30, "the stow")
        assert rig.rotator.position(rig.clock.monotonic())[0] == pytest.approx(azimuth_deg, abs=0.02)

    run_rotator(scenario)


def test_a_person_s_stop_ends_a_move_at_once_and_only_auto_ends_the_stop(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        await rig.operator.goto(45.0, 80.0, "look")
        await rig.until(lambda: rig.motion.moving, 20, "the move")
        await asyncio.sleep(1.0)
        await rig.operator.stop("enough")
        stopped = rig.truth()
        await asyncio.sleep(400.0)
        assert rig.truth() == pytest.approx(stopped, abs=0.05)
        assert rig.mode is Mode.HOLD
        with pytest.raises(RefusedError):
            rig.motion.home()
        await rig.operator.auto("go on")
        await rig.until(lambda: rig.truth() != pytest.approx(stopped, abs=1.0), 400, "tracking again", every_s=0.5)

    run_rotator(scenario)


@pytest.mark.parametrize("how", ["cable", "hangs", "gone"])
def test_a_rotator_lost_in_mid_move_is_stopped_when_it_is_back_and_gets_a_new_target(run_rotator, how):
    def lose(rig, lost):
        if how == "cable":
            rig.cables.positioner.link_up = not lost
        elif how == "hangs":
            rig.cables.positioner.frozen = lost
        else:
            (rig.rotator.faults.add if lost else rig.rotator.faults.discard)("gone")

    async def scenario(rig):
        await until_tracked(rig)
        await rig.operator.goto(45.0, 80.0, "look")
        await rig.until(lambda: rig.motion.moving, 20, "the move")
        await asyncio.sleep(1.0)
        lose(rig, True)
        await rig.until(lambda: not rig.motion.connected, 10, "the loss")
        if how == "gone":
            assert "no connection to the rotator (RPRT -6): look at the rotator and its cable, then restart" in (
                rig.motion.outage.reason
            )
        moves, stops = len(rig.records_of(Move)), rig.rotator.received["stop"]
        # A rotator goes on to its last target even without its client.
        await asyncio.sleep(30.0)
        assert rig.stands_within(45.0, 80.0)
        rig.rotator.turn(150.0, 45.0, rig.clock.monotonic())
        lose(rig, False)
        await rig.until(lambda: rig.motion.connected and rig.motion.stands_since_s, 120, "the return")
        assert rig.rotator.received["stop"] > stops
        assert len(rig.records_of(Move)) == moves
        await rig.operator.auto("go on")
        await rig.until(lambda: rig.records_of(Move)[moves:], 400, "a move of today", every_s=0.5)
        assert rig.records_of(Move)[-1].outcome is MoveOutcome.ARRIVED
        assert not alarms(rig)

    run_rotator(scenario)


def test_a_move_ordered_by_another_rotctld_client_is_stopped_reported_and_ends_in_fault(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        await rig.until(lambda: rig.motion.is_idle, 30, "rest")
        rig.rotator.turn(100.0, 20.0, rig.clock.monotonic())
        await rig.until(lambda: "unexplained-motion" in alarms(rig), 20, "the alarm")
        assert "azimuth moved from" in alarms(rig)["unexplained-motion"]
        assert rig.rotator.destination() == pytest.approx(rig.rotator.position(rig.clock.monotonic()))
        await rig.until_mode(Mode.FAULT, 10)

    run_rotator(scenario)


def test_a_rotator_that_accepts_orders_without_moving_is_detected_by_its_position(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        rig.rotator.faults.add("deaf")
        rig.wind_m_s = 25.0
        await rig.until(lambda: "move-failed" in alarms(rig), 60, "the alarm", every_s=0.5)
        assert "no movement for" in alarms(rig)["move-failed"]
        rig.rotator.faults.discard("deaf")
        await rig.until(lambda: rig.stands_within(0.0, 90.0), 120, "the next try", every_s=0.5)

    run_rotator(scenario)


def test_a_rotator_that_does_not_obey_a_stop_raises_the_deaf_to_stop_alarm(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        await rig.operator.goto(45.0, 80.0, "look")
        await rig.until(lambda: rig.motion.moving, 20, "the move")
        rig.rotator.rotator_range = rigs_slow(rig.rotator.rotator_range)
        rig.rotator.turn(260.0, 20.0, rig.clock.monotonic())
        rig.rotator.faults.add("deaf")
        await rig.operator.stop("enough")
        await rig.until(lambda: "deaf-to-stop" in alarms(rig), 30, "the alarm", every_s=0.5)

    run_rotator(scenario)


def rigs_slow(turns):
    return type(turns)(
        azimuth_min_deg=turns.azimuth_min_deg,
        azimuth_max_deg=turns.azimuth_max_deg,
        elevation_min_deg=turns.elevation_min_deg,
        elevation_max_deg=turns.elevation_max_deg,
        speed_deg_per_s=0.8,
    )


def test_a_rotator_without_a_stop_command_is_stopped_by_a_target_at_its_own_position(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        rig.rotator.faults.add("stopless")
        await rig.operator.goto(45.0, 80.0, "look")
        await rig.until(lambda: rig.motion.moving, 20, "the move")
        await asyncio.sleep(1.0)
        await rig.operator.stop("enough")
        stopped = rig.truth()
        await asyncio.sleep(60.0)
        assert rig.truth() == pytest.approx(stopped, abs=0.5)
        assert not rig.stands_within(45.0, 80.0)

    run_rotator(scenario)


def test_a_rotator_that_cannot_reach_the_stow_position_is_never_moved_and_an_alarm_says_why(run_rotator):
    async def scenario(rig):
        # No range is set, so rotctld's own counts; wanting to stow changes nothing.
        await rig.until_mode(Mode.FAULT, 30)
        sentence = alarms(rig)["positioner-setup"]
        assert sentence.startswith("the stow position A 0, B 90 deg lies at azimuth ")
        assert "the rotator turns azimuth 0 to 360 and elevation 0 to 70 deg" in sentence
        rig.wind_m_s = 25.0
        await asyncio.sleep(400.0)
        assert rig.mode is Mode.FAULT
        assert not rig.records_of(Move)
        assert "set_pos" not in rig.rotator.received

    build = build_rotator

    def narrow(settings, own, clock):
        return build(settings, own.model_copy(update={"elevation_max_deg": 70.0}), clock)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{__name__}.build_rotator", narrow)
        run_rotator(scenario)


def test_a_target_beyond_the_reach_of_the_rotator_is_reported_as_a_failed_move(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        await rig.operator.goto(0.0, 20.0, "look")
        await rig.until(lambda: "move-failed" in alarms(rig), 60, "the alarm", every_s=0.5)
        assert "lies at azimuth 180.0, elevation 20.0 deg, but the rotator turns" in alarms(rig)["move-failed"]
        assert rig.rotator.position(rig.clock.monotonic())[1] > 25.0

    run_rotator(scenario, positioner={"elevation_min_deg": 25.0}, safety={"snow_b_deg": 30.0})


def test_a_rotator_that_reports_whole_degrees_raises_no_alarm_of_motion_or_stall(run_rotator):
    async def scenario(rig):
        rig.rotator.step_deg = 1.0
        await until_tracked(rig)
        for number in range(600):
            # The count flickers between two degrees.
            await asyncio.sleep(1.0)
            if not rig.motion.moving:
                azimuth_deg, elevation_deg = rig.rotator.position(rig.clock.monotonic())
                shake_deg = 0.6 * (-1) ** number
                rig.rotator.turn(azimuth_deg + shake_deg, elevation_deg, rig.clock.monotonic())
        assert not alarms(rig)

    run_rotator(scenario, positioner={"resolution_deg": 1.0}, motion={"tolerance_deg": 2.0})


def test_a_rotator_found_elsewhere_after_a_lost_link_waits_for_a_person_to_clear_it(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        await rig.until(lambda: rig.motion.is_idle, 30, "rest")
        await asyncio.sleep(15.0)
        rig.cables.positioner.link_up = False
        await asyncio.sleep(5.0)
        rig.rotator.turn(100.0, 45.0, rig.clock.monotonic())
        await asyncio.sleep(60.0)
        rig.cables.positioner.link_up = True
        await rig.until(lambda: "reference" in alarms(rig), 120, "the doubt", every_s=0.5)
        assert "before the loss it stood at" in alarms(rig)["reference"]
        assert alarms(rig)["reference"].endswith(": compare the angles with the arms, then clear it")
        with pytest.raises(RefusedError, match="has no reference run: compare its angles"):
            rig.motion.home()
        rig.motion.clear_faults()
        await rig.until_mode(Mode.TRACKING, 60)
        assert not [event for event in rig.records_of(Event) if event.text == "homing"]

    run_rotator(scenario)


def test_the_alarm_for_a_jump_of_the_rotators_position_names_a_remedy_without_a_reference_run(run_rotator):
    async def scenario(rig):
        await until_tracked(rig)
        await rig.until(lambda: rig.motion.is_idle, 30, "rest")
        rig.rotator.rotator_range = replace(rig.rotator.rotator_range, speed_deg_per_s=1e4)
        rig.rotator.turn(10.0, 45.0, rig.clock.monotonic())
        await rig.until(lambda: "reference" in alarms(rig), 120, "the doubt", every_s=0.5)
        remedy = "compare the angles with where the tracker points, then clear it"
        assert alarms(rig)["reference"].endswith(f"the reference may be lost: {remedy}")

    run_rotator(scenario)


@pytest.mark.parametrize("is_turned", [False, True])
def test_a_rotator_lost_in_mid_move_is_in_doubt_only_when_found_off_the_path_of_its_move(run_rotator, is_turned):
    async def scenario(rig):
        await until_tracked(rig)
        await rig.operator.goto(45.0, 80.0, "look")
        await rig.until(lambda: rig.motion.moving, 20, "the move")
        await asyncio.sleep(5.0)
        rig.cables.positioner.link_up = False
        if is_turned:
            rig.rotator.turn(100.0, 45.0, rig.clock.monotonic())
        await asyncio.sleep(60.0)
        rig.cables.positioner.link_up = True
        await rig.until(lambda: rig.motion.connected, 60, "the link", every_s=0.5)
        await asyncio.sleep(5.0)
        doubt = alarms(rig).get("reference", "")
        assert ("the move during which the link was lost does not lead there" in doubt) is is_turned, doubt

    run_rotator(scenario)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("elevation_max_deg = 60.0", "safety.night_b_deg = 90.0 (default): lies at azimuth"),
        ("azimuth_min_deg = 90.0\nazimuth_max_deg = 10.0", "azimuth_min_deg = 90.0: must be below azimuth_max_deg"),
        ("server = '127.0.0.1'", 'server = "127.0.0.1": must be a host and a port'),
        ("resolution_deg = 0.0", "resolution_deg = 0.0: must be"),
        ("modell = 1", "there is no such key; did you mean instruments.positioner.model?"),
    ],
)
def test_a_mistake_in_the_rotator_settings_is_refused_with_a_clear_sentence(tmp_path, text, sentence):
    file = tmp_path / "heliocube.toml"
    file.write_text(f"[instruments.positioner]\ndriver = 'rotctld'\n{text}\n")
    with pytest.raises(ConfigError) as caught:
        load_settings(file)
    assert sentence in str(caught.value)
