"""Whether a person is told of what the unit does by itself, and is not told of what never happened."""

import math

from daemon.base.records import Event

WORTH_TELLING_DEG = 0.5
TOLD_WITHIN_S = 10.0
"""The unit tells of some things in its slow screens only, and control looks every 5 s."""
CAUSE_WITHIN_S = 30.0
_SUBJECTS = ("alarm", "positioner", "control")


class Telling:
    """Compares what the axes did without an order with what the service has told.

    Parameters
    ----------
    fails
        Called with a promise and a text.
    """

    def __init__(self, fails):
        self._fails = fails
        self._turned_deg = 0.0
        self._begun_s = None
        self._untold = []
        self._cause_s = -math.inf
        self._blocked = None

    def cause(self, now_s):
        """A fault begins or ends, or a hand is at the unit."""
        self._cause_s = now_s

    def unexplained(self, turned_deg, now_s):
        """An axis turns without an order while the service could know."""
        self._cause_s = now_s
        if self._begun_s is None:
            self._begun_s, self._turned_deg = now_s, 0.0
        self._turned_deg += abs(turned_deg)
        if self._turned_deg >= WORTH_TELLING_DEG:
            self._untold.append((self._begun_s, self._turned_deg))
            self._begun_s = None

    def stands(self):
        """Both axes stand, or move by an order."""
        self._begun_s = None

    def look(self, plant, now_s):
        """Look at what has been told by now; nothing is asked of a service that has ended meanwhile."""
        blocked = plant.motion.unexplained
        if plant.watch.explained.by_hand(now_s):
            self._cause_s = now_s
        if blocked is not None and self._blocked is None and now_s - self._cause_s > CAUSE_WITHIN_S:
            self._fails("false-alarm", f"nothing has moved by itself, but: {blocked}")
        self._blocked = blocked
        while self._untold and now_s - self._untold[0][0] > TOLD_WITHIN_S:
            begun_s, turned_deg = self._untold.pop(0)
            if not blocked and not any(_tells(record, begun_s) for record in reversed(plant.records[-500:])):
                self._fails(
                    "untold", f"from {begun_s:.1f} s on an axis turned {turned_deg:.1f} deg, and nobody was told"
                )

    def forget(self):
        """The service cannot be held to account: it is gone, or cannot be heard."""
        self._untold.clear()
        self._begun_s = None


def _tells(record, since_s):
    return isinstance(record, Event) and record.subject in _SUBJECTS and record.time_monotonic_s >= since_s - 1.0
