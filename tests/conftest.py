"""Fixtures for every tier: nothing may leak a thread or a file descriptor out of a test."""

import gc
import os
import socket
import threading
from pathlib import Path

import pytest
from hypothesis import settings

from tests.firmware.peer import missing
from tests.support import SHARED
from tests.support.broker import LEFT_OUT, MOSQUITTO

# Machines are shared and slow now and then; CI draws the same examples every time.
settings.register_profile("heliocube", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("heliocube")

MEASURED = SHARED / "data"


pytest_plugins = ("tests.support.rig", "tests.support.ports", "tests.support.mqtt")

_TIER_OF_FIXTURE = {
    "run_rig": "rig",
    "scaled": "broker",
    "broker": "broker",
    "make_broker": "broker",
    "load_host": "protocol",
    "positioner_host": "protocol",
    "voltmeter_host": "protocol",
    "play": "protocol",
}
_TIER_OF_FOLDER = {"campaign": "campaign", "system": "system"}


def pytest_collection_modifyitems(items):
    """Mark each test with its tier, by what it asks for and where it lies."""
    for item in items:
        tiers = {_TIER_OF_FIXTURE.get(name) for name in item.fixturenames}
        tiers |= {_TIER_OF_FOLDER.get(part) for part in item.path.parts}
        for tier in tiers - {None}:
            item.add_marker(tier)


def pytest_report_header():
    """Say once, in a line each, what cannot be tested here."""
    broker = (
        None if MOSQUITTO else f"mosquitto is not here: the tests of MQTT run against amqtt and leave out {LEFT_OUT}"
    )
    return [line for line in (broker, missing()) if line]


@pytest.fixture(autouse=True)
def nothing_leaks():
    """Fail a test that leaves a thread or a file descriptor behind."""
    threads = set(threading.enumerate())
    descriptors = _descriptors()
    yield
    gc.collect()
    left = [t for t in threading.enumerate() if t not in threads and t.is_alive()]
    for thread in left:
        thread.join(timeout=1.0)
    assert not [t.name for t in left if t.is_alive()], "the test left threads running"
    opened = {number: target for number, target in _descriptors().items() if number not in descriptors}
    assert not opened, f"the test left file descriptors open: {opened}"


def _descriptors() -> dict[str, str]:
    found = {}
    for entry in Path("/proc/self/fd").iterdir():
        try:
            target = str(entry.readlink())
        except OSError:
            continue
        # Regular files of imported data (time zones, compiled caches) are the interpreter's, not the test's.
        if target.startswith(("socket:", "pipe:", "/dev/pt", "anon_inode:")) or (
            "/tmp" in target and "site-packages" not in target
        ):
            found[entry.name] = target
    return found


@pytest.fixture(scope="session")
def measured() -> Path:
    """The folder of measured weather beside the repository."""
    if not MEASURED.is_dir():
        pytest.skip(f"the measured data is not at {MEASURED}")
    return MEASURED


@pytest.fixture
def free_udp_port() -> int:
    """A UDP port on loopback that was free a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
