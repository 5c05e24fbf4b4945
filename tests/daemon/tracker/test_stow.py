"""Reasons to stow."""

import math

from daemon.config.sections import SafetySettings
from daemon.tracker.stow import OperatorStow, WindStow

SAFETY = SafetySettings(stow_wind_m_s=15, release_wind_m_s=10, stow_at_least_s=900, wind_stale_s=300)


class Wind:
    def __init__(self):
        self.speed = 3.0
        self.source = WindStow(SAFETY, lambda: self.speed)

    def at(self, now, speed):
        self.speed = speed
        return self.source.reason(now)


def test_strong_wind_stows_and_says_how_strong():
    wind = Wind()
    assert wind.at(0, 14.9) is None
    assert "15.0 m/s" in wind.at(5, 15.0)


def test_stow_stays_until_the_wind_has_been_low_for_the_minimum_time():
    wind = Wind()
    wind.at(0, 20)
    assert wind.at(100, 12)
    assert wind.at(900, 9.9)
    assert wind.at(999, 9.9)
    assert wind.at(1000, 9.9) is None


def test_wind_above_the_release_threshold_during_a_wind_stow_starts_its_minimum_time_anew():
    wind = Wind()
    wind.at(0, 20)
    wind.at(800, 11)
    assert wind.at(1000, 5)
    assert wind.at(1700, 5) is None


def test_a_silent_or_garbled_wind_sensor_counts_as_strong_wind():
    for bad in (None, math.nan, -1.0):
        wind = Wind()
        assert wind.at(0, 2) is None
        assert wind.at(300, bad) is None
        assert "no wind reading" in wind.at(301, bad)
        assert wind.at(302, 2), "one reading after the silence does not end the stay"


def test_a_wind_sensor_that_was_never_heard_counts_as_strong_wind_after_the_allowed_silence():
    wind = Wind()
    assert wind.at(0, None) is None
    assert wind.at(400, None)


def test_an_operators_stow_is_latched_until_released():
    stow = OperatorStow()
    assert stow.reason(0) is None
    stow.request("storm coming")
    assert stow.reason(1e9) == "storm coming"
    stow.release()
    assert stow.reason(1e9) is None


def test_an_invalid_wind_reading_releases_no_stow_however_long_ago_the_storm_was():
    for bad in (None, math.nan, -1.0):
        wind = Wind()
        wind.at(0, 20)
        for now in range(5, 1000, 5):
            wind.at(now, 5.0 if now < 800 else bad)
        assert wind.at(1000, bad)
        assert wind.at(1001, 5.0) is None


def test_the_reason_of_a_wind_stow_is_the_newest_strong_wind():
    wind = Wind()
    wind.at(0, 15.5)
    assert "25.0 m/s" in wind.at(5, 25)


def test_a_source_that_stowed_before_a_restart_counts_its_time_of_calm_from_its_first_reading():
    wind = Wind()
    wind.source.resume("stowed before the restart", 1000)
    for now in range(1000, 1200, 5):
        assert wind.at(now, None) == "stowed before the restart"
    for now in range(1200, 2095, 5):
        assert wind.at(now, 3)
    assert wind.at(2095, 3) is None


def test_the_wind_of_a_source_that_is_silent_for_too_long_is_unknown():
    wind = Wind()
    wind.at(0, 3)
    assert wind.source.status(300).speed_m_s == 3
    status = wind.source.status(301)
    assert math.isnan(status.speed_m_s)
    assert (status.age_s, status.stow_from_m_s) == (301, 15)


def test_a_status_shows_speed_age_thresholds_and_time_to_release_without_polling_the_source():
    wind = Wind()
    assert wind.source.status(0).age_s == math.inf
    wind.at(0, 20)
    wind.at(10, 4)
    status = wind.source.status(40)
    assert (status.speed_m_s, status.age_s, status.stow_from_m_s, status.release_below_m_s) == (4, 30, 15, 10)
    assert status.release_in_s == 860
    assert "20.0" in status.why
    wind.at(940, 4)
    assert math.isnan(wind.source.status(940).release_in_s)
