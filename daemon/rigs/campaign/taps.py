"""Taps before and behind a positioner's driver, which note every order that goes through it."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol

from daemon.base.records import Scan
from drivers.interfaces import AxisName, Positioner
from drivers.positioners.pozsol.positioner import PozsolPositioner
from sim_drivers.pozsol.core import PositionerCore
from solar.frames import Angles


class Witness(Protocol):
    """Is told of orders, services and plugs, and keeps the promises that were broken."""

    def add_violation(self, promise: str, text: str) -> None:
        """Take note of a broken promise."""

    def note_packet(self, data: bytes, now_s: float) -> None:
        """Take note of a packet that reaches the unit."""

    def sending(self, target: tuple[float, float]) -> AbstractContextManager[None]:
        """Watch a target [deg] while the driver sends and confirms it."""

    def note_homing(self, axis: AxisName) -> None:
        """Take note that a reference run is ordered."""

    def note_link_change(self) -> None:
        """Take note that a plug was pulled or put back."""

    def note_wake_up(self, slept_s: float) -> None:
        """Take note that the machine has slept for `slept_s`."""

    def note_service_start(self) -> None:
        """Take note that a new process is there."""

    def note_scan(self, scan: Scan) -> None:
        """Take note of a scan that the service has accepted."""


class SleeplessUnit:
    """A `PositionerCore` that goes on while the machine sleeps; its methods take the machine's monotonic time.

    Parameters
    ----------
    core
        The simulated unit.
    world_time_s
        Adds to a monotonic time [s] the time that the machine has slept.
    """

    def __init__(self, core: PositionerCore, world_time_s: Callable[[float], float]) -> None:
        self._core = core
        self._world_time_s = world_time_s

    def feed(self, data: bytes, now: float) -> None:
        """Take in bytes from the host."""
        self._core.feed(data, self._world_time_s(now))

    def enumerate_usb(self, now: float) -> None:
        """Connect the cable."""
        self._core.enumerate_usb(self._world_time_s(now))

    def next_event(self, now: float) -> float | None:
        """Return when the state next changes by itself, or None; the machine may sleep meanwhile."""
        due_s = self._core.next_event(self._world_time_s(now))
        return None if due_s is None else due_s - self._world_time_s(0.0)

    def truth(self, now: float) -> Angles:
        """Return where the axes really stand."""
        return self._core.truth(self._world_time_s(now))

    axes = truth

    def screens(self, now: float) -> bytes:
        """Return all screens."""
        return self._core.screens(self._world_time_s(now))

    def live_screens(self, now: float) -> bytes:
        """Return the screens that change while axes move."""
        return self._core.live_screens(self._world_time_s(now))

    def changes(self, now: float) -> int:
        """Return how often anything has changed so far."""
        return self._core.changes(self._world_time_s(now))

    def position_and_destination(self, name: AxisName, now: float) -> tuple[float, float]:
        """Return position and destination of an axis."""
        return self._core.position_and_destination(name, self._world_time_s(now))

    def shown_deg(self, name: AxisName, now: float) -> float:
        """Return the angle [deg] that the unit shows for an axis."""
        return self._core.shown_deg(name, self._world_time_s(now))

    def inject(self, fault: str, now: float) -> None:
        """Cause a fault."""
        self._core.inject(fault, self._world_time_s(now))

    def repair(self, fault: str, now: float) -> None:
        """End a condition that `inject` began."""
        self._core.repair(fault, self._world_time_s(now))

    def power_cycle(self, now: float, *, keep_position: bool) -> None:
        """Switch off and on."""
        self._core.power_cycle(self._world_time_s(now), keep_position=keep_position)


class UnitTap:
    """The unit as one process reaches it: every packet is noted, and a dead process sends nothing more.

    Parameters
    ----------
    unit
        The simulated unit.
    witness
        Notes every packet.
    """

    def __init__(self, unit: SleeplessUnit, witness: Witness) -> None:
        self._unit = unit
        self._witness = witness
        self.live_screens = unit.live_screens
        self.screens = unit.screens
        self.enumerate_usb = unit.enumerate_usb
        self.dead = False

    def feed(self, data: bytes, now: float) -> None:
        """Hand bytes to the unit."""
        if not self.dead:
            self._witness.note_packet(data, now)
            self._unit.feed(data, now)


class Line(Protocol):
    """The line that one process sends through."""

    dead: bool


class DriverTap:
    """A positioner's driver, with every order that goes through it noted.

    Parameters
    ----------
    driver, line
        The driver, and the line that it sends through.
    witness
        Notes targets and reference runs.
    """

    def __init__(self, driver: Positioner, line: Line, witness: Witness) -> None:
        self._driver = driver
        self._witness = witness
        self._line = line
        self.open, self.close = driver.open, driver.close
        self.read_telemetry, self.disable_autonomy = driver.read_telemetry, driver.disable_autonomy
        self.stop, self.halt, self.clear_faults = driver.stop, driver.halt, driver.clear_faults

    async def move_to(self, a_deg: float, b_deg: float, *, first: AxisName = "a") -> None:
        """Move there; see the driver."""
        if self._line.dead:
            await self._driver.move_to(a_deg, b_deg, first=first)
            return
        with self._witness.sending((a_deg, b_deg)):
            await self._driver.move_to(a_deg, b_deg, first=first)

    async def home(self, axis: AxisName) -> None:
        """Begin a reference run; see the driver."""
        if not self._line.dead:
            self._witness.note_homing(axis)
        await self._driver.home(axis)


class PozsolTap(DriverTap):
    """A tap of the POZSOL's driver, which has more methods than others."""

    def __init__(self, driver: PozsolPositioner, line: Line, witness: Witness) -> None:
        super().__init__(driver, line, witness)
        self.repeated_s, self.standing, self.recall = driver.repeated_s, driver.standing, driver.recall
