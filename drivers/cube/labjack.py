"""The cube `labjack`: four sensors at the analogue inputs of a LabJack T7 or T8, over Modbus TCP.

Registers by LabJack's own list (ljm_constants): AINn float at 2n, its range at 40000 + 2n, its negative channel at
41000 + n, its resolution index at 41500 + n, its settling time at 42000 + 2n; TEST 55100, PRODUCT_ID 60000,
SERIAL_NUMBER 60028. The ranges of each type are from there too; a T8 ignores negative channel and settling time.
Inferred: a value at the end of the range or beyond is no reading, as is the error value -9999.
"""

import math
from collections.abc import Callable, Iterator
from typing import Annotated, NamedTuple

from pydantic import AfterValidator, Field, WithJsonSchema

from drivers.errors import DeadlineError, IdentityError, LinkLostError, ProtocolError, RefusedError
from drivers.interfaces import CubeReading, FaceFlaw, FaceSample
from drivers.modbus.client import ModbusBus
from drivers.modbus.pdu import READ_HOLDING, decode_number, encode_number, write_registers
from drivers.modbus.transports import ModbusLine, ModbusTransport, TcpTransport, endpoint
from drivers.settings import CubeDriverSettings, CubeSurroundings, SettingsConflict, SettingsError

DEVICE = "cube"
UNIT = 1
TEST, TEST_WORDS = 55100, (0x0011, 0x2233)
PRODUCT_ID, SERIAL_NUMBER = 60000, 60028
AIN_RANGE, AIN_NEGATIVE, AIN_RESOLUTION, AIN_SETTLING_US = 40000, 41000, 41500, 42000
T7, T8 = 7, 8
RANGES_V = {
    T7: (0.01, 0.1, 1.0, 10.0),
    T8: (0.018, 0.036, 0.075, 0.15, 0.3, 0.6, 1.2, 2.4, 4.8, 9.6, 11.0),
}
"""The ranges [V] of each type."""
_INPUTS_OF_T8 = 8
_OPEN_S = 5.0


def _known_range(value: float) -> float:
    if value not in RANGES_V[T7]:
        raise ValueError("not a range of a LabJack")
    return value


LabjackRange = Annotated[
    float, AfterValidator(_known_range), WithJsonSchema({"type": "number", "enum": list(RANGES_V[T7])})
]


class LabjackSettings(CubeDriverSettings):
    """labjack: four sensors at the analogue inputs of a LabJack T7 or T8 in the network."""

    line: ModbusLine | None = Field(
        None,
        examples=["tcp:192.168.1.60:502"],
        description="The line that the LabJack or the sensors are on; a LabJack is only on Modbus TCP.",
    )
    inputs: tuple[int, ...] = Field(
        (0, 2, 4, 6),
        strict=False,
        min_length=4,
        max_length=4,
        description="Inputs AIN of east, south, west and zenith. A T7 measures each against the next odd input.",
    )
    range_v: LabjackRange = Field(
        1.0,
        description="Measuring range of a T7, from minus to plus. At 0.1 mV per W/m2, 0.1 V ends at 1000 W/m2, which"
        " clouds exceed. A T8 takes its next wider one: 0.018, 0.15, 1.2 or 11 V.",
    )
    resolution_index: int = Field(
        8,
        ge=0,
        le=16,
        description="Resolution index of the LabJack, higher is finer and slower: the finest is 8 for a T7,"
        " 12 for a T7-Pro, 16 for a T8.",
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


class _Setting(NamedTuple):
    """One setting of an input: its name for people, its register, and the words there."""

    name: str
    register: int
    words: tuple[int, ...]


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
        self._range_v = settings.range_v
        self._wanted: list[_Setting] = []
        self._turn = 0

    async def open(self) -> str:
        """Connect, identify, set the four inputs and read back what was set."""
        await self.close()
        await self._bus.open(_OPEN_S)
        if await self._read(TEST) != TEST_WORDS:
            raise IdentityError(DEVICE, "the device that answers is not a LabJack, or sends its words in another order")
        product, serial = decode_number(await self._read(PRODUCT_ID), "float32"), await self._read(SERIAL_NUMBER)
        if product not in RANGES_V:
            raise IdentityError(DEVICE, f"is a LabJack of type {product:g}, but a T7 or T8 was expected")
        self._range_v = next(each for each in RANGES_V[int(product)] if each >= self._settings.range_v)
        self._wanted = [setting for each in self._settings.inputs for setting in self._settings_of(each, int(product))]
        for setting in self._wanted:
            await self._write(setting)
        for setting in self._wanted:
            if not await self._is_kept(setting):
                raise ProtocolError(DEVICE, f"did not keep the {setting.name}")
        return f"LabJack T{product:g} no. {int(decode_number(serial, 'uint32'))}"

    async def close(self) -> None:
        """Disconnect."""
        await self._bus.close()

    async def read(self) -> CubeReading:
        """Read the four inputs, each with its instant, and look whether one of the settings still holds."""
        east, south, west, zenith = [await self._sample(each) for each in self._settings.inputs]
        # Another program in the network may set the inputs too, and a restart sets them to 10 V against ground.
        if self._wanted:
            self._turn = (self._turn + 1) % len(self._wanted)
            if not await self._is_kept(self._wanted[self._turn]):
                raise LinkLostError(
                    DEVICE, f"the {self._wanted[self._turn].name} has changed: is another program setting the LabJack?"
                )
        # The steps of a 16-bit converter are wider than its noise on the larger ranges.
        return CubeReading(east=east, south=south, west=west, zenith=zenith, unit="V", rounded=True)

    def _settings_of(self, each: int, product: int) -> Iterator[_Setting]:
        if product == T7 and each % 2:
            raise ProtocolError(DEVICE, f"is a T7, which measures even inputs against odd ones, but {each} is odd")
        if product == T8 and each >= _INPUTS_OF_T8:
            raise ProtocolError(DEVICE, f"is a T8, which has the inputs 0 to {_INPUTS_OF_T8 - 1}, and not {each}")
        yield _Setting(f"range of AIN{each}", AIN_RANGE + 2 * each, encode_number(self._range_v, "float32"))
        index = self._settings.resolution_index
        yield _Setting(f"resolution index {index} of AIN{each}", AIN_RESOLUTION + each, (index,))
        if product == T7:
            yield _Setting(f"negative channel of AIN{each}", AIN_NEGATIVE + each, (each + 1,))
            # 0 lets the LabJack choose; what another program has left here may be too short for a sensor.
            yield _Setting(f"settling time of AIN{each}", AIN_SETTLING_US + 2 * each, encode_number(0.0, "float32"))

    async def _write(self, setting: _Setting) -> None:
        try:
            await self._bus.ask(write_registers(UNIT, setting.register, setting.words), self._around.deadline_s)
        except DeadlineError as error:
            raise LinkLostError(DEVICE, "the LabJack does not answer") from error
        except RefusedError as error:
            raise ProtocolError(DEVICE, f"does not take the {setting.name}: {error.message}") from error

    async def _is_kept(self, setting: _Setting) -> bool:
        return await self._read(setting.register, len(setting.words)) == setting.words

    async def _sample(self, each: int) -> FaceSample:
        value_v = math.nan
        flaw: FaceFlaw | None = None
        try:
            value_v, flaw = self._judged(decode_number(await self._read(2 * each), "float32"))
        except RefusedError:
            flaw = "missing"
        return FaceSample(value_v, self._around.utc_s(), self._around.monotonic_s(), flaw)

    def _judged(self, value_v: float) -> tuple[float, FaceFlaw | None]:
        if math.isnan(value_v):
            return value_v, "missing"
        return (value_v, None) if abs(value_v) < self._range_v else (math.nan, "over-range")

    async def _read(self, register: int, count: int = 2) -> tuple[int, ...]:
        try:
            return await self._bus.read(UNIT, READ_HOLDING, register, count, self._around.deadline_s)
        except DeadlineError:
            raise LinkLostError(DEVICE, f"the LabJack does not answer within {self._around.deadline_s:g} s") from None


def build(
    settings: LabjackSettings,
    surroundings: CubeSurroundings,
    path: Callable[[str], ModbusTransport] | None = None,
) -> LabjackCube:
    """Return the cube, not yet connected, over the line of the settings unless a way is given."""
    where = None if settings.line is None else endpoint(settings.line)
    if path is not None:
        way = path(settings.line or "")
    elif where is not None:
        way = TcpTransport(DEVICE, where, surroundings.tap)
    else:
        raise SettingsError('instruments.cube.line is missing: name the LabJack, such as "tcp:192.168.1.60:502"')
    return LabjackCube(ModbusBus(way, DEVICE, 0.0, surroundings.monotonic_s, writes=True), settings, surroundings)
