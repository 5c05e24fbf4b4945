"""The positioner's own geometry, offsets and ranges, as its slow screens tell them, against what is configured.

As public firmware has it: 70 is the actuator's length at its low end, 71 and 72 are the arms, 74 is the holder, 75
tells the side that the actuator is on, 76 + 77 is the fixed angle; 96 to 103 are the same for axis B. Geometry modes
3 and 13 read them so, mode 2 has arms, holder and length in another order. Modes 1 and 11 are slew drives.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.interfaces import AxisName
from drivers.positioners.pozsol.geometry import AxisSetup, Proportional, Triangle

_FIRST_FIELD = {"a": 70, "b": 96}
_GEAR = {"a": 78, "b": 104}
_HIGHEST = {"a": 79, "b": 105}
_COORDINATE = {"a": 80, "b": 106}
_MODE = {"a": 83, "b": 107}
_LOWEST = {"a": 110, "b": 111}
_OFFSET = {"a": 192, "b": 193}
_FIELD_TABLES = (_GEAR, _HIGHEST, _COORDINATE, _MODE, _LOWEST, _OFFSET)
_AXES: tuple[AxisName, AxisName] = ("a", "b")
SETUP_FIELDS = frozenset([*(place[axis] for place in _FIELD_TABLES for axis in _AXES), *range(70, 78), *range(96, 104)])
"""The fields that a full comparison needs."""

_TRIANGLES, _DRIVES = (2, 3, 13), (1, 11)
# Lengths and angles are printed with one decimal.
_LENGTH_MM, _ANGLE_DEG, _OFFSET_UNITS = 0.11, 0.11, 0.01


def conflicts(fields: Mapping[int, str], a: AxisSetup, b: AxisSetup) -> tuple[str, ...]:
    """Return a sentence for each setting of the unit that contradicts the configuration; none for what never came."""
    return (*_Axis("a", a, fields).conflicts(), *_Axis("b", b, fields).conflicts())


def missing_fields(fields: Mapping[int, str]) -> tuple[int, ...]:
    """Return the fields that a full comparison needs and that have not come as numbers."""
    return tuple(sorted(code for code in SETUP_FIELDS if math.isnan(_number(fields, code))))


def count_step(fields: Mapping[int, str], axis: AxisName) -> float | None:
    """Return the position units of one Hall count, or None if the unit does not tell."""
    counts = _number(fields, _GEAR[axis])
    return 1.0 / counts if counts >= 1.0 else None


@dataclass(frozen=True, slots=True)
class _Axis:
    axis: AxisName
    setup: AxisSetup
    fields: Mapping[int, str]

    def conflicts(self) -> list[str]:
        found = [*self._offset(), *self._range()]
        mode = self._axis_field(_MODE)
        match self.setup.geometry:
            case Triangle() as triangle:
                found += self._triangle(triangle, mode)
            case Proportional(units_per_deg=1.0) as drive:
                found += self._drive(drive, mode)
        # What older units that count in impulses print here is not known.
        return found

    def _axis_field(self, place: Mapping[str, int]) -> float:
        return _number(self.fields, place[self.axis])

    def _field_from_first(self, step: int) -> float:
        return _number(self.fields, _FIRST_FIELD[self.axis] + step)

    def _sentence(self, code: int | str, says: str, key: str, configured: str, remedy: str) -> str:
        where = f"instruments.positioner.{self.axis}_axis.{key}"
        return f"field {code} of the positioner says {says}, but {where} is {configured}: {remedy}"

    def _compare(self, code: int | str, unit: float, configured: float, tolerance: float, key: str) -> list[str]:
        # A field that never came, NaN here, contradicts nothing.
        if not abs(unit - configured) > tolerance:
            return []
        return [self._sentence(code, f"{unit:g}", key, f"{configured:.4g}", f"set it to {unit:g} if the unit is right")]

    def _offset(self) -> list[str]:
        return self._compare(
            _OFFSET[self.axis], self._axis_field(_OFFSET), self.setup.zero_offset, _OFFSET_UNITS, "zero_offset"
        )

    def _range(self) -> list[str]:
        """Compare the unit's range, to which it cuts every target without a report, with what is to be reached."""
        try:
            ends = [self.setup.destination(angle) for angle in (self.setup.minimum_deg, self.setup.maximum_deg)]
        except ValueError as error:
            return [f"instruments.positioner.{self.axis}_axis cannot be right: {error}"]
        name, low, high = self.axis, self._axis_field(_LOWEST), self._axis_field(_HIGHEST)
        found = []
        for code, beyond, text in (
            (_LOWEST[name], low > min(ends), f"begins at {low:g}"),
            (_HIGHEST[name], high < max(ends), f"ends at {high:g}"),
        ):
            if beyond:
                found.append(
                    f"the positioner's range of axis {name.upper()} {text} (field {code}), but limits.{name}_min_deg to"
                    f" {name}_max_deg need {min(ends)} to {max(ends)}: narrow them, or widen the range in the unit"
                )
        return found

    def _triangle(self, mine: Triangle, mode: float) -> list[str]:
        if math.isnan(mode):
            return []
        if mode not in _TRIANGLES:
            return [self._wrong_mode(mode, "mm")]
        first = _FIRST_FIELD[self.axis]
        arms, holder, length = ((0, 1), 2, 3) if mode == 2 else ((1, 2), 4, 0)
        found = []
        unit_arms = [self._field_from_first(step) for step in arms]
        # The two arms are the same to the triangle.
        straight = abs(unit_arms[0] - mine.arm_1_mm) <= abs(unit_arms[0] - mine.arm_2_mm)
        keys = ("arm_1_mm", "arm_2_mm") if straight else ("arm_2_mm", "arm_1_mm")
        for step, unit, key in zip(arms, unit_arms, keys, strict=True):
            found += self._compare(first + step, unit, getattr(mine, key), _LENGTH_MM, key)
        found += self._compare(first + holder, self._field_from_first(holder), mine.holder_mm, _LENGTH_MM, "holder_mm")
        found += self._compare_sense_and_apex(mine, mode)
        return found or self._length(mine, first + length, self._field_from_first(length))

    def _compare_sense_and_apex(self, mine: Triangle, mode: float) -> list[str]:
        """Compare the sense of extension and the fixed angle."""
        side, first = self._field_from_first(5), _FIRST_FIELD[self.axis]
        fixed = self._field_from_first(6) + self._field_from_first(7)
        if math.isnan(side + fixed):
            return []
        below = int(side) != 0
        # Mode 13 counts the angle from the zenith; mode 2 sees the sides the other way round, and from 90 degrees.
        raises = below is (mode == 3)
        zero_deg = 90.0 if mode != 3 else 0.0 if below else 180.0
        sense = "raises" if raises else "lowers"
        if sense != mine.sense:
            says, remedy = f"{side:g} (extension {sense} the angle)", f'set it to "{sense}" if the unit is right'
            return [self._sentence(first + 5, says, "sense", f'"{mine.sense}"', remedy)]
        code = f"{first + 6} + {first + 7}"
        return self._compare(code, zero_deg - fixed, mine.apex_deg, 2 * _ANGLE_DEG, "apex_deg")

    def _length(self, mine: Triangle, code: int, length_mm: float) -> list[str]:
        if not abs(length_mm - mine.low_length_mm) > _LENGTH_MM:
            return []
        says = f"the actuator is {length_mm:g} mm long at its low end"
        configured = f"{mine.low_deg:g}, which makes it {mine.low_length_mm:.1f} mm"
        low_deg = mine.angle_at_length(length_mm)
        return [self._sentence(code, says, "low_deg", configured, f"set it to {low_deg:.2f} if the unit is right")]

    def _drive(self, mine: Proportional, mode: float) -> list[str]:
        if math.isnan(mode):
            return []
        if mode not in _DRIVES:
            return [self._wrong_mode(mode, "deg")]
        coordinate = self._axis_field(_COORDINATE)
        if mode != 1 or math.isnan(coordinate):
            return []
        low_deg = self._field_from_first(0) - (90.0 if coordinate in (2, 4, 6) else 180.0)
        return self._compare(_FIRST_FIELD[self.axis], low_deg, mine.low_deg, _ANGLE_DEG, "low_deg")

    def _wrong_mode(self, mode: float, unit: str) -> str:
        return (
            f"field {_MODE[self.axis]} of the positioner says geometry {mode:g} for axis {self.axis.upper()}, which has"
            f' no positions in {unit}, but instruments.positioner.position_unit is "{unit}": set it as the unit counts'
        )


def _number(fields: Mapping[int, str], code: int) -> float:
    try:
        number = float(fields.get(code, "nan"))
    except ValueError:
        return math.nan
    return number if abs(number) < 1e6 else math.nan
