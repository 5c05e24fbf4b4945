"""A rotator behind rotctld as the campaign's plant has it, and the line to it."""

import asyncio
import math
from dataclasses import replace

from daemon.config.settings import Settings
from daemon.rigs.campaign.rig import SteppingClock
from daemon.rigs.campaign.taps import Witness
from daemon.rigs.real import positioner_surroundings
from daemon.rigs.simulated_rotator import build_rotator, rotator_truth
from drivers.interfaces import AxisName, Positioner
from drivers.positioners.rotctld import driver, protocol
from drivers.positioners.rotctld.driver import RotctldSettings
from drivers.positioners.rotctld.mount import Mount
from drivers.positioners.rotctld.protocol import RotctldReply
from sim_drivers.transports import InMemoryRotctld
from solar.frames import Angles, equator_azimuth_deg

DEAF, GONE, STOPLESS, SENT_AWAY = "deaf", "gone", "stopless", "own_tracking"
"""Faults of a rotator: it is switched off behind its rotctld, which does not notice; it is unplugged from its rotctld,
until that is restarted with the plug in; it is of a make without a stop; another client sends it away."""
_SPEED_DEG_PER_S = 1.5


class SleeplessRotator:
    """A rotator that goes on while the machine sleeps; its methods take the machine's monotonic time.

    Its axes are azimuth and elevation, and it never counts wrong.

    Parameters
    ----------
    settings
        Settings of its tracker.
    clock
        The plant's clock.
    sent_to
        Where another client sends it, A and B [deg].
    """

    def __init__(self, settings: Settings, clock: SteppingClock, sent_to: Angles) -> None:
        own = settings.instruments.positioner
        assert isinstance(own, RotctldSettings)  # noqa: S101 - narrowing; the plant has set it
        self.own = own
        self.core = build_rotator(settings, own, clock)
        self.core.rotator_range = turns = replace(self.core.rotator_range, speed_deg_per_s=_SPEED_DEG_PER_S)
        self._truth = rotator_truth(self.core, settings)
        self._world_time_s = clock.world_time_s
        ranges = (turns.azimuth_min_deg, turns.azimuth_max_deg, turns.elevation_min_deg, turns.elevation_max_deg)
        mount = Mount(*ranges, equator_azimuth_deg(settings.site.latitude_deg))
        self._away_axes_deg = mount.place(sent_to.a_deg, sent_to.b_deg)
        self.limits: dict[AxisName, tuple[float, float]] = {"a": ranges[:2], "b": ranges[2:]}

    def truth(self, now: float) -> Angles:
        """Return where it really points, as A and B."""
        return self._truth(self._world_time_s(now))

    def axes(self, now: float) -> Angles:
        """Return where its axes really stand: azimuth and elevation."""
        return Angles(*self.core.position(self._world_time_s(now)))

    def next_event(self, _now: float) -> float | None:
        """Return None: nothing begins by itself."""
        return None

    def changes(self, now: float) -> int:
        """Return a number that changes whenever its course changes."""
        destination = self.core.destination()
        return hash((destination, self.core.position(self._world_time_s(now)) == destination))

    def position_and_destination(self, name: AxisName, now: float) -> tuple[float, float]:
        """Return position and destination [deg] of an axis."""
        at = 0 if name == "a" else 1
        return self.core.position(self._world_time_s(now))[at], self.core.destination()[at]

    def shown_deg(self, name: AxisName, now: float) -> float:
        """Return the angle [deg] that it shows for an axis."""
        return self.position_and_destination(name, now)[0]

    def inject(self, fault: str, now: float) -> None:
        """Cause a fault."""
        if fault in (DEAF, GONE, STOPLESS):
            self.core.faults.add(fault)
        elif fault == SENT_AWAY:
            self.core.set_target(*self._away_axes_deg, self._world_time_s(now))
        else:
            raise ValueError(f"a rotator has no fault {fault!r}")

    def repair(self, fault: str, _now: float) -> None:
        """End a condition that `inject` began; a rotator that was sent away still goes all the way."""
        self.core.faults.discard(fault)


class RotatorTap(InMemoryRotctld):
    """The line of one process to a rotator: orders are noted, and a dead process sends nothing more.

    Parameters
    ----------
    rotator
        The simulated rotator.
    clock
        The plant's clock.
    witness
        Notes every order.

    Attributes
    ----------
    dead
        Whether the process is dead.
    silent
        Whether rotctld answers nothing.
    write_s
        How long it takes to write an order [s]; the rotator has it after half of that.
    """

    def __init__(self, rotator: SleeplessRotator, clock: SteppingClock, witness: Witness) -> None:
        super().__init__(rotator.core, lambda: clock.world_time_s(clock.monotonic()))
        self._clock = clock
        self._witness = witness
        self.dead = False
        self.write_s = 0.0

    @property
    def silent(self) -> bool:
        """Whether rotctld answers nothing."""
        return self.frozen

    @silent.setter
    def silent(self, silent: bool) -> None:
        self.frozen = silent

    async def ask(self, command: bytes, within_s: float) -> RotctldReply:
        """Send one command and return its reply."""
        if not _is_order(command):
            return await super().ask(command, within_s)
        if self.write_s:
            await asyncio.sleep(0.5 * self.write_s)
        self._require_open()
        if self.dead:
            await asyncio.sleep(math.inf)
        if not (self.frozen or GONE in self._core.faults):
            self._witness.note_packet(command, self._clock.monotonic())
        reply = await super().ask(command, within_s)
        if self.write_s:
            await asyncio.sleep(0.5 * self.write_s)
        return reply


def _is_order(command: bytes) -> bool:
    return any(name in command for name in (protocol.SET_POSITION.encode(), protocol.STOP.encode()))


def build_rotator_driver(
    rotator: SleeplessRotator, line: RotatorTap, settings: Settings, clock: SteppingClock
) -> Positioner:
    """Return the driver of a rotator at the end of a line."""
    return driver.build(rotator.own, positioner_surroundings(settings, clock), line)
