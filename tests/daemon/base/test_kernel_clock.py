"""What the kernel says of its clock."""

import ctypes

import pytest

from daemon.base import kernel_clock


class Libc:
    """A C library whose kernel answers as told."""

    def __init__(self, state, status):
        self._state, self._status = state, status

    def adjtimex(self, found):
        found._obj.status = self._status
        return self._state


@pytest.mark.parametrize(
    ("platform", "state", "status", "expected"),
    [
        ("linux", 0, 0x2001, True),
        ("linux", 5, 0x0040, False),
        ("linux", 5, 0x2041, False),
        ("linux", -1, 0x0040, None),
        ("win32", 5, 0x0040, None),
    ],
)
def test_unsynchronised_is_one_bit_of_the_status(monkeypatch, platform, state, status, expected):
    monkeypatch.setattr(kernel_clock.sys, "platform", platform)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: Libc(state, status))
    assert kernel_clock.synchronised() is expected


def test_this_machine_answers():
    assert kernel_clock.synchronised() in (True, False, None)
