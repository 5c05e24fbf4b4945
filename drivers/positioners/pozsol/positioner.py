"""The POZSOL36A1 positioner: telemetry streams in, commands go out, and nothing answers.

A command has worked when its effect shows in the telemetry. Angles, positions and destinations come every 120 ms,
status, supply and mode every 3.24 s. A unit goes on with a move when the host falls silent: over USB nothing can stop
it but a stop that arrives, and the first packet after each enumeration does not. So a stop is sent until both axes
stand, and a stop is sent before any other command that would be the first.

Targets go out as whole positions (codes 46 and 50). The unit cuts the position of an angle down to whole units, which
takes an axis past a limit on one side; a whole position is taken as it is, and may be chosen on the inner side.

All of this is as public firmware of the same product family does it, in an emulator, and has not been measured on a
rig. Older firmware had a checksum; how it was formed is not known, so there is no such mode here. docs/hardware.md
lists what to check.
"""

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace

from drivers.errors import ConnectError, IdentityError, LinkLostError, RefusedError, StillMovingError
from drivers.interfaces import AxisName, PositionerIdentity, Telemetry
from drivers.positioners.pozsol import wire
from drivers.positioners.pozsol.end_switches import LeaveSwitchMove, leave_switch_position
from drivers.positioners.pozsol.geometry import AxisSetup
from drivers.positioners.pozsol.link import PositionerLine
from drivers.positioners.pozsol.reference import DESTINATION_TOLERANCE
from drivers.positioners.pozsol.refusals import geometry_mismatch, likely_cause, why_not_standing
from drivers.positioners.pozsol.standstill import Standstill
from drivers.positioners.pozsol.table import Value
from drivers.positioners.pozsol.unit_setup import SETUP_FIELDS, conflicts, count_step
from drivers.positioners.pozsol.watch import FAST_FIELDS, SLOW_FIELDS, PositionerWatch, position_of
from drivers.positioners.pozsol.wire import Field, encode_command

_DEVICE = "positioner"
_IDENTITY = (Field.BOARD, Field.VERSION, Field.SERIAL)
_HOME: dict[AxisName, str] = {"a": wire.HOME_A, "b": wire.HOME_B}
_TARGET: dict[AxisName, Field] = {"a": Field.A_DESTINATION, "b": Field.B_DESTINATION}

_HEAR_WITHIN_S = 2.5
_KNOW_WITHIN_S = 8.0
# One turn of the slow screens, and a little.
_SETUP_WITHIN_S = 4.5
_LOOK_EVERY_S = 0.04
_TARGET_SHOWS_S = 1.0
# Two turns of the slow screens, and a little.
_STATUS_SHOWS_S = 7.0
# A screen that was under way when a command was sent says nothing about it.
_UNDER_WAY_S = 0.1
_STOP_EVERY_S = 0.15
_STAND_WITHIN_S = 12.0
# Targets are whole units, and an axis rests up to 0.2 beyond. An axis sent back by so little may be braking when the
# target of the other comes, which is lost then; within 0.07 it may stay switched on at rest, which becomes a fault.
_AT_TARGET = 0.3
# How long an axis takes at the most to leave its end switch.
_LEFT_WITHIN_S = 30.0
# A Hall count, and what rounding to four decimals adds.
_JITTER_COUNTS = 1.2


class PozsolPositioner:
    """Two motor axes behind one line.

    Parameters
    ----------
    line
        The link; opened and closed with the positioner.
    now
        The service's monotonic time [s].
    a, b
        Geometry and limits of the axes; targets beyond the limits are refused before anything is sent.
    boards
        What field 37 may say; to any other board nothing is ever written.
    stale_s
        Silence of the fast fields after which the unit counts as lost; opening waits for so long as well.
    b_out_bit
        Where the status word has axis B's motion bits; None where that is not known until B has moved.
    """

    def __init__(
        self,
        line: PositionerLine,
        now: Callable[[], float],
        a: AxisSetup,
        b: AxisSetup,
        *,
        boards: tuple[str, ...] = ("36A1",),
        stale_s: float = 2.0,
        b_out_bit: int | None = None,
    ) -> None:
        self._line = line
        self._now = now
        self._axes: dict[AxisName, AxisSetup] = {"a": a, "b": b}
        self._boards = boards
        self._watch = PositionerWatch(now, self._axes, stale_s, b_out_bit)
        limits_s = (_HEAR_WITHIN_S, _KNOW_WITHIN_S, _SETUP_WITHIN_S)
        self._hear_within_s, self._know_within_s, self._setup_within_s = (max(each, stale_s) for each in limits_s)
        self._jitter = (a.step, b.step)
        self._sending = asyncio.Lock()
        self._identified = False
        self._nothing_sent = True
        self._sent_s = -math.inf
        self._stops = 0
        self._missing: dict[str, frozenset[int]] = {}

    async def open(self) -> PositionerIdentity:
        """Connect and identify by listening alone; takes up to one turn of the slow screens, 3.3 s, and any restart."""
        await self.close()
        try:
            await self._line.open()
            identity = await self._identify()
            await self._wait_for_setup(identity.serial)
        except BaseException:
            await self.close()
            raise
        self._watch.start(self._line.state().restarted_s)
        fields = self.fields()
        self._jitter = (self._jitter_of("a", fields), self._jitter_of("b", fields))
        return replace(identity, setup_conflicts=conflicts(fields, self._axes["a"], self._axes["b"]))

    async def close(self) -> None:
        """Release the link; a move goes on."""
        self._identified, self._nothing_sent = False, True
        self._watch.abort_reference_run()
        await self._line.close()

    async def read_telemetry(self) -> Telemetry:
        """Return the newest telemetry; `LinkLostError` when it is old."""
        return self._read()

    def repeated_s(self, telemetry: Telemetry) -> float | None:
        """Return the time at which a look would show what this last one did; None where a new look has to be made."""
        try:
            return self._watch.repeated_s(telemetry, self._line.state())
        except LinkLostError:
            return None

    def standing(self) -> tuple[float | None, float | None]:
        """Return where A and B stand, in the unit's position units, also while their count is lost; or None."""
        return self._watch.standing()

    def recall(self, a: float | None, b: float | None, doubt: str) -> None:
        """Take in what `standing` said last in the previous process: a reference run is judged by it."""
        self._watch.recall({"a": a, "b": b}, doubt)

    def fields(self) -> dict[int, str]:
        """Return every field that has come since `open`, by its code, as the unit prints it."""
        return {code: _text(value) for code, value in sorted(self._line.state().values.items())}

    def has_modem_lines(self) -> bool:
        """Tell whether the line has modem lines, which are then as they were asked for."""
        return self._line.has_modem_lines()

    async def disable_autonomy(self) -> None:
        """Switch the unit's own tracking off if it is on, and halt: switching it off stops no motor that runs."""
        if not self._read().autonomous:
            return
        stops = self._stops
        sent_s = await self._send(Field.MODE, wire.TRACKING_OFF, stops)
        await self._stop_until_standing(stops)
        await self._confirm(
            lambda seen: seen.status_monotonic_s > sent_s and not seen.autonomous,
            "to leave its own tracking",
            stops,
            _STATUS_SHOWS_S,
        )

    async def move_to(self, a_deg: float, b_deg: float, *, first: AxisName = "a") -> None:
        """Send both targets as whole positions, `first` first, and wait until the unit shows them, within a second.

        Nothing is sent while a fault or a reference run shows, or while angle and position do not go together; nor to
        an axis that stands at its target already.
        """
        a, b = self._axes["a"], self._axes["b"]
        if not (a.allows(a_deg) and b.allows(b_deg)):
            limits = f"A {a.minimum_deg:g} to {a.maximum_deg:g}, B {b.minimum_deg:g} to {b.maximum_deg:g} deg"
            raise ValueError(f"target A {a_deg}, B {b_deg} deg is outside the limits ({limits})")
        try:
            whole: dict[AxisName, int] = {"a": a.destination(a_deg), "b": b.destination(b_deg)}
        except ValueError as error:
            raise RefusedError(_DEVICE, f"is not given a target: {error}") from error
        what = f"the target A {a_deg:z.2f}, B {b_deg:z.2f} deg (destinations {whole['a']} and {whole['b']})"
        seen = self._require_fit(what)
        wanted = {"a": whole["a"] + a.zero_offset, "b": whole["b"] + b.zero_offset}
        shown = {"a": (seen.position_a, seen.destination_a), "b": (seen.position_b, seen.destination_b)}
        stops, sent_s = self._stops, 0.0
        for axis in (first, "b" if first == "a" else "a"):
            if not all(abs(place - wanted[axis]) <= _AT_TARGET for place in shown[axis]):
                self._watch.note_target(axis, wanted[axis])
                sent_s = await self._send(_TARGET[axis], whole[axis], stops)
        try:
            await self._confirm(
                lambda seen: (
                    seen.time_monotonic_s > sent_s
                    and abs(seen.destination_a - wanted["a"]) <= DESTINATION_TOLERANCE
                    and abs(seen.destination_b - wanted["b"]) <= DESTINATION_TOLERANCE
                ),
                what,
                stops,
                _TARGET_SHOWS_S,
            )
        except RefusedError:
            # One axis may have taken its target, and drives to it.
            await self._transmit(encode_command(Field.ACTION, wire.STOP))
            raise

    async def stop(self) -> None:
        """Send stop now; a call that is in the middle of sending something else sends no more."""
        self._stops += 1
        self._watch.abort_reference_run()
        packet, first = encode_command(Field.ACTION, wire.STOP), self._nothing_sent
        await self._transmit(packet)
        if first:
            await asyncio.sleep(wire.COMMAND_SPACING_S)
            await self._transmit(packet)

    async def halt(self) -> None:
        """Send stop now, and again every 0.15 s until fresh telemetry shows both axes standing, within 12 s."""
        self._stops += 1
        await self._stop_until_standing(self._stops, give_way=False)

    async def home(self, axis: AxisName) -> None:
        """Halt, start a reference run and wait until it shows, up to 7 s.

        To home one axis while the other moves would leave the other running without control. Where count and end switch
        have contradicted each other the axis leaves the switch first: a run without travel would prove nothing.
        """
        stops = self._stops
        await self._stop_until_standing(stops)
        await self._leave_switch(axis, stops)
        before = self._read()
        self._watch.begin_reference_run(axis, before, self._now() + _UNDER_WAY_S)
        try:
            run = self._watch.begin_reference_run(axis, before, await self._send(Field.ACTION, _HOME[axis], stops))
            await self._confirm(lambda _: run.begun, f"to home axis {axis.upper()}", stops, _STATUS_SHOWS_S)
        except BaseException:
            self._watch.abort_reference_run()
            raise

    async def clear_faults(self, *, forgive: bool = True) -> Telemetry:
        """Halt, look at a status younger than the call, clear, and wait until that shows; return the look.

        The unit would go on with what was pending behind a fault, so both axes stand first. Without `forgive` the
        doubts about the reference stay.
        """
        stops, called_s = self._stops, self._now()
        await self._stop_until_standing(stops)
        seen = await self._confirm(
            lambda seen: seen.status_monotonic_s > called_s, "to report its status", stops, _STATUS_SHOWS_S
        )
        kinds = self._watch.reference.kinds
        sent_s = await self._send(Field.STATUS, wire.CLEAR, stops)
        await self._confirm(
            lambda seen: seen.status_monotonic_s > sent_s and not (seen.faults or seen.was_reset),
            "to clear its status",
            stops,
            _STATUS_SHOWS_S,
        )
        if forgive:
            self._watch.forgive(kinds)
        return seen

    async def _identify(self) -> PositionerIdentity:
        start_s = self._now()
        while True:
            known, restarted_s = self._listen()
            board = _text(known.get(Field.BOARD))
            if board and board not in self._boards:
                raise IdentityError(
                    _DEVICE, f"says it is board {board[:20]!r}, not {' or '.join(self._boards)}: nothing is sent to it"
                )
            missing = [field for field in (*_IDENTITY, *SLOW_FIELDS, *FAST_FIELDS) if field not in known]
            if not missing:
                self._identified = True
                firmware, serial = _text(known[Field.VERSION]), _text(known[Field.SERIAL])
                return PositionerIdentity(board, firmware, serial, self._line.simulated)
            waited_s = self._now() - max(start_s + self._line.boot_s, restarted_s or start_s)
            if waited_s > self._hear_within_s and not known:
                raise ConnectError(_DEVICE, "sends no telemetry: it hangs, is in its bootloader, or is another device")
            if waited_s > self._know_within_s:
                names = ", ".join(str(field.value) for field in missing)
                raise IdentityError(_DEVICE, f"sends something, but not the fields {names} of a positioner")
            await asyncio.sleep(_LOOK_EVERY_S)

    async def _wait_for_setup(self, serial: str) -> None:
        """Wait for the screens that tell how the unit is set; older units may not have all of them.

        What a unit lacks is waited for only once: after a loss of the link an axis may run until the opening is over.
        """
        deadline_s, wanted = self._now() + self._setup_within_s, SETUP_FIELDS - self._missing.get(serial, frozenset())
        while missing := wanted - self._listen()[0].keys():
            if self._now() >= deadline_s:
                self._missing[serial] = missing
                return
            await asyncio.sleep(_LOOK_EVERY_S)

    def _jitter_of(self, axis: AxisName, fields: dict[int, str]) -> float:
        step = count_step(fields, axis)
        return self._axes[axis].step if step is None else _JITTER_COUNTS * step

    def _listen(self) -> tuple[dict[int, Value], float | None]:
        try:
            state = self._line.state()
        except LinkLostError as error:
            raise ConnectError(_DEVICE, error.message) from error
        return dict(state.values), state.restarted_s

    def _read(self) -> Telemetry:
        return self._watch.read(self._line.state())

    def _require_fit(self, what: str) -> Telemetry:
        seen = self._read()
        if why := likely_cause(seen) if seen.faults or seen.homing else geometry_mismatch(seen, self._axes):
            raise RefusedError(_DEVICE, f"is not given {what}: {why}")
        return seen

    async def _leave_switch(self, axis: AxisName, stops: int) -> None:
        """Drive an axis off its end switch by a few degrees where its count there is in doubt, and that is safe."""
        setup, here = self._axes[axis], position_of(axis, self._read())
        if (whole := leave_switch_position(setup, here, self._watch.reference.possible_position(axis))) is None:
            return
        way = LeaveSwitchMove(axis, setup, whole)
        self._watch.note_target(axis, way.destination)
        await self._send(_TARGET[axis], whole, stops)
        await self._confirm(way.is_over, f"to leave the end switch of axis {axis.upper()}", stops, _LEFT_WITHIN_S)
        await self._stop_until_standing(stops)
        if way.trouble:
            raise RefusedError(_DEVICE, f"did not leave the end switch of axis {axis.upper()}: {way.trouble}")

    async def _stop_until_standing(self, stops: int, *, give_way: bool = True) -> None:
        """Send stop again and again until both axes stand and aim at where they stand."""
        begin_s = self._now()
        self._watch.abort_reference_run()
        standstill = Standstill(begin_s, self._jitter)
        # A person's stop may overwrite, in the unit, what was sent an instant ago; a stop of our own must not.
        again_s = self._sent_s + wire.COMMAND_SPACING_S if give_way else begin_s
        packet, sent = encode_command(Field.ACTION, wire.STOP), 0
        while sent < 2 or not standstill.reached:
            if give_way:
                self._raise_if_stopped(stops)
            if self._now() - begin_s > _STAND_WITHIN_S:
                raise StillMovingError(_DEVICE, why_not_standing(self._read(), _STAND_WITHIN_S, still=standstill.still))
            if self._now() >= again_s:
                await self._transmit(packet)
                # The very first packet of a connection is lost.
                pause_s = wire.COMMAND_SPACING_S if sent == 0 else _STOP_EVERY_S
                sent, again_s = sent + 1, self._now() + pause_s
            await asyncio.sleep(_LOOK_EVERY_S)
            seen = self._read()
            standstill.update(
                (seen.position_a, seen.position_b), (seen.destination_a, seen.destination_b), seen.time_monotonic_s
            )
        self._watch.note_standstill()

    async def _send(self, field: Field, value: float | str, stops: int) -> float:
        """Send when the last command is long enough ago; return the time from which telemetry may show its effect."""
        packet = encode_command(field, value)
        async with self._sending:
            if self._nothing_sent:
                self._raise_if_stopped(stops)
                await self._transmit(encode_command(Field.ACTION, wire.STOP))
            wait_s = self._sent_s + wire.COMMAND_SPACING_S - self._now()
            while wait_s > 0:
                await asyncio.sleep(wait_s)
                # A stop goes out at once, so the last command may be a newer one by now.
                wait_s = self._sent_s + wire.COMMAND_SPACING_S - self._now()
            self._raise_if_stopped(stops)
            await self._transmit(packet)
            return self._now() + _UNDER_WAY_S

    async def _transmit(self, packet: bytes) -> None:
        if not self._identified:
            self._line.state()
            raise LinkLostError(_DEVICE, "has not been identified, so nothing is sent to it")
        self._sent_s = self._now()
        try:
            await self._line.send(packet)
        finally:
            self._sent_s = self._now()
        self._nothing_sent = False

    def _raise_if_stopped(self, stops: int) -> None:
        if self._stops != stops:
            raise RefusedError(_DEVICE, "a stop came in between")

    async def _confirm(self, done: Callable[[Telemetry], bool], what: str, stops: int, within_s: float) -> Telemetry:
        """Wait for telemetry that is `done`, and return it; the deadline is judged by the telemetry's own time."""
        deadline_s = self._now() + within_s
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            self._raise_if_stopped(stops)
            seen = self._read()
            if done(seen):
                return seen
            if seen.time_monotonic_s >= deadline_s:
                raise RefusedError(_DEVICE, f"did not take {what}: {likely_cause(seen)}")


def _text(value: Value | None) -> str:
    return "" if value is None else value.text.decode("latin-1").strip()
