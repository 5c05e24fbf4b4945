"""Whether the watch sees each promise broken, and never one that is kept, on a scripted truth."""

import pytest

from daemon.base.records import Event, FaceReading, Mode, ModeChange, Quality, Scan
from daemon.rigs.campaign.faults import FORGED_W_M2
from daemon.studies.campaign.watch.active_orders import AxisCount
from tests.daemon.studies.campaign.watch.scripted import promises


def reports(plant):
    return [found.promise for found in plant.watch.violations if found.promise in ("unreported", "false-alarm")]


def test_the_watch_accepts_a_move_that_was_ordered_and_taken(plant):
    plant.order(10, 60)
    plant.wait(12, a=10)
    plant.motion.target = None
    plant.wait(5)
    assert promises(plant) == []


@pytest.mark.parametrize("lasts_s", [1.5, 4.0])
def test_motion_without_an_order_is_unexplained_after_2_s(plant, lasts_s):
    plant.wait(lasts_s, a=lasts_s)
    plant.wait(5)
    assert promises(plant) == (["unexplained-motion"] if lasts_s > 2 else [])


def test_motion_away_from_the_target_is_unexplained(plant):
    plant.order(10, 60)
    plant.wait(5, a=-5)
    assert promises(plant) == ["unexplained-motion"]


def test_an_axis_that_drives_on_when_the_service_has_given_up_is_unexplained(plant):
    plant.order(40, 60)
    plant.wait(5, a=5)
    plant.motion.target = None
    plant.wait(5, a=5)
    assert promises(plant) == ["unexplained-motion"]


def test_motion_to_a_destination_that_the_positioner_has_set_itself_is_unexplained(plant):
    plant.order(40, 60)
    plant.wait(2, a=2)
    plant.destination["a"] = 300.0
    plant.wait(4, a=4)
    assert promises(plant) == ["unexplained-motion"]


def test_motion_to_a_target_that_was_never_confirmed_is_unexplained(plant):
    plant.order(10, 60, taken=False)
    plant.wait(4, a=4)
    assert promises(plant) == ["unexplained-motion"]


@pytest.mark.parametrize("lasts_s", [2.5, 8.0])
def test_an_axis_may_run_out_after_a_stop_for_3_s(plant, lasts_s):
    plant.order(40, 60)
    plant.wait(2, a=2)
    plant.sends_stop()
    plant.wait(lasts_s, a=lasts_s)
    assert promises(plant) == (["unexplained-motion"] if lasts_s > 5 else [])


def test_a_reference_run_is_explained_as_long_as_the_service_says_that_it_is_on(plant):
    plant.watch.note_homing("a")
    plant.sends_stop()
    plant.watch.note_packet(b"$95\r", plant.now_s)
    plant.motion.homing = True
    plant.wait(30, a=-30)
    assert promises(plant) == []
    plant.motion.homing = False
    plant.wait(5, a=-5)
    assert promises(plant) == ["unexplained-motion"]


def test_motion_is_explained_while_a_person_holds_the_buttons_and_not_afterwards(plant):
    plant.watch.active_orders.note_button(is_held=True, now_s=plant.now_s)
    plant.watch.note_stop_request()
    plant.wait(20, a=20)
    assert promises(plant) == []
    plant.watch.active_orders.note_button(is_held=False, now_s=plant.now_s)
    plant.wait(8, a=8)
    assert set(promises(plant)) == {"unexplained-motion", "moves-under-stop"}


@pytest.mark.parametrize("lost", ["unplugged", "deaf", "no service"])
def test_motion_that_cannot_be_stopped_breaks_no_promise_until_it_can_be_stopped(plant, lost):
    if lost == "unplugged":
        plant.plugged = False
    elif lost == "deaf":
        plant.watch.note_deafness(is_deaf=True)
    else:
        plant.is_served = False
    plant.wait(60, a=30)
    assert promises(plant) == []
    plant.plugged = plant.is_served = True
    plant.watch.note_deafness(is_deaf=False)
    plant.wait(20, a=10)
    assert promises(plant) == ["unexplained-motion"]


@pytest.mark.parametrize("latch", ["stop", "maintenance"])
@pytest.mark.parametrize("lasts_s", [0.6, 1.2])
def test_the_watch_notices_motion_later_than_700_ms_after_a_stop_or_maintenance(plant, latch, lasts_s):
    plant.order(40, 60)
    plant.wait(2, a=2)
    plant.watch.note_stop_request() if latch == "stop" else plant.watch.note_maintenance_start()
    plant.sends_stop()
    plant.wait(lasts_s, a=lasts_s)
    plant.wait(3)
    assert promises(plant) == ([f"moves-under-{latch}"] if lasts_s > 0.85 else [])
    if latch == "stop":
        assert plant.watch.stop_latencies_s == [pytest.approx(lasts_s + 0.1, abs=0.02)]


def test_a_move_that_the_positioner_begins_by_itself_under_a_stop_may_last_2_s(plant):
    plant.watch.note_stop_request()
    plant.wait(5)
    plant.watch.note_self_motion()
    plant.wait(1.8, a=1)
    plant.wait(5)
    assert promises(plant) == []
    plant.watch.note_self_motion()
    plant.wait(3, a=1)
    assert "moves-under-stop" in promises(plant)


def test_the_watch_notices_a_target_under_a_stop_before_anything_moves(plant):
    plant.watch.note_stop_request()
    plant.wait(5)
    plant.order(10, 60)
    assert promises(plant) == ["moves-under-stop"]
    plant.watch.note_stop_release()


@pytest.mark.parametrize(("to_deg", "count_off"), [(50.01, 0.0), (50.1, 0.0), (50.2, 5.0)])
def test_the_watch_notices_an_order_that_truly_drives_beyond_a_limit_unless_the_count_is_wrong(
    plant, to_deg, count_off
):
    plant.at["a"] = 45.0
    plant.wait(10)
    plant.watch.violations.clear()
    plant.count_off = count_off
    plant.order(60, 60)
    plant.wait(6, a=to_deg - 45)
    assert promises(plant) == (["limits"] if to_deg > 50.02 and not count_off else [])


def test_the_watch_notices_a_second_target_while_one_is_being_sent(plant):
    with plant.watch.sending((1, 60)), plant.watch.sending((2, 60)):
        pass
    assert promises(plant) == ["two-targets"]


def test_the_watch_notices_a_target_while_an_axis_still_moves(plant):
    plant.order(40, 60)
    plant.wait(2, a=2)
    plant.order(-40, 60)
    assert promises(plant) == ["two-targets"]


@pytest.mark.parametrize("excused", [False, True])
def test_the_watch_notices_a_wrong_count_that_the_service_does_not_doubt(plant, excused):
    plant.count_off = 5.0
    plant.watch.count_check.excused = excused
    plant.wait(60)
    assert promises(plant) == ([] if excused else ["believes-a-wrong-count"])
    plant.watch.violations.clear()
    plant.motion.doubt = "it restarted"
    plant.wait(60)
    assert promises(plant) == []


def test_the_watch_notices_a_tracker_that_tracks_in_a_storm(plant):
    plant.wind_m_s = 25.0
    plant.wait(10)
    assert promises(plant) == []
    plant.wait(5)
    assert promises(plant) == ["storm"]


@pytest.mark.parametrize("mode", [Mode.TRACKING, Mode.STOW, Mode.HOLD])
def test_the_watch_notices_a_tracker_that_goes_on_tracking_after_a_gust(plant, mode):
    plant.control.mode = mode
    plant.watch.note_gust()
    plant.wait(70)
    assert set(promises(plant)) == ({"storm"} if mode is Mode.TRACKING else set())


def test_the_watch_notices_a_move_on_old_readings(plant):
    plant.control.state.scan_age_s = 20.0
    plant.order(1, 60)
    assert promises(plant) == ["stale"]


@pytest.mark.parametrize("told", ["nothing", "an alarm", "a fault", "another mode"])
@pytest.mark.parametrize("turned_deg", [0.2, 1.5])
def test_the_watch_notices_a_turn_without_an_order_that_the_service_does_not_report(plant, turned_deg, told):
    plant.wait(1.5, a=turned_deg)
    if told == "an alarm":
        plant.records.append(Event(0.0, plant.now_s, "alarm", "A moved"))
    elif told != "nothing":
        after = Mode.FAULT if told == "a fault" else Mode.HOLD
        plant.records.append(ModeChange(0.0, plant.now_s, Mode.TRACKING, after, "why"))
    plant.wait(20)
    assert reports(plant) == (["unreported"] if turned_deg > 0.5 and told in ("nothing", "another mode") else [])


def test_small_turns_a_minute_apart_are_not_added_up_to_a_turn_that_must_be_reported(plant):
    for _ in range(4):
        plant.wait(0.4, a=0.3)
        plant.wait(60)
    assert reports(plant) == []


@pytest.mark.parametrize("cause", [False, True])
def test_the_watch_notices_an_alarm_of_motion_that_never_happened(plant, cause):
    if cause:
        plant.watch.note_disturbance()
    plant.motion.unexplained_motion = "A moved from 3 to 4 degrees without an order"
    plant.wait(5)
    assert reports(plant) == ([] if cause else ["false-alarm"])


def test_motion_while_no_service_ran_justifies_an_alarm_later(plant):
    plant.is_served = False
    plant.wait(3, a=3.0)
    plant.is_served = True
    plant.motion.unexplained_motion = "A moved from 0 to 3 degrees without an order"
    plant.wait(5)
    assert reports(plant) == []


@pytest.mark.parametrize("excused", [False, True])
def test_the_watch_notices_a_storm_that_does_not_end_in_the_stow_position(plant, excused):
    plant.control.mode, plant.wind_m_s = Mode.STOW, 25.0
    plant.watch.active_faults = 2 if excused else 1
    plant.wait(500)
    assert promises(plant) == ([] if excused else ["stow"] * len(promises(plant)))
    assert bool(promises(plant)) is not excused
    plant.watch.violations.clear()
    plant.at = {"a": 0.0, "b": 90.0}
    plant.watch.note_disturbance()
    plant.wait(500)
    assert promises(plant) == []


@pytest.mark.parametrize(
    ("value", "quality", "broken"),
    [
        (500.0, Quality.OK, []),
        (FORGED_W_M2, Quality.OK, ["forged"]),
        (9000.0, Quality.OK, ["implausible"]),
        (float("nan"), Quality.OK, ["implausible"]),
        (9000.0, Quality.OVER_RANGE, []),
    ],
)
def test_the_watch_notices_a_scan_with_forged_or_implausible_readings_marked_as_good(plant, value, quality, broken):
    face = FaceReading(irradiance_w_m2=value, quality=quality, time_utc_s=0.0, time_monotonic_s=0.0)
    scan = Scan(
        source="cube",
        session="1",
        sequence=1,
        time_utc_s=0.0,
        time_monotonic_s=0.0,
        east=face,
        south=face,
        west=face,
        zenith=face,
    )
    plant.watch.note_scan(scan)
    assert promises(plant) == broken


@pytest.mark.parametrize(("lowered", "broken"), [("a", []), ("", ["unexplained-motion"])])
def test_motion_of_an_axis_is_explained_only_in_the_direction_in_which_its_count_has_to_go(plant, lowered, broken):
    plant.lowered = lowered
    plant.order(30.0, 60.0)
    plant.destination["a"] = -150.0
    plant.watch.active_orders.confirm(
        *(AxisCount(*plant.position_and_destination(axis, 0.0), plant.per_deg) for axis in "ab")
    )
    plant.wait(8.0, a=8.0)
    assert promises(plant) == broken


@pytest.mark.parametrize("per_deg", [5.0, 60.0, 300.0])
@pytest.mark.parametrize(("left_deg", "broken"), [(0.7, []), (1.9, ["unexplained-motion"])])
def test_the_rest_of_a_move_is_measured_with_the_count_of_the_positioner_for_a_degree(plant, per_deg, left_deg, broken):
    plant.per_deg = per_deg
    plant.order(10, 60)
    plant.wait(9.0, a=10.0 - left_deg)
    plant.motion.target = None
    plant.wait(2.8, a=0.5)
    plant.wait(2.0)
    assert promises(plant) == broken


def test_motion_of_a_positioner_that_is_not_heard_breaks_no_promise(plant):
    plant.is_silent = True
    plant.watch.note_link_change()
    plant.wait(60, a=30)
    assert promises(plant) == []


def test_an_alarm_of_motion_with_a_wrong_count_is_not_a_false_alarm(plant):
    plant.count_off = 5.0
    plant.watch.count_check.excused = True
    plant.wait(60)
    plant.wait(1.0, a=0.3)
    plant.motion.unexplained_motion = "A moved from 3.0 to 3.3 degrees without an order"
    plant.wait(5)
    assert reports(plant) == []


def test_the_watch_checks_a_move_under_way_closely_a_few_times_and_not_ten_times_a_second(plant):
    plant.order(40, 60)
    plant.wait(1, a=1)
    before = plant.close_looks
    plant.wait(20, a=20)
    assert 2 <= plant.close_looks - before <= 20
    plant.wait(24, a=24)
    assert promises(plant) == ["unexplained-motion"]


def test_the_watch_notices_a_reference_run_that_goes_on_over_2_s_after_the_service_has_ended_it(plant):
    plant.watch.note_packet(b"$95\r", plant.now_s)
    plant.motion.homing = True
    plant.wait(20, a=-20)
    plant.motion.homing = False
    plant.wait(2.1, a=-2.1)
    assert promises(plant) == []
    plant.wait(0.2, a=-0.2)
    assert promises(plant) == ["unexplained-motion"]


def test_an_alarm_of_motion_in_the_middle_of_an_ordered_move_is_a_false_alarm(plant):
    plant.order(40, 60)
    plant.wait(32, a=16)
    plant.motion.unexplained_motion = "A has moved"
    plant.wait(0.1, a=0.05)
    assert reports(plant) == ["false-alarm"]


def test_the_time_to_stow_in_a_storm_that_begins_in_mid_move_counts_from_its_beginning(plant):
    plant.order(40, 60)
    plant.wait(12, a=6)
    plant.wind_m_s = 20.0
    plant.wait(10.9, a=5)
    assert promises(plant) == []
    plant.wait(0.3, a=0.15)
    assert promises(plant) == ["storm"]


def test_the_watch_notices_a_limit_that_is_passed_between_two_close_checks_of_a_move(plant):
    plant.order(60, 60)
    plant.wait(49, a=49)
    before = plant.close_looks
    plant.wait(0.8, a=0.8)
    assert plant.close_looks > before
    plant.wait(0.4, a=0.4)
    assert promises(plant) == ["limits"]
