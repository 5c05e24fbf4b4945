"""A screen that follows the service across its restarts."""

import io
import re
from datetime import UTC, datetime

import pytest
from rich.console import Console
from rich.live import Live

from daemon.base.errors import UserError
from daemon.base.records import Mode
from daemon.commands.status.screen import render
from daemon.commands.status.screen_log import ScreenLogStream
from daemon.commands.status.watch import watch
from daemon.service.recent import News, RecentRecords
from daemon.service.state import state_json


class SeenEnoughError(Exception):
    """The person has seen enough."""


def seen(state, answers, *, terminal):
    """Return what is shown while the service gives these answers: True for the state, else why it gives none."""
    left = iter([*answers])
    console = Console(file=io.StringIO(), force_terminal=terminal, width=80, height=60)

    def see():
        answer = next(left)
        if answer is True:
            return state
        raise UserError(answer)

    def sleep(_):
        if not left.__length_hint__():
            raise SeenEnoughError

    with pytest.raises(SeenEnoughError):
        watch(see, console, sleep)
    return console.file.getvalue()


@pytest.fixture
def state(run_rig):
    found = []

    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        found.append(state_json(rig.take_snapshot(RecentRecords())))

    run_rig(scenario)
    return found[0]


def test_the_status_screen_writes_a_count_of_one_scan_in_the_singular(state):
    state["bridge"]["accepted"] = 1
    console = Console(file=io.StringIO(), width=160)
    console.print(render(state))
    assert re.search("bridge +1 scan accepted, 0 lost", console.file.getvalue())


@pytest.mark.parametrize("terminal", [True, False])
def test_the_watch_screen_reports_a_lost_service_and_shows_its_state_again_afterwards(state, terminal):
    text = seen(state, [True, "nothing listens", True, True], terminal=terminal)
    assert text.count("NO CONNECTION: what is shown is old. nothing listens") == 1
    assert "tracking" in text.rpartition("nothing listens")[2]


def test_the_watch_screen_is_refused_without_a_service_at_the_beginning(state):
    with pytest.raises(UserError, match="nothing listens"):
        watch(lambda: (_ for _ in ()).throw(UserError("nothing listens")), Console(file=io.StringIO()))


def test_a_log_warning_is_printed_above_the_live_screen_which_is_erased_and_drawn_anew():
    console = Console(file=io.StringIO(), force_terminal=True, width=40, height=20)
    with Live("first\nsecond", console=console, auto_refresh=False) as live:
        live.refresh()
        begun = console.file.tell()
        ScreenLogStream(console).write("WARNING [bold]a wire is loose[/bold]\n")
        drawn = console.file.getvalue()[begun:]
    taken_away, warning, again = drawn.partition("WARNING [bold]a wire is loose[/bold]\n")
    assert warning
    assert taken_away.count("\x1b[2K") == 2, "both lines are erased"
    assert "first\nsecond" in again


@pytest.mark.parametrize(
    ("actual", "chronometric", "shown"),
    [
        (0.0013, 0.001, "+30.0 % over chronometric: 1.30 against 1.00 Wh/m2"),
        (0.84, 0.83, "+1.2 % over chronometric: 840 against 830 Wh/m2"),
        (3.0, 3.03, "-1.0 % over chronometric: 3.00 ag"),
    ],
)
def test_received_light_is_shown_in_a_unit_that_tells_it_apart_from_the_chronometric_one(
    state, actual, chronometric, shown
):
    state["received"] = {
        "since": state["time"],
        "gain": actual / chronometric - 1,
        "actual_kwh_m2": actual,
        "chronometric_kwh_m2": chronometric,
    }
    console = Console(file=io.StringIO(), width=160)
    console.print(render(state))
    assert shown in console.file.getvalue()


def test_news_is_dated_and_fits_the_terminal(run_rig):
    async def scenario(rig):
        await rig.until_mode(Mode.TRACKING, 120)
        recent = RecentRecords()
        for hour, text in [(8, "first"), (9, "second"), (10, "third " * 20)]:
            recent.news.append(News(datetime(2022, 10, 12, hour, tzinfo=UTC).timestamp(), text))
        console = Console(file=io.StringIO(), width=80)
        console.print(render(state_json(rig.take_snapshot(recent))))
        lines = console.file.getvalue().splitlines()
        first = next(number for number, line in enumerate(lines) if "first" in line)
        assert "second" in lines[first + 1]
        assert lines[first].startswith("2022-10-12 ")
        assert lines[first + 3].startswith(" " * 20)
        assert max(map(len, lines)) <= 80

    run_rig(scenario)
