"""What is refused while a person keeps the tracker still."""

from types import SimpleNamespace

import pytest

from daemon.base.clock import SystemClock
from daemon.base.records import Target
from daemon.base.state import StateFolder
from daemon.tracker.orders import Orders
from daemon.tracker.wishes import Wishes, WishFile
from drivers.errors import RefusedError

COMMANDS = ("stow", "snow", "hold", "goto", "home", "clear", "maintenance")


def refused(*wishes):
    """Return the commands that are refused with these wishes in force."""
    orders = Orders(SystemClock(), WishFile(StateFolder(None)))
    for wish in wishes:
        orders.latch(wish, "why", "somebody")
    found = []
    for command in COMMANDS:
        try:
            orders.refuse_if_stopped(command)
        except RefusedError:
            found.append(command)
    return tuple(found)


@pytest.mark.parametrize("wishes", [("stop",), ("maintenance",), ("stop", "buttons"), ("maintenance", "buttons")])
def test_a_stop_and_maintenance_forbid_everything(wishes):
    assert refused(*wishes) == COMMANDS


def test_a_refusal_says_how_the_tracker_is_released():
    orders = Orders(SystemClock(), WishFile(StateFolder(None)))
    orders.latch("stop", "ladder", "Ann")
    with pytest.raises(RefusedError, match=r"no goto: the tracker is stopped .*only 'heliocube auto' releases it"):
        orders.refuse_if_stopped("goto")


def test_a_person_at_the_buttons_forbids_every_command_but_maintenance():
    assert refused("buttons") == COMMANDS[:-1]


@pytest.mark.parametrize("wish", ["stow", "snow", "hold"])
def test_a_stow_a_snow_or_a_hold_in_force_forbids_no_command_in_orders(wish):
    assert refused(wish) == ()


class Hand:
    """A clock that a test sets."""

    now_s = 100.0

    def monotonic(self):
        return self.now_s

    def utc(self):
        return 1.7e9 + self.now_s


def seen(pressed, at_s):
    return SimpleNamespace(button_pressed=pressed, status_monotonic_s=at_s)


def test_a_pressed_button_holds_the_tracker_once_and_a_press_seen_before_auto_does_not():
    orders = Orders(Hand(), WishFile(StateFolder(None)))
    assert not orders.note_buttons(None)
    assert not orders.note_buttons(seen(False, 100.0))
    assert orders.wishes.buttons is None
    assert orders.note_buttons(seen(True, 100.0))
    assert orders.wishes.buttons is not None
    assert not orders.note_buttons(seen(True, 101.0)), "known already"
    orders.release()
    assert not orders.note_buttons(seen(True, 100.0)), "seen before"
    assert not orders.note_buttons(seen(True, float("nan")))
    assert orders.wishes.buttons is None
    assert orders.note_buttons(seen(True, 100.1))


def test_a_button_that_is_pressed_during_maintenance_does_not_hold_the_tracker():
    orders = Orders(Hand(), WishFile(StateFolder(None)))
    orders.latch("maintenance", "mirrors", "Ann")
    assert not orders.note_buttons(seen(True, 100.0))
    assert orders.wishes.buttons is None


def elsewhere():
    """Return orders that hold the tracker at a place, and stow it."""
    orders = Orders(Hand(), WishFile(StateFolder(None)))
    orders.latch("hold", "mirrors", "Ann")
    orders.latch("stow", "hail", "Ann")
    orders.hold_at = Target(10.0, 60.0, "mirrors")
    return orders


def test_release_ends_every_wish_with_the_place_of_a_hold_and_the_reason_to_stow():
    orders = elsewhere()
    assert orders.stow.reason(0.0) == "hail"
    orders.release()
    assert (orders.wishes, orders.hold_at, orders.stow.reason(0.0)) == (Wishes(), None, None)


def test_a_persons_stow_that_is_replaced_by_a_hold_is_no_reason_to_stow_any_more():
    orders = elsewhere()
    orders.latch("hold", "look", "Ann", instead_of="stow")
    assert (orders.wishes.stow, orders.stow.reason(0.0)) == (None, None)


def test_a_pressed_button_holds_the_tracker_where_it_stands_and_not_at_the_place_of_a_hold():
    orders = elsewhere()
    assert orders.note_buttons(seen(True, 100.0))
    assert orders.hold_at is None


def test_a_wish_of_a_person_from_before_a_restart_takes_precedence_over_a_hold_by_the_program(tmp_path):
    new = Orders(Hand(), WishFile(StateFolder(tmp_path / "new")), hold_why="a new release")
    assert new.wishes.held_by_program
    assert Orders(Hand(), WishFile(StateFolder(tmp_path / "new"))).wishes.held_by_program, "at the next start too"
    asked = Orders(Hand(), WishFile(StateFolder(tmp_path)))
    assert asked.wishes == Wishes()
    asked.latch("stow", "hail", "Ann")
    asked.keep()
    again = Orders(Hand(), WishFile(StateFolder(tmp_path)), hold_why="a new release")
    assert (again.stow.reason(0.0), again.wishes.hold) == ("hail", None)
