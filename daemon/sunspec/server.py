"""Serving the registers over Modbus TCP, beside everything else in the service's loop."""

import asyncio
import contextlib
import errno
import logging
import math
import os
from collections.abc import Callable

from daemon.base.addresses import parse_address
from daemon.base.clock import Clock
from daemon.base.reconnect import Outage
from daemon.base.recurrence import LogBudget, RateLimit
from daemon.config.settings import Settings
from daemon.service.operator import CommandError
from daemon.service.operator_commands import Command, Operators
from daemon.service.snapshot import Snapshot
from daemon.sunspec.models import SunSpecMap
from daemon.sunspec.table import Override, SunSpecTable
from drivers.modbus.framing import BrokenStreamError, ReceivedRequest, TcpServer
from drivers.modbus.pdu import DEVICE_FAILURE, EXCEPTION_FLAG, ILLEGAL_VALUE, WRITE_FUNCTIONS, exception_text
from drivers.modbus.server import answer

log = logging.getLogger("heliocube.sunspec")

_RETRY_EVERY_S = 10.0
_IDLE_S = 300.0
_MOST_CLIENTS = 16
# A control room asks every few seconds. If all places are taken, a client that was silent for this long makes room.
_MAKES_ROOM_S = 10.0
# A client waits about a second; a command that takes longer than this goes on, and its effect shows in the registers.
_ANSWER_WITHIN_S = 0.5
# A control room asks once a second; a program that asks in a loop has to wait, so that the rest of the service goes on.
_QUESTIONS_PER_S, _QUESTIONS_AT_ONCE, _PAUSE_S = 100.0, 200, 0.05
_NO_SUCH_UNIT = 11
# Modbus's guide for TCP: 255 is the device at this address, and 0 is accepted as well.
_THIS_DEVICE = (0, 0xFF)
_SETTLE_EVERY_S = 60.0
_CHUNK = 1024


class SunSpecServer:
    """The device as a companion of the service.

    Parameters
    ----------
    settings
        The whole configuration, its section `sunspec` above all.
    see
        Takes a snapshot.
    operators
        Carry out the manual override, with the same checks as for commands that come in by other ways.
    clock
        The service's time.
    alarm
        Raises an alarm, or ends it with None.
    speed
        The clock runs this many times as fast as the machine's.

    Attributes
    ----------
    port
        Where it is served; 0 while it is not.
    """

    def __init__(
        self,
        settings: Settings,
        see: Callable[[], Snapshot],
        operators: Operators,
        clock: Clock,
        alarm: Callable[[str, str | None], None],
        speed: float,
    ) -> None:
        self._own = settings.sunspec
        self._operators = operators
        self._clock = clock
        self._alarm = alarm
        self._speed = speed
        self._outage = Outage(log, "the SunSpec device")
        self._refusal_budget = LogBudget("writes over SunSpec that were refused")
        self._asked_s: dict[asyncio.StreamWriter, float] = {}
        self._running: set[asyncio.Task[object]] = set()
        serial = settings.mqtt.name or settings.cube.name
        tolerance_deg = {name: own.motion.tolerance_deg for name, own in settings.trackers}
        registers = SunSpecMap(serial, self._own.unit, tolerance_deg)
        self._table = SunSpecTable(registers, see, clock.monotonic, writable=self._own.manual)
        self.port = 0

    async def run(self) -> None:
        """Serve until cancelled; a port that cannot be bound raises an alarm, and is tried again every few seconds."""
        address = parse_address(self._own.listen)
        server: asyncio.Server | None = None
        try:
            while server is None:
                try:
                    opened = await asyncio.start_server(self._serve, address.host, address.port, limit=_CHUNK)
                except OSError as error:
                    # The text of asyncio's own error has the address once more; some of its errors have no number.
                    why = os.strerror(error.errno) if error.errno else str(error)
                else:
                    # asyncio passes over a kind of address that the system does not have, and opens no socket.
                    server, why = (opened if opened.sockets else None), os.strerror(errno.EAFNOSUPPORT)
                if server is None:
                    self._report_outage(f"cannot listen on {address}: {why}")
                    await asyncio.sleep(_RETRY_EVERY_S * self._speed)
            self._outage.up(self._clock.monotonic())
            self._alarm("sunspec-down", None)
            self.port = server.sockets[0].getsockname()[1]
            may = "the manual override may be written" if self._own.manual else "read-only"
            log.info("SunSpec is served at %s, %s", address, may)
            while True:
                await asyncio.sleep(_SETTLE_EVERY_S * self._speed)
                self._log(self._refusal_budget.poll_flood_summary(self._clock.monotonic()))
        finally:
            await self._end(server)

    async def _end(self, server: asyncio.Server | None) -> None:
        self.port = 0
        if server is not None:
            server.close()
        for writer in tuple(self._asked_s):
            writer.transport.abort()
        running = tuple(self._running)
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)

    def _report_outage(self, reason: str) -> None:
        self._outage.down(self._clock.monotonic(), f"{reason}; set sunspec.listen to another port or address")
        self._alarm("sunspec-down", f"the SunSpec device {reason}: no control room can read or command")

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self._has_room():
            writer.transport.abort()
            return
        self._asked_s[writer] = self._clock.monotonic()
        task = asyncio.current_task()
        if task is not None:
            self._running.add(task)
        host = str(writer.get_extra_info("peername", ("?",))[0])
        framing, pace = TcpServer(), RateLimit(_QUESTIONS_PER_S / self._speed, _QUESTIONS_AT_ONCE)
        try:
            # The end of the service cancels this task, which the library would report as an exception.
            with contextlib.suppress(OSError, TimeoutError, BrokenStreamError, asyncio.CancelledError):
                while data := await self._more(reader):
                    for asked in framing.feed(data, 0.0):
                        self._asked_s[writer] = self._clock.monotonic()
                        if not pace.admit(self._clock.monotonic()):
                            await asyncio.sleep(_PAUSE_S * self._speed)
                        writer.write(framing.reply(asked, await self._answer(asked, host)))
                        async with asyncio.timeout(_IDLE_S * self._speed):
                            await writer.drain()
        finally:
            self._asked_s.pop(writer, None)
            if task is not None:
                self._running.discard(task)
            writer.transport.abort()

    def _has_room(self) -> bool:
        """Return whether there is a place; if all are taken, the client that has been silent longest gives way."""
        if len(self._asked_s) < _MOST_CLIENTS:
            return True
        quietest = min(self._asked_s, key=self._asked_s.__getitem__)
        if self._clock.monotonic() - self._asked_s[quietest] < _MAKES_ROOM_S * self._speed:
            return False
        quietest.transport.abort()
        del self._asked_s[quietest]
        return True

    async def _more(self, reader: asyncio.StreamReader) -> bytes:
        async with asyncio.timeout(_IDLE_S * self._speed):
            return await reader.read(_CHUNK)

    async def _answer(self, asked: ReceivedRequest, host: str) -> bytes:
        pdu = asked.request.pdu
        if asked.request.unit not in (self._own.unit, *_THIS_DEVICE):
            return bytes((pdu[0] | EXCEPTION_FLAG, _NO_SUCH_UNIT))
        reply = answer(self._table, pdu) or bytes((pdu[0] | EXCEPTION_FLAG, DEVICE_FAILURE))
        override = self._table.pop_override()
        if reply[0] & EXCEPTION_FLAG or override is None:
            if reply[0] & EXCEPTION_FLAG and pdu[0] in WRITE_FUNCTIONS:
                why = exception_text(reply) if self._own.manual else "sunspec.manual is false"
                self._log_refusal(f"{host}, register {int.from_bytes(pdu[1:3])}: {why}")
            return reply
        if self._table.is_in_force(override):
            self._table.note_carried_out(override)
            return reply
        code = await self._carry_out(override, host)
        return bytes((pdu[0] | EXCEPTION_FLAG, code)) if code else reply

    async def _carry_out(self, override: Override, host: str) -> int:
        """Return 0 once a command is under way, or the exception of one that is refused."""
        goes = override.name == "goto"
        command = Command(
            name=override.name,
            action=override.name,
            channel="SunSpec",
            why="the control room set model 601 to manual" if override.name != "auto" else "the control room set 601",
            by=f"SunSpec client {host}",
            identifier=None,
            tracker=override.tracker,
            a_deg=override.a_deg if goes else math.nan,
            b_deg=override.b_deg if goes else math.nan,
        )
        task: asyncio.Task[object] = asyncio.create_task(self._command(command, override))
        self._running.add(task)
        task.add_done_callback(self._running.discard)
        await asyncio.wait((task,), timeout=_ANSWER_WITHIN_S * self._speed)
        refused = task.result() if task.done() else None
        if refused is None:
            return 0
        return ILLEGAL_VALUE if isinstance(refused, CommandError) and refused.wrong else DEVICE_FAILURE

    async def _command(self, command: Command, override: Override) -> CommandError | None:
        try:
            self._refuse_held(override)
            await self._operators.carry_out(command)
        except CommandError as error:
            self._table.note_refusal(override)
            self._log_refusal(f"{command.by}: {error}")
            return error
        self._table.note_carried_out(override)
        return None

    def _refuse_held(self, override: Override) -> None:
        if override.name == "auto" and self._table.is_held(override.tracker):
            raise CommandError("a person has stopped or stowed the tracker in the meantime")

    def _log_refusal(self, sentence: str) -> None:
        self._log(self._refusal_budget.spend(self._clock.monotonic(), f"a write over SunSpec is refused: {sentence}"))

    def _log(self, line: str) -> None:
        if line:
            log.warning("%s", line)
