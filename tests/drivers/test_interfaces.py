"""What drivers tell the service."""

import json
from dataclasses import asdict

import numpy as np

from drivers.interfaces import Telemetry


def test_telemetry_has_numbers_of_python_whatever_a_driver_reckons_with():
    angles = np.array([-12.5, 60.25, 1.0, 2.0, 1.0, 2.0], np.float32)
    told = Telemetry(
        5.0, *angles, homing=np.bool_(1), supply_v=np.int16(24), details={"wind": np.float32(0.5), "is": ""}
    )
    of_python = Telemetry(
        5.0, -12.5, 60.25, 1.0, 2.0, 1.0, 2.0, homing=True, supply_v=24, details={"wind": 0.5, "is": ""}
    )
    assert json.dumps(asdict(told)) == json.dumps(asdict(of_python))
