"""Whether the scans are good enough, for what, and whether it is night."""

import math

import pytest

from daemon.base.records import FaceReading, Quality, Scan
from daemon.config.settings import Settings
from daemon.tracker.modes import DataState
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


def test_night_begins_below_one_irradiance_of_the_zenith_face_and_ends_above_a_higher_one():
    rig = Rig()
    rig.sun_deg = 2.0
    assert rig.minutes(7.0)[2] is None
    assert rig.minutes(4.0)[2] is not None
    assert rig.minutes(7.0)[2] is not None, "between the thresholds it stays night"
    assert rig.minutes(11.0)[2] is None
    assert rig.minutes(7.0)[2] is None, "and day"


def test_without_readings_night_ends_at_a_sun_elevation_half_a_degree_higher_than_it_begins():
    rig = Rig()
    seen = []
    for sun_deg in (0.2, -0.2, 0.2, 0.6, 0.2):
        rig.sun_deg = sun_deg
        seen.append(rig.judge()[2] is not None)
    assert seen == [False, True, True, False, False]


def test_it_is_not_night_while_the_zenith_face_is_bright_with_the_sun_below_the_horizon():
    rig = Rig()
    rig.sun_deg = -3.0
    assert rig.minutes(40.0)[2] is None


def test_a_dark_zenith_face_under_a_high_sun_makes_the_readings_bad_and_is_not_night():
    rig = Rig()
    data, why, night = rig.minutes(2.0)
    assert (data, night) == (DataState.BAD, None)
    assert "in daylight" in why


def test_a_slightly_negative_reading_of_a_dark_face_is_shown_as_zero_and_not_as_minus_zero():
    rig = Rig()
    rig.sun_deg = -10.0
    assert rig.minutes(-0.04)[2] == "the zenith face reads 0.0 W/m2"
    rig.sun_deg = 30.0
    assert "the zenith face reads 0.0 W/m2 in daylight" in rig.minutes(-0.04)[1]


def test_a_dark_zenith_face_beside_a_sunlit_one_is_not_night_and_bad_data_if_the_law_believes_it():
    rig = Rig()
    rig.sun_deg = 3.0
    data, why, night = rig.minutes(0.0, south=400.0)
    assert (data, night) == (DataState.BAD, None)
    assert "in daylight" in why
    rig = Rig(Believing(believes=False))
    rig.sun_deg = 3.0
    assert rig.minutes(0.0, south=400.0)[::2] == (DataState.FRESH, None)


@pytest.mark.parametrize("believes", [False, True])
def test_a_law_decides_whether_to_believe_a_dark_zenith_face_only_while_the_sun_is_up(believes):
    rig = Rig(Believing(believes))
    assert rig.minutes(2.0)[0] is (DataState.BAD if believes else DataState.FRESH)
    rig.sun_deg = -1.0
    assert "zenith face reads 2.0" in rig.minutes(2.0)[2], "below the horizon dark is dark"


def test_a_vertical_face_counts_as_sunlit_above_ten_times_the_irradiance_that_ends_the_night():
    rig = Rig()
    rig.sun_deg = 5.0
    assert "zenith face reads 4.0" in rig.minutes(4.0, south=95.0)[2], "dusk under clouds"
    # A sun at 5 deg on a vertical face gives the zenith face tan 5 deg = 0.087 of that, and half of it is enough.
    assert rig.minutes(4.0, south=105.0)[2] is None


def test_beside_a_sunlit_face_the_zenith_face_is_believed_from_half_of_its_expected_irradiance():
    rig = Rig()
    rig.sun_deg = 1.0
    # 0.5 * 200 W/m2 * tan 1 deg = 1.75 W/m2.
    assert "zenith face reads 2.0" in rig.minutes(2.0, south=200.0)[2]
    assert rig.minutes(1.5, south=200.0)[2] is None


def test_a_bad_east_face_does_not_hide_that_the_south_face_is_sunlit():
    rig = Rig(Believing(believes=True))
    rig.sun_deg = 5.0
    assert rig.minutes(4.0, south=600.0, bad=("east",))[0] is DataState.BAD


def test_a_law_that_needs_only_one_face_has_night_by_the_zenith_face_alone():
    rig = Rig(Believing(believes=True, faces_needed=1))
    rig.sun_deg = 5.0
    assert "zenith face reads 4.0" in rig.minutes(4.0, bad=("east", "south", "west"))[2]


@pytest.mark.parametrize("believes", [False, True])
def test_without_the_zenith_face_the_suns_elevation_decides_on_night_for_a_law_that_needs_three(believes):
    rig = Rig(Believing(believes))
    rig.sun_deg = 2.0
    assert rig.minutes(9.0, bad=("zenith",))[::2] == (DataState.FRESH, None)
    rig.sun_deg = -1.0
    assert "the sun stands at -1.0 deg" in rig.minutes(9.0, bad=("zenith",))[2]


def test_without_the_zenith_face_and_with_the_clock_in_doubt_the_readings_are_bad():
    rig = Rig(Believing(believes=False))
    rig.minutes(9.0, bad=("zenith",))
    data, why, _ = rig.judge(sun_known=False)
    assert (data, why) == (DataState.BAD, "neither the zenith face nor the clock shows whether it is day or night")


def test_a_dark_zenith_face_that_the_law_does_not_believe_is_not_night_while_the_sun_is_up():
    rig = Rig(Believing(believes=False))
    rig.sun_deg = 0.5
    assert rig.minutes(2.0)[::2] == (DataState.FRESH, None)


def test_with_the_clock_in_doubt_a_dark_zenith_face_makes_readings_bad_even_if_it_is_not_believed():
    rig = Rig(Believing(believes=False))
    rig.minutes(2.0)
    assert rig.judge(sun_known=False)[0] is DataState.BAD


def test_the_readings_are_bad_if_all_four_faces_are_never_good_in_the_same_scan():
    rig = Rig()
    for _ in range(18):
        rig.scan(100.0, bad=("east",))
        rig.scan(100.0, bad=("west",))
    assert rig.readings.mean(rig.now).coverage > 0.9
    assert rig.judge()[0] is DataState.BAD


def test_a_scan_with_one_bad_face_is_good_enough_only_for_a_law_that_needs_three_faces():
    for law, expected in ((FOUR_FACES, DataState.WAITING), (Believing(believes=True), DataState.FRESH)):
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


def test_without_new_scans_the_mean_ends_and_the_readings_are_awaited_and_later_bad():
    rig = Rig()
    rig.minutes(100.0)
    rig.clock.now += 15
    assert rig.judge()[0] is DataState.FRESH
    rig.clock.now += 1
    assert rig.readings.mean(rig.now) is None
    assert rig.judge()[0] is DataState.WAITING
    rig.clock.now += 60
    data, why, _ = rig.judge()
    assert data is DataState.BAD
    assert "no good scan for 76 s" in why


def test_with_the_clock_in_doubt_the_suns_elevation_begins_no_night_and_only_light_ends_one():
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


def test_the_reason_why_no_scan_is_good_names_the_faces_that_are_bad():
    rig = Rig()
    rig.clock.now += 61
    assert rig.judge()[:2] == (DataState.BAD, "no good scan for 61 s"), "no scan at all has no face"
    for _ in range(13):
        rig.scan(100.0, bad=("east", "zenith"))
    assert rig.judge()[1] == "no good scan for 126 s (east late, zenith late)"
    rig.scan(100.0)
    assert rig.judge()[1] == "waiting for the cube's readings"
