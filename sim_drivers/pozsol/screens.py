"""What the simulated positioner prints: six fast slots in turn, the last of them one of 27 slow screens."""

from collections.abc import Mapping
from typing import NamedTuple

from drivers.positioners.pozsol.wire import SEPARATOR, Field
from sim_drivers.pozsol.motion import Axis
from sim_drivers.pozsol.setup import Mechanics, Setup, SlewDrive

BOARD = "36A1"
VERSION = "1.402 (B1.100)"
SERIAL = "0A1B2C3D-4E5F6071-8293A4B5-C6D7E8F9"
_MOTOR_CURRENT_A = 0.8

SLOTS = 6
SLOW_SCREENS: tuple[tuple[int, ...], ...] = (
    (130, 131, 134, 135),
    (43, 59, Field.VERSION, Field.SUPPLY, Field.SERIAL),
    (Field.STATUS, Field.MODE),
    (118, 94, 95, 83, 116, 117),
    (70, 71, 72, 73, 74, 75),
    (76, 77, 78, 79, 80, Field.LATITUDE),
    (84, 85, 86, 194, Field.LONGITUDE, 114),
    (90, Field.BOARD, Field.LINK_COUNTER, 61, 62),
    (91, Field.TRACKING_INTERVAL, 93, 81, 92),
    (96, 97, 98, 99, 100, 101),
    (102, 103, 104, 105, 106, 107),
    (108, 110, 112, 192, 138, 137),
    (109, 111, 113, 193, 161, 160),
    (141, 143, 142, 144, 145),
    (119, 120, 121, 133, 126, 122),
    (127, 123, 195, 197),
    (124, 125, 139, 140, 199),
    (147, 148, 149, 150, 151),
    (152, 153, 154, 155, 156),
    (158, 159),
    (200, 162, 163),
    (164, 165),
    (166, 167, 168, 169, 170),
    (171, 172, 60, 157, 180, 179),
    (187, 188, 189, 190, 191),
    (204, 205, 206, 209),
    (226, 214, 215, 216, 217, 220, 223, 225),
)
_TWO_ARMS_GEOMETRY, _SLEW_GEOMETRY = "3", "1"
_ELEVATION = "2"
_HORIZON_DEG = 90.0
_ONE_DECIMAL = (*range(61, 63), 94, 95, 73, 99, 77, 103, 119, 120, 134, 135, 137, 138, 157, 160, 161)
_TWO_DECIMALS = (*range(147, 157), *range(162, 166), 192, 193, 199)
_PRINTED: dict[int, str] = {
    **dict.fromkeys(_ONE_DECIMAL, "0.0"),
    **dict.fromkeys(_TWO_DECIMALS, "0.00"),
    **dict.fromkeys((84, 85, 114), "28.0"),
    **dict.fromkeys((86, 91, 130, 131, 194), "0000"),
    **dict.fromkeys((108, 109, 122, 123, 126, 127), "off"),
    **dict.fromkeys((Field.LATITUDE, Field.LONGITUDE), "0.0000"),
    **dict.fromkeys((112, 113), "2.00"),
    **dict.fromkeys((141, 142), "3.0"),
    **dict.fromkeys((143, 144), "500"),
    **dict.fromkeys((158, 159), "06:00:00 (Local:06:00:00)"),
    **dict.fromkeys(range(166, 172), "00:00"),
    **dict.fromkeys((190, 191), "0.00\xf8(PM), 0.00\xf8(AE)"),
    **dict.fromkeys((206, 209), "800.000"),
    Field.BOARD: BOARD,
    Field.VERSION: VERSION,
    Field.SERIAL: SERIAL,
    Field.TRACKING_INTERVAL: "300",
    43: "01",
    59: "01",
    60: "2000",
    90: "16",
    124: "0.000",
    145: "0.1",
    179: "00/00/0000 00:00:00",
    197: "4.95",
    214: "42",
    216: "7",
    217: "8",
    220: "-164",
    223: "19200",
    225: "65538",
    226: "116",
}
"""What is printed for all fields that a simulated unit has no use for."""
_SUN_SENSOR = b"$\x800000$\x810000"


class AxisReadout(NamedTuple):
    """One axis as the unit believes it: degrees, mm, ampere."""

    angle_deg: float
    position_mm: float
    destination_mm: float
    current_a: float
    remain_mm: float


class Readout(NamedTuple):
    """Everything that changes from screen to screen; `clock_s` is what the unit's own clock counts from 2000-01-01."""

    a: AxisReadout
    b: AxisReadout
    clock_s: float
    service: str
    supply_v: float
    mode: str
    status: int
    link_counter: int


def axis_readout(axis: Axis, destination_mm: float, now: float) -> AxisReadout:
    """Return what is shown of an axis on its way to a destination."""
    counted_mm = axis.counted_mm(now)
    return AxisReadout(
        angle_deg=axis.counted_deg(now),
        position_mm=counted_mm,
        destination_mm=destination_mm,
        current_a=_MOTOR_CURRENT_A if axis.active and axis.velocity_mm_s(now) else 0.0,
        remain_mm=axis.remain,
    )


def default_parameters(setup: Setup) -> dict[int, str]:
    """Return what is stored (identity, geometry, ranges, protection, autonomy) as the unit prints it."""
    parameters = {code: "0" for screen in SLOW_SCREENS for code in screen} | _PRINTED
    for first, codes, actuator in (
        (70, (78, 79, 80, 83), setup.a_actuator),
        (96, (104, 105, 106, 107), setup.b_actuator),
    ):
        values = (f"{setup.drive.counts_per_mm:.1f}", f"{int(actuator.travel_mm)}", _ELEVATION, _mode(actuator))
        parameters.update(zip(codes, values, strict=True))
        parameters.update(_geometry(first, actuator))
    parameters[192] = f"{setup.a_actuator.zero_offset_mm:.2f}"
    parameters[193] = f"{setup.b_actuator.zero_offset_mm:.2f}"
    return parameters


def _mode(mechanics: Mechanics) -> str:
    return _SLEW_GEOMETRY if isinstance(mechanics, SlewDrive) else _TWO_ARMS_GEOMETRY


def _geometry(first: int, actuator: Mechanics) -> dict[int, str]:
    """Return stator, both arms, holder, sense and angle as the unit has them: it counts angles from the lower side.

    A slew drive has the angle at its low end alone, as an elevation from the horizon.
    """
    if isinstance(actuator, SlewDrive):
        return {first: f"{actuator.low_deg + _HORIZON_DEG:.1f}"}
    angle_deg = -actuator.apex_deg if actuator.extension_raises_angle else 180 - actuator.apex_deg
    sides = (actuator.stator_mm, actuator.arm_1_mm, actuator.arm_2_mm)
    numbers = (*sides, 0.0, actuator.holder_mm, float(actuator.extension_raises_angle), angle_deg, 0.0)
    return {first + offset: f"{number:.1f}" for offset, number in enumerate(numbers)}


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
        # Nobody reads the unit's calendar here, so that months of 30 days are good enough.
        clock = {
            Field.GMT_SECOND: second,
            Field.GMT_MINUTE: minute,
            Field.GMT_HOUR: hour,
            Field.GMT_DAY: days % 30 + 1,
        }
    else:
        clock = {Field.GMT_MONTH: days // 30 % 12 + 1, Field.GMT_YEAR: days // 360}
    tail = _SUN_SENSOR if slot == 1 else token(Field.SERVICE, now.service) if slot == 5 else b""
    return b"".join(token(field, str(value)) for field, value in clock.items()) + tail


def slow_screen(index: int, now: Readout, parameters: Mapping[int, str]) -> bytes:
    """Return one of the 27 slow screens."""
    live: dict[int, str] = {
        Field.SUPPLY: f"{now.supply_v:.2f}",
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
            token(Field.SUPPLY, f"{now.supply_v:.2f}"),
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
