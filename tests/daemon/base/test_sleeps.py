"""Sleeps of the machine: what of an age they are."""

from daemon.base.sleeps import SleepWatch, asleep_s, slept_since


class Machine:
    """Its steady clock, and for how long it has slept."""

    now_s = 100.0
    slept_s = 5.0

    def monotonic(self):
        return self.now_s


def test_each_sleep_is_part_of_the_ages_of_what_was_before_it():
    machine = Machine()
    watch = SleepWatch(machine, lambda: machine.slept_s)
    assert watch.look() == ()
    machine.now_s, machine.slept_s = 100.1, 3605.0
    watch.look()
    machine.now_s = 200.0
    watch.look()
    machine.now_s, machine.slept_s = 200.1, 3615.0
    sleeps = watch.look()
    assert [slept_since(since_s, sleeps) for since_s in (99.0, 100.1, 200.1)] == [3610.0, 10.0, 0.0]


def test_this_machine_tells_how_long_it_has_slept():
    before_s = asleep_s()
    assert 0.0 <= max(before_s, 0.0) <= asleep_s() + 1.0
