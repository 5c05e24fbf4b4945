"""The simulated positioner's stream of telemetry in memory."""

import asyncio
from collections.abc import Callable

from drivers.positioners.pozsol.link import LinkState
from drivers.positioners.pozsol.table import FieldTable
from drivers.positioners.pozsol.wire import TokenStream, require_allowed
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.transports.cable import Cabled


class InMemoryStream(Cabled):
    """A `drivers.positioners.pozsol.link.PositionerLine`: what changes is read when it is asked for, as if just come.

    Parameters
    ----------
    core
        The simulated unit.
    now
        The event loop's time [s].

    Attributes
    ----------
    silent
        Nothing comes from the unit any more, although the cable is in and the unit obeys.
    write_s
        How long it takes to write a packet [s]; the unit has it after half of that time.
    """

    simulated = True
    boot_s = 0.0

    def __init__(self, core: PositionerCore, now: Callable[[], float]) -> None:
        super().__init__("positioner")
        self._core = core
        self._now = now
        self._state = LinkState({})
        self._table = FieldTable()
        self._screens = b""
        self.silent = False
        self.write_s = 0.0
        core.enumerate_usb(now())

    async def open(self) -> None:
        """Connect, and hear every screen once."""
        self._connect()
        now_s = self._now()
        # Nothing is garbled on the way, so every change is believed at once.
        self._table, self._screens = FieldTable({}), b""
        if self.silent:
            self._state = LinkState({})
            return
        self._take(self._core.screens(now_s), now_s)

    async def close(self) -> None:
        """Release the cable; a move goes on."""
        self._disconnect()

    async def send(self, packet: bytes) -> None:
        """Hand one command to the unit."""
        self._require_open()
        require_allowed(packet)
        if self.write_s:
            await asyncio.sleep(0.5 * self.write_s)
            self._require_open()
        self._core.feed(packet, self._now())
        if self.write_s:
            await asyncio.sleep(0.5 * self.write_s)

    def state(self) -> LinkState:
        """Return what the unit would have said by now."""
        self._require_open()
        if self.silent:
            # In a new mapping, so that the driver does not take it for a repetition; the times stay as old as they are.
            return self._state._replace(values=dict(self._state.values))
        now_s = self._now()
        screens = self._core.live_screens(now_s)
        if screens != self._screens:
            self._screens = screens
            self._take(screens, now_s)
        # As `_replace` does, at a third of its cost: a simulated day has 170,000 looks.
        self._state = LinkState(self._state.values, now_s, self._state.jumped_s, self._state.restarted_s)
        return self._state

    @property
    def link_up(self) -> bool:
        """Whether the cable is plugged in; the unit takes each plugging for a new host."""
        return self._is_up

    @link_up.setter
    def link_up(self, up: bool) -> None:
        if up and not self._is_up:
            self._core.enumerate_usb(self._now())
        self._is_up = up
        self._is_open = self._is_open and up

    def has_modem_lines(self) -> bool:
        """Tell that there are no modem lines."""
        return False

    def _take(self, screens: bytes, now_s: float) -> None:
        self._table.take(TokenStream().feed_tokens(screens + b"$"), now_s)
        self._state = LinkState(self._table.snapshot())
