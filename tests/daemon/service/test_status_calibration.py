from datetime import UTC, datetime
from random import Random

import pytest
from rich.console import Console

from daemon.base.clock import LoopClock
from daemon.base.process import SystemdNotifier
from daemon.base.records import Bus
from daemon.commands.status.screen import render
from daemon.config.settings import Settings
from daemon.rigs.simulated import build_simulated_rig, build_weather
from daemon.service.recent import RecentRecords
from daemon.service.rig import Role
from daemon.service.service import Service
from daemon.service.snapshot import snapshot
from daemon.service.state import state_json
from tests.daemon.cube.test_calibration import calibration


def status(now, made):
    settings = Settings()
    clock = LoopClock(lambda: 0.0, now.timestamp())
    weather, _ = build_weather(settings, now.timestamp(), now.timestamp())
    rig = build_simulated_rig(settings, Role.CUBE, clock, weather)
    service = Service(settings, Role.CUBE, rig, clock, Random(1), Bus(), None, SystemdNotifier({}, 0), calibration=made)
    found = state_json(snapshot(service, RecentRecords(), 1.0, None, {}))
    console = Console(width=120)
    with console.capture() as shown:
        console.print(render(found))
    return found["calibration"], [line.strip() for line in shown.get().splitlines() if "calibration" in line]


@pytest.mark.parametrize(
    ("year", "month", "validity", "mark"),
    [(2023, 1, "valid", ""), (2024, 3, "expires soon", "EXPIRES SOON "), (2024, 4, "expired", "EXPIRED ")],
)
def test_the_status_shows_the_calibration_and_whether_it_expires_soon_or_has_expired(year, month, validity, mark):
    made = calibration()
    found, (line,) = status(datetime(year, month, 10, tzinfo=UTC), made)
    assert found["identifier"] == made.identifier
    assert found["validity"] == validity
    assert " ".join(line.split()).startswith(f"calibration {mark}{made.identifier}, until 2024-03-20")


def test_the_status_is_silent_without_a_calibration():
    assert status(datetime(2023, 1, 10, tzinfo=UTC), None) == (None, [])
