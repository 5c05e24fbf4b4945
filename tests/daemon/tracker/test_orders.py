"""What is refused while somebody keeps the tracker still."""

from types import SimpleNamespace

import pytest

from daemon.base.clock import SystemClock
from daemon.base.files import StateFolder
from daemon.tracker.orders import Orders
from daemon.tracker.wishes import WishFile
from drivers.errors import RefusedError

COMMANDS = ("stow", "snow", "hold", "goto", "home", "clear", "maintenance")


def refused(*wishes):
    """Return which commands are refused with these wishes in force."""
    orders = Orders(SystemClock(), WishFile(StateFolder(None)))
    for wish in wishes:
        orders.latch(wish, "why", "somebody")
    found = []
    for command in COMMANDS:
        try:
            orders.refuse(command)
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
        orders.refuse("goto")


def test_a_person_at_the_buttons_forbids_everything_but_to_say_so():
    assert refused("buttons") == COMMANDS[:-1]


@pytest.mark.parametrize("wish", ["stow", "snow", "hold"])
def test_other_wishes_forbid_nothing_here(wish):
    assert refused(wish) == ()


class Hand:
    """A clock in hand."""

    now_s = 100.0

    def monotonic(self):
        return self.now_s

    def utc(self):
        return 1.7e9 + self.now_s


def seen(pressed, at_s):
    return SimpleNamespace(button_pressed=pressed, status_monotonic_s=at_s)


def test_a_button_holds_once_and_what_was_seen_before_auto_does_not():
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


def test_in_maintenance_a_button_is_no_news():
    orders = Orders(Hand(), WishFile(StateFolder(None)))
    orders.latch("maintenance", "mirrors", "Ann")
    assert not orders.note_buttons(seen(True, 100.0))
    assert orders.wishes.buttons is None
