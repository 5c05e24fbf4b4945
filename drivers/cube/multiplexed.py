"""A cube whose four sensors are read by one voltmeter, one after another through a multiplexer."""

import asyncio
import math
from collections.abc import Callable

from drivers.errors import DeadlineError, OverRangeError, ProtocolError
from drivers.interfaces import CubeReading, FaceFlaw, FaceSample, Multiplexer, Voltmeter
from drivers.settings import CubeDriverSettings, CubeSurroundings, CubeWiring


class MultiplexedSettings(CubeDriverSettings):
    """multiplexed: one voltmeter behind a multiplexer, each with its own section."""


SETTINGS = MultiplexedSettings


class MultiplexedCube:
    """The cube as multiplexer and voltmeter read it, in volts.

    Parameters
    ----------
    multiplexer, voltmeter
        The instruments, owned from here on.
    wiring
        Which input is which.
    utc_s, monotonic_s
        Return the service's time.
    """

    def __init__(
        self,
        multiplexer: Multiplexer,
        voltmeter: Voltmeter,
        wiring: CubeWiring,
        utc_s: Callable[[], float],
        monotonic_s: Callable[[], float],
    ) -> None:
        self._multiplexer = multiplexer
        self._voltmeter = voltmeter
        self._wiring = wiring
        self._utc_s = utc_s
        self._monotonic_s = monotonic_s

    async def open(self) -> str:
        """Connect both; return who they are."""
        # The meter first: a second service fails at the meter's port before it can touch the first one's multiplexer.
        meter = await self._voltmeter.open()
        switch = await self._multiplexer.open()
        return f"multiplexer {switch}; voltmeter {meter}"

    async def close(self) -> None:
        """Release both."""
        await self._voltmeter.close()
        await self._multiplexer.close()

    async def read(self) -> CubeReading:
        """Read the four faces once, in 4 x (settle + conversion) and as much for each self-test."""
        proven = await self._self_test()
        east, south, west, zenith = [await self._sample(channel) for channel in self._wiring.channels]
        # A multiplexer lost before the last reading was at another input then: see that it still takes an address.
        await self._multiplexer.select(self._wiring.channels[-1])
        return CubeReading(east=east, south=south, west=west, zenith=zenith, unit="V", proven=proven)

    async def _self_test(self) -> bool:
        for channel in self._wiring.self_test_channels:
            if not await self._reads_nothing(channel):
                return False
        return True

    async def _reads_nothing(self, channel: int) -> bool:
        try:
            voltage_v = await self._voltage(channel)
        except (OverRangeError, DeadlineError, ProtocolError):
            return False
        return abs(voltage_v) * 1e3 <= self._wiring.self_test_limit_mv

    async def _voltage(self, channel: int) -> float:
        await self._multiplexer.select(channel)
        await asyncio.sleep(self._wiring.settle_s)
        return await self._voltmeter.read_voltage()

    async def _sample(self, channel: int) -> FaceSample:
        voltage_v = math.nan
        flaw: FaceFlaw | None = None
        try:
            voltage_v = await self._voltage(channel)
        except OverRangeError:
            flaw = "over-range"
        except DeadlineError:
            flaw = "late"
        except ProtocolError:
            flaw = "missing"
        return FaceSample(voltage_v, self._utc_s(), self._monotonic_s(), flaw)


def build(_settings: MultiplexedSettings, surroundings: CubeSurroundings) -> MultiplexedCube:
    """Return the cube of the configured multiplexer and voltmeter, not yet connected."""
    parts = surroundings.switched_meter()
    return MultiplexedCube(
        parts.multiplexer, parts.voltmeter, parts.wiring, surroundings.utc_s, surroundings.monotonic_s
    )
