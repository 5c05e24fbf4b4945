"""Checks that a command over a broker is current: not too old, and not given before."""

from daemon.base.clock import Clock
from daemon.config.links import MqttSettings
from daemon.service.operator import CommandError
from daemon.service.operator_commands import URGENT, Command

_MOST_REMEMBERED = 4096

# Identifier and time [s] of a command; without an identifier the whole command as text, because its angles may be NaN,
# and such commands are not equal from Python 3.13 on. `_Given` adds when the command came.
_Date = tuple[str, float] | str
_Given = dict[_Date, float]


class ReplayGuard:
    """Remembers the latest commands, and among them all from the time that a command may take to arrive.

    Parameters
    ----------
    settings
        Whether each must have a time and an identifier, and how far from now the time may be.
    clock
        The service's time.
    """

    def __init__(self, settings: MqttSettings, clock: Clock) -> None:
        self._required = settings.dated_commands
        self._age_s = settings.command_age_s
        self._clock = clock
        self._began_s = clock.monotonic()
        # By whether it is urgent: a flood of wishes must not fill the memory for commands that make things safe.
        self._given_by_urgency: dict[bool, _Given] = {False: {}, True: {}}

    def check(self, command: Command) -> None:
        """Refuse a command that is old, has been given before, or lacks a required date; never refuse a stop.

        Raises
        ------
        CommandError
            In one sentence.
        """
        if command.action == "stop":
            return
        if command.time_utc_s is None or command.identifier is None:
            if self._required:
                raise CommandError('mqtt.dated_commands is set: a command needs an "id" and a "time" of its own')
            if command.time_utc_s is None:
                return
        utc_s, now_s = self._clock.utc(), self._clock.monotonic()
        off_s = utc_s - command.time_utc_s
        if not abs(off_s) <= self._age_s:
            side = "behind" if off_s > 0 else "ahead of"
            raise CommandError(
                f"its time is {abs(off_s):.0f} s {side} this machine's clock, more than mqtt.command_age_s ="
                f" {self._age_s:g} s"
            )
        # Commands from before a restart are not remembered, and so cannot be told from new ones. When this service
        # began is reckoned from the clock's present time, because the clock may have been set since.
        if command.time_utc_s < utc_s - (now_s - self._began_s):
            raise CommandError("it was given before this service began to listen: give it again")
        # The time alone is not enough: two programs, or one, may give two commands in one second.
        date = repr(command) if command.identifier is None else (command.identifier, command.time_utc_s)
        self._refuse_repeated(date, now_s, urgent=command.action in URGENT)

    def _refuse_repeated(self, date: _Date, now_s: float, *, urgent: bool) -> None:
        if any(date in given for given in self._given_by_urgency.values()):
            what = "of this time" if isinstance(date, str) else "with this id and time"
            raise CommandError(f"the same command, {what}, has been given before")
        given = self._given_by_urgency[urgent]
        if len(given) >= _MOST_REMEMBERED:
            self._forget_oldest(given, now_s)
        given[date] = now_s

    def _forget_oldest(self, given: _Given, now_s: float) -> None:
        """Make room for one more. No more are forgotten, because a clock that is set back makes old commands new."""
        oldest = next(iter(given))
        # Twice the age: a command's time may be ahead of the clock by as much when it comes.
        if now_s - given[oldest] <= 2.0 * self._age_s:
            raise CommandError("more dated commands have come than can be remembered: ask again later")
        del given[oldest]
