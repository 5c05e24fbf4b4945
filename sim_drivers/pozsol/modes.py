"""The simulated positioner's own modes: sun tracking, a master above it, wind and snow."""

import math
from dataclasses import dataclass

from drivers.interfaces import AxisName
from sim_drivers.pozsol.setup import Setup
from solar.frames import Angles


@dataclass(slots=True)
class _Stow:
    """One of the unit's own stow modes: entered `delay_s` after its cause appears, left `hold_s` after it ends."""

    pose: Angles | None
    delay_s: float
    hold_s: float
    active: bool = False
    change_s: float = math.inf

    def cause(self, present: bool, now_s: float) -> None:
        if self.pose is None or present is self.active:
            self.change_s = math.inf
        else:
            self.change_s = now_s + (self.delay_s if present else self.hold_s)


class OwnModes:
    """When the unit moves of its own accord, and to where.

    Attributes
    ----------
    tracking
        It follows the sun, or a master.
    slave
        A master may lead it.
    """

    def __init__(self, setup: Setup) -> None:
        self.tracking = self.slave = self._is_led = False
        self.wind = _Stow(setup.wind_stow, 0.5, setup.wind_hold_s)
        self.snow = _Stow(setup.snow_stow, 10.0, setup.snow_hold_s)
        self._setup = setup
        self._next_s = math.inf

    @property
    def ignores_host_targets(self) -> bool:
        """Whether targets of the host are ignored; a unit that a master leads takes them all the same."""
        return self.tracking and not self.slave

    def set_tracking(self, on: bool, now: float) -> None:
        """Switch tracking, as code 56 does."""
        self.tracking = on
        self.restart(now)

    def set_led_by_master(self, present: bool, now: float) -> None:
        """Let a master take the unit over and lead it, or let it go."""
        self.slave = self._is_led = present
        self.set_tracking(present, now)

    def restart(self, now: float) -> None:
        """Start tracking anew if it is on; without a word of its master a slave stays where it is."""
        moves = self.tracking and (self._is_led or not self.slave)
        self._next_s = now if moves else math.inf

    def events(self) -> tuple[float, ...]:
        """Return when something changes by itself."""
        return self._next_s, self.wind.change_s, self.snow.change_s

    def targets(self, now: float) -> list[tuple[AxisName, float]]:
        """Return the angles [deg] that the axes are sent to now, if it is time."""
        for stow in (self.wind, self.snow):
            if stow.change_s <= now:
                stow.active, stow.change_s = not stow.active, math.inf
                self.restart(now)
        if self._next_s > now:
            return []
        self._next_s = now + self._setup.own_interval_s
        stow = self.wind if self.wind.active else self.snow
        pose = stow.pose if stow.active and stow.pose else self._setup.own_target(now)
        return [("a", pose.a_deg), ("b", pose.b_deg)]
