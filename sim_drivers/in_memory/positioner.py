"""The simulated positioner in this process."""

import asyncio
import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from drivers import pozsol_wire as wire
from drivers.errors import IdentityError, ProtocolError, RefusedError, StillMovingError
from drivers.interfaces import Axis, PositionerIdentity, Telemetry
from drivers.pozsol_wire import Field, TokenStream, encode_command, parse_number, parse_status
from sim_drivers.in_memory.link import Cabled
from sim_drivers.positioner_core import PositionerCore
from sim_drivers.positioner_screens import BOARD
from sim_drivers.positioner_setup import Actuator
from sim_drivers.positioner_unit import MOVE_V
from solar.frames import Limits

_CONFIRM_S = 0.5
_LOOK_EVERY_S = 0.04
_STANDS_FOR_S = 0.3
_HALT_WITHIN_S = 12.0
_STOP_EVERY_S = 0.2
_NUMBERS = (
    Field.A_ANGLE,
    Field.B_ANGLE,
    Field.A_POSITION,
    Field.B_POSITION,
    Field.A_DESTINATION,
    Field.B_DESTINATION,
    Field.SUPPLY,
)


class InMemoryPositioner(Cabled):
    """The positioner over its simulated link, with telemetry on demand.

    Parameters
    ----------
    core
        The simulated unit.
    now
        The event loop's time [s].
    limits
        Targets outside them are refused before anything is sent.
    """

    def __init__(self, core: PositionerCore, now: Callable[[], float], limits: Limits) -> None:
        super().__init__("positioner")
        self._core = core
        self._now = now
        self._limits = limits
        self._sent_s = -wire.COMMAND_SPACING_S
        self._stops = 0

    async def open(self) -> PositionerIdentity:
        """Connect and identify by telemetry alone."""
        self._connect()
        values = dict(TokenStream().feed(self._core.screens(self._now()) + b"$"))
        board, firmware, serial = (
            values.get(field, b"").decode("latin-1") for field in (Field.BOARD, Field.VERSION, Field.SERIAL)
        )
        if board != BOARD:
            self._disconnect()
            raise IdentityError("positioner", f"says it is board {board!r}, not {BOARD}")
        return PositionerIdentity(board, firmware, serial, simulated=True)

    async def close(self) -> None:
        """Release the link; a move goes on."""
        self._disconnect()

    async def read_telemetry(self) -> Telemetry:
        """Return the present state."""
        return self._look()

    async def disable_autonomy(self) -> None:
        """Switch the unit's own tracking off if it is on; a slave would take the command for "on"."""
        if self._look().autonomous:
            await self._send(Field.MODE, wire.TRACKING_OFF, self._stops)
            await self._confirm(lambda seen: not seen.autonomous, "to leave its own tracking", self._stops)

    async def move_to(self, a_deg: float, b_deg: float, *, first: Axis = "a") -> None:
        """Send both targets, axis `first` before the other, and wait until the unit shows them as its destinations."""
        if not self._limits.contain(a_deg, b_deg):
            raise ValueError(f"target A {a_deg}, B {b_deg} deg is outside the limits ({self._limits})")
        stops = self._stops
        commands = [(Field.A_ANGLE, a_deg), (Field.B_ANGLE, b_deg)]
        for field, angle_deg in commands if first == "a" else reversed(commands):
            await self._send(field, angle_deg, stops)
        setup = self._core.setup
        a, b = _whole_units(setup.a_actuator, a_deg), _whole_units(setup.b_actuator, b_deg)
        await self._confirm(
            lambda seen: abs(seen.destination_a - a) <= 1 and abs(seen.destination_b - b) <= 1,
            f"the target A {a_deg:.2f}, B {b_deg:.2f} deg",
            stops,
        )

    async def stop(self) -> None:
        """Send stop now; whoever is in the middle of sending a target sends no more."""
        self._stops += 1
        self._transmit(Field.ACTION, wire.STOP)

    async def halt(self) -> None:
        """Send stop until positions have not changed for a while."""
        self._stops += 1
        start_s = since_s = self._now()
        sent_s, where = -math.inf, self._where()
        while self._now() - since_s < _STANDS_FOR_S:
            if self._now() - start_s > _HALT_WITHIN_S:
                raise StillMovingError("positioner", "goes on moving although it was told to stop")
            if self._now() - sent_s >= _STOP_EVERY_S:
                self._transmit(Field.ACTION, wire.STOP)
                sent_s = self._now()
            await asyncio.sleep(_LOOK_EVERY_S)
            if (here := self._where()) != where:
                where, since_s = here, self._now()

    def _where(self) -> tuple[float, float]:
        seen = self._look()
        return seen.position_a, seen.position_b

    async def home(self, axis: Axis) -> None:
        """Halt both axes, start a reference run and wait until it shows."""
        await self.halt()
        stops = self._stops
        await self._send(Field.ACTION, wire.HOME_A if axis == "a" else wire.HOME_B, stops)

        def begun(seen: Telemetry) -> bool:
            position, destination = (
                (seen.position_a, seen.destination_a) if axis == "a" else (seen.position_b, seen.destination_b)
            )
            # An axis that stands on its switch is home before anybody can look.
            return seen.homing or position == destination == 0.0

        await self._confirm(begun, f"to home axis {axis.upper()}", stops)

    async def clear_faults(self) -> Telemetry:
        """Stop, clear faults and the reset mark, and return the look before; what was pending would go on else."""
        stops = self._stops
        await self._send(Field.ACTION, wire.STOP, stops)
        before = self._look()
        await self._send(Field.STATUS, wire.CLEAR, stops)
        await self._confirm(lambda seen: not (seen.faults or seen.was_reset), "to clear its status", stops)
        return before

    def _transmit(self, field: Field, value: float | str) -> None:
        self._require_open()
        self._sent_s = self._now()
        self._core.feed(encode_command(field, value), self._sent_s)

    async def _send(self, field: Field, value: float | str, stops: int) -> None:
        wait_s = self._sent_s + wire.COMMAND_SPACING_S - self._now()
        if wait_s > 0:
            await asyncio.sleep(wait_s)
        self._heed(stops)
        self._transmit(field, value)

    def _heed(self, stops: int) -> None:
        if self._stops != stops:
            raise RefusedError("positioner", "a stop came in between")

    async def _confirm(self, done: Callable[[Telemetry], bool], what: str, stops: int) -> None:
        deadline_s = self._now() + _CONFIRM_S
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            self._heed(stops)
            seen = self._look()
            if done(seen):
                return
            if self._now() >= deadline_s:
                raise RefusedError("positioner", f"did not take {what}: {_likely_cause(seen)}")

    def _look(self) -> Telemetry:
        self._require_open()
        now = self._now()
        return Telemetry(*(now, *_read(self._core.live_screens(now)), (), "", now))


# A unit at rest says the same every time.
@lru_cache(maxsize=8)
def _read(screens: bytes) -> tuple[Any, ...]:
    """Return what the screens say, in the order of `Telemetry` after the time."""
    values = dict(TokenStream().feed(screens + b"$"))
    try:
        status = parse_status(values[Field.STATUS].decode("latin-1"), wire.B_OUT_BIT_STM)
        return (
            *(parse_number(field, values[field]) for field in _NUMBERS),
            status.faults,
            status.was_reset,
            status.button_pressed,
            status.homing,
            status.autonomous,
            values[Field.MODE].decode("latin-1"),
        )
    except (KeyError, ValueError) as error:
        raise ProtocolError("positioner", f"sent telemetry that cannot be read: {error}") from error


def _whole_units(actuator: Actuator, angle_deg: float) -> int:
    return min(max(int(actuator.position_mm(angle_deg)), 0), int(actuator.travel_mm))


def _likely_cause(seen: Telemetry) -> str:
    if seen.faults:
        return f"it reports {', '.join(seen.faults)}"
    if seen.homing:
        return "it is homing"
    if seen.supply_v < MOVE_V:
        return f"its motor supply is {seen.supply_v:g} V"
    if seen.autonomous:
        return f"its own mode is on ({seen.mode_text})"
    return "no reason shows in its telemetry"
