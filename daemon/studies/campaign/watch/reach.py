"""From when a service can be held to its promises: the unit is plugged in and hears, and the service has had time."""

import math

from daemon.rigs.campaign.plant import PlantTracker

CONNECTION_GRACE_S = 2.0
"""How long after the first telemetry the service has before all promises bind."""
CONNECTS_WITHIN_S = 15.0
DEAFNESS_GRACE_S = 6.0
"""How long after a unit was deaf: the service's pauses between its stop commands may have grown by then."""


class Reach:
    """Whether the service reaches the unit.

    Attributes
    ----------
    since_s
        When the unit last came within reach or went out of it.
    connected_s
        When the service last began to have telemetry; infinite while it has none.
    begun_s
        When the present service began.
    """

    def __init__(self) -> None:
        self.since_s = 0.0
        self.connected_s = math.inf
        self.begun_s = 0.0
        self._connected = False
        self._grace_s = 0.0
        self._deaf = False

    def note_service_start(self, now_s: float) -> None:
        """Take note of a new process."""
        self.begun_s = self.since_s = now_s
        self._connected, self.connected_s, self._grace_s = False, math.inf, 0.0

    def note_link_change(self, now_s: float) -> None:
        """Take note that a plug was pulled or put back, or that the unit is heard again."""
        self.since_s, self._grace_s = now_s, 0.0

    def note_deafness(self, now_s: float, *, is_deaf: bool) -> None:
        """Take note that the unit takes no commands, or takes them again."""
        self._deaf, self.since_s, self._grace_s = is_deaf, now_s, DEAFNESS_GRACE_S

    def sample(self, mount: PlantTracker, now_s: float) -> None:
        """See whether there is telemetry."""
        connected = mount.is_served and mount.motion.connected
        if connected and not self._connected:
            self.connected_s = now_s
        elif not connected:
            self.connected_s = math.inf
        self._connected = connected

    def can_keep_promises(self, mount: PlantTracker, now_s: float) -> bool:
        """Tell whether the service can keep its promises: it has had time to connect and to be heard."""
        if not (mount.is_served and mount.plugged) or self._deaf or mount.is_silent or mount.is_gone:
            return False
        if now_s - self.since_s > CONNECTS_WITHIN_S:
            return True
        since_s = max(self.connected_s, self.since_s)
        return self._connected and now_s - since_s > max(CONNECTION_GRACE_S, self._grace_s)
