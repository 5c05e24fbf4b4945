"""The simulated electronic load in this process."""

import asyncio
from collections.abc import Callable

import numpy as np

from drivers.interfaces import SweepPlan, SweptCurve
from sim_drivers.load.core import MEASURING_S, LoadCore
from sim_drivers.load.instrument import OVERFLOW
from sim_drivers.transports.link import Cabled


class InMemoryLoad(Cabled):
    """The load over its simulated line, a whole sweep at a time: the light goes evenly from its start to its end.

    Parameters
    ----------
    core
        The simulated instrument.
    now
        The event loop's time [s].
    settle_s, least_v
        Time from a new voltage to its measurement; the sweep ends at the first voltage below the second.
    """

    def __init__(
        self, core: LoadCore, now: Callable[[], float], *, settle_s: float = 0.03, least_v: float = 3.0
    ) -> None:
        super().__init__("load")
        self._core = core
        self._now = now
        self._settle_s = settle_s
        self._least_v = least_v

    async def open(self) -> str:
        """Connect, and leave the input off in constant voltage."""
        self._connect()
        self._core.switch(self._now(), on=False)
        self._core.set_mode(self._core.dialect.constant_voltage, self._now())
        return self._core.identity

    async def close(self) -> None:
        """Switch the input off and release the line."""
        if self._is_open:
            self._core.switch(self._now(), on=False)
        self._disconnect()

    async def sweep(self, plan: SweepPlan, stop_why: Callable[[], str | None]) -> SweptCurve:
        """Measure one curve; `stop_why` is asked at its start and at its end, where it takes the points away."""
        self._require_open()
        core, start_s = self._core, self._now()
        core.latched.clear()
        open_v = core.read(start_s)[0]
        open_v = float("nan") if open_v >= OVERFLOW else open_v
        levels = np.asarray(plan(open_v), dtype=np.float64)
        if core.latched:
            return SweptCurve(open_v, (), (), f"protection is latched: {', '.join(sorted(core.latched))}")
        stopped = stop_why()
        if stopped or not levels.size:
            return SweptCurve(open_v, (), (), stopped or "")
        first = core.source.light(start_s)
        core.switch(start_s, on=True)
        try:
            await asyncio.sleep(levels.size * (self._settle_s + 3 * MEASURING_S))
            self._require_open()
            voltage_v, current_a = core.trace(first, core.source.light(self._now()), levels, self._settle_s)
        finally:
            core.switch(self._now(), on=False)
        stopped = stop_why() or ""
        if core.latched:
            stopped = f"protection tripped: {', '.join(sorted(core.latched))}"
        kept = (voltage_v < OVERFLOW) & (current_a < OVERFLOW)
        below = np.flatnonzero(kept & ~(voltage_v >= self._least_v))
        if below.size:
            stopped = stopped or f"the voltage fell to {voltage_v[below[0]]:.2f} V, below {self._least_v:g} V"
            kept[below[0] :] = False
        return SweptCurve(open_v, tuple(voltage_v[kept].tolist()), tuple(current_a[kept].tolist()), stopped)
