"""All reasons to stow together, and across a restart."""

import asyncio
import json
import math
import re

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import LoopClock
from daemon.base.state import StateFolder
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.sections import SafetySettings
from daemon.tracker.stow import StowStatus, WindStow
from daemon.tracker.stow_watch import SafetyFile, StowWatch
from tests.support import DOCS

SAFETY = SafetySettings(stow_wind_m_s=15, release_wind_m_s=10, stow_at_least_s=900, wind_stale_s=300)


class SetClock:
    def __init__(self, now=0.0, utc=1.7e9):
        self.now, self.offset = now, utc - now

    def monotonic(self):
        return self.now

    def utc(self):
        return self.now + self.offset


class Rig:
    """Two wind sensors, a watch over both, and a folder that survives them."""

    def __init__(self, directory=None, now=0.0, utc=1.7e9):
        self.clock = SetClock(now, utc)
        self.speeds = {"roof": None, "field": None}
        sources = [WindStow(SAFETY, lambda name=name: self.speeds[name], name) for name in self.speeds]
        self.folder = StateFolder(directory)
        self.alarms = Alarms(self.clock, lambda _record: None)
        self.watch = StowWatch(sources, SafetyFile(self.folder), self.clock, self.alarms)

    def look(self, now, roof=math.nan, field=math.nan):
        self.clock.now = now
        for name, speed in (("roof", roof), ("field", field)):
            if speed is None or not math.isnan(speed):
                self.speeds[name] = speed
        return self.watch.reasons(now)


def test_a_source_that_stows_does_not_hide_the_storm_of_another():
    rig = Rig()
    assert rig.look(0, roof=20, field=3)
    for now in range(5, 900, 5):
        rig.look(now, roof=3)
    assert rig.look(900, field=25)
    assert rig.look(910, field=3) == ("wind 25.0 m/s, stow from 15 m/s",), "the roof has become calm meanwhile"
    assert rig.look(1795, field=3) == ("wind 25.0 m/s, stow from 15 m/s",)


def test_take_gust_gives_the_strongest_wind_of_all_polls_since_the_last_call_and_no_old_reading():
    rig = Rig()
    assert math.isnan(rig.watch.take_gust()), "nothing was read yet"
    rig.look(0, roof=2, field=3)
    rig.look(1, roof=12, field=4)
    rig.look(2, roof=5)
    assert rig.watch.take_gust() == 12.0
    rig.look(3, roof=1, field=None)
    assert rig.watch.take_gust() == 1.0
    for now in range(4, 20):
        rig.look(now, roof=None, field=None)
    assert math.isnan(rig.watch.take_gust()), "a reading of 16 s ago is no wind of now"
    rig.look(20, roof=-1, field=7)
    assert rig.watch.take_gust() == 7.0


def test_a_wind_sensor_that_died_while_another_sensor_stowed_is_a_reason_to_stow_by_its_silence():
    rig = Rig()
    rig.look(0, roof=20, field=3)
    for now in range(5, 900, 5):
        rig.look(now, roof=3, field=None)
    reasons = rig.look(900, roof=3)
    assert reasons == ("no wind reading for 900 s",)


def test_the_reasons_of_all_sources_that_stow_are_returned():
    assert len(Rig().look(0, roof=20, field=21)) == 2


def test_the_stow_watch_is_waiting_until_every_source_has_been_heard_once():
    rig = Rig()
    rig.look(0, roof=3)
    assert rig.watch.waiting_why(0) == "waiting for the first message of field"
    rig.look(5, field=3)
    assert rig.watch.waiting_why(5) is None
    rig.look(10, field=None)
    assert rig.watch.waiting_why(10) is None, "once is enough: from then on silence has its time"


def test_a_storm_outlives_a_restart_until_all_sources_have_been_heard_and_calm_for_their_time(tmp_path):
    before = Rig(tmp_path)
    before.look(0, roof=3, field=3)
    before.look(5, roof=25)
    after = Rig(tmp_path, now=70_000.0)
    (why,) = after.look(70_000)
    assert re.search(r"before the restart, since 2023-\S+Z: wind 25.0 m/s", why)
    for now in range(70_005, 70_400, 5):
        assert after.look(now, roof=3, field=None)
    for now in range(70_400, 71_295, 5):
        assert after.look(now, roof=3, field=3)
    assert after.look(71_300) == ()
    assert Rig(tmp_path, now=5.0).look(5) == (), "it is over for the next start as well"


@pytest.mark.parametrize("step_s", [-86400.0, 86400.0, 1e9])
def test_a_clock_that_was_set_during_a_restart_in_a_storm_releases_no_stow_early(tmp_path, step_s):
    Rig(tmp_path).look(0, roof=25, field=3)
    after = Rig(tmp_path, now=10.0, utc=1.7e9 + step_s)
    for now in range(10, 910, 5):
        assert after.look(now, roof=3, field=3)
    assert after.look(910) == ()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"stowing": 3}', '{"stowing": {"a": 1}, "since_utc": ""}', "\x00"])
def test_an_unreadable_safety_file_is_a_reason_to_stow(tmp_path, text):
    (tmp_path / "safety.json").write_text(text)
    assert "cannot be read" in Rig(tmp_path).look(0, roof=3, field=3)[0]


def test_a_calm_start_without_a_safety_file_does_not_stow_and_writes_the_file(tmp_path):
    assert Rig(tmp_path).look(0, roof=3, field=3) == ()
    assert json.loads((tmp_path / "safety.json").read_text())["stowing"] == {}


def test_a_storm_that_a_failing_disk_did_not_store_is_written_when_the_disk_works_again(tmp_path, caplog):
    blocked = tmp_path / "folder"
    blocked.write_text("a file where the folder should be")
    rig = Rig(blocked)
    for now in range(0, 120, 5):
        assert rig.look(now, roof=25, field=3)
    assert sum("cannot be written" in record.message for record in caplog.records) == 1
    blocked.unlink()
    rig.folder.retry()
    assert "25.0" in (blocked / "safety.json").read_text()


def test_the_stow_watch_wakes_the_control_within_a_second_when_a_stow_begins_and_only_then():
    async def scenario():
        loop = asyncio.get_running_loop()
        clock, woken, wind = LoopClock(loop.time, 1.7e9), [], {"roof": 3.0, "field": 3.0}
        polled = []

        def read(name):
            polled.append(loop.time())
            return wind[name]

        sources = [WindStow(SAFETY, lambda name=name: read(name), name) for name in wind]
        watch = StowWatch(
            sources,
            SafetyFile(StateFolder(None)),
            clock,
            Alarms(clock, lambda _record: None),
            lambda: woken.append(loop.time()),
        )
        began_s = loop.time()
        running = asyncio.create_task(watch.run())
        await asyncio.sleep(10.5)
        assert woken == []
        for name, after_s in (("roof", 1000.0), ("field", 1000.0)):
            wind[name] = 20.0
            await asyncio.sleep(2.0)
            wind[name] = 3.0
            await asyncio.sleep(after_s)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        count = len(polled)
        await asyncio.sleep(100.0)
        assert len(polled) == count, "nobody polls any more"
        return [at_s - began_s for at_s in woken]

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        assert runner.run(scenario()) == pytest.approx([11.0, 1013.0], abs=0.6)


def test_the_kept_reason_of_a_storm_stays_the_same_however_often_the_service_restarts_in_it(tmp_path):
    rig = Rig(tmp_path)
    rig.look(0, roof=20, field=18)
    kept = (tmp_path / "safety.json").read_text()
    for restart in range(1, 6):
        rig = Rig(tmp_path, utc=1.7e9 + 60 * restart)
        (reason,) = rig.look(0)
        assert reason == (
            "stowed before the restart, since 2023-11-14T22:13:20.000Z:"
            " wind 20.0 m/s, stow from 15 m/s; wind 18.0 m/s, stow from 15 m/s"
        )
        assert (tmp_path / "safety.json").read_text() == kept
    rig.look(5, field=25)
    assert Rig(tmp_path).look(0)[0].endswith("Z: wind 20.0 m/s, stow from 15 m/s; wind 18.0 m/s, stow from 15 m/s")


def test_an_unreadable_safety_file_stays_a_reason_to_stow_over_restarts(tmp_path):
    (tmp_path / "safety.json").write_text("{")
    (first,) = Rig(tmp_path).look(0)
    assert "it is not known whether the tracker was stowed before the restart" in first
    for _ in range(3):
        (again,) = Rig(tmp_path).look(0)
    assert again == f"stowed before the restart, since 2023-11-14T22:13:20.000Z: {first}"


def test_a_stow_source_that_is_silent_for_too_long_raises_an_alarm_until_it_is_heard():
    def alarms():
        return {alarm.name: alarm.text for alarm in rig.alarms.active}

    rig = Rig()
    for now in range(0, 301, 5):
        rig.look(now, roof=3, field=None)
        assert alarms() == {}
    rig.look(301, roof=None)
    assert alarms() == {"stow-source-silent": "field has not been heard since the start of the service"}
    rig.alarms.acknowledge("ana")
    rig.look(600)
    assert rig.alarms.active[0].state == "acknowledged"
    rig.look(601)
    assert alarms()["stow-source-silent"] == "roof is silent; field has not been heard since the start of the service"
    assert rig.alarms.active[0].state == "raised", "of the second one nobody has heard"
    rig.look(605, roof=20, field=3)
    assert alarms() == {}, "they are heard, and strong wind is no fault"


def test_a_silent_source_raises_the_alarm_anew_even_if_its_name_is_part_of_that_of_another():
    speeds = [3.0, None]
    watch, alarms = plugged(*(WindStow(SAFETY, lambda place=place: speeds[place], "roof") for place in range(2)))
    watch.reasons(0.0)
    watch.reasons(301.0)
    assert texts(alarms)["stow-source-silent"] == "roof (2) has not been heard since the start of the service"
    alarms.acknowledge("ana")
    speeds[0] = None
    watch.reasons(602.0)
    assert texts(alarms)["stow-source-silent"].startswith("roof is silent; roof (2) ")
    assert alarms.active[0].state == "raised"


class Plugged:
    """A third party's source, which gives the answers of a test; an error is raised."""

    def __init__(self, reason=None, age_s=0.0, name="hail"):
        self.name, self.why, self.age_s, self.resumed = name, reason, age_s, []

    def reason(self, _now_s):
        if isinstance(self.why, Exception):
            raise self.why
        return self.why

    def status(self, _now_s):
        if isinstance(self.age_s, Exception):
            raise self.age_s
        return StowStatus(self.name, None, self.age_s) if not isinstance(self.age_s, str) else self.age_s

    def resume(self, why, now_s):
        self.resumed.append((why, now_s))


def plugged(*sources):
    alarms = Alarms(SetClock(), lambda _record: None)
    return StowWatch(sources, SafetyFile(StateFolder(None)), SetClock(), alarms), alarms


def texts(alarms):
    return {alarm.name: alarm.text for alarm in alarms.active}


@pytest.mark.parametrize(
    ("reason", "age_s", "words"),
    [
        (ZeroDivisionError("division by zero"), 0.0, "ZeroDivisionError: division by zero"),
        (None, KeyError("gauge"), "KeyError: 'gauge'"),
        (None, "fine", "TypeError: its status is 'fine', not a StowStatus"),
        (None, None, "TypeError: "),
        (None, math.nan, "ValueError: its last reading is nan s old, which cannot be"),
        (None, -1.7e9, "ValueError: its last reading is -1.7e\\+09 s old, which cannot be"),
        ("", 0.0, "TypeError: its reason is '', neither a sentence nor None"),
        (math.nan, 0.0, "TypeError: its reason is nan, neither a sentence nor None"),
        (False, 0.0, "TypeError: its reason is False, neither a sentence nor None"),
    ],
)
def test_a_stow_source_that_fails_or_gives_an_invalid_answer_stows_and_raises_an_alarm(reason, age_s, words, caplog):
    watch, alarms = plugged(Plugged(reason, age_s))
    for now in range(5):
        (why,) = watch.reasons(now)
        assert re.match(rf"the stow source hail has failed \({words}", why)
        assert texts(alarms) == {"stow-source-failed": why}
        (status,) = watch.statuses(now)
        assert (status.name, status.why, status.age_s) == ("hail", why, math.inf)
    assert sum(record.exc_info is not None for record in caplog.records) == 1
    assert watch.waiting_why(5) == "waiting for the first message of hail"
    assert "`waiting for the first message of ...`" in " ".join((DOCS / "operate.md").read_text().split())


def test_a_stow_source_that_failed_releases_after_a_minute_of_work_and_its_own_time_of_calm(caplog):
    source, roof = Plugged(), WindStow(SAFETY, lambda: 3.0, "roof")
    watch, alarms = plugged(source, roof)
    assert watch.reasons(0) == ()
    for now in (1, 31):
        source.why = OSError("no such gauge")
        assert watch.reasons(now)
        assert watch.statuses(now)[0].age_s == 1.0
        source.why = None
        for later in range(now + 1, now + 30):
            assert watch.reasons(later), "it fails again and again"
        watch.statuses(now + 29)
    said, at_s = source.resumed[-1]
    assert (
        said == "the stow source hail has failed (OSError: no such gauge), and must now report calm for its whole time"
    )
    assert at_s == 31
    source.why = said
    assert watch.reasons(91) == (said,), "it stows for its own time"
    assert texts(alarms) == {}
    source.why = None
    assert watch.reasons(92) == ()
    assert sum(record.exc_info is not None for record in caplog.records) == 1, "it was told once"


def test_a_second_source_that_fails_raises_the_alarm_anew_after_an_acknowledgement():
    first, second = Plugged(OSError("one")), Plugged(name="flood")
    watch, alarms = plugged(first, second)
    watch.reasons(0)
    alarms.acknowledge("ana")
    assert alarms.active[0].acknowledged_by == "ana"
    second.why = OSError("two")
    watch.reasons(1)
    (alarm,) = alarms.active
    assert "hail has failed (OSError: one); the stow source flood has failed (OSError: two)" in alarm.text
    assert not alarm.acknowledged_by


def test_a_source_whose_resume_fails_stows_after_a_restart_in_a_storm(tmp_path):
    class Forgetful(Plugged):
        def resume(self, why, now_s):
            raise NotImplementedError

    folder = StateFolder(tmp_path)
    SafetyFile(folder).save({"hail": "hail"}, "2023-11-14T22:13:20.000Z")
    watch = StowWatch([Forgetful()], SafetyFile(folder), SetClock(), Alarms(SetClock(), lambda _record: None))
    assert watch.reasons(1) == ("the stow source hail has failed (NotImplementedError)",)


def test_stow_sources_of_the_same_name_are_numbered_and_each_gives_its_own_reason():
    watch, alarms = plugged(Plugged("hail in the north"), Plugged("hail in the south"), Plugged(OSError("no gauge")))
    north, south, failed = watch.reasons(0)
    assert (north, south) == ("hail in the north", "hail in the south")
    assert failed == texts(alarms)["stow-source-failed"] == "the stow source hail (3) has failed (OSError: no gauge)"
    assert [status.name for status in watch.statuses(0)] == ["hail", "hail (2)", "hail (3)"]
