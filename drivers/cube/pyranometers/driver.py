"""The cube of four pyranometers: lines are read at the same time, the sensors of one in turn, each with its time."""

import asyncio
from collections.abc import Callable, Sequence

from drivers.cube.pyranometers.makes import make_of
from drivers.cube.pyranometers.sensor import BusSensor
from drivers.cube.pyranometers.settings import FACE_NAMES, PyranometersSettings
from drivers.errors import ConnectError, DeviceError, DriverHungError, LinkLostError
from drivers.interfaces import CubeReading, FaceSample
from drivers.modbus.client import ModbusBus
from drivers.modbus.transports import ModbusTransport, build_transport
from drivers.settings import CubeSurroundings, SettingsError

DEVICE = "cube"
_FIRST_PAUSE_S = 2.0
_LONGEST_PAUSE_S = 30.0


class SensorLine:
    """The sensors of one line.

    Parameters
    ----------
    bus
        The line.
    sensors
        Pairs of a face, 0 to 3, and its sensor.
    within_s
        Longest wait for the line to open anew during a scan.
    monotonic_s
        The service's monotonic time.
    """

    def __init__(
        self,
        bus: ModbusBus,
        sensors: Sequence[tuple[int, BusSensor]],
        within_s: float,
        monotonic_s: Callable[[], float],
    ) -> None:
        self.sensors = sensors
        self.is_open = False
        self.why_not = ""
        self.hangs = False
        self._bus = bus
        self._within_s = within_s
        self._now = monotonic_s
        self._checked_index = 0
        self._failures = 0
        self._open_again_s = 0.0
        for _, sensor in sensors:
            sensor.same_address_sensors = tuple(
                other for _, other in sensors if other is not sensor and other.unit == sensor.unit
            )

    async def open(self, within_s: float = 15.0) -> None:
        """Connect; `why_not` says what has failed."""
        for _, sensor in self.sensors:
            sensor.begin()
        try:
            await self._bus.open(within_s)
        except DeviceError as error:
            self._failed(error)
        else:
            self.is_open, self.why_not, self.hangs, self._failures = True, "", False, 0

    async def close(self) -> None:
        """Release the line; never raises."""
        self.is_open = False
        await self._bus.close()

    async def read(self) -> list[tuple[int, FaceSample]]:
        """Read every sensor once, and compare the serial number of one of them, another one each time."""
        if not self.is_open and self._now() >= self._open_again_s:
            await self.open(self._within_s)
        self._checked_index = (self._checked_index + 1) % len(self.sensors)
        samples: list[tuple[int, FaceSample]] = []
        for number, (face, sensor) in enumerate(self.sensors):
            if self.is_open:
                try:
                    samples.append((face, await sensor.read(check=number == self._checked_index)))
                    continue
                except DeviceError as error:
                    await self.close()
                    self._failed(error)
            samples.append((face, sensor.lost(f"cannot be reached: {self.why_not}")))
        return samples

    def _failed(self, error: DeviceError) -> None:
        self.is_open, self.why_not, self.hangs = False, error.message, isinstance(error, DriverHungError)
        pause_s = min(_FIRST_PAUSE_S * 2.0 ** min(self._failures, 8), _LONGEST_PAUSE_S)
        self._failures += 1
        self._open_again_s = self._now() + pause_s


class PyranometerCube:
    """The cube, in W/m2.

    A sensor that is silent, wrong or in a bad mode flaws its own face and costs the others at most its time-out; so
    does one of several lines that is gone. With no sensor left that answers, the cube is gone. If a line's driver hangs
    for good, only a new process can go on.

    Parameters
    ----------
    lines
        Every line with its sensors; all four faces together.
    """

    def __init__(self, lines: Sequence[SensorLine]) -> None:
        self._lines = lines

    async def open(self) -> str:
        """Connect and read every sensor once; `ConnectError` if none of them answers."""
        await self.close()
        await asyncio.gather(*(line.open() for line in self._lines))
        try:
            await self._read()
        except DriverHungError:
            await self.close()
            raise
        except DeviceError as error:
            await self.close()
            raise ConnectError(DEVICE, error.message) from None
        sensors = [sensor for line in self._lines for _, sensor in line.sensors]
        return ", ".join(sensor.identity or ("without a name" if sensor.answers else "silent") for sensor in sensors)

    async def close(self) -> None:
        """Release the lines."""
        await asyncio.gather(*(line.close() for line in self._lines))

    async def read(self) -> CubeReading:
        """Read the four sensors."""
        east, south, west, zenith = await self._read()
        # Values come in steps of 0.01 to 1 W/m2: in a steady light they stay the same.
        return CubeReading(east=east, south=south, west=west, zenith=zenith, unit="W/m2", rounded=True)

    async def _read(self) -> list[FaceSample]:
        samples = dict(pair for read in await asyncio.gather(*(line.read() for line in self._lines)) for pair in read)
        if not any(line.is_open for line in self._lines):
            why = "; ".join(dict.fromkeys(line.why_not for line in self._lines))
            raise (DriverHungError if any(line.hangs for line in self._lines) else LinkLostError)(DEVICE, why)
        if not any(sensor.answers for line in self._lines for _, sensor in line.sensors):
            raise LinkLostError(
                DEVICE,
                "no pyranometer answers: are they on, are their wires A and B the right way round, and speed, parity"
                " and addresses as configured? 'heliocube probe cube' looks for them",
            )
        return [samples[face] for face in range(len(FACE_NAMES))]


def build(
    settings: PyranometersSettings,
    surroundings: CubeSurroundings,
    path: Callable[[str], ModbusTransport] | None = None,
) -> PyranometerCube:
    """Return the cube, not yet connected.

    Parameters
    ----------
    settings, surroundings
        What is configured, and time.
    path
        Returns the way over a line by its name; by default the one that the name says.
    """

    def configured(name: str) -> ModbusTransport:
        return build_transport(
            DEVICE, name, settings.serial_speed, settings.serial_form, surroundings.monotonic_s, surroundings.tap
        )

    by_line: dict[str, list[tuple[int, str]]] = {}
    for face, name in enumerate(FACE_NAMES):
        line = settings.line_of(name)
        if line is None:
            if path is None:
                raise SettingsError(
                    f"instruments.cube.line is missing, and instruments.cube.{name}.line too: name the line of the"
                    ' pyranometers, such as "/dev/serial/by-id/..." or "tcp:192.168.1.40:502"'
                )
            line = ""
        by_line.setdefault(line, []).append((face, name))
    lines = []
    for line, faces in by_line.items():
        bus = ModbusBus((path or configured)(line), DEVICE, settings.gap_s, surroundings.monotonic_s)
        sensors = [(face, _sensor(settings, name, bus, surroundings)) for face, name in faces]
        lines.append(SensorLine(bus, sensors, settings.answer_within_s, surroundings.monotonic_s))
    return PyranometerCube(lines)


def _sensor(settings: PyranometersSettings, name: str, bus: ModbusBus, surroundings: CubeSurroundings) -> BusSensor:
    own = settings.face(name)
    return BusSensor(
        face=name,
        unit=own.address,
        make=make_of(settings.make_of(name), settings.map_of(name)),
        pinned=own.serial,
        bus=bus,
        within_s=settings.answer_within_s,
        utc_s=surroundings.utc_s,
        monotonic_s=surroundings.monotonic_s,
    )
