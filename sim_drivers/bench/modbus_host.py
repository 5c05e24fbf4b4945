"""The simulated sensors of a cube on Modbus, on a serial line and on Modbus TCP at once."""

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from drivers.modbus.framing import BrokenStreamError, TcpServer
from sim_drivers.bench.line_host import LineHost
from sim_drivers.bench.pty_port import PtyPort
from sim_drivers.modbus.line import DeviceLineCore, SimulatedDevice

# 8 data bits, parity, start and stop at 19200 baud.
_BYTE_S = 11 / 19200


class ModbusHost:
    """The sensors behind their line and their network port.

    Parameters
    ----------
    sensors
        Of the faces, in their order.
    link
        Path of the serial port.
    now
        The event loop's time [s].

    Attributes
    ----------
    line
        The serial line.
    tcp_port
        Of Modbus TCP on loopback; 0 before the start.
    """

    def __init__(self, sensors: Sequence[SimulatedDevice], link: Path, now: Callable[[], float]) -> None:
        self.sensors = sensors
        self.line: LineHost[DeviceLineCore] = LineHost(DeviceLineCore(sensors), link, now, _BYTE_S)
        self.tcp_port = 0
        self._now = now
        self._server: asyncio.Server | None = None
        self._users: set[asyncio.StreamWriter] = set()
        self._frozen = False

    @property
    def port(self) -> PtyPort:
        """The serial port."""
        return self.line.port

    async def start(self) -> None:
        """Plug everything in."""
        self.port.plug()
        await self._listen()

    async def stop(self) -> None:
        """Pull everything out."""
        await self.unplug()

    async def unplug(self) -> None:
        """Pull the serial port and the network cable."""
        self.port.unplug()
        server, self._server = self._server, None
        if server is not None:
            server.close()
        for writer in list(self._users):
            writer.transport.abort()

    async def replug(self) -> None:
        """Plug both in again."""
        self.port.plug()
        await self._listen()

    def freeze(self) -> None:
        """Let all of them hang."""
        self._frozen = True
        self.line.freeze()

    def thaw(self) -> None:
        """Let them go on."""
        self._frozen = False
        self.line.thaw()

    def power_cycle(self) -> None:
        """Switch all of them off and on."""
        self.line.power_cycle()

    def state(self) -> dict[str, Any]:
        """Return who is there and how they are."""
        return {
            "plugged": self.port.plugged,
            "in_use": self.port.in_use or bool(self._users),
            "tcp_port": self.tcp_port,
            "questions": self.line.core.questions,
            "sensors": [each.state() for each in dict.fromkeys(self.sensors)],
        }

    async def _listen(self) -> None:
        if self._server is None:
            self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.tcp_port)
            self.tcp_port = self._server.sockets[0].getsockname()[1]

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        core = DeviceLineCore(self.sensors, TcpServer())
        self._users.add(writer)
        replies: set[asyncio.TimerHandle] = set()
        loop = asyncio.get_running_loop()
        try:
            while data := await reader.read(4096):
                # The timer of a reply that is due sends it at once: it need not be cancelled any more.
                replies = {timer for timer in replies if timer.when() > loop.time()}
                for due_s, frame in [] if self._frozen else core.feed(data, self._now()):
                    replies.add(loop.call_later(max(due_s - self._now(), 0.0), self._send, writer, frame))
        except (OSError, BrokenStreamError):
            return
        except Exception as failure:  # noqa: BLE001 - whatever a sensor raises ends the bench, as on the serial line
            self.line.fail(failure)
        finally:
            for timer in replies:
                timer.cancel()
            self._users.discard(writer)
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    def _send(self, writer: asyncio.StreamWriter, frame: bytes) -> None:
        if not writer.is_closing() and not self._frozen:
            writer.write(frame)
