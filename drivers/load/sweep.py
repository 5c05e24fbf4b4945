"""An electronic load that traces the curve of a photovoltaic module: the sweep, for every make.

The load holds one voltage after another, and the module is in open circuit in between. Whatever ends a sweep, the input
is switched off and the load is asked whether it is off. A load that does not answer is sent the command all the same,
and the next `open` switches the input off before anything else is set. A make is a `drivers.load.session.Dialect`.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import ConnectError, DeadlineError, LinkLostError, ProtocolError
from drivers.interfaces import SweepPlan, SweptCurve
from drivers.load.session import DEVICE, Dialect, LoadSession
from drivers.scpi import ScpiLine


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """How a sweep is run.

    Attributes
    ----------
    settle_s
        Time from when the load has taken a new voltage to its measurement.
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
    line
        Opened at each `open`.
    dialect, settings
        The make, and how it sweeps.
    """

    def __init__(self, line: ScpiLine, dialect: Dialect, settings: SweepSettings) -> None:
        self._line = line
        self._dialect = dialect
        self._settings = settings
        self._session: LoadSession | None = None

    async def open(self) -> str:
        """Connect, identify, switch the input off and configure."""
        await self.close()
        session = LoadSession(self._line, self._dialect, self._settings.deadline_s)
        try:
            await self._line.open()
            identity = await session.start()
        except BaseException:
            await session.close()
            raise
        self._session = session
        return identity

    async def close(self) -> None:
        """Switch the input off if the load still listens, and release the line."""
        session, self._session = self._session, None
        # A caller that is cancelled meanwhile must not leave the module under load.
        await (self._line.close() if session is None else asyncio.shield(session.close()))

    async def sweep(self, plan: SweepPlan, stop_why: Callable[[], str | None]) -> SweptCurve:
        """Measure one curve; see `drivers.interfaces.ElectronicLoad.sweep`."""
        session = self._session
        if session is None:
            raise LinkLostError(DEVICE, "has to be opened first")
        try:
            try:
                return await self._swept(session, plan, stop_why)
            finally:
                await self._switch_off(session)
        except (DeadlineError, ProtocolError, LinkLostError, ConnectError):
            await self.close()
            raise

    async def _switch_off(self, session: LoadSession) -> None:
        """Switch the input off; a session that is in doubt is closed, which does so too."""
        if session.in_doubt:
            await self.close()
        else:
            await session.switch_off()

    async def _swept(self, session: LoadSession, plan: SweepPlan, stop_why: Callable[[], str | None]) -> SweptCurve:
        open_circuit_v, tripped = await session.prepare()
        if tripped:
            return SweptCurve(open_circuit_v, (), (), f"protection is latched: {tripped}")
        points: list[tuple[float, float]] = []
        stopped = ""
        for number, target_v in enumerate(plan(open_circuit_v)):
            stopped = stop_why() or ""
            if stopped:
                break
            await session.hold(target_v, switch_on=number == 0)
            await asyncio.sleep(self._settings.settle_s)
            measured = await session.measure()
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
