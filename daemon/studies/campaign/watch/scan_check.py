"""Whether the service takes a scan as good that nobody should believe."""

from collections.abc import Callable

from daemon.base.records import Scan
from daemon.rigs.campaign.faults import FORGED_W_M2

LEAST_W_M2, MOST_W_M2 = -100.0, 2000.0


def check_scan(scan: Scan, fails: Callable[[str, str], None]) -> None:
    """Look at a scan that the service has accepted; `fails` is called with a promise and a text."""
    for face in scan.faces:
        value = face.irradiance_w_m2
        if value == FORGED_W_M2:
            fails("forged", "a scan that nobody with the key has signed was accepted")
        elif scan.ok and not LEAST_W_M2 <= value <= MOST_W_M2:
            fails("implausible", f"an irradiance of {value:g} W/m2 passes for good")
