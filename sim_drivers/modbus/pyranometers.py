"""Simulated pyranometers: the registers of each make, and what the makes are known to do that a driver has to bear."""

import math
from collections.abc import Callable
from typing import Any

from drivers.cube.pyranometers.settings import MakeName, RegisterMapSettings
from drivers.modbus.pdu import (
    DEVICE_FAILURE,
    ILLEGAL_ADDRESS,
    ILLEGAL_FUNCTION,
    ILLEGAL_VALUE,
    READ_HOLDING,
    READ_INPUT_REGISTERS,
    encode_number,
)
from drivers.modbus.server import RefusedRequestError, SilentError

_HUKSEFLUX_MOST = 5
_DELTA_OHM_BOOT_S = 10.0
_SMP_CLEAR_ERROR, _SMP_VOID, _SMP_ERROR = 10, 1 << 0, 1 << 3
_DELTA_OHM_NO_MEASUREMENT = 1 << 0
_NO_NUMBER = encode_number(math.nan, "float32")
_DEAF_S = 0.03
_BOTH_FUNCTIONS = (READ_HOLDING, READ_INPUT_REGISTERS)


class SimulatedPyranometer:
    """A sensor, as a table of registers.

    Parameters
    ----------
    address, serial
        Who it is.
    irradiance
        What falls on it [W/m2] at a monotonic time; NaN while it cannot measure.

    Attributes
    ----------
    status, mode
        What it says of itself; makes without such a register say nothing.
    silent
        Whether it has stopped answering.
    delay_s
        How much later it answers than it should.
    corrupt
        How many of its next replies are garbled on the way.
    deaf_s
        For how long after a reply on its pair it misses a question.
    now_s
        The time of the question that it is just asked.
    """

    functions: tuple[int, ...] = (READ_HOLDING,)

    def __init__(self, address: int, serial: int, irradiance: Callable[[float], float]) -> None:
        self.address = address
        self.serial = serial
        self.status = 0
        self.mode = 1
        self.silent = False
        self.delay_s = 0.0
        self.corrupt = 0
        self.deaf_s = _DEAF_S
        self.now_s = 0.0
        self._irradiance = irradiance
        self._on_since_s = -1e9

    def registers(self, w_m2: float) -> dict[int, int]:
        """Return everything that can be read."""
        raise NotImplementedError

    def blind_registers(self) -> dict[int, int]:
        """Return everything that can be read while it cannot measure; what a make says then is often not known."""
        raise RefusedRequestError(DEVICE_FAILURE)

    def power_cycle(self, now_s: float) -> None:
        """Switch it off and on."""
        self._on_since_s = now_s

    def state(self) -> dict[str, Any]:
        """Return who it is and how it is."""
        names = ("address", "serial", "status", "mode", "silent", "delay_s")
        return {"make": type(self).__name__.removeprefix("Simulated")} | {name: getattr(self, name) for name in names}

    def read(self, function: int, register: int, count: int) -> tuple[int, ...]:
        """Return registers."""
        if function not in self.functions:
            raise RefusedRequestError(ILLEGAL_FUNCTION)
        w_m2 = self._irradiance(self.now_s)
        known = self.blind_registers() if math.isnan(w_m2) else self.registers(w_m2)
        try:
            return tuple(known[each] & 0xFFFF for each in range(register, register + count))
        except KeyError:
            raise RefusedRequestError(ILLEGAL_ADDRESS) from None

    def write(self, function: int, register: int, values: tuple[int, ...]) -> None:  # noqa: ARG002
        """Refuse: most of them have nothing that may be written."""
        raise RefusedRequestError(ILLEGAL_ADDRESS)

    def read_bits(self, function: int, first: int, count: int) -> tuple[bool, ...]:  # noqa: ARG002
        """Refuse: most of them have none."""
        raise RefusedRequestError(ILLEGAL_FUNCTION)

    def write_bits(self, function: int, first: int, values: tuple[bool, ...]) -> None:  # noqa: ARG002
        """Refuse."""
        raise RefusedRequestError(ILLEGAL_FUNCTION)


class SimulatedSmp(SimulatedPyranometer):
    """Kipp & Zonen SMP3; input and holding registers are one table, and so are coils and discrete inputs."""

    functions = _BOTH_FUNCTIONS
    kind = 601
    scale = 1

    def registers(self, w_m2: float) -> dict[int, int]:
        """Return the registers that the manual has."""
        value = encode_number(w_m2 * 10.0**self.scale, "int16")[0]
        measured = [self.kind, 100, self.mode, self.status, self.scale, value, value, 3, 248, 234, *[0] * 16]
        errors = [9 if self.status & _SMP_ERROR else 0, *[0] * 7, self.scale]
        return (
            dict(enumerate(measured))
            | dict(enumerate(errors, 26))
            | dict(enumerate((2023, self.serial, 108, 5, self.address), 41))
        )

    def blind_registers(self) -> dict[int, int]:
        """Return the registers with the flag of void data."""
        return self.registers(0.0) | {3: self.status | _SMP_VOID}

    def read_bits(self, function: int, first: int, count: int) -> tuple[bool, ...]:  # noqa: ARG002
        """Return the flags of the status behind one that is always off and one that is always on."""
        bits = (False, True, *(bool(self.status >> bit & 1) for bit in range(7)))
        if first + count > len(bits):
            raise RefusedRequestError(ILLEGAL_ADDRESS)
        return bits[first : first + count]

    def write_bits(self, function: int, first: int, values: tuple[bool, ...]) -> None:  # noqa: ARG002
        """Clear the error."""
        if first != _SMP_CLEAR_ERROR:
            raise RefusedRequestError(ILLEGAL_ADDRESS)
        if values[0]:
            self.status &= ~_SMP_ERROR


class SimulatedHukseflux(SimulatedPyranometer):
    """Hukseflux SR20-D; a new address holds from the next restart on."""

    functions = _BOTH_FUNCTIONS
    base = 0
    model = "SR20-D2   "

    def __init__(self, address: int, serial: int, irradiance: Callable[[float], float]) -> None:
        super().__init__(address, serial, irradiance)
        self.stored_address = address

    def registers(self, w_m2: float) -> dict[int, int]:
        """Return the registers that the manual has."""
        irradiance = encode_number(w_m2 * 100.0, "int32")
        letters = self.model.encode()
        model = [letters[2 * index] | letters[2 * index + 1] << 8 for index in range(5)]
        known = dict(enumerate((self.stored_address, 5, *irradiance, *irradiance, 2225, 1234, 100, 100, 0, 7000)))
        known |= dict(enumerate((*model, 0, 0, 0, self.serial, *encode_number(15.31, "float32"), 45), 32))
        return {self.base + register: value for register, value in known.items()}

    def read(self, function: int, register: int, count: int) -> tuple[int, ...]:
        """Return registers; a question for more than five is not answered at all."""
        if count > _HUKSEFLUX_MOST:
            raise SilentError
        return super().read(function, register, count)

    def write(self, function: int, register: int, values: tuple[int, ...]) -> None:  # noqa: ARG002
        """Take a new address."""
        if register != self.base:
            raise RefusedRequestError(ILLEGAL_ADDRESS)
        if not 1 <= values[0] <= 247:
            raise RefusedRequestError(ILLEGAL_VALUE)
        self.stored_address = values[0]

    def power_cycle(self, now_s: float) -> None:
        """Switch it off and on: the stored address is its own from now on."""
        super().power_cycle(now_s)
        self.address = self.stored_address


class SimulatedHuksefluxPv(SimulatedHukseflux):
    """Hukseflux SR05-D1A3-PV: its own map begins at 0x1000, below it mimics a reference cell."""

    base = 0x1000
    model = "SR05-D1A3 "

    def registers(self, w_m2: float) -> dict[int, int]:
        """Return both maps."""
        return super().registers(w_m2) | {0: encode_number(w_m2 * 10.0, "uint16")[0]}


class SimulatedApogee(SimulatedPyranometer):
    """Apogee SP-522."""

    def registers(self, w_m2: float) -> dict[int, int]:
        """Return the floats, and the same as integers times ten."""
        floats = (*encode_number(w_m2, "float32"), *encode_number(w_m2 / 40.0, "float32"), *[0] * 8)
        return dict(enumerate(floats)) | {40: encode_number(w_m2 * 10.0, "int16")[0]}

    def blind_registers(self) -> dict[int, int]:
        """Return a float that is no number."""
        return self.registers(0.0) | dict(enumerate(_NO_NUMBER))


class SimulatedEko(SimulatedPyranometer):
    """EKO MS-60S."""

    def registers(self, w_m2: float) -> dict[int, int]:
        """Return the irradiance."""
        return dict(enumerate((0, 0, *encode_number(w_m2, "float32"))))

    def blind_registers(self) -> dict[int, int]:
        """Return a float that is no number."""
        return self.registers(0.0) | dict(enumerate(_NO_NUMBER, 2))


class SimulatedDeltaOhm(SimulatedPyranometer):
    """Delta OHM LPPYRA13, silent for ten seconds after power-up."""

    functions = (READ_INPUT_REGISTERS,)

    def registers(self, w_m2: float) -> dict[int, int]:
        """Return irradiance and status."""
        if self.now_s - self._on_since_s < _DELTA_OHM_BOOT_S:
            raise SilentError
        return {0: 0, 1: 250, 2: encode_number(w_m2, "int16")[0], 3: self.status}

    def blind_registers(self) -> dict[int, int]:
        """Return the registers with the bit that says that there is no measurement."""
        return self.registers(0.0) | {3: self.status | _DELTA_OHM_NO_MEASUREMENT}


class SimulatedMapped(SimulatedPyranometer):
    """A sensor with the registers that a map of the configuration says, and no others; a logger has several maps."""

    functions = _BOTH_FUNCTIONS

    def __init__(
        self, address: int, serial: int, irradiance: Callable[[float], float], used: RegisterMapSettings
    ) -> None:
        super().__init__(address, serial, irradiance)
        self._maps = [(used, irradiance)]

    def add(self, used: RegisterMapSettings, irradiance: Callable[[float], float]) -> None:
        """Let it show another sensor."""
        self._maps.append((used, irradiance))

    def registers(self, w_m2: float) -> dict[int, int]:  # noqa: ARG002 - each map has a sensor of its own
        """Return irradiance, status, serial number and address as far as the maps have them."""
        known: dict[int, int] = {}
        for used, irradiance in self._maps:
            known |= self._registers_by_map(used, irradiance(self.now_s))
        return known

    def blind_registers(self) -> dict[int, int]:
        """Return what `registers` does: each map has a sensor of its own, which gives NaN while it cannot measure."""
        return self.registers(math.nan)

    def _registers_by_map(self, used: RegisterMapSettings, w_m2: float) -> dict[int, int]:
        known: dict[int, int] = {}
        status = self.status
        if math.isnan(w_m2) and used.number_type != "float32":
            if used.status_register is None:
                raise RefusedRequestError(DEVICE_FAILURE)
            status, w_m2 = status | used.status_bits, 0.0
        if used.status_register is not None:
            low, high = sorted((used.status_register, used.register_number))
            known = {**dict.fromkeys(range(low, high), 0), used.status_register: status}
        if used.serial_register is not None:
            serial = encode_number(self.serial, used.serial_type, used.word_order)
            known |= dict(enumerate(serial, used.serial_register))
        if used.address_register is not None:
            known[used.address_register] = self.address
        value = encode_number(w_m2 / used.scale, used.number_type, used.word_order)
        return known | dict(enumerate(value, used.register_number))


_SENSOR_OF_MAKE: dict[MakeName, type[SimulatedPyranometer]] = {
    "smp": SimulatedSmp,
    "hukseflux": SimulatedHukseflux,
    "hukseflux-pv": SimulatedHuksefluxPv,
    "apogee": SimulatedApogee,
    "eko-ms60s": SimulatedEko,
    "delta-ohm": SimulatedDeltaOhm,
}


def simulated_pyranometer(
    make: MakeName, address: int, serial: int, irradiance: Callable[[float], float], used: RegisterMapSettings
) -> SimulatedPyranometer:
    """Return a sensor of a make, or by a map."""
    if make == "map":
        return SimulatedMapped(address, serial, irradiance, used)
    return _SENSOR_OF_MAKE[make](address, serial, irradiance)
