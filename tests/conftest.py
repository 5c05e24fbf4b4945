"""Fixtures for every tier; the check that no test leaks anything is in tests/support/leaks.py."""

import gc
import os
import shutil
import signal
import socket
from pathlib import Path

import pytest
from hypothesis import settings

from tests.firmware.peer import missing
from tests.support import SHARED
from tests.support.addresses import free_port, reserve_port_block
from tests.support.bad_network import why_no_namespaces
from tests.support.broker import MOSQUITTO, UNTESTED_WITH_AMQTT
from tests.support.dealing import contains_any_word, distribute_tests, long_first
from tests.support.postgres import BINARIES, WITHOUT_POSTGRES
from tests.support.rotctld import LEFT_OUT as WITHOUT_ROTCTLD
from tests.support.rotctld import ROTCTLD

# Garbage collection in the middle of tests took a twentieth of their time; each ends with it (tests/support/leaks.py).
gc.set_threshold(100_000, 20, 20)
# Started in the background of a script, the tests would ignore Ctrl-C, and so would their children.
signal.signal(signal.SIGINT, signal.default_int_handler)
# Under nohup they would ignore SIGHUP, by which some tests end their children: those would go on.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
# Machines are shared and slow now and then; CI draws the same examples every time.
settings.register_profile("heliocube", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("heliocube")

MEASURED = SHARED / "data"


pytest_plugins = (
    "tests.support.forks",
    "tests.support.leaks",
    "tests.support.rig",
    "tests.support.api",
    "tests.support.command_line",
    "tests.support.ports",
    "tests.support.mqtt",
    "tests.support.archive",
)

_TIER_OF_FIXTURE = {
    "run_rig": "rig",
    "run_scaled": "broker",
    "broker": "broker",
    "make_broker": "broker",
    "postgres": "system",
    "database": "system",
    "load_host": "protocol",
    "positioner_host": "protocol",
    "voltmeter_host": "protocol",
    "play": "protocol",
    "start_rotctld": "protocol",
    # A unit on a port at its own pace, not the one in lock step.
    "start_firmware": "live",
}
_TIER_OF_FOLDER = {"campaign": "campaign", "system": "system"}
_LIVE = {"broker", "protocol", "system"}
_TAKES_LONG = {"rig", "campaign", "firmware", "shared_data"}
# A file, or a folder above it, must contain one of these if one of its tests passes real time.
_WAITS = [
    *(f"mark.{tier}" for tier in (*_LIVE, "live")),
    *(fixture for fixture, tier in _TIER_OF_FIXTURE.items() if tier in {*_LIVE, "live"}),
]


def pytest_configure():
    reserve_port_block()


def pytest_addoption(parser):
    parser.addoption(
        "--live",
        choices=("with", "only", "without"),
        default="with",
        help="tests that pass real time: with the others (default), only those, or all others",
    )
    parser.addoption("--quick", action="store_true", help="only fast tests: not the live and slow ones, nor whole rigs")


def pytest_ignore_collect(collection_path, config):
    """Skip importing a file in which nothing waits, if only tests that wait are asked for."""
    if config.getoption("--live") != "only" or not collection_path.match("test_*.py"):
        return None
    return None if _may_wait(collection_path) else True


def _may_wait(file):
    return any(_TIER_OF_FOLDER.get(part) in _LIVE for part in file.parts) or contains_any_word(file, _WAITS)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect no garbage while tests are collected, nor their objects later: it took a fifth of each worker's time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_unconfigure():
    """Leave the rest of the memory to the end of the process; pytest would search it for garbage five times."""
    gc.freeze()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark each test with its tier, by its fixtures and its folder, and keep those that are asked for.

    This hook runs before all others: `-m` chooses among the tiers. And without tests that use hypothesis, that plugin
    does not read all our source for constants, which took a fifth of a worker's time before its first test. The order
    made after the others is final.
    """
    _mark(items)
    left_out = [item for item in items if not _is_asked_for(config, item)]
    if left_out:
        gone = set(left_out)
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in gone]
    yield
    workers = getattr(config, "workerinput", {}).get("workercount", 1)
    if config.getoption("--live") == "only" and workers > 1:
        items[:] = distribute_tests(items, workers)
    elif workers > 1:
        items[:] = long_first(items)


def _mark(items):
    for item in items:
        tiers = {_TIER_OF_FIXTURE.get(name) for name in item.fixturenames}
        tiers |= {_TIER_OF_FOLDER.get(part) for part in item.path.parts}
        for tier in tiers - {None}:
            item.add_marker(tier)
        marks = {mark.name for mark in item.iter_markers()}
        if marks & _LIVE and "computes" not in marks:
            item.add_marker("live")
        if item.get_closest_marker("live") and not _may_wait(item.path):
            raise pytest.UsageError(f"{item.nodeid} waits, and `--live only` would not find it: see {__file__}")


def _is_asked_for(config, item):
    marks = {mark.name for mark in item.iter_markers()}
    live = "live" in marks
    if config.getoption("--quick") and (live or marks & {*_TAKES_LONG, "slow"}):
        return False
    return {"with": True, "only": live, "without": not live}[config.getoption("--live")]


def pytest_report_header():
    """Say once, in a line each, what cannot be tested here."""
    broker = (
        None
        if MOSQUITTO
        else f"mosquitto is not here: the tests of MQTT run against amqtt and leave out {UNTESTED_WITH_AMQTT}"
    )
    mbpoll = None if shutil.which("mbpoll") else "mbpoll is not here: its tests of Modbus are left out"
    archive = None if BINARIES else WITHOUT_POSTGRES
    rotator = None if ROTCTLD else WITHOUT_ROTCTLD
    return [line for line in (broker, mbpoll, missing(), rotator, archive, why_no_namespaces()) if line]


@pytest.fixture(scope="session")
def measured() -> Path:
    """The folder of measured weather beside the repository."""
    if not MEASURED.is_dir():
        pytest.skip(f"the measured data is not at {MEASURED}")
    return MEASURED


@pytest.fixture
def free_udp_port() -> int:
    """A UDP port on loopback that is free."""
    return free_port(socket.SOCK_DGRAM)
