"""The simulated scanning meters: bytes in, replies with their due times out, time as an argument."""

from collections.abc import Callable, Collection

import numpy as np

from sim_drivers.scanner.commands import TABLES
from sim_drivers.scanner.instrument import ScannerInstrument, ScannerMake


class ScannerCore(ScannerInstrument):
    """A meter behind its line, with the commands of its make; the parameters are those of `ScannerInstrument`."""

    def __init__(
        self,
        make: ScannerMake,
        sensor_v: Callable[[int, float], float | None],
        random: np.random.Generator,
        *,
        slots: Collection[int] = (1,),
        line_frequency_hz: float = 50.0,
        now: float = 0.0,
    ) -> None:
        super().__init__(make, sensor_v, random, slots=slots, line_frequency_hz=line_frequency_hz, now=now)
        self.table = TABLES[make]
