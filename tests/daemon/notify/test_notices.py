"""What a watch over a service makes of its answers."""

import pytest

from daemon.notify.notices import ServiceWatch


@pytest.mark.parametrize("rest", [{}, {"alarms": [{"name": "x"}]}, {"alarms": [{"name": "x", "tracker": None}]}])
def test_an_answer_that_cannot_be_used_names_nobody(rest):
    watch = ServiceWatch("127.0.0.1:20572", 120.0, "warning", None, 0.0)
    with pytest.raises(KeyError):
        watch.answered({"site": {"name": "a stranger"}, "simulated": False, "trackers": {}, **rest}, 10.0)
    (notice,) = watch.failed("what answers there is not heliocube", 200.0)
    assert notice.title == "heliocube 127.0.0.1:20572: CRITICAL does not answer"


@pytest.mark.parametrize(
    ("role", "unit"), [("cube", "heliocube-cube'"), ("tracker", "heliocube-tracker'"), ("both", "heliocube-tracker'")]
)
def test_the_remedy_for_a_silent_service_names_the_unit_of_its_role(role, unit):
    watch = ServiceWatch("127.0.0.1:20572", 30.0, "warning", None, 0.0)
    state = {"site": {"name": "roof"}, "simulated": False, "role": role, "trackers": {}, "alarms": []}
    assert watch.answered(state, 1.0) == []
    (notice,) = watch.failed("nothing listens there", 60.0)
    assert f"'systemctl status {unit}" in notice.body


def test_the_remedy_names_both_units_where_the_role_is_not_known():
    watch = ServiceWatch("127.0.0.1:20572", 30.0, "warning", None, 0.0)
    (notice,) = watch.failed("nothing listens there", 60.0)
    assert "'systemctl status heliocube-tracker heliocube-cube'" in notice.body
