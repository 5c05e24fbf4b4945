"""The cube's role: four faces through one multiplexer and one voltmeter, every few seconds."""

import asyncio
import logging
import math
from collections.abc import Callable
from dataclasses import replace
from random import Random

from daemon.base.clock import Clock
from daemon.base.reconnect import Outage, Reconnection, Rhythm
from daemon.base.records import FACES, Event, FaceReading, Quality, Scan
from daemon.config.sections import CubeSettings
from daemon.cube.calibration import DarkOffsets, calibrated
from daemon.cube.face_watch import FaceWatch
from drivers.errors import DeadlineError, DeviceError, DriverHungError, OverRangeError, ProtocolError
from drivers.interfaces import Multiplexer, Voltmeter

log = logging.getLogger("heliocube.acquisition")

# A six-and-a-half-digit meter on a live sensor does not give the very same digits this many times in a row.
_STUCK_AFTER = 6


class Acquisition:
    """Reads the cube and hands every scan on.

    Parameters
    ----------
    cube
        Faces, rhythm and plausibility.
    settle_s
        Time between switching the multiplexer and the start of a conversion.
    multiplexer, voltmeter
        The instruments, owned from here on.
    clock
        The service's time.
    random
        For the session's name and the jitter of reconnection.
    on_scan
        Called with every scan as soon as it is complete.
    publish
        Called with events worth telling.
    sun_elevation_deg
        Of UTC [s]; dark offsets are learnt only when the sun is well below the horizon.
    simulated, calibration
        Mark every scan; the identifier is empty where the gains are the settings' own.
    face_watch
        Finds faces that cannot be true, or None.
    """

    def __init__(
        self,
        cube: CubeSettings,
        settle_s: float,
        multiplexer: Multiplexer,
        voltmeter: Voltmeter,
        clock: Clock,
        random: Random,
        on_scan: Callable[[Scan], None],
        publish: Callable[[Event], None],
        sun_elevation_deg: Callable[[float], float],
        simulated: bool,
        calibration: str = "",
        face_watch: FaceWatch | None = None,
    ) -> None:
        self._face_watch = face_watch
        self._cube = cube
        self._settle_s = settle_s
        self._multiplexer = multiplexer
        self._voltmeter = voltmeter
        self._clock = clock
        self._on_scan = on_scan
        self._publish = publish
        self._simulated = simulated
        self._calibration = calibration
        self._session = f"{random.getrandbits(64):016x}"
        self._sequence = 0
        self._faces = tuple(getattr(cube, name) for name in FACES)
        self._dark = DarkOffsets(sun_elevation_deg) if cube.dark_correction else None
        self._repeats = [0] * len(FACES)
        self._last_voltage = [math.nan] * len(FACES)
        # As read in the present scan, for the watch over the faces.
        self._read_mv = [math.nan] * len(FACES)
        self._read_w_m2 = [math.nan] * len(FACES)
        self.outage = Outage(log, "the cube")
        self._reconnection = Reconnection(
            self.outage, random, clock.monotonic, self._notify, lost=DeviceError, hopeless=(DriverHungError,)
        )
        self._rhythm = Rhythm(cube.scan_every_s)
        self._was_open = False
        self.scan_every_s = cube.scan_every_s
        self.last_scan_s = clock.monotonic()

    @property
    def ready(self) -> bool:
        """Whether the instruments are open and answering."""
        return self._sequence > 0 and not self.outage.is_down

    @property
    def skipped(self) -> int:
        """How many scans were left out because the one before took too long."""
        return self._rhythm.skipped

    async def run(self) -> None:
        """Acquire until cancelled; a lost instrument is opened anew for as long as it takes.

        Raises `DriverHungError` when only a new process can open it.
        """
        try:
            await self._reconnection.run(self._acquire, self._close)
        finally:
            await self._close()

    async def _open(self) -> None:
        # The meter first: a second service fails at its port before it can touch the switch of the first.
        meter = await self._voltmeter.open()
        switch = await self._multiplexer.open()
        if not self._was_open:
            self._was_open = True
            log.info("instruments of the cube are open", extra={"fields": {"multiplexer": switch, "voltmeter": meter}})

    async def _close(self) -> None:
        await self._voltmeter.close()
        await self._multiplexer.close()

    async def _acquire(self) -> None:
        await self._open()
        self._rhythm.start(self._clock.monotonic())
        while True:
            scan = await self.scan()
            self._reconnection.works()
            self.last_scan_s = self._clock.monotonic()
            self._on_scan(scan)
            await asyncio.sleep(self._rhythm.wait_s(self._clock.monotonic()))

    async def scan(self) -> Scan:
        """Read the four faces once, in 4 x (settle + conversion); raises `DeviceError` when the link is gone."""
        proven = await self._self_test()
        faces = [await self._read(index, proven) for index in range(len(FACES))]
        # A switch that was lost before the last reading has gone to another input: it must still take its address.
        await self._multiplexer.select(self._faces[-1].channel)
        east, south, west, zenith = self._believed(faces, proven)
        scan = Scan(
            source=self._cube.name,
            session=self._session,
            sequence=self._sequence,
            time_utc_s=zenith.time_utc_s,
            time_monotonic_s=zenith.time_monotonic_s,
            east=east,
            south=south,
            west=west,
            zenith=zenith,
            simulated=self._simulated,
            calibration=self._calibration,
        )
        self._sequence += 1
        return scan

    async def _self_test(self) -> bool:
        for channel in (self._cube.self_test_channel, self._cube.second_self_test_channel):
            if channel is not None and not await self._reads_nothing(channel):
                return False
        return True

    async def _reads_nothing(self, channel: int) -> bool:
        try:
            voltage_v = await self._voltage(channel)
        except (OverRangeError, DeadlineError, ProtocolError):
            return False
        return abs(voltage_v) * 1e3 <= self._cube.self_test_limit_mv

    async def _voltage(self, channel: int) -> float:
        await self._multiplexer.select(channel)
        await asyncio.sleep(self._settle_s)
        return await self._voltmeter.read_voltage()

    async def _read(self, index: int, proven: bool) -> FaceReading:
        voltage_v = irradiance = math.nan
        self._read_mv[index] = self._read_w_m2[index] = math.nan
        try:
            voltage_v = await self._voltage(self._faces[index].channel)
            quality = Quality.OK
        except OverRangeError:
            quality = Quality.OVER_RANGE
        except DeadlineError:
            quality = Quality.LATE
        except ProtocolError:
            quality = Quality.MISSING
        utc_s = self._clock.utc()
        if quality is Quality.OK:
            dark_mv = self._dark.learn(index, voltage_v * 1e3, utc_s) if self._dark else 0.0
            irradiance = calibrated(voltage_v * 1e3 - dark_mv, self._faces[index])
            self._read_mv[index], self._read_w_m2[index] = voltage_v * 1e3, irradiance
            quality = self._judge(index, voltage_v, irradiance, proven)
        return FaceReading(irradiance, quality, utc_s, self._clock.monotonic())

    def _believed(self, faces: list[FaceReading], proven: bool) -> list[FaceReading]:
        watch = self._face_watch
        if watch is None:
            return faces
        if proven:
            watch.note(self._read_w_m2, self._read_mv)
        return [
            replace(face, quality=Quality.IMPLAUSIBLE)
            if face.quality is Quality.OK and watch.implausible(index)
            else face
            for index, face in enumerate(faces)
        ]

    def _judge(self, index: int, voltage_v: float, irradiance: float, proven: bool) -> Quality:
        repeated = voltage_v == self._last_voltage[index] and voltage_v != 0.0
        self._repeats[index] = self._repeats[index] + 1 if repeated else 0
        self._last_voltage[index] = voltage_v
        if not proven:
            return Quality.SELF_TEST_FAILED
        if not (self._cube.minimum_w_m2 <= irradiance <= self._cube.maximum_w_m2):
            return Quality.IMPLAUSIBLE
        if self._repeats[index] >= _STUCK_AFTER:
            return Quality.STALE
        return Quality.OK

    def _notify(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "cube", text))
