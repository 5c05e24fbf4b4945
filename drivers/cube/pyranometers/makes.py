"""What each make says in its registers, and which of it can be believed.

Sources: Kipp & Zonen "SMP series" manual, appendix A; Hukseflux "SR05-D1A3-PV manual v1801"; Apogee SP-522 manual; EKO
MS-60S manual (its number type is inferred); Delta OHM LPPYRA13 manual. Registers count from 0.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from drivers.cube.pyranometers.settings import MakeName, RegisterMapSettings
from drivers.interfaces import FaceFlaw
from drivers.modbus.pdu import READ_HOLDING, READ_INPUT_REGISTERS, decode_number, register_count

Words = tuple[int, ...]


class Block(NamedTuple):
    """Registers that are read in one question."""

    function: int
    register: int
    length: int


class SensorReading(NamedTuple):
    """What a sensor tells in one reply.

    Attributes
    ----------
    w_m2
        The irradiance; NaN where there is none to be used.
    flaw
        Why there is none.
    note
        What the sensor reports to be wrong with itself, for people.
    """

    w_m2: float
    flaw: FaceFlaw | None = None
    note: str = ""


class SensorIdentity(NamedTuple):
    """Who a sensor says it is; no serial number where its make tells none."""

    text: str
    serial: int | None = None


class Make(Protocol):
    """One make's registers."""

    @property
    def data(self) -> Block:
        """The block read at every scan, in one question, so that value, scale and flags are of one moment."""

    @property
    def proof(self) -> Block | None:
        """The block asked of a sensor that has been silent; None where no such question is known.

        Its reply has another length than that to `data`, so that a late reply to one is not taken for the other. It
        has the serial number where there is one.
        """

    @property
    def more(self) -> tuple[Block, ...]:
        """Further blocks that `identify` needs."""

    def identify(self, proof: Words, *more: Words) -> SensorIdentity:
        """Return who it is; `WrongSensorError` if it is something else."""

    def serial(self, proof: Words) -> int | None:
        """Return the serial number."""

    def decode(self, data: Words) -> SensorReading:
        """Return what it tells."""


class WrongSensorError(Exception):
    """What answers is of another kind; the message says which."""


_SMP_NAMES = {
    **dict.fromkeys((601, 602), "SMP3"),
    **dict.fromkeys((603, 604), "SMP11"),
    **dict.fromkeys((605, 606), "SMP21"),
    **dict.fromkeys((607, 608), "SMP22"),
    **dict.fromkeys((617, 618), "SMP10"),
    **dict.fromkeys((619, 620), "SMP6"),
    633: "SMP12",
}
_SMP_OTHERS = {609: "SGR3 pyrgeometer", 610: "SGR3 pyrgeometer", 613: "SHP1 pyrheliometer", 614: "SHP1 pyrheliometer"}
_SMP_MODES = {2: "service mode", 3: "calibration mode", 4: "factory mode", 5: "a fatal error"}
_SMP_FLAGS = {
    0: "void data",
    1: "overflow",
    2: "underflow",
    4: "an ADC error",
    5: "a DAC error",
    6: "a calibration error",
    7: "an EEPROM error",
}
_SMP_OVERFLOW, _SMP_ERROR = 1 << 1, 1 << 3
_SMP_FACTORS = {2: 0.01, 1: 0.1, 0: 1.0, -1: 10.0}


class Smp:
    """Kipp & Zonen SMP3 to SMP22. Reading register 7 restarts the sensor's deviation, so it is never read."""

    data = Block(READ_INPUT_REGISTERS, 0, 7)
    proof: Block | None = Block(READ_INPUT_REGISTERS, 41, 5)
    more: tuple[Block, ...] = (Block(READ_INPUT_REGISTERS, 0, 2),)

    def identify(self, proof: Words, *more: Words) -> SensorIdentity:
        """Return type, serial number and software."""
        kind = more[0][0]
        self._require_kind(kind)
        batch, serial, software, *_ = proof
        name = _SMP_NAMES.get(kind, f"SMP of type {kind}")
        return SensorIdentity(f"{name} no. {serial} of {batch}, software {software}", serial)

    def serial(self, proof: Words) -> int | None:
        """Return the serial number."""
        return proof[1]

    def decode(self, data: Words) -> SensorReading:
        """Refuse the value in any mode but the normal one, or with a flag set; bit 3 alone is a warning."""
        kind, _, mode, status, scale, value, _ = data
        self._require_kind(kind)
        if mode != 1:
            return SensorReading(
                math.nan, "missing", f"is in {_SMP_MODES.get(mode, f'mode {mode}')}, not in normal mode"
            )
        flags = [name for bit, name in _SMP_FLAGS.items() if status >> bit & 1]
        if flags:
            flaw: FaceFlaw = "over-range" if status & _SMP_OVERFLOW else "missing"
            return SensorReading(math.nan, flaw, f"reports {', '.join(flags)}")
        power = int(decode_number((scale,), "int16"))
        if power not in _SMP_FACTORS:
            return SensorReading(math.nan, "missing", f"has the scale {power}, which is not in its manual")
        note = ""
        if status & _SMP_ERROR:
            note = "keeps an error from earlier; its values are used, and 'heliocube probe cube --clear' clears it"
        return SensorReading(round(decode_number((value,), "int16") * _SMP_FACTORS[power], 2), None, note)

    def _require_kind(self, kind: int) -> None:
        if kind in _SMP_OTHERS or not 600 <= kind < 700:
            raise WrongSensorError(f"is not an SMP pyranometer but {_SMP_OTHERS.get(kind, f'a device of type {kind}')}")


class Hukseflux:
    """Hukseflux SR05-D, SR15-D, SR20-D, SR30: a question for more than five registers is not answered at all.

    Parameters
    ----------
    base
        Where the map begins: 0, or 0x1000 in the SR05-D1A3-PV.
    """

    def __init__(self, base: int = 0) -> None:
        self.data = Block(READ_HOLDING, base + 2, 2)
        self.proof: Block | None = Block(READ_HOLDING, base + 40, 3)
        self.more: tuple[Block, ...] = (Block(READ_HOLDING, base + 6, 4), Block(READ_HOLDING, base + 32, 5))
        self._per_w_m2 = 100.0

    def identify(self, proof: Words, *more: Words) -> SensorIdentity:
        """Return model and serial number, and take in the scale."""
        scale, model = more[0][2], _text_low_first(more[1])
        if not model.startswith("SR"):
            raise WrongSensorError(f"is not a Hukseflux SR but calls itself {model!r}")
        if scale == 0:
            raise WrongSensorError("has the scale 0 in register 8")
        self._per_w_m2 = float(scale)
        return SensorIdentity(f"{model} no. {proof[0]}", proof[0])

    def serial(self, proof: Words) -> int | None:
        """Return the serial number."""
        return proof[0]

    def decode(self, data: Words) -> SensorReading:
        """Return the compensated irradiance; the ends of its range are no values."""
        raw = decode_number(data, "int32")
        if abs(raw) >= 2**31 - 1:
            return SensorReading(math.nan, "over-range", "is at the end of its range")
        return SensorReading(raw / self._per_w_m2)


@dataclass(frozen=True)
class PlainRegisters:
    """One number, with a status or without: for makes that have nothing else, and for maps of the configuration.

    Attributes
    ----------
    name
        Of the make.
    data, proof
        The blocks that are read.
    register_map
        How the number is written, its factor to W/m2, and the bits of the status that spoil it.
    value_offset, status_offset
        Where number and status begin in `data`; None: there is no status.
    has_serial
        Whether `proof` is the serial number.
    """

    name: str
    data: Block
    proof: Block | None
    register_map: RegisterMapSettings
    value_offset: int = 0
    status_offset: int | None = None
    has_serial: bool = False
    more: tuple[Block, ...] = ()

    def identify(self, proof: Words, *more: Words) -> SensorIdentity:  # noqa: ARG002 - there is no more
        """Return the make, and the serial number if there is one."""
        serial = self.serial(proof)
        return SensorIdentity(self.name if serial is None else f"{self.name} no. {serial}", serial)

    def serial(self, proof: Words) -> int | None:
        """Return the serial number."""
        return (
            int(decode_number(proof, self.register_map.serial_type, self.register_map.word_order))
            if self.has_serial
            else None
        )

    def decode(self, data: Words) -> SensorReading:
        """Return the number, unless a bit of the status or the number itself says that there is none."""
        if self.status_offset is not None and (bits := data[self.status_offset] & self.register_map.status_bits):
            return SensorReading(math.nan, "missing", f"reports status bits {bits:#06x}")
        words = data[self.value_offset : self.value_offset + register_count(self.register_map.number_type)]
        value = (
            decode_number(words, self.register_map.number_type, self.register_map.word_order) * self.register_map.scale
        )
        if math.isnan(value):
            return SensorReading(value, "missing", "sends no number in its registers")
        return SensorReading(value)


def make_of(name: MakeName, used: RegisterMapSettings) -> Make:
    """Return the registers of a make, or of the map of the file."""
    if name == "smp":
        return Smp()
    if name in ("hukseflux", "hukseflux-pv"):
        return Hukseflux(0x1000 if name == "hukseflux-pv" else 0)
    if name == "map":
        return _registers_of_map(used)
    return _PLAIN[name]


def _registers_of_map(used: RegisterMapSettings) -> PlainRegisters:
    first, count = used.register_number, register_count(used.number_type)
    last = first + count - 1
    if used.status_register is not None:
        first, last = min(first, used.status_register), max(last, used.status_register)
    data = Block(used.function, first, last - first + 1)
    proof = None if data.length == 1 else Block(used.function, first, 1)
    if used.serial_register is not None:
        proof = Block(used.function, used.serial_register, register_count(used.serial_type))
    return PlainRegisters(
        name="pyranometer",
        data=data,
        proof=proof,
        register_map=used,
        value_offset=used.register_number - first,
        status_offset=None if used.status_register is None else used.status_register - first,
        has_serial=used.serial_register is not None,
    )


def _text_low_first(words: Words) -> str:
    data = b"".join(bytes((word & 0xFF, word >> 8)) for word in words)
    return "".join(letter if " " <= letter <= "~" else " " for letter in data.decode("latin-1")).strip()


_PLAIN = {
    "apogee": PlainRegisters(
        name="Apogee SP-500",
        data=Block(READ_HOLDING, 0, 2),
        proof=Block(READ_HOLDING, 0, 4),
        register_map=RegisterMapSettings(),
    ),
    "eko-ms60s": PlainRegisters(
        name="EKO MS-60S",
        data=Block(READ_HOLDING, 2, 2),
        proof=Block(READ_HOLDING, 2, 1),
        register_map=RegisterMapSettings(register_number=2),
    ),
    "delta-ohm": PlainRegisters(
        name="Delta OHM LPPYRA13",
        data=Block(READ_INPUT_REGISTERS, 2, 2),
        proof=Block(READ_INPUT_REGISTERS, 2, 1),
        register_map=RegisterMapSettings(function=4, register_number=2, number_type="int16", status_bits=0b1101),
        status_offset=1,
    ),
}
