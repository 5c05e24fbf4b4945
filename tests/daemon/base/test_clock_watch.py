"""Steps of the machine's clock."""

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock_watch import ClockWatch


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


@pytest.mark.parametrize(("step", "told", "trusted"), [
    (1.5, None, True),
    (2.0, 2.0, True),
    (-30.0, -30.0, True),
    (30.5, 30.5, False),
    (-30.5, -30.5, False),
])  # fmt: skip
def test_two_seconds_are_a_step_and_more_than_thirty_make_the_sun_doubtful_for_fifteen_minutes(step, told, trusted):
    clock = SetClock()
    watch = ClockWatch(clock)
    # Halves are exact beside an offset of this size.
    clock.offset += step
    assert watch.step_s() == told
    clock.now += 899.0
    assert watch.trusted == trusted
    clock.now += 1.0
    assert watch.trusted


class Told:
    """Alarms on a clock, with the kernel's answer in hand."""

    def __init__(self, answer):
        self.clock = SetClock()
        self.answer = answer
        self.asked = 0
        self.alarms = Alarms(self.clock, lambda _: None)
        self.watch = ClockWatch(self.clock, self.alarms, self.ask)

    def ask(self):
        self.asked += 1
        return self.answer

    def after(self, seconds):
        for _ in range(int(seconds // 5)):
            self.clock.now += 5
            self.watch.step_s()
        return [alarm.text for alarm in self.alarms.active if alarm.name == "clock"]


def test_a_clock_that_was_never_synchronised_is_told_and_over_when_it_is():
    told = Told(answer=False)
    assert not told.after(100), "what synchronises it may need some time"
    (text,) = told.after(60)
    assert "has not been synchronised" in text
    told.answer = True
    assert not told.after(65)
    asked = told.asked
    told.answer = False
    assert not told.after(3600), "it was synchronised once"
    assert told.asked == asked


def test_a_clock_that_nothing_synchronises_is_asked_for_after_two_minutes_and_every_minute_from_then_on():
    told = Told(answer=False)
    assert not told.after(115)
    assert told.asked == 0
    assert told.after(5)
    assert told.asked == 1
    told.after(55)
    assert told.asked == 1
    told.after(5)
    assert told.asked == 2
    told.after(600)
    assert told.asked == 12


@pytest.mark.parametrize("answer", [None, True])
def test_a_clock_that_is_synchronised_or_unknown_is_no_alarm(answer):
    assert not Told(answer).after(3600)


def test_a_step_is_an_alarm_until_the_clock_has_settled():
    told = Told(answer=None)
    told.clock.offset += 43200
    (text,) = told.after(5)
    assert "the clock was set by +43200 s" in text
    assert "before it has kept time for 15 minutes" in text
    assert told.after(800)
    assert not told.after(120)
