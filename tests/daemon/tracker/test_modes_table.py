"""What holds in every possible situation, and the page that shows it."""

import importlib.util
from dataclasses import replace

import pytest

from daemon.base.records import Mode
from daemon.tracker.modes import DataState, Situation, next_mode
from tests.support import DOCS

MOVING = {Mode.TRACKING, Mode.FALLBACK, Mode.NIGHT, Mode.STOW, Mode.SNOW}


@pytest.fixture(scope="module")
def modes_table():
    specification = importlib.util.spec_from_file_location("modes_table", DOCS / "modes_table.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def every(modes_table):
    """Every situation with the mode and the reason that follow from every mode."""
    return [(s, mode, *next_mode(mode, s)) for s in modes_table.situations() for mode in Mode]


def test_the_page_of_the_modes_in_the_docs_is_up_to_date(modes_table):
    assert modes_table.PAGE.read_text(encoding="utf-8") == modes_table.page(), "run: python docs/modes_table.py"


def test_the_table_of_modes_covers_every_field_of_a_situation_and_reaches_every_mode(modes_table, every):
    assert set(Situation.__dataclass_fields__) == {*modes_table.CONDITIONS, "data", "data_why"}
    assert len(every) == 2**11 * 3 * len(Mode)
    assert {after for *_, after, _ in every} == set(Mode)


@pytest.mark.parametrize(
    ("sentence", "holds"),
    [
        ("in maintenance nothing else is done", lambda s, m: not s.maintenance_why or m is Mode.MAINTENANCE),
        ("only maintenance makes the mode so", lambda s, m: bool(s.maintenance_why) or m is not Mode.MAINTENANCE),
        ("a stop never yields a mode that moves", lambda s, m: not s.stop_why or m not in MOVING),
        ("nor does a person at the buttons", lambda s, m: not s.buttons_why or m not in MOVING),
        ("a stop that can be carried out is a hold", lambda s, m: not _stopped(s) or m is Mode.HOLD),
        ("what is blocked never moves", lambda s, m: not s.blocked_why or m not in MOVING),
        ("nor what is not connected", lambda s, m: s.connected or m not in MOVING),
        ("stow goes before all but people and what cannot move", lambda s, m: not _can_stow(s) or m is Mode.STOW),
        ("nothing else stows", lambda s, m: bool(s.stow_why) or m is not Mode.STOW),
        ("in doubt nothing moves but a stow", lambda s, m: not s.doubt_why or m is Mode.STOW or m not in MOVING),
        ("during a homing run no law steers", lambda s, m: not s.homing or m not in MOVING - {Mode.STOW}),
        ("a held tracker does not track", lambda s, m: not s.hold_why or m not in {Mode.TRACKING, Mode.NIGHT}),
        ("a hold is somebody's", lambda s, m: m is not Mode.HOLD or bool(s.stop_why or s.buttons_why or s.hold_why)),
        (
            "without good readings no law but the sun's steers",
            lambda s, m: s.data is not DataState.BAD or m is not Mode.TRACKING,
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_next_mode_obeys_the_rule_in_every_situation(every, sentence, holds):
    assert not [(s, before) for s, before, after, _ in every if not holds(s, after)]


def test_the_mode_before_affects_the_next_mode_only_while_readings_are_awaited(every):
    afters = {}
    for situation, _, after, _ in every:
        afters.setdefault(situation, set()).add(after)
    for situation, found in afters.items():
        if len(found) > 1:
            assert situation.data is DataState.WAITING
            assert found == {Mode.STARTING, Mode.TRACKING, Mode.FALLBACK}


def test_the_reason_names_who_stopped_the_tracker_or_put_it_in_maintenance_in_every_situation(modes_table):
    for situation in modes_table.situations():
        named = {
            f"{name}_why": f"{name} by ana" for name in ("maintenance", "stop") if getattr(situation, f"{name}_why")
        }
        why = next_mode(Mode.TRACKING, replace(situation, **named))[1]
        assert all(text in why for text in named.values())


def _stopped(s):
    return s.stop_why and s.connected and not s.blocked_why and not s.maintenance_why


def _can_stow(s):
    return s.stow_why and s.connected and not (s.blocked_why or s.maintenance_why or s.stop_why or s.buttons_why)
