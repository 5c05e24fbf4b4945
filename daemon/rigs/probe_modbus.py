"""The probe of Modbus lines: what answers there, old errors cleared, and addresses given to new sensors."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple, cast

from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.config.plugin_sections import PYRANOMETERS
from daemon.config.settings import Settings
from drivers.cube.pyranometers.makes import Block, Make, SensorIdentity, SensorReading, WrongSensorError, make_of
from drivers.cube.pyranometers.settings import MakeName, PyranometersSettings
from drivers.errors import DeadlineError, RefusedError, UnavailableError
from drivers.modbus.client import ModbusBus
from drivers.modbus.pdu import READ_HOLDING, READ_INPUT_REGISTERS, write_coil, write_register
from drivers.modbus.transports import ModbusTransport, build_transport
from drivers.transcript import Tap, no_tap

Say = Callable[[str], object]
Ask = Callable[[str], str]

_SMP_ERROR_CODE, _SMP_CLEAR_ERROR = 26, 10
_RECOGNISED: tuple[MakeName, ...] = ("smp", "hukseflux", "hukseflux-pv")
_ADDRESS_REGISTERS: dict[MakeName, int] = {"hukseflux": 0, "hukseflux-pv": 0x1000}
_ANY_REGISTER = Block(READ_HOLDING, 0, 1)
_GARBLED = "answers with garbage: are there two sensors of this address?"
_UNCHANGEABLE_WHY = {
    "smp": "an SMP takes its address from the maker's Smart Explorer alone",
    "apogee": "a write to an Apogee may wipe its calibration; use the maker's tool",
}


class AnsweringDevice(NamedTuple):
    """A device that answers.

    Attributes
    ----------
    unit
        Its address.
    text
        Its identity, as far as that is known, and its reading.
    make
        The make whose registers it was read by; None for an unknown one.
    serial
        Its serial number, if it has one to read.
    """

    unit: int
    text: str
    make: MakeName | None = None
    serial: int | None = None


class ModbusProbe:
    """Looks at the lines of a configuration.

    Parameters
    ----------
    settings
        Settings with the cube that is looked at.
    line
        Line to use instead of those of the configuration.
    clock
        The service's time.
    say
        Takes the lines of the report.
    tap
        Called with all bytes on the lines.
    path
        Returns the transport of a line by its name; None: the transport that the name means.

    Raises
    ------
    UserError
        The cube is not one of pyranometers on Modbus, or no line is known.
    """

    def __init__(
        self,
        settings: Settings,
        line: str | None,
        clock: Clock,
        say: Say,
        tap: Tap = no_tap,
        path: Callable[[str], ModbusTransport] | None = None,
    ) -> None:
        own = settings.instruments.cube
        if own.driver != PYRANOMETERS:
            raise UserError(
                f'instruments.cube.driver is "{own.driver}": only the cube "{PYRANOMETERS}" is probed on its line;'
                " 'heliocube probe voltmeter' and 'probe multiplexer' look at the usual one, and --cube NAME chooses"
            )
        self._own = cast("PyranometersSettings", own)
        named = [line] if line else [name for name in map(self._own.line_of, FACES) if name]
        if not named:
            raise UserError("instruments.cube.line is missing; name the line with --line, such as COM5 or tcp:HOST:502")
        self._lines = list(dict.fromkeys(named))
        self._clock = clock
        self._say = say
        self._tap = tap
        self._path = path

    async def report(self, units: Sequence[int], *, clear: bool) -> dict[str, Any]:
        """Say which device answers at which address; with `clear`, clear old errors. Raises `DeviceError`.

        Returns the devices by line, for scripts.
        """
        answering: dict[str, list[dict[str, Any]]] = {}
        for line in self._lines:
            bus = self._bus(line, writes=clear)
            self._say(f"{line}:")
            await bus.open()
            try:
                found = await self._find(bus, line, units)
                answering[line] = [each._asdict() | {"face": self._face_at(line, each.unit)} for each in found]
                for each in found:
                    self._say(f"  address {each.unit}: {each.text}{self._face_of(line, each)}")
                    if clear and each.make == "smp":
                        with _naming_silent_address(each.unit):
                            await self._clear(bus, each.unit)
            finally:
                await bus.close()
            if not found:
                self._say(
                    f"  nothing answers at {units[0]} to {units[-1]}: are they on, A and B the right way round, speed"
                    f" and parity ({self._own.serial_speed}, {self._own.serial_form}) as at the sensors?"
                )
        return {"lines": answering}

    async def set_addresses(self, ask: Ask, units: Sequence[int]) -> dict[str, Any]:
        """Guide a person through giving each face's sensor its address, with one sensor on the line at a time.

        Nothing is written before the person has confirmed it twice. Raises `DeviceError`.
        """
        for face in FACES:
            line = self._own.line_of(face) if len(self._lines) > 1 else self._lines[0]
            bus = self._bus(line or self._lines[0], writes=True)
            await bus.open()
            try:
                await self._set_one(bus, line or "", face, ask, units)
            finally:
                await bus.close()
        return {}

    async def _set_one(self, bus: ModbusBus, line: str, face: str, ask: Ask, units: Sequence[int]) -> None:
        wanted = self._own.face(face).address
        while True:
            answer = ask(f"Connect the {face} sensor ALONE to {line} and press Enter; s and Enter skips it")
            if answer.strip().lower() == "s":
                return
            found = await self._find(bus, line, units)
            garbled = [each.unit for each in found if each.text == _GARBLED]
            if len(found) == 1 and not garbled:
                break
            many = f"{len(found)} devices answer, at {', '.join(str(each.unit) for each in found)}: take the others off"
            if garbled:
                # A write to this address would reach all sensors that have it.
                many = _two_sensors_text(garbled)
            self._say(f"  {many if found else 'nothing answers: is it on, and are speed and parity right?'}")
        sensor = found[0]
        self._say(f"  address {sensor.unit}: {sensor.text}")
        if sensor.unit == wanted:
            self._say(f"  it has the address {wanted} already")
        elif await self._write_address(bus, sensor, wanted, ask):
            await self._confirm(bus, line, sensor, wanted, ask)
        if sensor.serial is not None:
            self._say(f"  pin it: serial = {sensor.serial} in [instruments.cube.{face}]")

    async def _write_address(self, bus: ModbusBus, sensor: AnsweringDevice, wanted: int, ask: Ask) -> bool:
        register = self._address_register(sensor)
        if register is None:
            make = sensor.make or self._own.make
            why = _UNCHANGEABLE_WHY.get(make, "set instruments.cube.map.address_register, or use the maker's tool")
            self._say(f"  its address is not changed here: {why}")
            return False
        if ask(f"Give {sensor.text.partition(':')[0]} the address {wanted} instead of {sensor.unit}? yes") != "yes":
            self._say("  left as it is")
            return False
        if ask(f"Type the new address once more ({wanted}) and it is written") != str(wanted):
            self._say("  that was another number: left as it is")
            return False
        with _naming_silent_address(sensor.unit):
            await bus.ask(write_register(sensor.unit, register, wanted), self._within_s)
        return True

    async def _confirm(self, bus: ModbusBus, line: str, sensor: AnsweringDevice, wanted: int, ask: Ask) -> None:
        while True:
            ask("Written. Switch the sensor off and on, wait ten seconds, and press Enter")
            found = await self._find(bus, line, [wanted])
            if not found:
                self._say(f"  nothing answers at {wanted}")
            elif found[0].text == _GARBLED:
                self._say(f"  {_two_sensors_text([wanted])}")
            elif found[0].serial != sensor.serial:
                numbers = f"{found[0].serial}, not {sensor.serial}"
                self._say(f"  another sensor answers at {wanted}: it has the serial number {numbers}")
            else:
                self._say(f"  it answers at {wanted} now")
                return
            if ask("Try again? Enter, or n and Enter").strip().lower() == "n":
                return

    def _address_register(self, sensor: AnsweringDevice) -> int | None:
        if sensor.make in _ADDRESS_REGISTERS:
            return _ADDRESS_REGISTERS[sensor.make]
        unknown = sensor.make is None or sensor.make == "map"
        return self._own.map.address_register if unknown and self._own.make == "map" else None

    async def _find(self, bus: ModbusBus, line: str, units: Sequence[int]) -> list[AnsweringDevice]:
        found = []
        for unit in units:
            try:
                await self._greet(bus, unit, twice=self._face_at(line, unit) is not None)
            except DeadlineError as error:
                # A gateway answers in place of devices that are not there.
                if error.message and not isinstance(error, UnavailableError):
                    found.append(AnsweringDevice(unit, _GARBLED))
                continue
            found.append(await self._identify_unit(bus, line, unit))
        return found

    async def _greet(self, bus: ModbusBus, unit: int, *, twice: bool) -> None:
        """Ask an address for any register, to see whether it answers; raises `DeadlineError` if it is silent."""
        with suppress(RefusedError):
            await self._read(bus, unit, _ANY_REGISTER, times=2 if twice else 1)

    async def _read(self, bus: ModbusBus, unit: int, block: Block, *, times: int = 2) -> tuple[int, ...]:
        """Read a block, up to `times` times if there is no proper answer: one question may be lost, hardly two."""
        for _ in range(times - 1):
            with suppress(DeadlineError):
                return await bus.read(unit, *block, self._within_s)
        return await bus.read(unit, *block, self._within_s)

    async def _identify_unit(self, bus: ModbusBus, line: str, unit: int) -> AnsweringDevice:
        text = "answers; its make is not known here, see docs/instruments.md for a map"
        for name, make in self._candidates(line, unit):
            try:
                words = await self._read(bus, unit, make.proof) if make.proof else ()
                more = [await self._read(bus, unit, block) for block in make.more]
                who = make.identify(words, *more)
                told = make.decode(await self._read(bus, unit, make.data))
            except DeadlineError as error:
                text = _GARBLED if error.message else text
            except (RefusedError, WrongSensorError):
                pass
            else:
                return self._answering(unit, name, who, told)
        return AnsweringDevice(unit, text)

    def _answering(self, unit: int, name: MakeName, who: SensorIdentity, told: SensorReading) -> AnsweringDevice:
        value = "no value" if told.flaw else f"{told.w_m2:z.2f} W/m2"
        return AnsweringDevice(unit, f"{who.text}: {value}{', ' if told.note else ''}{told.note}", name, who.serial)

    def _candidates(self, line: str, unit: int) -> Iterator[tuple[MakeName, Make]]:
        """Yield the makes that can be recognised, then the one that is configured for this address."""
        for name in _RECOGNISED:
            yield name, make_of(name, self._own.map)
        for face in FACES:
            here = self._own.line_of(face) in (None, line) and self._own.face(face).address == unit
            if here and self._own.make_of(face) not in _RECOGNISED:
                yield self._own.make_of(face), make_of(self._own.make_of(face), self._own.map_of(face))

    def _face_at(self, line: str, unit: int) -> str | None:
        for face in FACES:
            if self._own.line_of(face) in (None, line) and self._own.face(face).address == unit:
                return face
        return None

    def _face_of(self, line: str, found: AnsweringDevice) -> str:
        face = self._face_at(line, found.unit)
        if face is None:
            return "; not configured"
        serial = self._own.face(face).serial
        if serial is not None and found.serial != serial:
            return f"; the {face} face is configured here, with serial number {serial}: INTERCHANGED?"
        return f"; configured as the {face} face"

    async def _clear(self, bus: ModbusBus, unit: int) -> None:
        (code,) = await bus.read(unit, READ_INPUT_REGISTERS, _SMP_ERROR_CODE, 1, self._within_s)
        if not code:
            self._say("    it keeps no error")
            return
        await bus.ask(write_coil(unit, _SMP_CLEAR_ERROR, on=True), self._within_s)
        self._say(f"    error {code} cleared")

    @property
    def _within_s(self) -> float:
        return self._own.answer_within_s

    def _bus(self, line: str, *, writes: bool) -> ModbusBus:
        own = self._own
        if self._path is not None:
            path = self._path(line)
        else:
            try:
                path = build_transport(
                    "cube", line, own.serial_speed, own.serial_form, self._clock.monotonic, self._tap
                )
            except ValueError:
                raise UserError(
                    f"--line {line!r} is neither a serial port whose name outlives a replug, nor tcp:HOST:PORT, nor"
                    " rtu-over-tcp:HOST:PORT"
                ) from None
        return ModbusBus(path, "cube", own.gap_s, self._clock.monotonic, writes=writes)


@contextmanager
def _naming_silent_address(unit: int) -> Iterator[None]:
    """Name the address whose answer is missing, in an error that a person reads."""
    try:
        yield
    except DeadlineError as error:
        message = error.message or f"address {unit} no longer answers: is it still on? Then give the command again"
        raise DeadlineError(error.device, message) from None


def unit_range(text: str) -> range:
    """Return the addresses of a text such as `1-32` or `7`; `UserError` for any other text."""
    first, _, last = text.partition("-")
    try:
        units = range(int(first), int(last or first) + 1)
    except ValueError:
        units = range(0)
    if not units or not set(units) <= set(range(1, 248)):
        raise UserError(f"--addresses {text!r} is not a range of addresses from 1 to 247, such as 1-32")
    return units


def _two_sensors_text(units: Sequence[int]) -> str:
    return f"the answer at {', '.join(map(str, units))} is garbage: leave one sensor on the line, not two"
