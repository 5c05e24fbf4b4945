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
