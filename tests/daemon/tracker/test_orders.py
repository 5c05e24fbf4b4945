"""What is refused while somebody keeps the tracker still."""

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
