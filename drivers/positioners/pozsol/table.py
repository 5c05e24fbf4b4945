"""The newest value of each telemetry field that can be believed."""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

from drivers.positioners.pozsol.wire import DECIMALS, Field, parse_number, parse_status

# Between two screens an axis turns by a tenth of the first, and it never turns faster than the second; a larger change
# means that the unit now counts from elsewhere.
_JUMP_DEG = 2.0
_FASTEST_DEG_PER_S = 10.0
_JUMP_WITHIN_S = 1.0
# If nothing was read for so much longer than was meant, the first data that is read then has waited, and data that did
# not fit into the port's buffer is lost.
_PAUSE_S = 0.15
_BACKLOG_S = 0.5
_ANGLES: dict[int, float] = {Field.A_ANGLE: _JUMP_DEG, Field.B_ANGLE: _JUMP_DEG}
# The fields that one screen says of an axis belong together: each with the code of the angle that begins the screen.
_SCREENS: dict[int, int] = {
    int(code): int(angle)
    for angle, codes in {
        Field.A_ANGLE: (Field.A_ANGLE, Field.A_POSITION, Field.A_DESTINATION),
        Field.B_ANGLE: (Field.B_ANGLE, Field.B_POSITION, Field.B_DESTINATION),
    }.items()
    for code in codes
}
_SCREEN_LENGTH = 3
_ALL_FIELDS = frozenset(range(256))


@dataclass(slots=True)
class Value:
    """A field as it was printed, when it last came in that form [s], and its number; NaN for a text."""

    text: bytes
    time_s: float
    number: float = math.nan


class FieldTable:
    """The newest value of each field that can be believed; filled by one thread, read by any.

    An axis's angle, position and destination are always those of one screen: the position of a new count beside the
    angle of the old one would be taken for motion.

    Parameters
    ----------
    jumps
        By field, the change within a second that is believed only once the next value confirms it.

    Attributes
    ----------
    jumped_s
        When an angle has last changed by more than an axis can turn, or None: the unit counts from elsewhere then.
    moved_unseen_s
        When an angle has last changed by that much after a silence in which an axis can have turned so far, or None.
    """

    def __init__(self, jumps: Mapping[int, float] = _ANGLES) -> None:
        self._jumps = jumps
        self._taken_s = self._paused_s = self._caught_up_s = -math.inf
        self.jumped_s: float | None = None
        self.moved_unseen_s: float | None = None
        self.forget()

    def get(self, field: int) -> Value | None:
        """Return the newest value of a field, or None if it never came."""
        return self._values.get(field)

    def snapshot(self) -> dict[int, Value]:
        """Return all fields; their times go on being updated, what they say does not."""
        return dict(self._values)

    def forget(self) -> None:
        """Start anew."""
        self._values: dict[int, Value] = {}
        # Values by their token, as the stream has it.
        self._values_by_token: dict[bytes, Value] = {}
        self._suspected_jumps: dict[int, float] = {}
        # The axis' screen that is being read, hidden until it is whole; the axes whose angle was not believed.
        self._screen: dict[int, Value] = {}
        self._distrusted_axes: set[int] = set()

    def take(self, tokens: Sequence[bytes], now_s: float, waited_s: float = 0.0) -> None:
        """Note what has come, except impossible values: bytes of those were lost, and the next screen has them again.

        Parameters
        ----------
        tokens
            One byte that names the field, and its text; in the order in which they came.
        now_s
            When they were read [s].
        waited_s
            How long they were let wait on purpose.
        """
        if self._values and now_s - self._taken_s > _PAUSE_S + waited_s:
            self._paused_s, self._caught_up_s = self._taken_s, now_s + _BACKLOG_S
        self._taken_s = now_s
        said, news = self._values_by_token, self._changed_fields(tokens)
        for token in tokens:
            # A screen that has lost its end is ended by the next field, whatever that says.
            if token[0] in news or self._screen:
                self._take(token, now_s)
            else:
                said[token].time_s = now_s

    def _changed_fields(self, tokens: Sequence[bytes]) -> Set[int]:
        """Return the fields that have to be looked at: of a unit at rest hardly any says something new.

        All tokens of the other fields repeat what is known, so that no change in between is missed.
        """
        if self._screen or self._distrusted_axes:
            return _ALL_FIELDS
        said = self._values_by_token
        news = {token[0] for token in tokens if token not in said}
        return news if news.isdisjoint(_SCREENS) else news | _SCREENS.keys()

    def _take(self, token: bytes, now_s: float) -> None:
        code = token[0]
        axis = _SCREENS.get(code)
        if self._screen and (axis not in self._screen or axis == code):
            self._end_screen()
        # While the angle that began a screen is not believed, nothing else of the axis is.
        if axis != code and axis in self._distrusted_axes:
            return
        value = self._believable_value(token, now_s)
        if axis is not None:
            self._take_of_axis(axis, code, value)
        elif value is not None:
            self._keep({code: value})

    def _take_of_axis(self, axis: int, code: int, value: Value | None) -> None:
        if axis == code:
            (self._distrusted_axes.add if value is None else self._distrusted_axes.discard)(axis)
        if value is None:
            return
        if axis != code and not self._screen:
            # The unit prints this field before the angle, or the angle was lost.
            self._keep({code: value})
            return
        self._screen[code] = value
        if len(self._screen) == _SCREEN_LENGTH:
            self._end_screen()

    def _end_screen(self) -> None:
        screen, self._screen = self._screen, {}
        self._keep(screen)

    def _keep(self, values: dict[int, Value]) -> None:
        for code, value in values.items():
            known = self._values.get(code)
            if known is not value:
                if known is not None:
                    del self._values_by_token[b"%c%b" % (code, known.text)]
                self._values_by_token[b"%c%b" % (code, value.text)] = value
        # In one step: another thread sees all of them or none.
        self._values.update(values)

    def _believable_value(self, token: bytes, now_s: float) -> Value | None:
        """Return what a field says now, or None if that is impossible."""
        code, known = token[0], self._values_by_token.get(token)
        if known is not None:
            # The unit repeats the believed value, so a suspected jump has not happened.
            self._suspected_jumps.pop(code, None)
            known.time_s = now_s
            return known
        text, number = token[1:], math.nan
        try:
            if code in DECIMALS:
                number = parse_number(code, text)
            elif code == Field.STATUS:
                parse_status(text.decode("latin-1"))
        except ValueError:
            return None
        if code in self._jumps and not self._plausible(code, number, now_s):
            return None
        return Value(text, now_s, number)

    def _plausible(self, code: int, number: float, now_s: float) -> bool:
        """Tell whether a value is possible; a jump is, once the next value confirms it."""
        known, most = self._values.get(code), self._jumps[code]
        if known is None:
            self._suspected_jumps.pop(code, None)
            return True
        passed_s = now_s - (min(known.time_s, self._paused_s) if now_s < self._caught_up_s else known.time_s)
        change = abs(number - known.number)
        if passed_s > _JUMP_WITHIN_S or change <= most + _FASTEST_DEG_PER_S * passed_s:
            self._suspected_jumps.pop(code, None)
            if change > most and code in _ANGLES:
                self.moved_unseen_s = now_s
            return True
        suspect = self._suspected_jumps.get(code)
        self._suspected_jumps[code] = number
        if suspect is None or abs(number - suspect) > most:
            return False
        del self._suspected_jumps[code]
        if code in _ANGLES:
            self.jumped_s = now_s
        return True
