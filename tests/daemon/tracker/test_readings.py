"""Whether the scans are good enough, for what, and whether it is night."""

import math

import pytest

from daemon.base.records import FaceReading, Quality, Scan
from daemon.config.settings import Settings
from daemon.tracker.modes import Data
from daemon.tracker.readings import Readings
from solar.ephemeris import Site
from solar.frames import Limits
from solar.laws.law import DirectionLaw, TrackerFacts


class SetClock:
    now = 1000.0

    def monotonic(self):
        return self.now

    def utc(self):
        return self.now + 1.7e9


class FourFacesLaw(DirectionLaw):
    """A law that says nothing about faces, as anybody may write one."""

    def direction(self, _now, to_sun):
        """Return the way to the sun."""
        return to_sun


FOUR_FACES = FourFacesLaw(TrackerFacts(Site(48.7, 2.2, 156.0), Limits(), 5.0, 300.0, 0.0))


class Rig:
    """Readings under a sun that a test sets; a scan every 5 s."""

    def __init__(self, law=FOUR_FACES):
        self.clock = SetClock()
        self.sun_deg = 30.0
        self.readings = Readings(Settings(), self.clock, lambda _utc_s: self.sun_deg, law)

    def scan(self, zenith, bad=(), south=60.0):
        self.clock.now += 5
        faces = [
            FaceReading(math.nan if name in bad else value, Quality.LATE if name in bad else Quality.OK, 0.0, self.now)
            for name, value in (("east", 50.0), ("south", south), ("west", 40.0), ("zenith", zenith))
        ]
        self.readings.add(Scan("cube", "s", 0, 0.0, self.now, *faces))

    @property
    def now(self):
        return self.clock.now

    def judge(self, **how):
        return self.readings.judge(self.now, self.readings.mean(self.now), **how)

    def minutes(self, zenith, count=3, **how):
        for _ in range(count * 12):
            self.scan(zenith, **how)
        return self.judge()


class Believing:
    """A law that can do without a face, and that believes the zenith face or not."""

    def __init__(self, believes, faces_needed=3):
        self.believes = believes
        self.faces_needed = faces_needed

    def believes_zenith(self, _faces, _utc_s):
        return self.believes


def test_night_begins_below_one_brightness_and_ends_above_another():
    rig = Rig()
    rig.sun_deg = 2.0
    assert rig.minutes(7.0)[2] is None
    assert rig.minutes(4.0)[2] is not None
    assert rig.minutes(7.0)[2] is not None, "between the thresholds it stays night"
    assert rig.minutes(11.0)[2] is None
    assert rig.minutes(7.0)[2] is None, "and day"


def test_without_readings_the_sun_ends_the_night_half_a_degree_later_than_it_began_it():
    rig = Rig()
    seen = []
    for sun_deg in (0.2, -0.2, 0.2, 0.6, 0.2):
        rig.sun_deg = sun_deg
        seen.append(rig.judge()[2] is not None)
    assert seen == [False, True, True, False, False]


def test_a_bright_zenith_face_with_the_sun_below_the_horizon_is_no_night():
    rig = Rig()
    rig.sun_deg = -3.0
    assert rig.minutes(40.0)[2] is None


def test_a_dark_zenith_face_under_a_high_sun_is_a_fault():
    rig = Rig()
    data, why, night = rig.minutes(2.0)
    assert (data, night) == (Data.BAD, None)
    assert "in daylight" in why


def test_a_dark_sensor_reads_no_minus_zero():
    rig = Rig()
    rig.sun_deg = -10.0
    assert rig.minutes(-0.04)[2] == "the zenith face reads 0.0 W/m2"
    rig.sun_deg = 30.0
    assert "the zenith face reads 0.0 W/m2 in daylight" in rig.minutes(-0.04)[1]


def test_a_dark_zenith_face_beside_a_sunlit_one_is_a_fault_and_no_night():
    rig = Rig()
    rig.sun_deg = 3.0
    data, why, night = rig.minutes(0.0, south=400.0)
    assert (data, night) == (Data.BAD, None)
    assert "in daylight" in why
    rig = Rig(Believing(believes=False))
    rig.sun_deg = 3.0
    assert rig.minutes(0.0, south=400.0)[::2] == (Data.FRESH, None)


@pytest.mark.parametrize("believes", [False, True])
def test_a_law_is_asked_whether_the_zenith_face_is_to_be_believed_only_by_day(believes):
    rig = Rig(Believing(believes))
    assert rig.minutes(2.0)[0] is (Data.BAD if believes else Data.FRESH)
    rig.sun_deg = -1.0
    assert "zenith face reads 2.0" in rig.minutes(2.0)[2], "below the horizon dark is dark"


def test_a_vertical_face_is_sunlit_from_ten_times_the_end_of_night():
    rig = Rig()
    rig.sun_deg = 5.0
    assert "zenith face reads 4.0" in rig.minutes(4.0, south=95.0)[2], "dusk under clouds"
    # A sun at 5 deg on a vertical face gives the zenith face tan 5 deg = 0.087 of that, and half of it is enough.
    assert rig.minutes(4.0, south=105.0)[2] is None


def test_beside_a_sunlit_face_half_of_its_share_is_enough_to_believe_the_zenith_face():
    rig = Rig()
    rig.sun_deg = 1.0
    # 0.5 * 200 W/m2 * tan 1 deg = 1.75 W/m2.
    assert "zenith face reads 2.0" in rig.minutes(2.0, south=200.0)[2]
    assert rig.minutes(1.5, south=200.0)[2] is None


def test_a_missing_face_hides_no_sunlit_one():
    rig = Rig(Believing(believes=True))
    rig.sun_deg = 5.0
    assert rig.minutes(4.0, south=600.0, bad=("east",))[0] is Data.BAD


def test_a_law_that_needs_the_zenith_face_alone_has_its_night():
    rig = Rig(Believing(believes=True, faces_needed=1))
    rig.sun_deg = 5.0
    assert "zenith face reads 4.0" in rig.minutes(4.0, bad=("east", "south", "west"))[2]


@pytest.mark.parametrize("believes", [False, True])
def test_without_the_zenith_face_the_sun_alone_makes_the_night_of_a_law_that_needs_three(believes):
    rig = Rig(Believing(believes))
    rig.sun_deg = 2.0
    assert rig.minutes(9.0, bad=("zenith",))[::2] == (Data.FRESH, None)
    rig.sun_deg = -1.0
    assert "the sun stands at -1.0 deg" in rig.minutes(9.0, bad=("zenith",))[2]


def test_without_the_zenith_face_and_with_the_clock_in_doubt_nothing_tells_day_from_night():
    rig = Rig(Believing(believes=False))
    rig.minutes(9.0, bad=("zenith",))
    data, why, _ = rig.judge(sun_known=False)
    assert (data, why) == (Data.BAD, "neither the zenith face nor the clock shows whether it is day or night")


def test_a_zenith_face_that_is_not_believed_makes_no_night_while_the_sun_is_up():
    rig = Rig(Believing(believes=False))
    rig.sun_deg = 0.5
    assert rig.minutes(2.0)[::2] == (Data.FRESH, None)


def test_a_dark_zenith_face_is_a_fault_for_every_law_while_the_clock_is_in_doubt():
    rig = Rig(Believing(believes=False))
    rig.minutes(2.0)
    assert rig.judge(sun_known=False)[0] is Data.BAD


def test_four_faces_that_are_never_good_in_one_scan_are_no_readings():
    rig = Rig()
    for _ in range(18):
        rig.scan(100.0, bad=("east",))
        rig.scan(100.0, bad=("west",))
    assert rig.readings.mean(rig.now).coverage > 0.9
    assert rig.judge()[0] is Data.BAD


def test_a_scan_of_which_a_face_is_bad_is_good_enough_for_a_law_that_needs_three():
    for law, expected in ((FOUR_FACES, Data.WAITING), (Believing(believes=True), Data.FRESH)):
        rig = Rig(law)
        rig.minutes(100.0)
        for _ in range(4):
            rig.scan(100.0, bad=("east",))
        assert rig.judge()[0] is expected


def test_a_face_that_has_fallen_silent_drops_out_of_the_mean_when_it_is_stale():
    rig = Rig(Believing(believes=True))
    rig.minutes(100.0)
    for _ in range(3):
        rig.scan(100.0, bad=("east",))
    assert rig.readings.mean(rig.now).east_w_m2 == pytest.approx(50)
    rig.scan(100.0, bad=("east",))
    assert math.isnan(rig.readings.mean(rig.now).east_w_m2)


def test_no_mean_outlives_its_readings():
    rig = Rig()
    rig.minutes(100.0)
    rig.clock.now += 15
    assert rig.judge()[0] is Data.FRESH
    rig.clock.now += 1
    assert rig.readings.mean(rig.now) is None
    assert rig.judge()[0] is Data.WAITING
    rig.clock.now += 60
    data, why, _ = rig.judge()
    assert data is Data.BAD
    assert "no good scan for 76 s" in why


def test_with_the_clock_in_doubt_the_sun_begins_no_night_and_light_ends_one():
    rig = Rig()
    rig.minutes(100.0)
    rig.sun_deg = -40.0
    rig.clock.now += 30
    assert rig.judge(sun_known=False)[2] is None
    assert rig.judge()[2] is not None
    assert rig.judge(sun_known=False)[2] is not None, "as it was"
    for _ in range(36):
        rig.scan(9.0)
    assert rig.judge(sun_known=False)[2] is not None, "dusk is no light"
    for _ in range(36):
        rig.scan(100.0)
    assert rig.judge(sun_known=False)[2] is None


def test_what_is_missing_is_said_with_the_faces_that_are_bad():
    rig = Rig()
    rig.clock.now += 61
    assert rig.judge()[:2] == (Data.BAD, "no good scan for 61 s"), "no scan at all has no face"
    for _ in range(13):
        rig.scan(100.0, bad=("east", "zenith"))
    assert rig.judge()[1] == "no good scan for 126 s (east late, zenith late)"
    rig.scan(100.0)
    assert rig.judge()[1] == "waiting for the cube's readings"
