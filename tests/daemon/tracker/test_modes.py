"""The state machine as a table."""

from dataclasses import replace

import pytest

from daemon.base.records import Mode
from daemon.tracker.modes import DataState, Situation, next_mode

GOOD = Situation(
    connected=True,
    blocked_why=None,
    doubt_why=None,
    homing=False,
    maintenance_why=None,
    stop_why=None,
    buttons_why=None,
    stow_why=None,
    snow_why=None,
    hold_why=None,
    night_why=None,
    data=DataState.FRESH,
    data_why="fresh",
)
EVERY = list(Mode)


@pytest.mark.parametrize("mode", EVERY)
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, Mode.TRACKING),
        ({"data": DataState.BAD}, Mode.FALLBACK),
        ({"night_why": "dark"}, Mode.NIGHT),
        ({"maintenance_why": "greasing", "blocked_why": "lost", "connected": False, "stop_why": "x"}, Mode.MAINTENANCE),
        ({"buttons_why": "pressed", "stow_why": "wind", "homing": True}, Mode.HOLD),
        ({"snow_why": "hail", "hold_why": "asked", "night_why": "dark"}, Mode.SNOW),
        ({"snow_why": "hail", "stow_why": "wind"}, Mode.STOW),
        ({"snow_why": "hail", "doubt_why": "reset"}, Mode.FAULT),
        ({"stop_why": "hand in the gear", "stow_why": "wind", "homing": True}, Mode.HOLD),
        ({"hold_why": "asked", "night_why": "dark"}, Mode.HOLD),
        ({"doubt_why": "reset", "hold_why": "asked"}, Mode.FAULT),
        ({"homing": True, "doubt_why": "reset"}, Mode.STARTING),
        ({"stow_why": "wind", "homing": True, "doubt_why": "reset", "hold_why": "x", "night_why": "x"}, Mode.STOW),
        ({"blocked_why": "lost", "connected": False, "stow_why": "wind"}, Mode.FAULT),
        ({"connected": False, "stow_why": "wind"}, Mode.STARTING),
    ],
)
def test_unless_readings_are_awaited_the_situation_alone_decides_the_next_mode(mode, change, expected):
    assert next_mode(mode, replace(GOOD, **change))[0] is expected


@pytest.mark.parametrize("mode", EVERY)
def test_while_readings_are_awaited_tracking_and_fallback_go_on_and_every_other_mode_ends(mode):
    after, _ = next_mode(mode, replace(GOOD, data=DataState.WAITING))
    assert after is (mode if mode in (Mode.TRACKING, Mode.FALLBACK) else Mode.STARTING)


@pytest.mark.parametrize(
    ("change", "why"),
    [({"stow_why": "wind 16 m/s"}, "wind 16 m/s"), ({"blocked_why": "unplugged"}, "unplugged"), ({}, "fresh")],
)
def test_every_mode_comes_with_its_reason(change, why):
    assert next_mode(Mode.TRACKING, replace(GOOD, **change))[1] == why


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"stop_why": "stopped by ana", "blocked_why": "a_overcurrent"}, "a_overcurrent; stopped by ana"),
        ({"stop_why": "stopped by ana", "connected": False}, "waiting for the positioner; stopped by ana"),
        ({"buttons_why": "pressed", "blocked_why": "unplugged"}, "unplugged; pressed"),
        ({"blocked_why": "a_overcurrent", "stow_why": "wind"}, "a_overcurrent; stow is wanted and not done (wind)"),
        ({"stop_why": "stopped by ana", "stow_why": "wind"}, "stopped by ana; stow is wanted and not done (wind)"),
        (
            {"maintenance_why": "greasing", "connected": False, "stow_why": "wind", "stop_why": "stopped by ana"},
            "greasing; stopped by ana; waiting for the positioner; stow is wanted and not done (wind)",
        ),
    ],
)
def test_a_reason_that_the_mode_hides_is_named_beside_the_reason_of_the_mode(change, why):
    assert next_mode(Mode.TRACKING, replace(GOOD, **change))[1] == why
