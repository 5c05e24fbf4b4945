"""How far the laws may move in a day, to the last move and the last degree."""

import pytest

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import SystemClock
from daemon.base.state import StateFolder
from daemon.config.sections import MotionSettings
from daemon.tracker.budget import DayBudget
from solar.ephemeris import Site

DAY_S = 86400.0
# Solar midnight at 90 deg east is 18:00 UTC. On the equator the day there lasts from six to six, solar time.
EAST, MIDNIGHT_UTC_S = Site(0.0, 90.0, 0.0), 19_000 * DAY_S - 21_600.0
HOUR_S = 3600.0
SETTINGS = MotionSettings(moves_per_day=100, travel_per_day_deg=400.0)


class Budget(DayBudget):
    """A budget with its alarms within reach."""

    def __init__(self, folder=None, utc_s=MIDNIGHT_UTC_S):
        self.told = Alarms(SystemClock(), lambda _record: None)
        super().__init__(SETTINGS, EAST, StateFolder(folder), self.told, utc_s)

    @property
    def texts(self):
        return [alarm.text for alarm in self.told.active]

    def spend(self, moves, each_deg):
        for _ in range(moves):
            self.book(each_deg)
        return self


def left(budget):
    return budget.moves_left, budget.travel_left_deg


def test_the_moves_and_degrees_left_are_counted_down_to_zero_and_not_below():
    budget = Budget()
    assert left(budget) == (100, 400.0)
    assert left(budget.spend(10, 2.5)) == (90, 375.0)
    assert left(budget.spend(91, 5.0)) == (0, 0.0)


@pytest.mark.parametrize(("moves", "each_deg", "next_deg", "refused"), [
    (99, 1.0, 1.0, False),
    (100, 1.0, 0.5, True),
    (10, 30.0, 100.0, False),
    (10, 30.0, 100.5, True),
    (10, 40.0, 0.5, True),
])  # fmt: skip
def test_the_last_move_and_the_last_degree_are_allowed_and_no_more(moves, each_deg, next_deg, refused):
    budget = Budget().spend(moves, each_deg)
    account = f"{moves} moves of 100, {moves * each_deg:.0f} deg of 400; see motion.moves_per_day"
    why = budget.refusal(next_deg)
    assert (why is not None) == refused
    if refused:
        assert why.startswith(f"the laws have used up the day's budget of motion: {account}")
        assert budget.texts == [why]


@pytest.mark.parametrize(("moves", "each_deg", "kept"), [
    (76, 1.0, False), (10, 30.0, False), (10, 30.1, True),
])  # fmt: skip
def test_the_last_quarter_of_the_travel_is_kept_for_following_the_sun_and_an_alarm_says_so(moves, each_deg, kept):
    budget = Budget().spend(moves, each_deg)
    assert budget.is_reserved_for_sun == kept
    assert [text.partition(" (")[0] for text in budget.texts] == [
        "three quarters of the day's budget of travel are used"
    ] * kept


@pytest.mark.parametrize(("hour", "moves", "waits"), [
    (5.5, 90, False),
    (6.5, 13, False),
    (6.5, 15, True),
    (12.0, 54, False),
    (12.0, 57, True),
    (17.5, 95, False),
    (17.5, 98, True),
    (17.5, 100, False),
    (18.5, 99, False),
])  # fmt: skip
def test_the_moves_of_a_day_are_spread_until_sunset_and_a_tenth_may_be_made_early(hour, moves, waits):
    why = Budget().spend(moves, 1.0).waits_why(MIDNIGHT_UTC_S + hour * HOUR_S)
    assert (why is not None) == waits
    assert why is None or why == "waits, because the day's 100 moves are to last until sunset"


def test_the_budget_begins_anew_at_solar_midnight():
    budget = Budget().spend(80, 1.0)
    budget.begin_day_if_due(MIDNIGHT_UTC_S + DAY_S - 1.0)
    assert left(budget) == (20, 320.0)
    budget.begin_day_if_due(MIDNIGHT_UTC_S + DAY_S)
    assert left(budget) == (100, 400.0)
    assert budget.texts == []


def test_the_used_budget_and_the_beginning_of_a_new_day_are_kept_over_a_restart(tmp_path):
    Budget(tmp_path).spend(30, 2.0)
    again = Budget(tmp_path, MIDNIGHT_UTC_S + 3600.0)
    assert left(again) == (70, 340.0)
    again.begin_day_if_due(MIDNIGHT_UTC_S + DAY_S)
    assert left(Budget(tmp_path)) == (100, 400.0)


def test_a_clock_in_1970_does_not_lose_the_count_of_the_day_to_which_it_is_set_later(tmp_path):
    noon_utc_s = MIDNIGHT_UTC_S + 12 * HOUR_S
    Budget(tmp_path).spend(30, 2.0)
    for _ in range(2):
        unset = Budget(tmp_path, 5.0)
        unset.begin_day_if_due(5.0)
        assert left(unset) == (100, 400.0)
        unset.spend(5, 2.0)
    unset.begin_day_if_due(noon_utc_s)
    assert left(unset) == left(Budget(tmp_path)) == (60, 320.0)
    unset.begin_day_if_due(noon_utc_s + DAY_S)
    assert left(unset) == left(Budget(tmp_path)) == (100, 400.0)


def test_a_kept_count_of_a_future_day_does_not_limit_the_moves_of_today(tmp_path):
    Budget(tmp_path, MIDNIGHT_UTC_S + 9000 * DAY_S).spend(100, 2.0)
    budget = Budget(tmp_path)
    budget.begin_day_if_due(MIDNIGHT_UTC_S)
    assert left(budget) == (100, 400.0)
    budget.begin_day_if_due(MIDNIGHT_UTC_S + DAY_S)
    assert left(Budget(tmp_path)) == (100, 400.0)


def test_an_unreadable_count_file_is_logged_and_the_count_begins_at_zero_again(tmp_path, caplog):
    (tmp_path / "day.json").write_text('{"day": 19000, "moves": -1}')
    assert left(Budget(tmp_path)) == (100, 400.0)
    assert "the moves of the day are counted from zero again" in caplog.text
