"""The orders of persons that are in force: latched, kept, refused while one stands in the way, and released."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from daemon.base.clock import Clock
from daemon.tracker.stow import OperatorStow
from daemon.tracker.wishes import PROGRAM, Wish, Wishes, WishFile
from drivers.errors import RefusedError
from drivers.interfaces import Telemetry

if TYPE_CHECKING:
    from daemon.base.records import Target

RELEASE = "only 'heliocube auto' releases it"
_BUTTON_PRESSED_WHY = "a button was pressed at the unit: a person is there"


class Orders:
    """Keeps what persons asked for.

    Parameters
    ----------
    clock
        The service's time.
    file
        Keeps the wishes over a restart.
    hold_why
        Why the tracker is to be held from the start where nobody has asked for anything; None to let it go to work.

    Attributes
    ----------
    wishes
        What is in force.
    stow
        The person's wish as one reason to stow among others.
    hold_at
        Where a hold is, or None for wherever the tracker stands.
    """

    def __init__(self, clock: Clock, file: WishFile, hold_why: str | None = None) -> None:
        self._clock = clock
        self._file = file
        self._released_s = float("-inf")
        self.stow = OperatorStow()
        self.hold_at: Target | None = None
        self._goto_ended_by = "a restart"
        self._set(file.load())
        self._kept = self.wishes
        if hold_why is not None and self.wishes == Wishes():
            self.latch("hold", hold_why, PROGRAM)
            self.keep()

    def refuse_if_stopped(self, command: str) -> None:
        """Raise `RefusedError` where a person's stop, maintenance or a person at the buttons forbids a command."""
        wishes, standstill_reason = self.wishes, self.wishes.standstill_reason
        # A person who works at a tracker may press its buttons before giving the command.
        from_buttons = command == "maintenance" and wishes.stop is None and wishes.maintenance is None
        if standstill_reason is None or from_buttons:
            return
        raise RefusedError("positioner", f"no {command}: the tracker is {standstill_reason}; {RELEASE}")

    def latch(
        self,
        name: str,
        why: str,
        by: str,
        *,
        instead_of: str | None = None,
        goto_deg: tuple[float, float] | None = None,
    ) -> None:
        """Put a wish in force, in memory; `keep` writes it down. A stop joins one that stands and does not replace it.

        Parameters
        ----------
        name
            Name of the wish.
        why, by
            Reason and person.
        instead_of
            A wish that this one ends.
        goto_deg
            For the hold of a goto: its position, A and B.
        """
        wish = Wish(why=why, by=by, since_utc_s=self._clock.utc(), goto_deg=goto_deg)
        if name == "stop" and self.wishes.stop is not None:
            wish = self.wishes.stop.joined_by(wish)
        ended = {} if instead_of is None else {instead_of: None}
        self._set(self.wishes.model_copy(update={name: wish, **ended}))

    def end_goto(self, by: str) -> None:
        """End a goto because of what has come: afterwards the position that a person wanted may be the wrong one."""
        if self.hold_at is not None:
            self.hold_at, self._goto_ended_by = None, by

    def end_goto_on_its_way(self, stands_at: Callable[[float, float], bool]) -> str | None:
        """Let a sleep of the machine end a goto that has not arrived, and return that in words; None if there is none.

        Hours later the person who gave it may no longer be at the tracker. `stands_at` is as for `why_held`.
        """
        if self.hold_at is None or stands_at(self.hold_at.a_deg, self.hold_at.b_deg):
            return None
        self.end_goto("a sleep of the machine")
        return self.why_held(stands_at)

    def why_held(self, stands_at: Callable[[float, float], bool]) -> str | None:
        """Return why a person holds the tracker, or None; for a goto that ended on its way, also what ended it.

        Parameters
        ----------
        stands_at
            Returns whether the tracker rests at a place of A and B [deg].
        """
        hold = self.wishes.hold
        if hold is None:
            return None
        if hold.goto_deg is None or self.hold_at is not None or stands_at(*hold.goto_deg):
            return hold.why
        a_deg, b_deg = hold.goto_deg
        place = f"A {a_deg:g}, B {b_deg:g} deg"
        return f"{hold.why}; {self._goto_ended_by} has ended the goto to {place}: give it again to go there"

    def release(self) -> None:
        """End all wishes, in memory."""
        self._released_s = self._clock.monotonic()
        self.hold_at = None
        self._set(Wishes())

    def keep(self) -> None:
        """Write down what is in force, once."""
        if self.wishes is not self._kept:
            self._kept = self.wishes
            self._file.save(self.wishes)

    def note_buttons(self, telemetry: Telemetry | None) -> bool:
        """Hold, in memory, when somebody presses a button at the unit; return whether that is new.

        A press seen before the last `auto` no longer counts; in maintenance somebody is known to be there anyway.
        """
        if telemetry is None or not telemetry.button_pressed or self.wishes.buttons or self.wishes.maintenance:
            return False
        if not telemetry.status_monotonic_s > self._released_s:
            return False
        self.latch("buttons", _BUTTON_PRESSED_WHY, "")
        self.hold_at = None
        return True

    def _set(self, wishes: Wishes) -> None:
        self.wishes = wishes
        if wishes.stow is None:
            self.stow.release()
        else:
            self.stow.request(wishes.stow.why)
