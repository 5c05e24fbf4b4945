"""What a bench can be told."""

from typing import NamedTuple

from sim_drivers.load.instrument import TRIPS
from sim_drivers.pozsol.core import FAULTS
from sim_drivers.rotctld.core import ROTATOR_FAULTS

DEVICES = ("positioner", "voltmeter", "multiplexer", "server", "load", "cube")
"""Everything that has a plug; the server is the NI gRPC server, not the device behind it."""
PYRANOMETER_ACTIONS = ("silent", "speaks", "delay S", "corrupt COUNT", "status BITS", "mode N", "address N")
"""What one sensor of a cube on Modbus can be made to do."""


class Verb(NamedTuple):
    """What a command takes and what it does."""

    usage: str
    meaning: str


VERBS = {
    "state": Verb("", "the truth as JSON: sun, sky, faces, pose, instruments"),
    "unplug": Verb("DEVICE [SECONDS]", f"pull a plug: {', '.join(DEVICES)}"),
    "replug": Verb("DEVICE", "plug it in again"),
    "freeze": Verb("DEVICE", "let a device hang; a hanging positioner is also one in its bootloader"),
    "thaw": Verb("DEVICE", "let it go on"),
    "delay": Verb("DEVICE SECONDS", "replies of voltmeter, load or multiplexer come this much later; 0 ends it"),
    "drop": Verb("DEVICE [COUNT]", "lose the next replies of voltmeter or load, screens of the positioner"),
    "corrupt": Verb("DEVICE [COUNT]", "garble one byte of each of the next ones"),
    "fail": Verb("CODE [COUNT]", "the next writes to the multiplexer fail with this NI error"),
    "overcurrent": Verb("AXIS", "latch an overcurrent of axis a or b"),
    "hall-loss": Verb("AXIS [on|off]", "take an axis's Hall pulses away, or give them back"),
    "end-switch": Verb("AXIS closed|open|works", "let an axis's low end switch stick"),
    "inject": Verb("FAULT", f"any fault of the positioner: {', '.join(FAULTS)}"),
    "repair": Verb("FAULT", "end it"),
    "mux-line": Verb("BIT high|low|works", "let address line 0, 1 or 2 stick; works frees all"),
    "shade": Verb("FACE SHARE", "let only a share (0 to 1) of the light reach a face"),
    "sensor": Verb("FACE VOLT|works", "let a sensor give one voltage, whatever falls on it"),
    "pyranometer": Verb("FACE WHAT [VALUE]", f"of a cube on Modbus: {', '.join(PYRANOMETER_ACTIONS)}"),
    "rotator": Verb("WHAT on|off", f"of a rotator: {', '.join(ROTATOR_FAULTS)}"),
    "turn": Verb("AZIMUTH ELEVATION", "turn the rotator [deg] as another client of its rotctld would"),
    "power-cycle": Verb("DEVICE [kept|lost]", "off and on; what the positioner's count does"),
    "restart": Verb("SECONDS", "restart the positioner, its USB stays: silent for this long, then its banner"),
    "boots-at-open": Verb("SECONDS|never", "let the positioner restart so long whenever its port is opened"),
    "trip": Verb("PROTECTION", f"latch a protection of the load: {', '.join(TRIPS)}"),
    "identity": Verb("DEVICE TEXT", "let voltmeter, load or positioner say that it is something else"),
}
"""All commands; each is a method of `sim_drivers.bench.control.BenchControl`."""
