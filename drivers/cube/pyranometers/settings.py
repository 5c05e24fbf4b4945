"""The keys of the cube `modbus-pyranometers`."""

from collections.abc import Iterator
from typing import Any, Literal

from pydantic import Field, ValidationInfo, field_validator

from drivers.lines.serial_port import SerialForm
from drivers.modbus.pdu import NumberType, WordOrder
from drivers.modbus.transports import ModbusLine
from drivers.settings import CubeDriverSettings, DriverSettings, Positive, SettingsConflict, with_defaults

FACE_NAMES = ("east", "south", "west", "zenith")
MakeName = Literal["smp", "hukseflux", "hukseflux-pv", "apogee", "eko-ms60s", "delta-ohm", "map"]
_FURTHEST_STATUS = 60
_KEYS_OF_A_FACE = ("function", "register_number", "number_type", "word_order", "scale")
_MAKES_WITH_SERIAL = ("smp", "hukseflux", "hukseflux-pv")


class RegisterMapSettings(DriverSettings):
    """Where a pyranometer of make "map" has its numbers; registers count from 0. A face may set its own."""

    function: Literal[3, 4] = Field(
        3, description="Modbus function that reads: 3 holding registers, 4 input registers."
    )
    register_number: int = Field(
        0, ge=0, le=65535, description="First register of the irradiance, counted from 0 (40001 of a manual is 0)."
    )
    number_type: NumberType = Field("float32", description="Number format of the irradiance.")
    word_order: WordOrder = Field("high-first", description="Which of two registers comes first.")
    scale: float = Field(1.0, ge=-1e6, le=1e6, description="Factor by which the number is multiplied to get W/m2.")
    status_register: int | None = Field(
        None,
        ge=0,
        le=65535,
        examples=[3],
        description="Register whose bits mark the irradiance as unusable; read together with it.",
    )
    status_bits: int = Field(
        65535, ge=1, le=65535, description="Bits of the status register that mark the irradiance as unusable."
    )
    serial_register: int | None = Field(
        None,
        ge=0,
        le=65535,
        examples=[40],
        description="First register of the serial number, so that the configured number can be checked.",
    )
    serial_type: Literal["uint16", "uint32"] = Field("uint16", description="Number format of the serial number.")
    address_register: int | None = Field(
        None,
        ge=0,
        le=65535,
        examples=[0],
        description="Register that holds the sensor's own address; 'heliocube probe cube --set-address' writes it.",
    )


class PyranometerSettings(DriverSettings):
    """One sensor. Make, line and map are those of all four sensors where they are not set here."""

    address: int = Field(1, ge=1, le=247, description="Its address on the line.")
    serial: int | None = Field(
        None,
        ge=1,
        le=4294967295,
        examples=[180123],
        description="Its serial number: a sensor with another number is not accepted for this face.",
    )
    make: MakeName | None = Field(
        None, examples=["apogee"], description="Its make, if it differs from that of the others."
    )
    line: ModbusLine | None = Field(
        None, examples=["tcp:192.168.1.41:502"], description="Its line, if it differs from that of the others."
    )
    function: Literal[3, 4] | None = Field(None, examples=[4], description='Make "map": the function, if it differs.')
    register_number: int | None = Field(
        None, ge=0, le=65535, examples=[2], description='Make "map": the first register, if it differs.'
    )
    number_type: NumberType | None = Field(
        None, examples=["int16"], description='Make "map": number format of the irradiance, if it differs.'
    )
    word_order: WordOrder | None = Field(
        None, examples=["low-first"], description='Make "map": which register comes first, if it differs.'
    )
    scale: float | None = Field(
        None, ge=-1e6, le=1e6, examples=[0.1], description='Make "map": the factor to W/m2, if it differs.'
    )


class PyranometersSettings(CubeDriverSettings):
    """modbus-pyranometers: four digital pyranometers, which report W/m2 themselves."""

    line: ModbusLine | None = Field(
        None,
        examples=["/dev/serial/by-id/usb-FTDI_USB-RS485_Cable_FT4X2Q9B-if00-port0"],
        description="The line that the sensors are on: a serial port, Modbus TCP, or RTU over TCP.",
    )
    make: MakeName = Field(
        "smp",
        description="Kipp & Zonen SMP, Hukseflux (SR05, SR15, SR20, SR30; hukseflux-pv for the SR05-D1A3-PV),"
        " Apogee SP-522 and SP-510, EKO MS-60S, Delta OHM LPPYRA13, or map for any other, by"
        " [instruments.cube.map].",
    )
    serial_speed: Literal[1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200] = Field(
        19200, description="Speed of serial lines in baud."
    )
    serial_form: SerialForm = Field("8E1", description="Data bits, parity and stop bits of serial lines.")
    gap_s: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Silence between a reply and the next question; some sensors need a quarter second.",
    )
    answer_within_s: Positive = Field(
        0.3,
        le=5,
        description="Longest wait for a sensor's answer; a silent one is asked once a scan, then more rarely.",
    )
    map: RegisterMapSettings = RegisterMapSettings()
    east: PyranometerSettings = PyranometerSettings(address=1)
    south: PyranometerSettings = PyranometerSettings(address=2)
    west: PyranometerSettings = PyranometerSettings(address=3)
    zenith: PyranometerSettings = PyranometerSettings(address=4)

    @field_validator(*FACE_NAMES, mode="before")
    @classmethod
    def _complete(cls, value: Any, info: ValidationInfo) -> Any:
        """Complete a face, of which the file names only some keys, by that face's defaults."""
        return with_defaults(cls, value, info)

    def face(self, name: str) -> PyranometerSettings:
        """Return a face's settings as the file has them."""
        found: PyranometerSettings = getattr(self, name)
        return found

    def make_of(self, name: str) -> MakeName:
        """Return the make of a face's sensor."""
        return self.face(name).make or self.make

    def line_of(self, name: str) -> str | None:
        """Return the line of a face's sensor; None where the file names none."""
        return self.face(name).line or self.line

    def map_of(self, name: str) -> RegisterMapSettings:
        """Return the map of a face's sensor."""
        face = self.face(name)
        given = {key: getattr(face, key) for key in _KEYS_OF_A_FACE}
        return self.map.model_copy(update={key: value for key, value in given.items() if value is not None})

    def conflicts(self) -> Iterator[SettingsConflict]:
        """Yield sensors that cannot be told apart, and maps that cannot be read."""
        yield from self._shared_conflicts()
        yield from self._map_conflicts()

    def _shared_conflicts(self) -> Iterator[SettingsConflict]:
        places: dict[tuple[object, ...], str] = {}
        serials: dict[int, str] = {}
        for name in FACE_NAMES:
            face = self.face(name)
            place: tuple[object, ...] = (self.line_of(name), face.address)
            if self.make_of(name) == "map":
                # A logger has all four at one address.
                place += (self.map_of(name).function, self.map_of(name).register_number)
            other = places.setdefault(place, name)
            if other != name:
                reason = f"is the address of the {other} sensor on the same line already; each sensor needs its own"
                yield SettingsConflict(f"{name}.address", reason, (f"{other}.address",))
            if face.serial is not None and (twin := serials.setdefault(face.serial, name)) != name:
                reason = f"is the serial number of the {twin} sensor already; look at the two type plates"
                yield SettingsConflict(f"{name}.serial", reason, (f"{twin}.serial",))
            make = self.make_of(name)
            mapped = make == "map" and self.map.serial_register is not None
            if face.serial is not None and make not in _MAKES_WITH_SERIAL and not mapped:
                reason = f'cannot be checked: a sensor of make "{make}" does not report it; leave it out'
                if make == "map":
                    reason = "cannot be checked without map.serial_register; set that, or leave it out"
                yield SettingsConflict(f"{name}.serial", reason, ("map.serial_register",))

    def _map_conflicts(self) -> Iterator[SettingsConflict]:
        for name in FACE_NAMES:
            used = self.map_of(name)
            if self.make_of(name) != "map":
                continue
            own = self.face(name).register_number is not None
            key = f"{name}.register_number" if own else "map.register_number"
            if used.scale == 0.0:
                at = f"{name}.scale" if self.face(name).scale is not None else "map.scale"
                yield SettingsConflict(at, "makes every irradiance zero; give the factor from the sensor's manual")
                return
            if used.register_number == 65535 and used.number_type not in ("int16", "uint16"):
                yield SettingsConflict(key, f"is the last register, and {used.number_type} takes two")
                return
            status = used.status_register
            if status is not None and abs(status - used.register_number) > _FURTHEST_STATUS:
                reason = (
                    f"is too far from register {used.register_number} to be read with it; at most"
                    f" {_FURTHEST_STATUS} registers lie between them"
                )
                yield SettingsConflict("map.status_register", reason, (key,))
                return


SETTINGS = PyranometersSettings
