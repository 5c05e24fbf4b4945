"""The maker's firmware as a peer; where it or its emulator is not there, one line says so and the tier is left out."""

import pytest

from .live import LiveFirmware
from .peer import missing


def pytest_collection_modifyitems(items):
    """Mark the tier, and leave it out where it cannot run."""
    why = missing()
    for item in items:
        if "tests/firmware/" in item.nodeid:
            item.add_marker(pytest.mark.firmware)
            if why:
                item.add_marker(pytest.mark.skip(reason=why))


@pytest.fixture
def start_firmware(tmp_path):
    """Start a powered-up, provisioned unit on a pseudo-terminal, its axes at the angles given."""
    started = []

    def start(a_deg=0.0, b_deg=90.0):
        started.append(LiveFirmware(tmp_path / "positioner", a_deg, b_deg))
        return started[-1]

    yield start
    for firmware in started:
        firmware.end()
