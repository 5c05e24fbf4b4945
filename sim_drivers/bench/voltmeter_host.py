"""The simulated voltmeter on its serial line."""

from collections.abc import Callable
from pathlib import Path

from sim_drivers.bench.line_host import LineHost
from sim_drivers.voltmeter.core import VoltmeterCore

BAUD_RATES = (300, 600, 1200, 2400, 4800, 9600, 19200)
_BITS_PER_BYTE = 10


class VoltmeterHost(LineHost[VoltmeterCore]):
    """The meter behind its port.

    Parameters
    ----------
    core
        The simulated instrument.
    link
        Path of the port.
    now
        The event loop's time [s].
    baud_rate
        As chosen on the front panel. The port has no rate of its own, so a user's is not compared with it.
    """

    def __init__(self, core: VoltmeterCore, link: Path, now: Callable[[], float], baud_rate: int) -> None:
        if baud_rate not in BAUD_RATES:
            raise ValueError(f"the meter has the baud rates {BAUD_RATES}, not {baud_rate}")
        super().__init__(core, link, now, _BITS_PER_BYTE / baud_rate)
