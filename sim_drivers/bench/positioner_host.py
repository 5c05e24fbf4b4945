"""The simulated positioner on its USB port: a stream of screens every 20 ms out, commands in."""

import asyncio
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.positioners.pozsol.wire import COMMAND_SPACING_S, SEPARATOR
from sim_drivers.bench.pty_port import PtyPort
from sim_drivers.pozsol.core import PositionerCore

SCREEN_EVERY_S = 0.02
BANNER = b"\r\nPOZSOL36A1 ready\r\n"
"""What the simulated unit prints after a restart; whether a real one prints anything is not known."""
ECHO_OFF_WITHIN_S = 0.25
_MOST_WAITING_COMMANDS = 3


class PositionerHost:
    """The unit behind its port.

    The first screen after the port has been opened is an old one, held since the last user left. It comes a period
    later, and not before the user has switched echo off, so that a user whom a busy machine keeps waiting does no harm.
    A user who leaves echo on gets it after a quarter of a second; what is echoed then is taken for a command.

    Of two commands within 20 ms a unit hears one. A busy machine may read commands that were sent in good time all at
    once from a pseudo-terminal. So they are handed over one by one, at the distance that the unit asks for. More than
    three that wait are an echo, and are handed over as they are.

    Parameters
    ----------
    core
        The simulated unit.
    link
        Path of the port.
    now
        The event loop's time [s].
    random
        For corrupted screens.

    Attributes
    ----------
    boots_at_open_s
        How long the unit restarts whenever its port is opened; None if it does not. A pseudo-terminal has no modem
        lines, so a user cannot prevent that.
    received
        How often each command code has come in, whoever sent it.
    lost_screens
        Screens for which there was no room.
    """

    def __init__(self, core: PositionerCore, link: Path, now: Callable[[], float], random: np.random.Generator) -> None:
        self.core = core
        self.port = PtyPort(link, self._take)
        self.received: Counter[int] = Counter()
        self.lost_screens = 0
        self._now = now
        self._random = random
        self._held_screen: bytes | None = None
        self._has_user = False
        self._echo_until_s = now()
        self.boots_at_open_s: float | None = None
        self._boots_until_s: float | None = None
        self._frozen = False
        self._drops = self._corruptions = 0
        self._free_s = now()

    async def run(self) -> None:
        """Stream until cancelled."""
        due_s = self._now()
        while True:
            due_s = max(due_s + SCREEN_EVERY_S, self._now())
            await asyncio.sleep(due_s - self._now())
            if not self._frozen:
                self._stream()

    def freeze(self) -> None:
        """Neither send nor take anything, as a unit that hangs and as one in its bootloader."""
        self._frozen = True
        self.port.pause()

    def thaw(self) -> None:
        """Go on."""
        self._frozen = False
        self.port.resume()

    def restart(self, silent_s: float) -> None:
        """Start the unit anew without a loss of USB: it is silent and deaf for a while and prints its banner then."""
        self.core.power_cycle(self._now(), keep_position=True)
        self._held_screen = None
        self._boots_until_s = self._now() + silent_s

    def drop_next(self, count: int) -> None:
        """Lose the next screens."""
        self._drops += count

    def corrupt_next(self, count: int) -> None:
        """Garble one byte of each of the next screens."""
        self._corruptions += count

    def _stream(self) -> None:
        if self._boots_until_s is not None:
            if self._now() >= self._boots_until_s:
                self._boots_until_s = None
                self.port.send(BANNER)
            return
        if not self.port.in_use:
            self._has_user = False
            if self._held_screen is None:
                self._held_screen = self.core.next_screen(self._now())
            return
        if not self._has_user:
            self._has_user = True
            self._echo_until_s = self._now() + ECHO_OFF_WITHIN_S
            if self.boots_at_open_s is not None:
                self.restart(self.boots_at_open_s)
            return
        if self._now() < self._echo_until_s and self.port.echoes:
            return
        self._echo_until_s = self._now()
        screen, self._held_screen = self._held_screen or self.core.next_screen(self._now()), None
        if self._drops:
            self._drops -= 1
            return
        if self._corruptions:
            self._corruptions -= 1
            garbled = bytearray(screen)
            garbled[int(self._random.integers(len(garbled)))] ^= 0x40
            screen = bytes(garbled)
        if not self.port.send(screen):
            self.lost_screens += 1

    def _take(self, data: bytes) -> None:
        now_s, packets = self._now(), _commands(data)
        if len(packets) > _MOST_WAITING_COMMANDS or self._free_s - now_s > _MOST_WAITING_COMMANDS * COMMAND_SPACING_S:
            self._hand_over(data)
            return
        for packet in packets:
            wait_s = self._free_s - now_s
            if wait_s > 0.0:
                asyncio.get_running_loop().call_later(wait_s, self._hand_over, packet)
            else:
                self._hand_over(packet)
            self._free_s = max(self._free_s, now_s) + COMMAND_SPACING_S

    def _hand_over(self, packet: bytes) -> None:
        if self._frozen or self._boots_until_s is not None:
            return
        at = packet.find(SEPARATOR)
        if 0 <= at < len(packet) - 1:
            self.received[packet[at + 1]] += 1
        self.core.feed(packet, self._now())


def _commands(data: bytes) -> list[bytes]:
    first, *others = data.split(b"%c" % SEPARATOR)
    return [packet for packet in (first, *(b"%c%b" % (SEPARATOR, other) for other in others)) if packet]
