"""Steps of the machine's clock."""

import pytest

from daemon.clockwatch import ClockWatch


class SetClock:
    def __init__(self):
        self.now = 100.0
        self.offset = 1.7e9

    def monotonic(self):
        return self.now

    def utc(self):
        return self.now + self.offset


@pytest.mark.parametrize("step", [3600.0, -3600.0, 86400.0, -86400.0])
def test_a_step_is_told_once_and_the_sun_is_doubted_until_the_clock_has_settled(step):
    clock = SetClock()
    watch = ClockWatch(clock)
    assert watch.step_s() is None
    assert watch.trusted
    clock.offset += step
    assert watch.step_s() == pytest.approx(step)
    assert watch.step_s() is None
    assert not watch.trusted
    clock.now += 901
    assert watch.trusted


def test_slewing_and_small_corrections_are_no_steps():
    clock = SetClock()
    watch = ClockWatch(clock)
    for _ in range(1000):
        clock.now += 5
        clock.offset += 0.01
        assert watch.step_s() is None
    clock.offset += 5
    assert watch.step_s() == pytest.approx(5)
    assert watch.trusted
