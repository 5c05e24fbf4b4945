"""What the tracker has gained today, by the light on the faces."""

import asyncio
import json
import math

import numpy as np
import pytest

from daemon.base.records import FaceReading, Mode, Pose, Quality, Scan
from daemon.base.state import StateFolder
from daemon.base.timeloop import VirtualTimeLoop
from daemon.received.today import ReceivedToday
from daemon.service.recent import RecentRecords
from daemon.service.state import state_json
from daemon.tracker.phase import Phase
from solar.ephemeris import Site, sun_direction
from solar.frames import Limits, angles_within
from tests.support.rig import SITE, ManualWeather

# 14 October 2022, 11:00 UTC.
NOON_S = 1665745200.0
FLAT = (0.0, 90.0)
DAY_S = 86400


def today(tmp_path=None, utc_s=NOON_S):
    return ReceivedToday(Site(*SITE), Limits(), lambda: 0.2, StateFolder(tmp_path), utc_s)


def scan(at_s, light, bad=()):
    faces = [
        FaceReading(value, Quality.MISSING if number in bad else Quality.OK, NOON_S + at_s, at_s)
        for number, value in enumerate(light)
    ]
    return Scan("cube", "s", int(at_s), NOON_S + at_s, at_s, *faces, simulated=True)


def feed(counted, light, seconds, begin_s=0.0, where=FLAT, bad=()):
    """Hand in a scan every 5 s; `where` is None or the tracker's angles."""
    for at_s in np.arange(begin_s, begin_s + seconds + 1.0, 5.0):
        pose = None if where is None else Pose(NOON_S + at_s, at_s, *where, moving=False)
        counted.add(scan(at_s, light, bad), pose, NOON_S + at_s)
    return counted.today


def even(diffuse_w_m2):
    """Return what the faces read under a uniform sky over ground of albedo 0.2."""
    vertical = diffuse_w_m2 * (0.5 + 0.2 * 0.5)
    return (vertical, vertical, vertical, diffuse_w_m2)


def test_under_a_uniform_sky_lying_flat_receives_most_and_pointing_at_the_sun_less():
    found = feed(today(), even(200.0), 3600)
    to_sun = sun_direction(NOON_S + 1800, *SITE)
    a_deg, b_deg = angles_within(to_sun, Limits())
    up = math.cos(math.radians(a_deg)) * math.sin(math.radians(b_deg))
    ratio = 1.0 / ((1.0 + up) / 2.0 + 0.2 * (1.0 - up) / 2.0)
    assert found.known_s == 3600
    assert found.since_utc_s == NOON_S
    assert found.actual_kwh_m2 == pytest.approx(0.2, rel=1e-3)
    assert found.best_kwh_m2 == pytest.approx(found.actual_kwh_m2, rel=1e-3)
    assert found.gain == pytest.approx(ratio - 1.0, rel=0.02)
    assert found.gain > 0.15


def test_scans_without_a_known_pose_or_with_two_faces_missing_are_not_counted():
    counted = today()
    assert feed(counted, even(200.0), 600, where=None).known_s == 0.0
    assert feed(counted, even(200.0), 600, begin_s=605, bad=(0, 1)).known_s == 0.0
    assert math.isnan(counted.today.gain)
    assert feed(counted, even(200.0), 600, begin_s=1210).since_utc_s == pytest.approx(NOON_S + 1205, abs=6)


def test_a_gap_between_scans_is_not_counted():
    counted = today()
    feed(counted, even(200.0), 600)
    assert feed(counted, even(200.0), 600, begin_s=4000).known_s == 1200


def test_scans_once_a_minute_are_counted_even_when_slightly_late_or_early():
    counted = today()
    for number, off_s in enumerate([0.0, 0.02, -0.01, 0.0, 0.01] * 6):
        at_s = 60.0 * number + off_s
        counted.add(scan(at_s, even(200.0)), Pose(NOON_S + at_s, at_s, *FLAT, moving=False), NOON_S + at_s)
    assert counted.today.known_s == pytest.approx(29 * 60.0, abs=61.0)


def test_the_energy_received_today_outlives_a_restart_and_starts_anew_with_the_solar_day(tmp_path):
    folder = StateFolder(tmp_path)
    before = feed(today(tmp_path), even(200.0), 3600)
    again = ReceivedToday(Site(*SITE), Limits(), lambda: 0.2, folder, NOON_S + 3700)
    assert again.today == before
    assert feed(again, even(200.0), 600, begin_s=3700.0).known_s == 4200
    assert feed(again, even(200.0), 600, begin_s=float(DAY_S)).known_s == 600


def test_each_of_many_trackers_saves_the_ended_day_at_its_own_time_and_not_at_the_scan(tmp_path):
    """If all trackers booked at one scan, 500 of them would hold up the loop for half a second."""
    wait_s = 60.0 * 5 / 10

    def kept():
        return json.loads((tmp_path / "received.json").read_text())["known_s"] if any(tmp_path.iterdir()) else 0

    async def scenario():
        counted = ReceivedToday(
            Site(*SITE), Limits(), lambda: 0.2, StateFolder(tmp_path), NOON_S, Phase(place=5, trackers=10)
        )
        feed(counted, even(200.0), 600)
        for at_s in np.arange(605.0, 1205.0, 5.0):
            counted.add(scan(at_s, even(200.0)), Pose(NOON_S + at_s, at_s, *FLAT, moving=False), NOON_S + at_s)
        at_s = float(DAY_S)
        counted.add(scan(at_s, even(200.0)), None, NOON_S + at_s)
        assert (counted.today_without_pending.known_s, kept()) == (0, 0), (
            "the scan that ends the day does not wait for the booking"
        )
        await asyncio.sleep(wait_s - 1)
        assert kept() == 0
        await asyncio.sleep(2)
        assert kept() == 1200
        assert counted.today.known_s == 0

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        runner.run(scenario())


# No calendar goes as far as the second time: it could be kept and never be shown.
@pytest.mark.parametrize("more", ['"known_s": -3', '"known_s": 3, "since_utc_s": 1e18'])
def test_an_unusable_received_json_is_logged_and_counting_starts_from_zero(tmp_path, caplog, more):
    (tmp_path / "received.json").write_text(f'{{"day": 1, {more}}}')
    assert today(tmp_path).today.known_s == 0.0
    assert "counted from zero again" in caplog.text


@pytest.mark.parametrize(("law", "least", "most"), [("chronometric", -0.01, 0.005), ("flat", -0.9, -0.1)])
def test_the_state_shows_the_gain_over_chronometric_from_the_readings_of_the_faces(run_rig, law, least, most):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        await rig.until(lambda: rig.service.trackers[0].received.today.known_s >= 3000, 4000, "most of an hour")
        found = state_json(rig.take_snapshot(RecentRecords()))["received"]
        assert least < found["gain"] < most
        assert found["chronometric_kwh_m2"] == pytest.approx(found["known_s"] / 3.6e6 * 780.0, rel=0.03)
        assert found["actual_kwh_m2"] <= found["best_kwh_m2"]

    fewer = {"cube": {"scan_every_s": 20}, "safety": {"scan_stale_s": 65}}
    run_rig(scenario, law={"name": law}, weather=ManualWeather(dni=700, dhi=90), **fewer)


def test_energy_received_on_another_day_is_not_shown_as_of_today_before_the_first_scan(run_rig, tmp_path):
    yesterday = {"day": 19_000, "since_utc_s": 19_000.4 * DAY_S, "known_s": 3600.0, "actual_kwh_m2": 0.7}
    for name in ("received.json", "shadow-flat-received.json"):
        (tmp_path / name).write_text(json.dumps(yesterday))

    async def scenario(rig):
        assert rig.control.state.scan is None
        found = state_json(rig.take_snapshot(RecentRecords()))
        assert (found["received"], found["shadow"]["received"]) == (None, None)

    run_rig(scenario, law={"name": "chronometric", "shadow": "flat"}, store={"directory": tmp_path})
