"""Steps of the machine's clock."""

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock_watch import ClockWatch


class SetClock:
    def __init__(self):
        self.now = 100.0
        self.offset = 1.7e9
        self.asleep = None

    def monotonic(self):
        return self.now

    def utc(self):
        return self.now + self.offset

    def asleep_s(self):
        return self.asleep


@pytest.mark.parametrize("step", [3600.0, -3600.0, 86400.0, -86400.0])
def test_a_clock_step_is_reported_once_and_the_time_is_distrusted_until_it_is_undone(step):
    clock = SetClock()
    watch = ClockWatch(clock)
    assert watch.step_s() is None
    assert watch.trusted
    clock.offset += step
    assert watch.step_s() == pytest.approx(step)
    assert watch.step_s() is None
    for _ in range(100):
        clock.now += 3600.0
        watch.step_s()
        assert not watch.trusted, "that a clock has run on proves nothing"
        # A time that is not believed ends no night, and opens no day's budget.
        assert watch.believed_utc_s == clock.utc() - step
    clock.offset -= step - 30.0
    watch.step_s()
    assert watch.trusted
    assert watch.believed_utc_s == clock.utc()


@pytest.mark.parametrize(
    ("slept", "step", "told"),
    [(7200.0, 0.0, None), (7200.0, -7200.0, -7200.0), (7200.0, 3600.0, 3600.0)],
)
def test_a_sleep_of_known_length_is_no_clock_step_and_does_not_hide_one(slept, step, told):
    clock = SetClock()
    clock.asleep = 500.0
    watch = ClockWatch(clock)
    clock.asleep += slept
    clock.offset += slept + step
    right = step == 0.0
    assert watch.trusted_now == right, "also before anybody has looked"
    assert watch.step_s() == told
    assert watch.trusted == right
    assert watch.believed_utc_s == clock.utc() - step
    clock.offset -= step
    watch.step_s()
    assert watch.trusted


def test_a_known_sleep_does_not_end_the_distrust_of_a_time_before_the_last_run():
    clock = SetClock()
    clock.asleep = 500.0
    watch = ClockWatch(clock, ran_utc_s=clock.utc() + 7200.0)
    clock.asleep += 7200.0
    clock.offset += 7200.0
    watch.step_s()
    assert not watch.trusted
    assert watch.believed_utc_s == clock.utc() + 7200.0


@pytest.mark.parametrize(("known", "trusted"), [(None, False), (False, False), (True, True)])
def test_a_time_before_the_last_run_is_distrusted_until_the_clock_is_synchronised(known, trusted):
    clock, answers = SetClock(), [known]
    watch = ClockWatch(clock, synchronised=lambda: answers[-1], ran_utc_s=clock.utc() + 31.0)
    assert watch.trusted == watch.trusted_now == trusted
    assert watch.step_s() is None
    assert watch.trusted == trusted
    clock.now += 200.0
    # Now it is right, but believed only when whatever has set it says so.
    clock.offset += 3e7
    watch.step_s()
    assert not watch.trusted
    clock.now += 200.0
    answers.append(True)
    watch.step_s()
    assert watch.trusted
    assert watch.believed_utc_s == clock.utc()


def test_a_time_30_s_before_the_last_run_is_trusted():
    clock = SetClock()
    assert ClockWatch(clock, ran_utc_s=clock.utc() + 30.0).trusted
    assert ClockWatch(clock, ran_utc_s=float("nan")).trusted


def test_slewing_is_no_clock_step_and_a_step_of_5_s_leaves_the_time_trusted():
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
def test_a_clock_step_is_reported_from_2_s_on_and_one_of_more_than_30_s_makes_the_time_distrusted(step, told, trusted):
    clock = SetClock()
    watch = ClockWatch(clock)
    # With an offset of this size, halves are exact numbers.
    clock.offset += step
    assert watch.step_s() == told
    assert watch.trusted == trusted
    clock.now += 3600.0
    watch.step_s()
    assert watch.trusted == trusted


def test_a_clock_that_is_slowly_brought_back_is_trusted_when_it_is_back():
    clock = SetClock()
    watch = ClockWatch(clock)
    clock.offset += 3600.0
    watch.step_s()
    for _ in range(3570):
        assert not watch.trusted
        clock.now += 10.0
        clock.offset -= 1.0
        assert watch.step_s() is None
    assert watch.trusted


def test_opposite_clock_steps_leave_the_time_trusted_and_two_in_one_direction_do_not():
    clock = SetClock()
    watch = ClockWatch(clock)
    for step, trusted in ((3600.0, False), (3600.0, False), (-3600.0, False), (-3600.0, True), (-40.0, False)):
        clock.now += 5.0
        clock.offset += step
        watch.step_s()
        assert watch.trusted == trusted


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_small_clock_steps_within_an_hour_add_up_to_distrust_and_are_reported_as_one(sign):
    told = Told(answer=None)
    doubts = []
    for _ in range(6):
        told.clock.offset += 10.0 * sign
        doubts += told.after(600)
    told_of = [doubt.partition(",")[0] for doubt in doubts]
    assert told_of == [f"the clock was set {'forward' if sign > 0 else 'back'} by {steps} s" for steps in (40, 50, 60)]
    told.clock.offset -= 40.0 * sign
    assert not told.after(5)


def test_small_corrections_hours_apart_do_not_add_up():
    told = Told(answer=None)
    for _ in range(20):
        told.clock.offset += 10.0
        assert not told.after(7200)
    assert told.watch.believed_utc_s == told.clock.utc()


class Told:
    """Alarms on a clock, with an answer of the kernel that a test sets."""

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


def test_a_clock_that_was_never_synchronised_raises_an_alarm_until_it_is():
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


def test_clock_synchronisation_is_asked_for_first_after_two_minutes_and_then_every_minute():
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


@pytest.mark.parametrize(
    ("step_s", "told"),
    [
        (1665566421.0, "the clock was set forward by 53 years, and"),
        (-3660.0, "the clock was set back by 61 min, and"),
        (-200.0 * 86400.0, "the clock was set back by 200 days, and"),
    ],
)
def test_a_clock_step_is_reported_in_the_usual_unit_for_its_size(step_s, told):
    found = Told(answer=None)
    found.clock.offset += step_s
    (text,) = found.after(5)
    assert text.startswith(told)


@pytest.mark.parametrize("answer", [None, True])
def test_a_clock_that_is_synchronised_or_of_unknown_state_raises_no_alarm(answer):
    assert not Told(answer).after(3600)


@pytest.mark.parametrize("answer", [None, False])
def test_the_alarm_of_a_clock_step_lasts_as_long_as_nothing_confirms_the_time(answer):
    told = Told(answer)
    told.clock.offset += 43200
    (text,) = told.after(5)
    assert "the clock was set forward by 12 h, and nothing confirms" in text
    assert "restart" in text
    assert told.after(86400) == [text]


def test_a_step_is_believed_two_minutes_later_if_the_clock_is_synchronised_then():
    told = Told(answer=True)
    told.after(3600)
    asked = told.asked
    told.clock.offset += 43200
    assert told.after(120)
    assert told.asked == asked, "what synchronises it has to notice that somebody has set it"
    assert not told.after(5)
    assert told.watch.trusted


def test_a_step_that_nothing_has_confirmed_is_believed_within_a_minute_of_synchronisation():
    told = Told(answer=True)
    told.after(300)
    told.answer = False
    told.clock.offset -= 43200
    assert told.after(7200)
    told.answer = True
    assert not told.after(65)
    assert told.watch.trusted
    assert told.watch.believed_utc_s == told.clock.utc()
