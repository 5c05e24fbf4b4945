"""How long each mode lasted today."""

from daemon.base.records import Mode, ModeChange
from daemon.service.mode_times import ModeTimes

MIDNIGHT_UTC_S = 19_000 * 86400.0
EAST_DEG = 15.0


class HandClock:
    def __init__(self, utc_s):
        self.now, self.start_utc_s = 0.0, utc_s

    def monotonic(self):
        return self.now

    def utc(self):
        return self.start_utc_s + self.now


def change(after):
    return ModeChange(time_utc_s=0.0, time_monotonic_s=0.0, before=Mode.STARTING, after=after, why="")


def test_mode_durations_add_up_from_the_start_and_again_from_zero_at_solar_midnight():
    # An hour east of Greenwich the solar day begins at 23:00 UTC.
    clock = HandClock(MIDNIGHT_UTC_S - 3600.0 - 100.0)
    times = ModeTimes(clock, EAST_DEG)
    clock.now = 30.0
    times.note(change(Mode.TRACKING))
    clock.now = 50.0
    times.note(change(Mode.STOW))
    clock.now = 60.0
    times.note(change(Mode.TRACKING))
    clock.now = 100.0 - 1.0
    found = times.today()
    assert found.lasted_s == {Mode.STARTING: 30.0, Mode.TRACKING: 20.0 + 39.0, Mode.STOW: 10.0}
    assert found.since_utc_s == clock.start_utc_s
    clock.now = 100.0 + 5.0
    assert times.today().lasted_s == {Mode.TRACKING: 5.0}
    assert times.today().since_utc_s == MIDNIGHT_UTC_S - 3600.0
    times.note(change(Mode.NIGHT))
    clock.now += 7.0
    assert times.today().lasted_s == {Mode.TRACKING: 5.0, Mode.NIGHT: 7.0}


def test_a_clock_that_is_set_does_not_lengthen_a_mode():
    clock = HandClock(MIDNIGHT_UTC_S + 7200.0)
    times = ModeTimes(clock, EAST_DEG)
    clock.now = 10.0
    clock.start_utc_s += 3600.0
    assert times.today().lasted_s == {Mode.STARTING: 10.0}


def test_after_a_clock_that_was_ahead_is_set_back_mode_durations_still_begin_a_new_day():
    clock = HandClock(MIDNIGHT_UTC_S + 30 * 86400.0)
    times = ModeTimes(clock, 0.0)
    clock.now = 10.0
    times.note(change(Mode.TRACKING))
    clock.now = 30.0
    clock.start_utc_s = MIDNIGHT_UTC_S + 100.0
    found = times.today()
    assert (found.since_utc_s, found.lasted_s) == (MIDNIGHT_UTC_S + 100.0, {Mode.STARTING: 10.0, Mode.TRACKING: 20.0})
    clock.now += 86400.0
    assert times.today().lasted_s == {Mode.TRACKING: 130.0}
    times.note(change(Mode.NIGHT))
    clock.now += 5.0
    assert times.today().lasted_s == {Mode.TRACKING: 130.0, Mode.NIGHT: 5.0}
