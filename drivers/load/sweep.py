"""An electronic load that traces the curve of a photovoltaic module: the sweep, for every make.

The load holds one voltage after another, and the module is in open circuit in between. Whatever ends a sweep, the input
is switched off and the load is asked whether it is; where it does not answer it is told to, unheard, and the next
`open` switches the input off before anything else is set. A make is a `drivers.load.session.Dialect`.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from drivers.errors import ConnectError, DeadlineError, LinkLostError, ProtocolError
from drivers.interfaces import SweepPlan, SweptCurve
from drivers.lines.threads import DeviceThread
from drivers.load.session import DEVICE, Dialect, Line, LoadSession

T = TypeVar("T")

_CLOSE_S = 3.0


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """How a sweep is run.

    Attributes
    ----------
    settle_s
        Time from a new voltage to its measurement.
    least_v
        The sweep ends at the first voltage below this.
    deadline_s
        How long one answer may take.
    """

    settle_s: float = 0.03
    least_v: float = 3.0
    deadline_s: float = 1.0


class ScpiLoad:
    """An electronic load of one dialect.

    Parameters
    ----------
    connect
        Opens the line; called in the instrument's thread at each `open`.
    dialect, settings
        The make, and how it sweeps.
    """

    def __init__(self, connect: Callable[[], Line], dialect: Dialect, settings: SweepSettings) -> None:
        self._connect = connect
        self._dialect = dialect
        self._settings = settings
        self._thread = DeviceThread(DEVICE)
        self._session: LoadSession | None = None

    async def open(self) -> str:
        """Connect, identify, switch the input off and configure."""
        await self.close()

        def start() -> LoadSession:
            return LoadSession(self._connect(), self._dialect, self._settings.deadline_s)

        try:
            self._session = await self._thread.call(start, 30 * self._settings.deadline_s + 5.0, LoadSession.close)
        except BaseException:
            await self.close()
            raise
        return self._session.identity

    async def close(self) -> None:
        """Switch the input off if the load still listens, and release the line."""
        session, self._session = self._session, None
        await self._thread.finish(None if session is None else session.close, _CLOSE_S + self._settings.deadline_s)

    async def sweep(self, plan: SweepPlan, stop_why: Callable[[], str | None]) -> SweptCurve:
        """Measure one curve; see `drivers.interfaces.ElectronicLoad.sweep`."""
        session = self._session
        if session is None:
            raise LinkLostError(DEVICE, "has to be opened first")
        try:
            try:
                return await self._swept(session, plan, stop_why)
            finally:
                await self._call(session.leave, 3)
        except (DeadlineError, ProtocolError, LinkLostError, ConnectError):
            await self.close()
            raise

    async def _call(self, function: Callable[[], T], answers: int) -> T:
        return await self._thread.call(function, answers * self._settings.deadline_s + 2.0)

    async def _swept(self, session: LoadSession, plan: SweepPlan, stop_why: Callable[[], str | None]) -> SweptCurve:
        open_circuit_v, tripped = await self._call(session.prepare, 12)
        if tripped:
            return SweptCurve(open_circuit_v, (), (), f"protection is latched: {tripped}")
        points: list[tuple[float, float]] = []
        stopped = ""
        for number, target_v in enumerate(plan(open_circuit_v)):
            stopped = stop_why() or ""
            if stopped:
                break
            await self._call(partial(session.hold, target_v, switch_on=number == 0), 1)
            await asyncio.sleep(self._settings.settle_s)
            measured = await self._call(session.measure, 3)
            if measured.tripped:
                stopped = f"protection tripped: {measured.tripped}"
                break
            if measured.point is None:
                continue
            if not measured.point[0] >= self._settings.least_v:
                stopped = f"the voltage fell to {measured.point[0]:.2f} V, below {self._settings.least_v:g} V"
                break
            points.append(measured.point)
        return SweptCurve(open_circuit_v, tuple(v for v, _ in points), tuple(i for _, i in points), stopped)
