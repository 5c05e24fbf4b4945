"""What holds for all tests of the dashboard."""

import signal

import pytest


@pytest.fixture(autouse=True)
def heard():
    """Let signals act again that have ended a dashboard: the process of the tests goes on."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
