"""The POZSOL36A1 positioner on its USB port: telemetry streams in, commands go out, and nothing answers.

A command has worked when its effect shows in the telemetry. Angles, positions and destinations come every 120 ms,
status, supply and mode every 3.24 s. A unit goes on with a move when the host falls silent: over USB nothing can stop
it but a stop that was sent.

All of this is as public firmware of the same product family does it, and has not been measured on a rig: the layout of
the status word, the 60 ms between commands, the cut to whole position units, and that no checksum is needed. Older
firmware had one; how it was formed is not known, so there is no such mode here. docs/hardware.md lists what to check.
"""

import asyncio
import math
from collections.abc import Callable

from drivers import pozsol_wire as wire
from drivers.errors import ConnectError, IdentityError, LinkLostError, ProtocolError, RefusedError
from drivers.executor import DeviceThread
from drivers.geometry import AxisSetup
from drivers.homing import HomingRun
from drivers.interfaces import Axis, PositionerIdentity, Telemetry
from drivers.own_moves import OWN_MOVES, own_moves
from drivers.pozsol_wire import Field, Status, encode_command, parse_number, parse_status
from drivers.telemetry import Port, TelemetryReader, Value

_DEVICE = "positioner"
_FAST = (Field.A_ANGLE, Field.A_POSITION, Field.A_DESTINATION, Field.B_ANGLE, Field.B_POSITION, Field.B_DESTINATION)
_SLOW = (Field.SUPPLY, Field.STATUS, Field.MODE)
_IDENTITY = (Field.BOARD, Field.VERSION, Field.SERIAL)
_HOME: dict[Axis, str] = {"a": wire.HOME_A, "b": wire.HOME_B}

_OPEN_S = 5.0
_HEAR_WITHIN_S = 2.5
_KNOW_WITHIN_S = 8.0
_SLOW_STALE_S = 8.0
_LOOK_EVERY_S = 0.04
_TARGET_SHOWS_S = 1.0
# Two turns of the slow screens, and a little.
_STATUS_SHOWS_S = 7.0
# A screen that was under way when a command was sent says nothing about it.
_UNDER_WAY_S = 0.1
_WRITE_S = 1.0
_CLOSE_S = 1.0
_JUMP_SHOWS_S = 1.0
_LOWEST_SUPPLY_V = 20.0


class PozsolPositioner:
    """Two motor axes behind one USB port.

    Parameters
    ----------
    connect
        Opens the port; called in the instrument's thread at each `open`.
    now
        The service's monotonic time [s]; also called in the reader's thread.
    a, b
        Geometry and limits of the axes; targets beyond the limits are refused before anything is sent.
    boards
        What field 37 may say; to any other board nothing is ever written.
    stale_s
        Silence of the fast fields after which the unit counts as lost.
    b_out_bit
        Where the status word has axis B's motion bits; None where that is not known.
    boot_s
        How long the unit may take to restart because its port was opened; 0 if it does not.
    banner
        What the unit prints when it has restarted; None if nothing is known of that. Whenever it comes, the reference
        is in doubt; in the midst of things the link counts as lost too.
    """

    def __init__(
        self,
        connect: Callable[[], Port],
        now: Callable[[], float],
        a: AxisSetup,
        b: AxisSetup,
        *,
        boards: tuple[str, ...] = ("36A1",),
        stale_s: float = 2.0,
        b_out_bit: int | None = None,
        boot_s: float = 0.0,
        banner: str | None = None,
    ) -> None:
        self._connect = connect
        self._now = now
        self._axes = {"a": a, "b": b}
        self._boards = boards
        self._stale_s = stale_s
        self._b_out_bit = b_out_bit
        self._boot_s = boot_s
        self._banner = b"" if banner is None else banner.encode("latin-1")
        self._thread = DeviceThread(_DEVICE)
        self._sending = asyncio.Lock()
        self._port: Port | None = None
        self._reader: TelemetryReader | None = None
        self._identified = False
        self._sent_s = now() - wire.COMMAND_SPACING_S
        self._stops = 0
        self._homing: HomingRun | None = None
        self._forgiven_s = -math.inf
        self._reference_lost = False
        self._restarted_s: float | None = None

    async def open(self) -> PositionerIdentity:
        """Connect and identify by listening alone; takes up to one turn of the slow screens, 3.3 s, and any restart."""
        await self.close()
        try:
            self._port = port = await self._thread.call(self._connect, _OPEN_S, lambda late: late.close())
            self._reader = TelemetryReader(port, self._now, boot_s=self._boot_s, banner=self._banner)
            identity = await self._identify(self._reader)
        except BaseException:
            await self.close()
            raise
        self._restarted_s = self._reader.restarted_s
        self._reference_lost = self._reference_lost or self._restarted_s is not None
        return identity

    async def close(self) -> None:
        """Release the port; a move goes on."""
        reader, self._reader, self._port = self._reader, None, None
        self._identified = False
        self._homing = None
        if reader is not None:
            reader.stop()
        await self._thread.finish(None if reader is None else reader.close, _CLOSE_S)

    async def read_telemetry(self) -> Telemetry:
        """Return the newest telemetry; `LinkLostError` when it is old."""
        return self._look()[0]

    def fields(self) -> dict[int, str]:
        """Return every field that has come since `open`, by its code, as the unit prints it."""
        return {code: _text(value) for code, value in sorted(self._require_reader().snapshot().items())}

    def has_lines(self) -> bool:
        """Tell whether the port has modem lines, which are then as they were asked for."""
        self._require_reader()
        return self._port is not None and self._port.has_lines()

    async def disable_autonomy(self) -> None:
        """Switch the unit's own tracking off if it is on; a slave would take the command for "on"."""
        if not self._look()[0].autonomous:
            return
        stops = self._stops
        sent_s = await self._send(Field.MODE, wire.TRACKING_OFF, stops)
        await self._confirm(
            lambda seen, status_s: status_s > sent_s and not seen.autonomous,
            "to leave its own tracking",
            stops,
            _STATUS_SHOWS_S,
        )

    async def move_to(self, a_deg: float, b_deg: float) -> None:
        """Send both targets and wait until the unit shows them as its destinations, within a second."""
        a, b = self._axes["a"], self._axes["b"]
        if not (a.allows(a_deg) and b.allows(b_deg)):
            limits = f"A {a.minimum_deg:g} to {a.maximum_deg:g}, B {b.minimum_deg:g} to {b.maximum_deg:g} deg"
            raise ValueError(f"target A {a_deg}, B {b_deg} deg is outside the limits ({limits})")
        stops = self._stops
        await self._send(Field.A_ANGLE, a_deg, stops)
        await self._send(Field.B_ANGLE, b_deg, stops)
        wanted = (a.destination(a_deg), b.destination(b_deg))
        await self._confirm(
            lambda seen, _: abs(seen.destination_a - wanted[0]) <= 1 and abs(seen.destination_b - wanted[1]) <= 1,
            f"the target A {a_deg:.2f}, B {b_deg:.2f} deg (destinations {wanted[0]} and {wanted[1]})",
            stops,
            _TARGET_SHOWS_S,
        )

    async def stop(self) -> None:
        """Send stop now; whoever is in the middle of sending something else sends no more."""
        self._stops += 1
        self._homing = None
        await self._transmit(encode_command(Field.ACTION, wire.STOP))

    async def home(self, axis: Axis) -> None:
        """Start a reference run and wait until it shows, up to 7 s: the unit tells of homing in its slow status."""
        stops = self._stops
        before = self._look()[0]
        sent_s = await self._send(Field.ACTION, _HOME[axis], stops)
        status_shows = axis == "a" or self._b_out_bit is not None
        run = HomingRun(axis, before, sent_s, status_shows=status_shows)
        self._homing = run
        try:
            await self._confirm(
                lambda _seen, _status_s: run.begun, f"to home axis {axis.upper()}", stops, _STATUS_SHOWS_S
            )
        except BaseException:
            self._homing = None
            raise

    async def clear_faults(self) -> None:
        """Clear faults and the reset mark, after a stop: the unit would go on with what was pending behind a fault."""
        stops = self._stops
        await self._send(Field.ACTION, wire.STOP, stops)
        sent_s = await self._send(Field.STATUS, wire.CLEAR, stops)
        self._reference_lost, self._forgiven_s = False, sent_s
        await self._confirm(
            lambda seen, status_s: status_s > sent_s and not (seen.faults or seen.was_reset),
            "to clear its status",
            stops,
            _STATUS_SHOWS_S,
        )

    async def _identify(self, reader: TelemetryReader) -> PositionerIdentity:
        start_s = self._now()
        while True:
            known = reader.snapshot()
            board = _text(known.get(Field.BOARD))
            if board and board not in self._boards:
                raise IdentityError(
                    _DEVICE, f"says it is board {board[:20]!r}, not {' or '.join(self._boards)}: nothing is sent to it"
                )
            missing = [field for field in (*_IDENTITY, *_SLOW, *_FAST) if field not in known]
            if not missing:
                self._identified = True
                return PositionerIdentity(board, _text(known[Field.VERSION]), _text(known[Field.SERIAL]))
            if reader.lost:
                raise ConnectError(_DEVICE, reader.lost)
            waited_s = self._now() - max(start_s + self._boot_s, reader.restarted_s or start_s)
            if waited_s > _HEAR_WITHIN_S and not reader.heard:
                message = "sends no telemetry: it is in its bootloader or hangs, or this is another device"
                raise ConnectError(_DEVICE, message)
            if waited_s > _KNOW_WITHIN_S:
                names = ", ".join(f"{field.value}" for field in missing)
                raise IdentityError(_DEVICE, f"sends something, but not the fields {names} of a positioner")
            await asyncio.sleep(_LOOK_EVERY_S)

    def _require_reader(self) -> TelemetryReader:
        reader = self._reader
        if reader is None:
            raise LinkLostError(_DEVICE, "has to be opened first")
        if reader.lost:
            raise LinkLostError(_DEVICE, reader.lost)
        return reader

    async def _send(self, field: Field, value: float | str, stops: int) -> float:
        """Send when the last command is long enough ago; return the time from which telemetry may show its effect."""
        packet = encode_command(field, value)
        async with self._sending:
            wait_s = self._sent_s + wire.COMMAND_SPACING_S - self._now()
            while wait_s > 0:
                await asyncio.sleep(wait_s)
                # A stop goes out at once, so the last command may be a newer one by now.
                wait_s = self._sent_s + wire.COMMAND_SPACING_S - self._now()
            self._heed(stops)
            await self._transmit(packet)
            return self._now() + _UNDER_WAY_S

    async def _transmit(self, packet: bytes) -> None:
        self._require_reader()
        port = self._port
        if port is None or not self._identified:
            raise LinkLostError(_DEVICE, "has not been identified, so nothing is sent to it")
        self._sent_s = self._now()
        try:
            await self._thread.call(lambda: port.write(packet), _WRITE_S)
        finally:
            self._sent_s = self._now()

    def _heed(self, stops: int) -> None:
        if self._stops != stops:
            raise RefusedError(_DEVICE, "a stop came in between")

    async def _confirm(self, done: Callable[[Telemetry, float], bool], what: str, stops: int, within_s: float) -> None:
        """Wait until `done`, of telemetry and the time of its status, says so."""
        deadline_s = self._now() + within_s
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            self._heed(stops)
            seen, status_s = self._look()
            if done(seen, status_s):
                return
            if self._now() >= deadline_s:
                raise RefusedError(_DEVICE, f"did not take {what}: {_likely_cause(seen)}")

    def _look(self) -> tuple[Telemetry, float]:
        """Return the newest telemetry and the time of its status."""
        reader = self._require_reader()
        if reader.restarted_s != self._restarted_s:
            self._reference_lost = True
            raise LinkLostError(_DEVICE, "has restarted: it prints its banner")
        known, now = reader.snapshot(), self._now()
        try:
            oldest_s = min(known[field].time_s for field in _FAST)
            oldest_slow_s = min(known[field].time_s for field in _SLOW)
            if now - oldest_s > self._stale_s or now - oldest_slow_s > max(_SLOW_STALE_S, self._stale_s):
                raise LinkLostError(_DEVICE, f"has been silent for {now - min(oldest_s, oldest_slow_s):.1f} s")
            status = parse_status(_text(known[Field.STATUS]), self._b_out_bit)
            telemetry = self._telemetry(known, status, oldest_s)
        except (KeyError, ValueError) as error:
            raise ProtocolError(_DEVICE, f"sent telemetry that cannot be read: {error}") from error
        return telemetry, known[Field.STATUS].time_s

    def _telemetry(self, known: dict[int, Value], status: Status, oldest_s: float) -> Telemetry:
        numbers = {field: parse_number(field, known[field].text) for field in (*_FAST, Field.SUPPLY)}
        positions = (numbers[Field.A_POSITION], numbers[Field.B_POSITION])
        destinations = (numbers[Field.A_DESTINATION], numbers[Field.B_DESTINATION])
        homing = status.homing
        if self._homing is not None:
            self._homing.look(positions, destinations, status, known[Field.STATUS].time_s, self._now())
            homing = homing or (self._homing.begun and not self._homing.over)
            if self._homing.over:
                self._homing = None
                self._forgiven_s = self._now()
        self._note_jump(homing)
        return Telemetry(
            time_monotonic_s=oldest_s,
            a_deg=numbers[Field.A_ANGLE],
            b_deg=numbers[Field.B_ANGLE],
            position_a=positions[0],
            position_b=positions[1],
            destination_a=destinations[0],
            destination_b=destinations[1],
            supply_v=numbers[Field.SUPPLY],
            faults=status.faults,
            was_reset=status.was_reset or self._reference_lost,
            button_pressed=status.button_pressed,
            homing=homing,
            autonomous=status.autonomous,
            mode_text=_text(known[Field.MODE]),
            own_moves=own_moves({code: _text(known[code]) for code in known.keys() & OWN_MOVES}),
        )

    def _note_jump(self, homing: bool) -> None:
        reader = self._reader
        if reader is None or reader.jumped_s is None:
            return
        # At the end of a reference run the count is meant to jump, and what was cleared may still be on its way.
        if not homing and reader.jumped_s > self._forgiven_s + _JUMP_SHOWS_S:
            self._reference_lost = True
        reader.jumped_s = None


def _text(value: Value | None) -> str:
    return "" if value is None else value.text.decode("latin-1").strip()


def _likely_cause(seen: Telemetry) -> str:
    if seen.faults:
        return f"it reports {', '.join(seen.faults)}"
    if seen.homing:
        return "it is homing"
    if seen.supply_v < _LOWEST_SUPPLY_V:
        return f"its motor supply is {seen.supply_v:g} V"
    if seen.autonomous:
        return f"its own mode is on ({seen.mode_text})"
    shown = f"destinations {seen.destination_a:g} and {seen.destination_b:g}"
    return f"it shows {shown} and no reason; is the geometry in instruments.positioner that of this unit?"
