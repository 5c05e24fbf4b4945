"""When notices are held back, and how they are told together afterwards."""

import json
from datetime import time

import pytest

from daemon.base.alarms.kinds import KINDS
from daemon.notify.backlog import QuietHours
from tests.daemon.commands.status.test_times import place
from tests.daemon.notify.test_courier import lab, told

__all__ = ["lab", "place", "told"]


@pytest.mark.parametrize(
    ("begin", "end", "quiet", "loud"),
    [
        ("22:00", "06:30", ["22:00", "00:00", "06:29"], ["06:30", "21:59"]),
        ("12:00", "13:00", ["12:00"], ["11:59", "13:00"]),
        (None, None, [], ["00:00"]),
    ],
)
def test_quiet_hours_may_go_over_midnight(begin, end, quiet, loud):
    hours = QuietHours(begin, end)
    assert all(hours.is_quiet_at(time.fromisoformat(at)) for at in quiet)
    assert not any(hours.is_quiet_at(time.fromisoformat(at)) for at in loud)


@pytest.mark.slow
def test_in_quiet_hours_only_critical_alarms_are_sent_and_the_others_together_afterwards(lab, told):
    async def scenario(step):
        lab.alarms = [lab.alarm("clock")]
        await step()
        lab.alarms = [lab.alarm("clock"), lab.alarm("cube-face"), lab.alarm()]
        await step()
        assert [title.rpartition(" ")[2] for title in lab.titles] == ["stow-wanted"]
        await step(3600.0)
        ((_, _, body),) = lab.told[1:]
        found = json.loads(body)
        assert found["title"] == "heliocube: 2 changes of alarms"
        for line, name in zip(found["message"].splitlines(), ("clock", "cube-face"), strict=True):
            told_in_a_line = f"{lab.alarm()['text']}. Remedy: {KINDS[name].remedy.replace('`', chr(39))}"
            assert line == f"roof SIMULATED: WARNING {name}, since 2026-06-21 12:00:00 UTC: {told_in_a_line}"

    told(scenario, quiet_from="11:30", quiet_until="12:30")


@pytest.mark.slow
def test_alarms_that_come_and_go_beyond_the_hourly_limit_are_gathered_into_one_message(lab, told):
    async def scenario(step):
        for number in range(12):
            lab.alarms = [lab.alarm("clock", raised=f"2026-06-21T12:00:{number:02}.000Z")] if number % 2 == 0 else []
            await step(1.0)
        assert len(lab.titles) == 3
        await step(1200.0)
        assert lab.titles[3:] == ["heliocube: 9 changes of alarms"]

    told(scenario, most_per_hour=3)


@pytest.mark.slow
def test_critical_alarms_have_an_hourly_limit_of_their_own_beside_that_of_the_other_alarms(lab, told):
    async def scenario(step):
        for number in range(4):
            lab.alarms = [lab.alarm("clock", raised=f"2026-06-21T12:00:{number:02}.000Z")] if number % 2 == 0 else []
            await step(1.0)
        assert len(lab.titles) == 1
        lab.alarms = [lab.alarm("clock"), lab.alarm()]
        await step(1.0)
        assert [title.rpartition(" ")[2] for title in lab.titles[1:]] == ["stow-wanted"]
        lab.alarms = []
        await step(1.0)
        assert len(lab.titles) == 2, "the critical ones have their limit too"
        await step(3600.0)
        assert lab.titles[2:] == ["heliocube: 6 changes of alarms"]

    told(scenario, most_per_hour=1)


@pytest.mark.slow
def test_the_next_message_says_how_many_changes_were_lost_while_too_many_waited(lab, told):
    async def scenario(step):
        lab.taking = False
        lab.alarms = [lab.alarm("clock") | {"tracker": f"row-{number}"} for number in range(205)]
        await step()
        lab.taking = True
        for _ in range(3):
            await step(1800.0)
        lost = "Older changes were lost because more than 200 waited: 5."
        assert [message.splitlines()[0] for message in lab.messages] == [
            lost,
            "roof SIMULATED: WARNING row-105 clock, since 2026-06-21 12:00:00 UTC",
        ]
        assert sum(message.count("clock") for message in lab.messages) == 200

    told(scenario)


@pytest.mark.slow
@pytest.mark.parametrize("place", ["Europe/Paris"], indirect=True)
@pytest.mark.usefixtures("place")
def test_after_quiet_hours_an_alarm_that_came_and_went_is_sent_with_its_local_time(lab, told):
    async def scenario(step):
        lab.alarms = [lab.alarm("clock")]
        await step()
        lab.alarms = []
        await step()
        assert lab.told == []
        await step(3600.0)
        raised, over = lab.messages[0].splitlines()
        since = "since 2026-06-21 14:00:00 (UTC+02:00)"
        text = "stow is wanted (wind 20.0 m/s)"
        assert raised.startswith(f"roof SIMULATED: WARNING clock, {since}: {text}. Remedy: check")
        assert over == f"roof SIMULATED: over: clock, it was on {since}: {text}"

    told(scenario, quiet_from="13:30", quiet_until="14:30")


@pytest.mark.slow
def test_of_many_changes_the_first_come_in_full_and_the_others_as_name_and_time_in_900_characters(lab, told):
    async def scenario(step):
        lab.alarms = [lab.alarm("clock") | {"tracker": f"row-{number}"} for number in range(6)]
        await step()
        lines = lab.messages[0].splitlines()
        assert [". Remedy: " in line for line in lines] == [True, True, False, False, False, False]
        assert all(", since 2026-06-21 12:00:00 UTC" in line for line in lines)
        assert 700 < sum(map(len, lines)) <= 912

    told(scenario)
