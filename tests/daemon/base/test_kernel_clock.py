"""What the kernel says about its clock."""

import ctypes

import pytest

from daemon.base import kernel_clock


class Libc:
    """A C library whose kernel gives the answers of a test."""

    def __init__(self, state, maxerror_us):
        self._state, self._maxerror_us = state, maxerror_us

    def adjtimex(self, found):
        found._obj.maxerror = self._maxerror_us
        return self._state


@pytest.mark.parametrize(
    ("platform", "state", "maxerror_us", "expected"),
    [
        ("linux", 0, 25_000, True),
        ("linux", 5, 15_999_999, True),
        ("linux", 5, 16_000_000, False),
        ("linux", -1, 16_000_000, None),
        ("win32", 5, 16_000_000, None),
    ],
)
def test_the_clock_counts_as_unsynchronised_from_a_maximum_error_of_16_s_on(
    monkeypatch, platform, state, maxerror_us, expected
):
    monkeypatch.setattr(kernel_clock.sys, "platform", platform)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: Libc(state, maxerror_us))
    assert kernel_clock.synchronised() is expected


def test_asking_the_kernel_of_this_machine_for_its_clock_state_succeeds():
    assert kernel_clock.synchronised() in (True, False, None)
