"""What drivers tell the service."""

import json
from dataclasses import asdict, replace

import numpy as np

from drivers.interfaces import Telemetry


def test_telemetry_turns_numpy_numbers_of_a_driver_into_python_numbers():
    angles = np.array([-12.5, 60.25, 1.0, 2.0, 1.0, 2.0], np.float32)
    told = Telemetry(
        5.0, *angles, homing=np.bool_(1), supply_v=np.int16(24), details={"wind": np.float32(0.5), "is": ""}
    )
    of_python = Telemetry(
        5.0, -12.5, 60.25, 1.0, 2.0, 1.0, 2.0, homing=True, supply_v=24, details={"wind": 0.5, "is": ""}
    )
    assert json.dumps(asdict(told)) == json.dumps(asdict(of_python))


def test_telemetry_repeated_at_a_later_time_keeps_all_other_values():
    look = Telemetry(5.0, -12.5, 60.25, 1.0, 2.0, 3.0, 4.0, faults=("a_cable",), supply_v=24.0, details={"mode": "ok"})
    assert look.with_time(7.5) == replace(look, time_monotonic_s=7.5, status_monotonic_s=7.5)
