import asyncio
import logging
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.base.reconnect import Outage, PeriodicSchedule, Reconnection
from daemon.base.timeloop import VirtualTimeLoop


@pytest.fixture
def outage(caplog):
    caplog.set_level(logging.DEBUG)
    return Outage(logging.getLogger("heliocube.test"), "the positioner")


def told(caplog, level=logging.INFO):
    return [(r.levelname, r.getMessage()) for r in caplog.records if r.levelno >= level]


def test_an_outage_is_logged_once_when_it_begins_and_once_with_its_length_when_it_ends(outage, caplog):
    assert outage.down(100.0, "the port is gone")
    assert not outage.down(101.0, "the port is gone")
    assert not outage.down(102.0, "the port is gone")
    assert outage.up(163.5)

    assert told(caplog) == [
        ("WARNING", "the positioner is down: the port is gone"),
        ("INFO", "the positioner is back"),
    ]
    assert caplog.records[-1].fields == {"down_s": 63.5, "repeats": 2}


def test_repeated_failures_in_an_outage_are_debug_lines_with_their_count(outage, caplog):
    for second in range(4):
        outage.down(float(second), "no answer")
    repeats = [r for r in caplog.records if r.levelno == logging.DEBUG]
    assert [r.fields["repeats"] for r in repeats] == [1, 2, 3]


def test_an_outage_has_a_start_and_a_reason_only_while_it_lasts(outage):
    assert (outage.is_down, outage.since, outage.reason, outage.repeats) == (False, None, "", 0)
    outage.down(5.0, "no answer")
    outage.down(9.0, "refused")
    assert (outage.is_down, outage.since, outage.reason, outage.repeats) == (True, 5.0, "refused", 1)
    outage.up(10.0)
    assert (outage.is_down, outage.since, outage.reason) == (False, None, "")


def test_a_recovery_without_an_outage_logs_nothing(outage, caplog):
    assert not outage.up(1.0)
    assert told(caplog, logging.DEBUG) == []


def test_a_reminder_is_never_sooner_than_ten_minutes_after_the_one_before(outage):
    outage.down(0.0, "x")
    assert outage.down(3590.0, "x"), "late, for nobody asked meanwhile"
    assert not outage.down(3600.0, "x")
    assert not outage.down(4189.0, "x")
    assert outage.down(4190.0, "x")


def test_only_the_first_log_line_of_an_outage_has_no_length(outage, caplog):
    outage.down(100.0, "x")
    outage.down(700.06, "x")
    first, reminder = caplog.records
    assert not hasattr(first, "fields")
    assert reminder.fields == {"down_s": 600.1, "repeats": 1}


def test_a_second_outage_starts_its_count_and_reminders_from_zero(outage, caplog):
    outage.down(0.0, "x")
    outage.down(700.0, "x")
    outage.up(800.0)
    caplog.clear()
    assert outage.down(1000.0, "y")
    assert not outage.down(1001.0, "y")
    assert outage.repeats == 1
    outage.up(1002.0)
    assert len(told(caplog)) == 2


def test_reminders_come_after_ten_minutes_one_hour_six_hours_and_then_every_six(outage):
    hours = [second / 3600 for second in range(0, 24 * 3600 + 1, 5) if outage.down(float(second), "x")]
    assert hours == pytest.approx([0, 1 / 6, 1, 6, 12, 18, 24])


@given(gaps_s=st.lists(st.floats(0.1, 3600.0), min_size=1, max_size=300))
def test_a_day_of_outage_logs_at_most_twenty_lines_however_often_the_device_fails(gaps_s):
    logger = logging.getLogger("heliocube.test.quiet")
    logger.setLevel(logging.INFO)
    outage, now_s, lines = Outage(logger, "the cube"), 0.0, 0
    for gap_s in gaps_s * (1 + int(86400 / sum(gaps_s)) if sum(gaps_s) > 600 else 1):
        now_s += gap_s
        if now_s > 86400:
            break
        lines += bool(outage.down(now_s, "x"))
    assert lines + bool(outage.up(now_s)) <= 20


def flap(outage, times, start_s=0.0, reason="unplugged"):
    """Be down for 10 s and up for 10 s; return the monotonic time after it [s]."""
    for turn in range(times):
        outage.down(start_s + 20.0 * turn, reason)
        outage.up(start_s + 20.0 * turn + 10.0)
    return start_s + 20.0 * times


def test_a_device_that_comes_and_goes_is_logged_six_times_and_then_with_its_number(outage, caplog):
    flap(outage, 12)
    assert told(caplog) == [
        *[("WARNING", "the positioner is down: unplugged"), ("INFO", "the positioner is back")] * 6,
        ("WARNING", "the positioner comes and goes: 7 times in the last hour: unplugged"),
    ]
    quiet = [record.getMessage() for record in caplog.records if record.levelno == logging.DEBUG]
    assert quiet[:3] == [
        "the positioner is back",
        "the positioner comes and goes: 8 times in the last hour: unplugged",
        "the positioner is back",
    ]


def test_a_day_of_a_device_coming_and_going_logs_at_most_twenty_lines(outage, caplog):
    flap(outage, 4320)
    assert len(told(caplog)) <= 20


def test_a_device_that_came_and_went_is_logged_as_steady_after_half_an_hour_with_its_outages(outage, caplog):
    end_s = flap(outage, 20) - 10.0
    caplog.clear()
    assert not outage.up(end_s + 1799.0)
    assert outage.up(end_s + 1800.0)
    assert not outage.up(end_s + 1801.0)
    text = "the positioner is steady again: it has worked for 30 min, after 20 outages"
    assert told(caplog) == [("INFO", text)]


def test_a_new_outage_of_a_device_that_no_longer_comes_and_goes_is_logged_at_once(outage, caplog):
    end_s = flap(outage, 20)
    outage.up(end_s + 2000.0)
    caplog.clear()
    assert outage.down(end_s + 3000.0, "no answer") == "the positioner is down: no answer"
    assert outage.up(end_s + 3010.0, "firmware 7") == "the positioner is back: firmware 7"


def test_a_long_outage_of_a_device_that_comes_and_goes_is_logged_after_an_hour(outage, caplog):
    end_s = flap(outage, 20)
    caplog.clear()
    lines = [second for second in range(0, 7 * 3600, 5) if outage.down(end_s + second, "no answer")]
    assert lines == [3600, 6 * 3600]
    assert told(caplog)[0] == ("WARNING", "the positioner is still down: no answer")


def test_an_outage_keeps_its_state_while_its_log_lines_are_suppressed(outage):
    end_s = flap(outage, 20)
    outage.down(end_s, "no answer")
    assert (outage.is_down, outage.since, outage.reason) == (True, end_s, "no answer")
    outage.up(end_s + 5.0)
    assert (outage.is_down, outage.since, outage.reason) == (False, None, "")


class GoneError(Exception):
    pass


class HungError(GoneError):
    pass


def reconnecting(outage, tries):
    """Use a device that answers as `tries` says, one by one, and return what happened when, in tenths of a second."""
    seen = []
    loop = VirtualTimeLoop()

    def note(what):
        seen.append((round(loop.time() * 10), what))

    async def use():
        answer = tries.pop(0)
        if answer is None:
            reconnection.note_working("as before")
            answer = asyncio.CancelledError()
        note("use")
        raise answer

    async def close():
        note("close")

    class Steady(Random):
        def random(self):
            return 0.0

    reconnection = Reconnection(outage, Steady(), loop.time, note, lost=GoneError, hopeless=(HungError,))
    try:
        loop.run_until_complete(reconnection.run(use, close, lambda: note("forget")))
    except (asyncio.CancelledError, HungError, ValueError) as error:
        note(type(error).__name__)
    finally:
        loop.close()
    return seen


def test_a_lost_device_is_forgotten_reported_closed_and_used_again_after_growing_pauses(outage):
    assert reconnecting(outage, [GoneError("no port"), GoneError("no port"), None]) == [
        (0, "use"), (0, "forget"), (0, "the positioner is down: no port"), (0, "close"),
        (5, "use"), (5, "forget"), (5, "close"),
        (14, "the positioner is back: as before"), (14, "use"), (14, "CancelledError"),
    ]  # fmt: skip


@pytest.mark.parametrize("error", [HungError("no answer"), ValueError("a defect")])
def test_a_hopeless_error_or_a_defect_is_not_retried(outage, error):
    assert reconnecting(outage, [error]) == [(0, "use"), (0, type(error).__name__)]


def test_beginning_and_end_of_an_outage_are_notified_and_reminders_are_not():
    class Steady(Random):
        def random(self):
            return 0.0

    told = []
    outage = Outage(logging.getLogger("heliocube.test"), "the positioner")
    loop = VirtualTimeLoop()

    async def use():
        # With a try every 8 s these are tries for more than an hour, with two reminders.
        if loop.time() < 4000.0:
            raise GoneError("no port")
        assert reconnection.note_working()
        assert not reconnection.note_working()
        raise ValueError("enough")

    async def close():
        pass

    reconnection = Reconnection(outage, Steady(), loop.time, told.append, lost=GoneError)
    with pytest.raises(ValueError, match="enough"):
        loop.run_until_complete(reconnection.run(use, close))
    loop.close()
    assert told == ["the positioner is down: no port", "the positioner is back"]
    assert outage.repeats > 400


def test_suppressed_log_lines_of_a_device_that_comes_and_goes_are_not_notified_either(outage):
    flap(outage, 20, start_s=-450.0)
    seen = reconnecting(outage, [GoneError("no port"), None])
    assert [what for _, what in seen] == ["use", "forget", "close", "use", "CancelledError"]


def test_a_rhythm_keeps_its_phase_and_counts_the_beats_that_it_skips():
    rhythm = PeriodicSchedule(5.0)
    rhythm.start(100.0)
    assert rhythm.wait_s(101.0) == pytest.approx(4.0)
    assert rhythm.wait_s(109.5) == pytest.approx(0.5)
    assert rhythm.skipped == 0
    assert rhythm.wait_s(122.0) == pytest.approx(3.0)
    assert rhythm.skipped == 2
    assert rhythm.wait_s(130.0) == pytest.approx(5.0), "a beat that is due this instant has no time left"
    assert rhythm.skipped == 3
