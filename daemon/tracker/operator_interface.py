"""What operators may ask of the tracker, and what is refused while somebody keeps it still."""

import asyncio

from daemon.base.records import Mode, Target
from daemon.config.settings import Settings
from daemon.motion.motion import Motion
from daemon.tracker.orders import RELEASE, Orders
from daemon.tracker.parking import Parking
from daemon.tracker.phase import Phase
from daemon.tracker.wishes import Wishes
from drivers.errors import RefusedError

# The first decisions of hundreds of trackers take a second or two.
_ALL_DECIDE_WITHIN_S = 3.0


class OperatorInterface:
    """Latches what operators ask for; the state machine behind it carries it out.

    Parameters
    ----------
    settings
        The whole configuration.
    motion
        The only way to the axes.
    orders
        What persons asked for.
    parking
        Brings the tracker to fixed positions.
    phase
        When its turn is among the trackers of the process.

    Attributes
    ----------
    mode, why
        What the tracker does, and the reason.
    """

    def __init__(self, settings: Settings, motion: Motion, orders: Orders, parking: Parking, phase: Phase) -> None:
        self._settings = settings
        self._motion = motion
        self._orders = orders
        self._parking = parking
        self._phase = phase
        self._wake = asyncio.Event()
        self.mode = Mode.STARTING
        self.why = "starting"

    def decide_again(self) -> None:
        """Request a tick at once, which judges the situation anew."""
        self._wake.set()

    def _decide_in_turn(self) -> None:
        """Request a tick for what all trackers have been waiting for: at once, or soon, one after the other."""
        if self._phase.place == 0:
            self._wake.set()
        else:
            asyncio.get_running_loop().call_later(self._phase.delay_s(_ALL_DECIDE_WITHIN_S), self._wake.set)

    @property
    def wishes(self) -> Wishes:
        """What persons asked for and is in force."""
        return self._orders.wishes

    def refuse_if_stopped(self, command: str) -> None:
        """Raise `RefusedError` where a person's stop, maintenance or a person at the unit forbids a command."""
        self._orders.refuse_if_stopped(command)

    def stow(self, why: str, by: str = "") -> None:
        """Go to the stow position and stay until released; `RefusedError` while nothing may move."""
        self._orders.refuse_if_stopped("stow")
        self._orders.latch("stow", why, by)
        self._keep_wishes()

    def snow(self, why: str, by: str = "") -> None:
        """Go to the snow position and stay until released, but for stow; `RefusedError` while nothing may move."""
        self._orders.refuse_if_stopped("snow")
        if self.wishes.stow is not None:
            raise RefusedError("positioner", f"no snow: the tracker is {self.wishes.describe('stow')}; {RELEASE}")
        self._orders.hold_at = None
        self._orders.latch("snow", why, by, instead_of="hold")
        self._parking.forget()
        self._keep_wishes()

    def hold(self, why: str, by: str = "") -> None:
        """Stay where the tracker is; a move in progress is stopped. Stow still goes before it.

        Raises `RefusedError` while nothing may move, and while the tracker is stowed.
        """
        self._orders.refuse_if_stopped("hold")
        self._refuse_stowed("hold")
        self._orders.hold_at = None
        self._orders.latch("hold", why, by, instead_of="snow")
        self._keep_wishes()

    def goto(self, a_deg: float, b_deg: float, why: str, by: str = "") -> None:
        """Go to a position and hold there.

        Raises
        ------
        ValueError
            Outside the limits, or not a number.
        RefusedError
            The tracker is stopped, stowed, starting or in fault: nothing is kept for later.
        """
        self.check_goto(a_deg, b_deg)
        if self.mode in (Mode.STARTING, Mode.FAULT):
            remedy = "; give it again in a minute, or after 'heliocube hold'" if self.mode is Mode.STARTING else ""
            raise RefusedError("positioner", f"no goto in mode {self.mode}: {self.why}{remedy}")
        self._orders.hold_at = Target(a_deg, b_deg, why)
        # An older order that waits could still move the tracker to elsewhere.
        self._motion.cancel_waiting_order()
        self._orders.latch("hold", why, by, instead_of="snow", goto_deg=(a_deg, b_deg))
        self._parking.forget()
        self._keep_wishes()

    def check_goto(self, a_deg: float, b_deg: float) -> None:
        """Raise what `goto` raises because of the position, a person's orders or a stow."""
        limits = self._settings.limits.limits()
        if not limits.contain(a_deg, b_deg):
            raise ValueError(f"A {a_deg:g}, B {b_deg:g} deg is outside the limits ({limits})")
        self._orders.refuse_if_stopped("goto")
        self._refuse_stowed("goto")

    def auto(self) -> None:
        """Release everything that persons asked for: the one way out of stop and maintenance."""
        self._orders.release()
        if self.mode in (Mode.HOLD, Mode.SNOW):
            # If nothing is decided anew, a move to the position that a person wanted would go on.
            self._motion.cancel_move()
        self._freeze()
        self._keep_wishes()

    async def stop(self, why: str, by: str = "") -> None:
        """Stop the axes at once and keep them stopped until released, even from stowing: somebody may be in reach.

        Raises `DeviceError` when the positioner cannot be reached; it is stopped on reconnection then.
        """
        await self._stand_still("stop", why, by)

    def join_stop(self, why: str, by: str = "") -> bool:
        """Note who else wants the tracker stopped, just after a stop was sent; return whether that is new."""
        if self.wishes.stop is not None and self.wishes.stop.has_request(why, by):
            return False
        self._orders.latch("stop", why, by)
        self._freeze()
        self._keep_wishes()
        return True

    async def maintenance(self, why: str, by: str = "") -> None:
        """Stop the axes, keep them still and all alarms silent until released.

        Raises `RefusedError` while a person's stop stands, and `DeviceError` as `stop` does.
        """
        self._orders.refuse_if_stopped("maintenance")
        await self._stand_still("maintenance", why, by)

    async def _stand_still(self, name: str, why: str, by: str) -> None:
        self._orders.latch(name, why, by)
        self._orders.hold_at = None
        self._freeze()
        # The stop does not wait for the disk, and writing to disk does not wait for a slow link.
        asyncio.get_running_loop().call_soon(self._orders.keep)
        try:
            await self._motion.stop()
        finally:
            self._keep_wishes()

    def _freeze(self) -> None:
        """Tell motion at once what persons want to stand still."""
        standstill_reason = self.wishes.standstill_reason
        if standstill_reason is not None:
            # A move to a fixed position ends here; if this is released before the next tick, order it again at once.
            self._parking.forget()
        self._motion.freeze(None if standstill_reason is None else f"the tracker is {standstill_reason}; {RELEASE}")

    def _refuse_stowed(self, command: str) -> None:
        if self.mode is Mode.STOW:
            raise RefusedError(
                "positioner",
                f"no {command} while the tracker is stowed ({self.why}): 'heliocube auto' ends a stow that was asked"
                " for; one for the wind ends with the wind",
            )

    def _keep_wishes(self) -> None:
        self._orders.keep()
        self._wake.set()

    def home(self) -> None:
        """Start a reference run of both axes; `RefusedError` while nothing may move, and while stowed."""
        self.check_home()
        self._motion.home()
        self._wake.set()

    def check_home(self) -> None:
        """Raise what `home` raises because of a person's orders or a stow."""
        self._orders.refuse_if_stopped("home")
        self._refuse_stowed("home")

    def clear_faults(self, shown: tuple[str, ...] | None = None) -> tuple[str, ...]:
        """Clear the faults and doubts that are shown, and no other; return them. `RefusedError` while stopped."""
        self._orders.refuse_if_stopped("clear")
        found = self._motion.concerns if shown is None else shown
        self._motion.clear_faults(shown=found)
        return found
