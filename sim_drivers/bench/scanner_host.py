"""The simulated scanning meter behind its port."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from sim_drivers.bench.line_host import LineHost
from sim_drivers.scanner.core import ScannerCore

# 10 bits a byte at 9600 baud, as these meters leave the factory.
_BYTE_S = 10 / 9600


class ScannerHost(LineHost[ScannerCore]):
    """A meter that is the cube.

    Parameters
    ----------
    core
        The simulated meter.
    link
        Path of the port.
    now
        The event loop's time [s].
    """

    def __init__(self, core: ScannerCore, link: Path, now: Callable[[], float]) -> None:
        super().__init__(core, link, now, _BYTE_S)

    @property
    def line(self) -> "ScannerHost":
        """What runs and is plugged in: the meter itself."""
        return self

    async def start(self) -> None:
        """Plug it in."""
        self.port.plug()

    async def stop(self) -> None:
        """Pull it out."""
        self.port.unplug()

    async def unplug(self) -> None:
        """Pull its plug."""
        self.port.unplug()

    async def replug(self) -> None:
        """Plug it in again."""
        self.port.plug()

    def state(self) -> dict[str, Any]:
        """Return who is there."""
        return {"plugged": self.port.plugged, "in_use": self.port.in_use, "make": self.core.make}
