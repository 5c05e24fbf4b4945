"""The cube `labjack`: four sensors at the analogue inputs of a LabJack T7 or T8, over Modbus TCP.

Registers by LabJack's own list (ljm_constants): AINn float at 2n, its range at 40000 + 2n, its negative channel at
41000 + n, its resolution index at 41500 + n; TEST 55100, PRODUCT_ID 60000, SERIAL_NUMBER 60028. Inferred: a reading at
the end of the range or beyond is none, the error value -9999 among them.
"""

import math
from collections.abc import Callable, Iterator
from typing import Annotated

from pydantic import AfterValidator, Field, WithJsonSchema

from drivers.errors import DeadlineError, IdentityError, LinkLostError, ProtocolError, RefusedError
from drivers.interfaces import CubeReading, FaceFlaw, FaceSample
from drivers.modbus.client import ModbusBus
from drivers.modbus.paths import ModbusLine, ModbusPath, TcpPath, endpoint
from drivers.modbus.pdu import READ_HOLDING, number, words_for, write_registers
from drivers.settings import CubeDriverSettings, CubeSurroundings, SettingsConflict, SettingsError

DEVICE = "cube"
UNIT = 1
TEST, TEST_WORDS = 55100, (0x0011, 0x2233)
PRODUCT_ID, SERIAL_NUMBER = 60000, 60028
AIN_RANGE, AIN_NEGATIVE, AIN_RESOLUTION = 40000, 41000, 41500
_T7, _T8 = 7, 8
_OPEN_S = 5.0


RANGES_V = (0.01, 0.1, 1.0, 10.0)


def _known_range(value: float) -> float:
    if value not in RANGES_V:
        raise ValueError("not a range of a LabJack")
    return value


LabjackRange = Annotated[
    float, AfterValidator(_known_range), WithJsonSchema({"type": "number", "enum": list(RANGES_V)})
]


class LabjackSettings(CubeDriverSettings):
    """labjack: four sensors at the analogue inputs of a LabJack T7 or T8 in the network."""

    line: ModbusLine | None = Field(
        None, examples=["tcp:192.168.1.60:502"], description="Where the LabJack is, by Modbus TCP."
    )
    inputs: tuple[int, ...] = Field(
        (0, 2, 4, 6),
        strict=False,
        min_length=4,
        max_length=4,
        description="Inputs AIN of east, south, west and zenith. A T7 measures each against the next odd one.",
    )
    range_v: LabjackRange = Field(
        1.0, description="Measuring range, from minus to plus; 0.1 V ends at 1000 W/m2 of 0.1 mV, which clouds exceed."
    )
    resolution_index: int = Field(
        8,
        ge=0,
        le=16,
        description="Resolution against speed, as LabJack counts: 8 is the best of a T7, 12 of a T7-Pro.",
    )

    def conflicts(self) -> Iterator[SettingsConflict]:
        """Yield inputs that cannot be read."""
        if self.line is not None and (where := endpoint(self.line)) is not None and where.kind != "tcp":
            yield SettingsConflict("line", "is not Modbus TCP, which is all that a LabJack speaks; write tcp:HOST:502")
        if self.line is not None and endpoint(self.line) is None:
            yield SettingsConflict("line", "is a serial port; a LabJack is in the network, write tcp:HOST:502")
        if len(set(self.inputs)) < len(self.inputs):
            yield SettingsConflict("inputs", "has an input twice; each face needs one of its own")
        if not all(0 <= each <= 12 for each in self.inputs):
            yield SettingsConflict("inputs", "has an input that is not among 0 to 12")


SETTINGS = LabjackSettings


class LabjackCube:
    """The four inputs, in volts.

    Parameters
    ----------
    bus
        To the LabJack, which must be allowed to write.
    settings
        Its inputs and ranges.
    surroundings
        Time and deadline.
    """

    def __init__(self, bus: ModbusBus, settings: LabjackSettings, surroundings: CubeSurroundings) -> None:
        self._bus = bus
        self._settings = settings
        self._around = surroundings

    async def open(self) -> str:
        """Connect, identify, and set range, resolution and negative channel of the four inputs."""
        await self.close()
        await self._bus.open(_OPEN_S)
        if await self._read(TEST) != TEST_WORDS:
            raise IdentityError(DEVICE, "what answers is no LabJack, or gives its words in another order")
        product, serial = number(await self._read(PRODUCT_ID), "float32"), await self._read(SERIAL_NUMBER)
        if product not in (_T7, _T8):
            raise IdentityError(DEVICE, f"is a LabJack of type {product:g}, and a T7 or T8 was expected")
        for each in self._settings.inputs:
            await self._configure(each, product)
        return f"LabJack T{product:g} no. {int(number(serial, 'uint32'))}"

    async def close(self) -> None:
        """Disconnect."""
        await self._bus.close()

    async def read(self) -> CubeReading:
        """Read the four inputs, each with its instant."""
        east, south, west, zenith = [await self._sample(each) for each in self._settings.inputs]
        # The steps of a 16-bit converter are wider than its noise on the larger ranges.
        return CubeReading(east=east, south=south, west=west, zenith=zenith, unit="V", rounded=True)

    async def _configure(self, each: int, product: float) -> None:
        wanted = words_for(self._settings.range_v, "float32")
        settings = {AIN_RANGE + 2 * each: wanted, AIN_RESOLUTION + each: (self._settings.resolution_index,)}
        if product == _T7:
            if each % 2:
                raise ProtocolError(DEVICE, f"is a T7, which measures even inputs against odd ones, and {each} is odd")
            settings[AIN_NEGATIVE + each] = (each + 1,)
        try:
            for register, words in settings.items():
                await self._bus.ask(write_registers(UNIT, register, words), self._around.deadline_s)
        except DeadlineError as error:
            raise LinkLostError(DEVICE, "the LabJack does not answer") from error
        except RefusedError as error:
            raise ProtocolError(DEVICE, f"does not take the settings of AIN{each}: {error.message}") from error
        if await self._read(AIN_RANGE + 2 * each) != wanted:
            raise ProtocolError(DEVICE, f"did not keep the range of AIN{each}")

    async def _sample(self, each: int) -> FaceSample:
        value_v = math.nan
        flaw: FaceFlaw | None = None
        try:
            value_v, flaw = self._judged(number(await self._read(2 * each), "float32"))
        except RefusedError:
            flaw = "missing"
        return FaceSample(value_v, self._around.utc_s(), self._around.monotonic_s(), flaw)

    def _judged(self, value_v: float) -> tuple[float, FaceFlaw | None]:
        if math.isnan(value_v):
            return value_v, "missing"
        return (value_v, None) if abs(value_v) < self._settings.range_v else (math.nan, "over-range")

    async def _read(self, register: int) -> tuple[int, ...]:
        try:
            return await self._bus.read(UNIT, READ_HOLDING, register, 2, self._around.deadline_s)
        except DeadlineError:
            raise LinkLostError(DEVICE, f"the LabJack does not answer within {self._around.deadline_s:g} s") from None


def build(
    settings: LabjackSettings,
    surroundings: CubeSurroundings,
    path: Callable[[str], ModbusPath] | None = None,
) -> LabjackCube:
    """Return the cube, not yet connected, over the line of the settings unless a way is given."""
    where = None if settings.line is None else endpoint(settings.line)
    if path is not None:
        way = path(settings.line or "")
    elif where is not None:
        way = TcpPath(DEVICE, where, surroundings.tap)
    else:
        raise SettingsError('instruments.cube.line is missing: name the LabJack, such as "tcp:192.168.1.60:502"')
    return LabjackCube(ModbusBus(way, DEVICE, 0.0, surroundings.monotonic_s, writes=True), settings, surroundings)
