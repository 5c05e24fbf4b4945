"""Which keys stop a move, on a pseudo-terminal."""

import os
import pty
import select

import pytest

from daemon.commands.setup.any_key import stop_keys
from tests.support import PATIENCE_S


@pytest.mark.parametrize("key", [b"x", b"\x1a", b"\x1c", b"\x13"], ids=["x", "Ctrl-Z", "Ctrl-\\", "Ctrl-S"])
def test_any_key_stops_a_move_even_if_it_has_a_special_meaning_for_the_terminal(monkeypatch, key):
    ours, theirs = pty.openpty()
    with os.fdopen(ours, "wb", 0) as person, os.fdopen(theirs) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        with stop_keys() as keys:
            assert not keys.pressed()
            person.write(key)
            select.select([terminal], [], [], PATIENCE_S)
            assert keys.pressed()
            assert not keys.exit_requested
