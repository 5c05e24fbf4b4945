"""Days that pass quickly, an operator, and where the tracker stands afterwards."""

import asyncio
from datetime import datetime

import pytest

from daemon.motion.polling import Polling
from daemon.service.operator import Operator

FEWER_SCANS = {"cube": {"scan_every_s": 20}, "safety": {"scan_stale_s": 65, "fallback_after_s": 130}}
SLOW = {"cube": {"scan_every_s": 60}, "safety": {"scan_stale_s": 130, "fallback_after_s": 600}}


def operator(rig):
    return Operator(rig.tracker, 1.0)


def pass_quietly(rig, until):
    """Let time jump to this instant, for hours in which nothing happens."""
    # With them the looks at the positioner are left out; nothing depends on these.
    rig.motion._polling = Polling(idle_s=86400.0)
    asyncio.get_running_loop().skip(datetime.fromisoformat(f"{until}Z").timestamp() - rig.clock.utc())


def at(a_deg, b_deg):
    return pytest.approx(a_deg, abs=0.9), pytest.approx(b_deg, abs=0.9)
