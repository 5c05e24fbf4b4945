"""The notices that a watch over a service makes from its answers."""

import pytest

from daemon.notify.notices import ServiceWatch


@pytest.mark.parametrize("rest", [{}, {"alarms": [{"name": "x"}]}, {"alarms": [{"name": "x", "tracker": None}]}])
def test_the_notice_of_a_failing_service_ignores_the_site_name_in_an_unusable_answer(rest):
    watch = ServiceWatch("127.0.0.1:20572", 120.0, "warning", None, 0.0)
    with pytest.raises(KeyError):
        watch.note_answer({"site": {"name": "a stranger"}, "simulated": False, "trackers": {}, **rest}, 10.0)
    (notice,) = watch.note_failure("the program that answers there is not heliocube", 200.0)
    assert notice.title == "heliocube 127.0.0.1:20572: CRITICAL does not answer"


@pytest.mark.parametrize(
    ("role", "unit"), [("cube", "heliocube-cube'"), ("tracker", "heliocube-tracker'"), ("both", "heliocube-tracker'")]
)
def test_the_remedy_for_a_silent_service_names_the_unit_of_its_role(role, unit):
    watch = ServiceWatch("127.0.0.1:20572", 30.0, "warning", None, 0.0)
    state = {"site": {"name": "roof"}, "simulated": False, "role": role, "trackers": {}, "alarms": []}
    assert watch.note_answer(state, 1.0) == []
    (notice,) = watch.note_failure("nothing listens there", 60.0)
    assert f"'systemctl status {unit}" in notice.body


def test_the_remedy_for_a_silent_service_of_unknown_role_names_both_units():
    watch = ServiceWatch("127.0.0.1:20572", 30.0, "warning", None, 0.0)
    (notice,) = watch.note_failure("nothing listens there", 60.0)
    assert "'systemctl status heliocube-tracker heliocube-cube'" in notice.body


def test_a_latched_alarm_that_came_and_went_between_two_polls_is_reported_each_time():
    def look(*alarms, mode="tracking"):
        now.append(now[-1] + 10.0)
        state = {"site": {"name": "roof"}, "simulated": False, "trackers": {"tracker": {"mode": {"name": mode}}}}
        return watch.note_answer({**state, "alarms": alarms}, now[-1])

    def over(name, cleared_at="12:00:04"):
        times = {"raised_at": "2026-06-21T12:00:01Z", "cleared_at": f"2026-06-21T{cleared_at}Z"}
        said = {"text": "A stalled", "effect": "it stands", "remedy": "look for ice", "severity": "critical"}
        rest = {"state": "cleared", "latched": True, "acknowledged_at": None}
        return {"name": name, "tracker": "tracker", **said, **times, **rest}

    watch, now = ServiceWatch("127.0.0.1:20572", 120.0, "warning", None, 0.0), [0.0]
    assert look(over("motor-current")) == [], "at the first look what is over may have been told before"
    (notice,) = look(over("motor-current"), over("move-failed"))
    assert (notice.title, notice.severity, notice.is_recovery) == (
        "heliocube roof: CRITICAL move-failed, over already",
        "critical",
        False,
    )
    first, remedy, times, stays = notice.body.splitlines()
    assert (first, remedy) == ("A stalled.", "Remedy: look for ice.")
    assert times.startswith("It was on since 2026-06-2")
    assert "UTC" in times
    assert "'heliocube alarms ack move-failed'" in stays
    assert look(over("motor-current"), over("move-failed")) == []
    assert look(mode="maintenance") == []
    assert look(over("motor-current"), over("move-failed")) == []
    (again,) = look(over("motor-current", "12:30:00"), over("move-failed"))
    assert again.title == "heliocube roof: CRITICAL motor-current, over already"
    assert look() == []


def test_with_several_trackers_the_notice_names_the_acknowledge_command_with_the_tracker():
    alarm = {"name": "move-failed", "tracker": "east", "text": "A stalled", "severity": "critical", "latched": True}
    alarm |= {"state": "raised", "raised_at": "2026-06-21T12:00:01Z", "acknowledged_at": None, "effect": "it stands"}
    state = {
        "site": {"name": "roof"},
        "simulated": False,
        "trackers": {name: {"mode": {"name": "fault"}} for name in "ew"},
    }
    watch = ServiceWatch("127.0.0.1:20572", 120.0, "warning", None, 0.0)
    watch.note_answer({**state, "alarms": [alarm | {"remedy": "look for ice"}]}, 1.0)
    over = alarm | {"state": "cleared", "cleared_at": "2026-06-21T12:00:04Z", "remedy": "look for ice"}
    (notice,) = watch.note_answer({**state, "alarms": [over]}, 11.0)
    assert "'heliocube alarms ack move-failed --tracker east'" in notice.body


def test_the_notice_of_an_ended_alarm_gives_its_time_with_the_time_zone():
    alarm = {"name": "clock", "tracker": None, "text": "the clock was set", "severity": "warning", "latched": False}
    alarm |= {"state": "raised", "raised_at": "2026-06-21T12:00:01Z", "acknowledged_at": None}
    state = {"site": {"name": "roof"}, "simulated": False, "trackers": {}}
    watch = ServiceWatch("127.0.0.1:20572", 120.0, "warning", None, 0.0)
    watch.note_answer({**state, "alarms": [alarm | {"effect": "the tracker stands", "remedy": "set it"}]}, 1.0)
    (notice,) = watch.note_answer({**state, "alarms": []}, 11.0)
    was_on = notice.body.splitlines()[1]
    assert was_on.startswith("It was on since 2026-06-2")
    assert "UTC" in was_on, "wherever this machine stands"
