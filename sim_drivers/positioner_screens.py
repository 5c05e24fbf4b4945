"""What the simulated positioner prints: six fast slots in turn, the last of them one of 27 slow screens."""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.pozsol_wire import DECIMALS, SEPARATOR, Field
from sim_drivers.positioner_setup import Actuator

BOARD = "36A1"
VERSION = "1.402 (B1.100)"
SERIAL = "0A1B2C3D 4E5F6071 8293A4B5 C6D7E8F9"

SLOTS = 6
SLOW_SCREENS: tuple[tuple[int, ...], ...] = (
    (Field.BOARD,),
    (Field.VERSION,),
    (Field.SUPPLY,),
    (Field.SERIAL,),
    (Field.STATUS,),
    (Field.MODE,),
    (Field.LINK_COUNTER,),
    (Field.LATITUDE, Field.LONGITUDE),
    (Field.TRACKING_INTERVAL,),
    (70, 71, 72, 73),
    (74, 75, 76, 77),
    (78, 79, 80, 83),
    (96, 97, 98, 99),
    (100, 101, 102, 103),
    (104, 105, 106, 107),
    (108, 109),
    (110, 111, 192, 193),
    (112, 113),
    (117, 118),
    (119, 120, 121, 122),
    (123, 124, 125),
    (126, 127),
    (141, 142, 143, 144),
    (157, 158, 159, 160, 161),
    (190, 191),
    (194, 197, 198, 199),
    (204,),
)
_GEAR_RATIO = "800.0"
_TWO_ARMS_GEOMETRY = "3"


@dataclass(frozen=True, slots=True)
class AxisReadout:
    """One axis as the unit believes it: degrees, mm, ampere."""

    angle_deg: float
    position_mm: float
    destination_mm: float
    current_a: float
    remain_mm: float


@dataclass(frozen=True, slots=True)
class Readout:
    """Everything that changes from screen to screen; `clock_s` is what the unit's own clock counts from 2000-01-01."""

    a: AxisReadout
    b: AxisReadout
    clock_s: float
    service: str
    supply_v: float
    mode: str
    status: int
    link_counter: int


def default_parameters(a: Actuator, b: Actuator) -> dict[int, str]:
    """Return what is stored (identity, geometry, ranges, protection, autonomy) as the unit prints them."""
    parameters = {code: "0.0" for screen in SLOW_SCREENS[7:] for code in screen}
    for first, ratio, largest, geometry, actuator in ((70, 78, 79, 83, a), (96, 104, 105, 107, b)):
        parameters[first] = f"{actuator.arm_1_mm:.1f}"
        parameters[first + 1] = f"{actuator.arm_2_mm:.1f}"
        parameters[first + 2] = f"{actuator.apex_deg:.1f}"
        parameters[ratio] = _GEAR_RATIO
        parameters[largest] = f"{int(actuator.travel_mm):.1f}"
        parameters[geometry] = _TWO_ARMS_GEOMETRY
    parameters.update({Field.BOARD: BOARD, Field.VERSION: VERSION, Field.SERIAL: SERIAL})
    parameters.update({Field.TRACKING_INTERVAL: "300", 112: "2.0", 113: "2.0"})
    parameters.update(dict.fromkeys((108, 109, 126, 127), "off"))
    return parameters


def fast_screen(slot: int, now: Readout) -> bytes:
    """Return the screen of slot 1 to 5."""
    if slot == 2:
        return _axis(Field.A_ANGLE, Field.A_REMAIN, now.a)
    if slot == 3:
        return _axis(Field.B_ANGLE, Field.B_REMAIN, now.b)
    seconds = int(now.clock_s)
    days, (hour, minute, second) = seconds // 86400, (seconds // 3600 % 24, seconds // 60 % 60, seconds % 60)
    if slot == 1:
        clock = {Field.CLOCK_HOUR: hour, Field.CLOCK_MINUTE: minute, Field.CLOCK_SECOND: second}
    elif slot == 4:
        # The unit's calendar is nothing that anybody reads here: months of 30 days do.
        clock = {
            Field.GMT_SECOND: second,
            Field.GMT_MINUTE: minute,
            Field.GMT_HOUR: hour,
            Field.GMT_DAY: days % 30 + 1,
        }
    else:
        clock = {Field.GMT_MONTH: days // 30 % 12 + 1, Field.GMT_YEAR: days // 360}
    tail = token(Field.SERVICE, now.service) if slot == 5 else b""
    return b"".join(token(field, str(value)) for field, value in clock.items()) + tail


def slow_screen(index: int, now: Readout, parameters: Mapping[int, str]) -> bytes:
    """Return one of the 27 slow screens."""
    live: dict[int, str] = {
        Field.SUPPLY: f"{now.supply_v:.{DECIMALS[Field.SUPPLY]}f}",
        Field.STATUS: f"{_signed(now.status):04d}",
        Field.MODE: now.mode,
        Field.LINK_COUNTER: str(now.link_counter),
    }
    return b"".join(token(code, live.get(code) or parameters[code]) for code in SLOW_SCREENS[index])


def live_screens(now: Readout) -> bytes:
    """Return only what a motion program watches: both axes, supply, mode and status."""
    return b"".join(
        (
            _axis(Field.A_ANGLE, Field.A_REMAIN, now.a),
            _axis(Field.B_ANGLE, Field.B_REMAIN, now.b),
            token(Field.SUPPLY, f"{now.supply_v:.{DECIMALS[Field.SUPPLY]}f}"),
            token(Field.MODE, now.mode),
            token(Field.STATUS, f"{_signed(now.status):04d}"),
        )
    )


def token(code: int, text: str) -> bytes:
    """Return one field as the unit sends it."""
    return bytes((SEPARATOR, code)) + text.encode("latin-1")


def _axis(first: int, remain: int, axis: AxisReadout) -> bytes:
    return b"$%c%.1f$%c%.4f$%c%.4f$%c%.2f$%c%.4f" % (
        first,
        axis.angle_deg,
        first + 1,
        axis.position_mm,
        first + 2,
        axis.destination_mm,
        first + 3,
        axis.current_a,
        remain,
        axis.remain_mm,
    )


def _signed(word: int) -> int:
    return word - (1 << 32) if word >> 31 else word
