"""Sleeps of the machine: how they count in an age, and how they are told from a step of its clock."""

import sys
import time

import pytest

from daemon.base.clock import SystemClock
from daemon.base.sleeps import SleepGauge, SleepWatch, slept_since


class Machine:
    """The machine's steady clock, and how long it has slept."""

    now_s = 100.0
    slept_s = 5.0

    def monotonic(self):
        return self.now_s

    def asleep_s(self):
        return self.slept_s


def test_each_sleep_of_the_machine_adds_to_the_age_of_earlier_instants():
    machine = Machine()
    watch = SleepWatch(machine)
    assert watch.sleeps_until_now() == ()
    machine.now_s, machine.slept_s = 100.1, 3605.0
    watch.sleeps_until_now()
    machine.now_s = 200.0
    watch.sleeps_until_now()
    machine.now_s, machine.slept_s = 200.1, 3615.0
    sleeps = watch.sleeps_until_now()
    assert [slept_since(since_s, sleeps) for since_s in (99.0, 100.1, 200.1)] == [3610.0, 10.0, 0.0]


@pytest.mark.parametrize(
    ("platform", "boot_s", "utc_s", "slept_s"),
    [("linux", 90.0, 0.0, 90.0), ("linux", 90.0, -90.0, 90.0), ("linux", 0.0, 90.0, 0.0), ("darwin", 0.0, 90.0, 90.0)],
)
def test_linux_distinguishes_a_sleep_from_a_clock_step_and_other_systems_do_not(
    monkeypatch, platform, boot_s, utc_s, slept_s
):
    monkeypatch.setattr(sys, "platform", platform)
    gauge = SleepGauge(SystemClock())
    boot, utc = time.clock_gettime, time.time
    monkeypatch.setattr(time, "clock_gettime", lambda which: boot(which) + boot_s)
    monkeypatch.setattr(time, "time", lambda: utc() + boot_s + utc_s)
    assert gauge.take_s() == pytest.approx(slept_s, abs=1.0)
    monkeypatch.undo()
    assert SleepGauge(SystemClock()).take_s() < 1.0
