"""A cube whose driver may fail in any way: that is an outage of the cube, and not the end of the service."""

import logging
import math
from collections.abc import Awaitable, Callable
from numbers import Real
from typing import TypeVar, get_args

from daemon.base.clock import END_UTC_S, FIRST_UTC_S
from daemon.base.errors import UserError, error_location
from drivers.errors import DeviceError
from drivers.interfaces import Cube, CubeReading, FaceFlaw

log = logging.getLogger("heliocube.acquisition")

Answer = TypeVar("Answer")

_UNITS = ("V", "W/m2")
# Nearly all values are of the first type, which `isinstance` finds at once.
_NUMBERS = (float, Real)
_FLAWS = get_args(FaceFlaw)


class GuardedCube:
    """A `drivers.interfaces.Cube` that raises only `DeviceError`, and `UserError` when simulated weather has ended.

    Parameters
    ----------
    cube
        The cube, whose driver anybody may have written.
    """

    def __init__(self, cube: Cube) -> None:
        self._cube = cube
        self._logged_errors: set[tuple[str, str]] = set()

    async def open(self) -> str:
        """Connect, identify and configure; return a sentence that identifies the instruments."""
        return await self._ask(self._cube.open)

    async def read(self) -> CubeReading:
        """Return a reading of all faces; an invalid reading counts as an error."""

        async def checked() -> CubeReading:
            return _checked(await self._cube.read())

        return await self._ask(checked)

    async def close(self) -> None:
        """Release the instruments; an error is logged, and nothing else."""
        try:
            await self._cube.close()
        except Exception as error:  # noqa: BLE001 - its traceback is logged once
            self._describe(error)

    async def _ask(self, question: Callable[[], Awaitable[Answer]]) -> Answer:
        try:
            return await question()
        except (DeviceError, UserError):
            raise
        except Exception as error:
            raise DeviceError("cube", self._describe(error)) from error

    def _describe(self, error: Exception) -> str:
        """Return an error in words, with the line that raised it; log its traceback the first time."""
        kind, place = type(error).__name__, error_location(error)
        if (kind, place) not in self._logged_errors:
            self._logged_errors.add((kind, place))
            log.error("the driver of the cube has failed", exc_info=error)
        return f"its driver has failed with {kind}: {error} ({place})"


def _checked(reading: object) -> CubeReading:
    """Return the reading; `TypeError` or `ValueError` for an invalid one."""
    if not isinstance(reading, CubeReading):
        raise TypeError(f"its reading is {reading!r}, not a CubeReading")
    if reading.unit not in _UNITS:
        raise ValueError(f"the unit of its reading is {reading.unit!r}, not one of {', '.join(_UNITS)}")
    for face in reading.faces:
        if face.flaw is not None and face.flaw not in _FLAWS:
            raise ValueError(f"the flaw of a face is {face.flaw!r}, not one of {', '.join(_FLAWS)}")
        values: tuple[object, ...] = (face.value, face.time_utc_s, face.time_monotonic_s)
        for value in values:
            if not isinstance(value, _NUMBERS):
                raise TypeError(f"a face has {value!r}, which is not a number")
        # NaN, or a time that is no date, would end the parts of the service that take the scan.
        if not FIRST_UTC_S <= face.time_utc_s < END_UTC_S:
            raise ValueError(f"the time of a face is {face.time_utc_s!r}")
        if not math.isfinite(face.time_monotonic_s):
            raise ValueError(f"the time of a face is {face.time_monotonic_s!r}")
    return reading
