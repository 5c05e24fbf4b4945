"""The tier of the maker's firmware: left out, with one line, where the emulator or the firmware is missing."""

import contextlib

import pytest

from tests.firmware import peer, recorded
from tests.firmware.live import LiveFirmware


def pytest_collection_modifyitems(items):
    """Mark this tier's tests, and skip them where they cannot run."""
    missing = peer.missing()
    for item in items:
        if "firmware" in item.path.parts:
            item.add_marker(pytest.mark.firmware)
            if missing and ("lock_step" in item.fixturenames or "recorded" not in item.fixturenames):
                item.add_marker(pytest.mark.skip(reason=missing))


@pytest.fixture(scope="session")
def lock_step():
    """The module that runs the firmware in lock step."""
    return peer.driver()


@pytest.fixture(scope="session", name="recorded")
def _recorded():
    """What the maker's firmware did, by kind of sequence: its fingerprint, and the recording of each seed."""
    return {which: recorded.read(which) for which in recorded.MAKERS}


@pytest.fixture
def unit(lock_step):
    """The maker's firmware, powered up and provisioned, in lock step: A at 0, B at 90 degrees."""
    firmware = peer.Firmware(lock_step, 0.0, 90.0)
    yield firmware
    firmware.close()


@pytest.fixture(scope="session")
def powered_up(lock_step):
    """Where such a unit stands, to let simulated ones begin alike: it stands at the same place each time."""
    with contextlib.closing(peer.Firmware(lock_step, 0.0, 90.0)) as firmware:
        return firmware.stands()


@pytest.fixture
def start_firmware(tmp_path, monkeypatch):
    """Start a powered-up, provisioned unit on a pseudo-terminal, its axes at the angles given."""
    # It reports its status every 3 s of its own time, which passes more slowly on a busy machine.
    monkeypatch.setattr("drivers.positioners.pozsol.positioner._STATUS_SHOWS_S", 20.0)
    started = []

    def start(a_deg=0.0, b_deg=90.0, **how):
        started.append(LiveFirmware(tmp_path / "positioner", a_deg, b_deg, **how))
        return started[-1]

    yield start
    for firmware in started:
        firmware.end()
