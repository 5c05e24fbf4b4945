"""Without a self-test: a face that cannot be true is found by day, told, not used, and used again once it agrees."""

import re
from datetime import datetime

import numpy as np
import pytest

from daemon.base.records import FACES
from daemon.config.sections import CubeSettings
from daemon.cube.face_watch import face_normals
from solar.frames import FACE_NORMALS
from tests.support.watched_day import WatchedDay

MORNING_UTC_S = 1655283600.0  # 2022-06-15 09:00
DECEMBER_UTC_S = MORNING_UTC_S - 180 * 86400.0


@pytest.mark.parametrize(("face", "at_w_m2"), [(0, 90.0), (0, 300.0), (1, 120.0), (1, 450.0), (3, 250.0), (3, 600.0)])
def test_a_frozen_face_is_found_within_the_hour_and_used_again_when_it_follows_the_light(face, at_w_m2):
    # The sun leaves the east face at noon; the south face is judged while the sun reaches another face for hours.
    day = WatchedDay(MORNING_UTC_S + {0: -3600.0, 1: 9000.0, 3: 0.0}[face])
    assert day.minutes(40) == [None] * 4
    found = day.minutes(60, frozen=face, at_w_m2=at_w_m2)
    assert found[face] is not None
    assert [minutes for other, minutes in enumerate(found) if other != face] == [None] * 3
    (alarm,) = day.alarms.active
    assert "the same while the light changes on the others" in alarm.text
    day.minutes(20, frozen=face, at_w_m2=at_w_m2)
    assert day.implausible_faces() == [face], "nothing forgives a face that stays"
    day.minutes(60)
    assert day.implausible_faces() == []


@pytest.mark.parametrize("start_utc_s", [MORNING_UTC_S - 5 * 3600, 1671602400.0])
def test_no_face_of_a_sound_cube_is_doubted_on_a_day_of_passing_clouds(start_utc_s):
    assert WatchedDay(start_utc_s).minutes(16 * 60) == [None] * 4


def test_after_a_sleep_of_the_machine_no_face_is_judged_by_the_light_before_it():
    day = WatchedDay(MORNING_UTC_S)
    day.minutes(10)
    day.sleep(10 * 3600.0)
    assert day.minutes(10) == [None] * 4


@pytest.mark.parametrize(("at_w_m2", "found"), [(1800.0, True), (1200.0, False)])
def test_a_face_that_reads_more_than_sun_and_sky_can_give_is_found_within_minutes(at_w_m2, found):
    day = WatchedDay(MORNING_UTC_S)
    day.minutes(10)
    minutes = day.minutes(15, frozen=3, at_w_m2=at_w_m2)
    assert [each is not None for each in minutes] == [False, False, False, found]
    assert ["more than sun and sky can give" in alarm.text for alarm in day.alarms.active] == [True] * found


def test_a_face_is_doubted_at_the_third_look_at_five_minutes_and_cleared_after_ten_looks_that_agree():
    day = WatchedDay(MORNING_UTC_S)
    assert day.minutes(7, frozen=3, at_w_m2=1800.0) == [None, None, None, 6.75]
    day.minutes(9)
    assert day.implausible_faces() == [3]
    day.minutes(6)
    assert day.implausible_faces() == []


def test_a_face_that_is_found_wrong_again_within_a_day_has_to_agree_for_twice_as_long():
    # With the east face at azimuth 60 deg the comparison over half an hour is off; it would have to agree as well.
    day = WatchedDay(MORNING_UTC_S, east=CubeSettings().east.model_copy(update={"azimuth_deg": 60.0}))
    agreed = []
    for gap_hours in (0, 0, 0, 25):
        day.clock.utc_s += 3600.0 * gap_hours
        day.minutes(12, frozen=3, at_w_m2=1800.0)
        agreed.append(0)
        while day.implausible_faces():
            day.minutes(1)
            agreed[-1] += 1
    assert np.diff(agreed).tolist() == pytest.approx([10, 20, -30], abs=1)


@pytest.mark.parametrize("face", [1, 3])
def test_a_face_at_half_its_gain_is_not_taken_for_a_swap_nor_cleared_by_light_that_would_need_snow(face):
    day = WatchedDay(DECEMBER_UTC_S)
    day.share[face] = 0.5
    doubted = []
    for _ in range(40):
        day.minutes(10)
        doubted.append(day.implausible_faces())
    assert 2 not in map(len, doubted)
    named = doubted.index([face]) if face == 3 else len(doubted)
    assert all(face in faces for faces in doubted[named:])


def test_a_contradicted_face_stays_reported_as_such_while_all_faces_read_the_same():
    day = WatchedDay(MORNING_UTC_S)
    day.share[3] = 0.5
    day.minutes(90)
    for _ in range(40):
        day.clock.utc_s += 15.0
        day.watch.note([50.0] * 4, [5.0] * 4)
    (alarm,) = day.alarms.active
    assert "the zenith face reads what the others and the sun's position contradict" in alarm.text
    assert "the east, south and west faces read the same as another face, in pairs" in alarm.text


def test_looks_that_accuse_a_face_count_only_without_one_that_agrees_between_them():
    day = WatchedDay(MORNING_UTC_S)
    for _ in range(5):
        # After a gap one look sees the first minute only.
        day.clock.utc_s += 600.0
        day.minutes(1, frozen=3, at_w_m2=9000.0)
        assert day.minutes(9) == [None] * 4


def test_the_alarm_names_each_fault_with_the_faces_that_have_it():
    day = WatchedDay(MORNING_UTC_S)
    day.minutes(8, frozen=[1, 3], at_w_m2=[0.0, 1800.0])
    (alarm,) = day.alarms.active
    found, checks = alarm.text.split(", until each agrees with the others again: ")
    assert re.fullmatch(
        r"the south face reads next to nothing while other faces are lit; not used since 2022-06-15 09:0\d UTC;"
        r" the zenith face reads more than sun and sky can give there; not used since 2022-06-15 09:0\d UTC",
        found,
    )
    assert len(found) < 255, "all that Home Assistant shows of a text"
    south, zenith = checks.split("; ")
    assert south == "check sensor, cable and multiplexer input of south"
    assert zenith == "check the gain of zenith, and whether faces are interchanged"


def test_two_faces_with_the_same_fault_are_named_each_with_its_own_time():
    day = WatchedDay(MORNING_UTC_S)
    day.minutes(8, frozen=1, at_w_m2=0.0)
    day.minutes(12, frozen=[1, 2], at_w_m2=0.0)
    (alarm,) = day.alarms.active
    assert re.fullmatch(
        r"the south and west faces read next to nothing while other faces are lit; not used since"
        r" 2022-06-15 09:0\d UTC \(south\) and 2022-06-15 09:1\d UTC \(west\), until each agrees with the others again:"
        r" check sensor, cable and multiplexer input of south and west",
        alarm.text,
    )


@pytest.mark.parametrize(("gap_s", "looks_again"), [(90.0, True), (150.0, False)])
def test_after_a_gap_of_more_than_two_minutes_five_minutes_of_readings_are_gathered_anew(gap_s, looks_again):
    day = WatchedDay(MORNING_UTC_S)
    assert day.minutes(6, frozen=3, at_w_m2=1800.0)[3] is None
    day.clock.utc_s += gap_s
    found = day.minutes(6, frozen=3, at_w_m2=1800.0)[3]
    assert (found < 2.0) == looks_again
    assert found < 6.0, "and the looks of before still count"


def test_a_frozen_face_is_also_found_on_a_cube_that_is_read_once_a_minute():
    day = WatchedDay(MORNING_UTC_S)
    found = day.minutes(90, frozen=3, at_w_m2=250.0, every_s=60.0, late_s=0.02)
    assert [minutes is not None for minutes in found] == [False, False, False, True]
    assert "the same while the light changes on the others" in day.alarms.active[0].text


@pytest.mark.parametrize("latitude_deg", [48.7, 0.0, -0.5, -33.0])
def test_the_south_face_looks_to_the_equator(latitude_deg):
    assert face_normals(CubeSettings(), latitude_deg) == pytest.approx(FACE_NORMALS, abs=1e-12)


def test_faces_are_not_compared_by_the_light_on_a_cube_whose_faces_point_elsewhere():
    east = CubeSettings().east.model_copy(update={"azimuth_deg": 60.0})
    day = WatchedDay(MORNING_UTC_S - 3600.0, east=east)
    day.share = [1.0, 0.3, 1.0, 1.0]
    assert day.minutes(100) == [None] * 4


def test_a_second_doubted_face_raises_the_alarm_again_and_has_its_own_time():
    day = WatchedDay(MORNING_UTC_S)
    first = day.minutes(8, frozen=1, at_w_m2=0.0)[1]
    day.alarms.acknowledge("ana")
    second = day.minutes(8, frozen=[1, 3], at_w_m2=[0.0, 1800.0])[3]
    (alarm,) = day.alarms.active
    assert alarm.state == "raised", "nobody has seen that there are two"
    told = dict(re.findall(r"the (\w+) face reads .*?; not used since ([-0-9]+ [0-9:]+) UTC", alarm.text))
    at = {face: datetime.fromisoformat(text + "Z").timestamp() - MORNING_UTC_S for face, text in told.items()}
    assert at == pytest.approx({"south": first * 60.0, "zenith": (8 + second) * 60.0}, abs=60.0)


def test_a_face_that_is_never_read_is_not_accused():
    day = WatchedDay(MORNING_UTC_S)
    assert day.minutes(40, frozen=1, at_w_m2=np.nan) == [None] * 4
    assert day.alarms.active == ()


def test_swapped_faces_are_both_named_within_the_hour_and_used_again_when_they_are_put_right():
    day = WatchedDay(MORNING_UTC_S - 3600.0)
    day.order = [0, 2, 1, 3]
    found = day.minutes(60)
    assert [minutes is not None for minutes in found] == [False, True, True, False]
    (alarm,) = day.alarms.active
    assert "the south and west faces read each other's light" in alarm.text
    day.minutes(10, frozen=2, at_w_m2=1400.0)
    assert [each.text for each in day.alarms.active] == [alarm.text], "what is too much besides makes it no better"
    day.order = [0, 1, 2, 3]
    day.minutes(60)
    assert day.implausible_faces() == []


def test_passing_clouds_tell_which_of_the_faces_are_swapped_where_the_readings_do_not():
    day = WatchedDay(MORNING_UTC_S)
    day.order = [1, 0, 2, 3]
    day.minutes(60)
    assert day.implausible_faces() == [0, 1]
    (alarm,) = day.alarms.active
    assert "the east and south faces read each other's light" in alarm.text


def test_swapped_faces_are_named_together_although_one_was_left_out_before_the_other():
    day = WatchedDay(MORNING_UTC_S - 3600.0)
    day.order = [2, 1, 0, 3]
    east, _, west, _ = day.minutes(60)
    assert west < east
    (alarm,) = day.alarms.active
    assert "the east and west faces read each other's light; not used since" in alarm.text
    assert alarm.text.endswith(": check whether the cables of east and west are swapped")
    assert len(re.findall(r"[0-9:]{5} UTC", alarm.text)) == 2


@pytest.mark.parametrize("exactly", [False, True])
def test_no_swap_of_faces_is_reported_beside_a_face_that_repeats_itself_to_the_last_digit(exactly):
    day = WatchedDay(MORNING_UTC_S)
    day.order = [0, 3, 2, 1]
    found = day.minutes(60, frozen=2, at_w_m2=200.0, exactly=exactly)
    assert [minutes is not None for minutes in found] == [False, not exactly, False, not exactly]


@pytest.mark.parametrize(("face", "at_w_m2"), [(0, 1350.0), (1, 0.0)])
def test_a_face_that_jumps_for_a_minute_now_and_then_is_named_and_no_other_is(face, at_w_m2):
    day = WatchedDay(DECEMBER_UTC_S)
    day.in_cloud_w_m2 = 750.0
    for _ in range(4):
        # The jump is spread over two minutes, half in each.
        day.minutes(9.5)
        assert set(day.implausible_faces()) <= {face}
        day.minutes(1, frozen=face, at_w_m2=at_w_m2)
    assert day.implausible_faces() == [face]
    (alarm,) = day.alarms.active
    assert f"the {FACES[face]} face reads for a minute now and then what the others do not" in alarm.text
    day.minutes(45)
    assert day.implausible_faces() == []


@pytest.mark.parametrize(("hours", "share"), [(0.0, 0.1), (2.25, 1.0)])
def test_jumps_that_do_not_show_which_face_is_wrong_cast_doubt_on_no_face(hours, share):
    # In dim light jumps are small, and the sun of a winter noon reaches only one other face.
    day = WatchedDay(DECEMBER_UTC_S + 3600.0 * hours)
    day.in_cloud_w_m2 = 750.0
    day.share = [share] * 4
    for _ in range(4):
        day.minutes(9.5)
        day.minutes(1, frozen=1, at_w_m2=0.0)
    assert day.implausible_faces() == []


def test_a_face_that_jumps_most_of_the_time_makes_no_other_face_look_frozen():
    day = WatchedDay(MORNING_UTC_S + 8.0 * 3600.0)
    day.in_cloud_w_m2 = 750.0
    day.share = [0.1] * 4
    day.minutes(30)
    for jumping in (2, 1):
        day.minutes(jumping, frozen=2, at_w_m2=1350.0)
        day.minutes(1)
        assert set(day.implausible_faces()) <= {2}
    day.minutes(20)
    assert set(day.implausible_faces()) <= {2}


def test_a_face_in_a_shade_of_its_own_is_named_and_used_again_when_it_follows_the_light():
    day = WatchedDay(MORNING_UTC_S - 3600.0)
    day.minutes(40)
    day.share = [1.0, 0.3, 1.0, 1.0]
    day.minutes(60)
    assert day.implausible_faces() == [1]
    (alarm,) = day.alarms.active
    assert "the south face reads what the others and the sun's position contradict" in alarm.text
    assert alarm.text.endswith(": check south for shade, dirt, reflections, a stuck sensor or a turned mount")
    day.share = [1.0] * 4
    day.minutes(60)
    assert day.implausible_faces() == []


@pytest.mark.parametrize(("face", "hour"), [(1, 1.0), (0, 0.0), (2, 4.0)])
def test_a_face_that_goes_into_shade_under_a_clear_sky_is_found_and_makes_no_other_look_frozen(face, hour):
    day = WatchedDay(MORNING_UTC_S + 3600.0 * hour)
    day.in_cloud_w_m2 = 750.0
    day.minutes(40)
    day.share[face] = 0.1
    found = day.minutes(60)
    assert [each is not None for each in found] == [each == face for each in range(4)]


def test_a_face_that_looked_frozen_is_used_again_once_it_is_known_which_face_was_in_the_shade():
    day = WatchedDay(MORNING_UTC_S + 2.0 * 3600.0)
    day.in_cloud_w_m2 = 750.0
    day.minutes(40)
    day.share[1] = 0.1
    day.minutes(10)
    assert day.implausible_faces() == [3]
    day.minutes(50)
    assert day.implausible_faces() == [1]
    (alarm,) = day.alarms.active
    assert "the south face reads" in alarm.text
    assert "zenith" not in alarm.text


@pytest.mark.parametrize("left", [0.02, 0.3])
def test_a_face_that_comes_out_of_its_shade_has_to_agree_and_makes_no_other_face_look_frozen(left):
    day = WatchedDay(MORNING_UTC_S - 3600.0)
    day.minutes(40)
    day.share = [1.0, left, 1.0, 1.0]
    day.minutes(60)
    assert day.implausible_faces() == [1]
    day.share = [1.0] * 4
    day.minutes(25)
    assert day.implausible_faces() == [1], "to leave the shade at once is a change, and no agreement of half an hour"
    day.minutes(50)
    assert day.implausible_faces() == []
    day.share = [1.0, left, 1.0, 1.0]
    day.minutes(60)
    assert day.implausible_faces() == [1]


@pytest.mark.parametrize("hours", [9.0, -12.0, -3.0, 2.0 / 3.0])
def test_no_face_is_doubted_while_the_clock_is_set_wrong_for_hours(hours):
    day = WatchedDay(MORNING_UTC_S - 3600.0)
    assert day.minutes(40) == [None] * 4
    day.clock.off_s = hours * 3600.0
    assert day.minutes(4 * 60) == [None] * 4
    day.clock.off_s = 0.0
    assert day.minutes(60) == [None] * 4


def test_faces_doubted_because_of_a_wrong_clock_are_used_again_once_it_is_synchronised():
    day = WatchedDay(MORNING_UTC_S, off_s=-4 * 3600.0)
    day.minutes(60)
    assert day.implausible_faces()
    day.clock.off_s = 0.0
    day.minutes(60)
    assert day.implausible_faces(), "nothing confirms the new time"
    day.synchronised = True
    day.minutes(2)
    assert day.implausible_faces() == []
    assert day.minutes(60) == [None] * 4
    assert day.alarms.active == ()
    assert day.minutes(15, frozen=3, at_w_m2=1800.0)[3] is not None


@pytest.mark.parametrize(("face", "at_w_m2", "is_seen"), [(3, 0.0, True), (3, 250.0, True), (2, 1800.0, False)])
def test_after_a_restart_an_acknowledged_face_raises_no_new_alarm_and_another_face_does(
    tmp_path, face, at_w_m2, is_seen
):
    for hour, frozen in enumerate((3, face)):
        day = WatchedDay(MORNING_UTC_S + 3600.0 * hour, directory=tmp_path)
        assert day.minutes(59, frozen=frozen, at_w_m2=at_w_m2)[frozen] is not None
        assert day.alarms.acknowledge("ana") == (() if hour and is_seen else ("cube-face",))


def test_no_face_is_used_while_no_light_explains_the_four_until_they_agree():
    day = WatchedDay(MORNING_UTC_S)
    day.in_cloud_w_m2 = 750.0
    day.order = [1, 0, 2, 3]
    day.minutes(60)
    assert day.implausible_faces() == [0, 1, 2, 3]
    (alarm,) = day.alarms.active
    assert "what no light explains" in alarm.text
    day.order = [0, 1, 2, 3]
    day.minutes(60)
    assert day.implausible_faces() == []


def test_of_faces_that_no_light_explains_the_frozen_one_is_named_and_the_others_are_used_again():
    day = WatchedDay(MORNING_UTC_S - 3 * 3600.0)
    day.minutes(150, frozen=1, at_w_m2=400.0)
    assert day.implausible_faces() == [0, 1, 2, 3], "until the sun has reached the south face"
    day.minutes(40, frozen=1, at_w_m2=400.0)
    assert day.implausible_faces() == [1]
    (alarm,) = day.alarms.active
    assert "the same while the light changes on the others" in alarm.text


def test_a_dead_face_is_not_used_again_because_the_day_has_grown_too_dark_to_tell():
    day = WatchedDay(MORNING_UTC_S)
    day.minutes(8, frozen=1, at_w_m2=0.0)
    day.share = [0.02] * 4
    day.minutes(20, frozen=1, at_w_m2=0.0)
    assert day.implausible_faces() == [1], "darkness is no agreement"


def test_a_face_stuck_at_a_level_is_named_in_the_night():
    day = WatchedDay(MORNING_UTC_S + 14 * 3600.0)
    found = day.minutes(15, frozen=1, at_w_m2=200.0)
    assert [minutes is not None for minutes in found] == [False, True, False, False]
    (alarm,) = day.alarms.active
    assert "the south face reads light in the night while the others are dark" in alarm.text
    day.minutes(30)
    assert day.implausible_faces() == [1], "darkness is no agreement"
