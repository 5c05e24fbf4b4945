"""The cube's role: four faces every few seconds, judged and calibrated."""

import asyncio
import logging
import math
from collections.abc import Callable
from random import Random

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.reconnect import Outage, PeriodicSchedule, Reconnection
from daemon.base.records import FACES, Event, FaceReading, Quality, Scan
from daemon.config.sections import CubeSettings
from daemon.cube.calibration import DarkOffsets, calibrated_irradiance
from daemon.cube.face_alarms import SensorAlarm
from daemon.cube.face_watch import FaceWatch
from daemon.cube.guarded_cube import GuardedCube
from daemon.cube.repeats import Repeats
from drivers.errors import DeviceError, DriverHungError
from drivers.interfaces import Cube, CubeReading, FaceFlaw, FaceSample

log = logging.getLogger("heliocube.acquisition")

_QUALITY_OF_FLAW: dict[FaceFlaw, Quality] = {
    "over-range": Quality.OVER_RANGE,
    "late": Quality.LATE,
    "missing": Quality.MISSING,
}


class Acquisition:
    """Reads the cube and hands every scan on.

    Parameters
    ----------
    settings
        Faces, rhythm and plausibility.
    cube
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
        Returns the sun's elevation at a UTC [s], NaN where it is not known; dark offsets are learnt only when the sun
        is well below the horizon.
    simulated, calibration
        Mark every scan; the identifier is empty where the gains are the settings' own.
    face_watch
        Finds faces that cannot be true, or None.
    alarms
        Told of faults that the sensors report of themselves; or None.
    """

    def __init__(
        self,
        settings: CubeSettings,
        cube: Cube,
        clock: Clock,
        random: Random,
        on_scan: Callable[[Scan], None],
        publish: Callable[[Event], None],
        sun_elevation_deg: Callable[[float], float],
        simulated: bool,
        calibration: str = "",
        face_watch: FaceWatch | None = None,
        alarms: Alarms | None = None,
    ) -> None:
        self._face_watch = face_watch
        self._sensor_alarm = None if alarms is None else SensorAlarm(alarms, clock)
        self._settings = settings
        self._cube = GuardedCube(cube)
        self._clock = clock
        self._on_scan = on_scan
        self._publish = publish
        self._simulated = simulated
        self._calibration = calibration
        self._session = f"{random.getrandbits(64):016x}"
        self._sequence = 0
        self._faces = tuple(getattr(settings, name) for name in FACES)
        self._dark_offsets = DarkOffsets(sun_elevation_deg) if settings.dark_correction else None
        self._repeats = Repeats(settings.scan_every_s)
        # As read in the present scan, for `FaceWatch`.
        self._read_mv = [math.nan] * len(FACES)
        self._read_w_m2 = [math.nan] * len(FACES)
        self.outage = Outage(log, "the cube")
        self._reconnection = Reconnection(
            self.outage, random, clock.monotonic, self._notify, lost=DeviceError, hopeless=(DriverHungError,)
        )
        self._rhythm = PeriodicSchedule(settings.scan_every_s)
        self._was_open = False
        self.scan_every_s = settings.scan_every_s
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
            await self._reconnection.run(self._acquire, self._cube.close)
        finally:
            await self._cube.close()

    async def _open(self) -> None:
        identity = await self._cube.open()
        if not self._was_open:
            self._was_open = True
            log.info("instruments of the cube are open", extra={"fields": {"cube": identity}})

    async def _acquire(self) -> None:
        await self._open()
        self._rhythm.start(self._clock.monotonic())
        while True:
            scan = await self.scan()
            self._reconnection.note_working()
            self.last_scan_s = self._clock.monotonic()
            self._on_scan(scan)
            await asyncio.sleep(self._rhythm.wait_s(self._clock.monotonic()))

    async def scan(self) -> Scan:
        """Read and judge the four faces once; raises `DeviceError` when the link is gone."""
        reading = await self._cube.read()
        if self._sensor_alarm is not None:
            self._sensor_alarm.note(reading)
        faces = [self._face(index, sample, reading) for index, sample in enumerate(reading.faces)]
        east, south, west, zenith = self._mark_implausible(faces, reading.proven)
        scan = Scan(
            source=self._settings.name,
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

    def _face(self, index: int, sample: FaceSample, reading: CubeReading) -> FaceReading:
        irradiance = math.nan
        self._read_mv[index] = self._read_w_m2[index] = math.nan
        if sample.flaw is not None:
            quality = _QUALITY_OF_FLAW[sample.flaw]
        elif math.isnan(sample.value):
            quality = Quality.MISSING
        else:
            irradiance = self._irradiance(index, sample, reading)
            # An infinite value is implausible in any case, and has no mean.
            self._read_w_m2[index] = irradiance if math.isfinite(irradiance) else math.nan
            quality = self._judge(index, sample.value, irradiance, reading)
        return FaceReading(irradiance, quality, sample.time_utc_s, sample.time_monotonic_s)

    def _irradiance(self, index: int, sample: FaceSample, reading: CubeReading) -> float:
        """Return an irradiance [W/m2]; dark offset, gain and voltage are only for sensors that give volts."""
        # A driver may well give a number of numpy, which no message can carry.
        value = float(sample.value)
        if reading.unit == "W/m2":
            return value
        read_mv = value * 1e3
        self._read_mv[index] = read_mv
        dark_mv = self._dark_offsets.learn(index, read_mv, sample.time_utc_s) if self._dark_offsets else 0.0
        return calibrated_irradiance(read_mv - dark_mv, self._faces[index])

    def _mark_implausible(self, faces: list[FaceReading], proven: bool) -> list[FaceReading]:
        watch = self._face_watch
        if watch is None:
            return faces
        if proven:
            watch.note(self._read_w_m2, self._read_mv)
        return [
            face._replace(quality=Quality.IMPLAUSIBLE)
            if face.quality is Quality.OK and watch.implausible(index)
            else face
            for index, face in enumerate(faces)
        ]

    def _judge(self, index: int, value: float, irradiance: float, reading: CubeReading) -> Quality:
        self._repeats.note(index, value)
        if not reading.proven:
            return Quality.SELF_TEST_FAILED
        if not (self._settings.minimum_w_m2 <= irradiance <= self._settings.maximum_w_m2):
            return Quality.IMPLAUSIBLE
        frozen = self._repeats.frozen(index, irradiance, rounded=reading.rounded)
        return Quality.STALE if frozen else Quality.OK

    def _notify(self, text: str) -> None:
        self._publish(Event(self._clock.utc(), self._clock.monotonic(), "cube", text))
