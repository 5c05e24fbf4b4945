"""What motion shows of itself as alarms, and when motor currents are one."""

from daemon.base.alarms.alarms import Alarms
from daemon.motion.reference import Doubts, fault_text
from drivers.interfaces import PositionerIdentity, Telemetry

_LASTS_S = 2.0
# What the unit measures with no motor driven is below this; a motor that has been driven needs a moment to be still.
_AT_REST_A = 0.3
_RUN_OUT_S = 3.0
# So long without a high current before the next one is told anew.
_OVER_AFTER_S = 3600.0


class Currents:
    """Whether motor currents are what they should be.

    Parameters
    ----------
    alarm_a
        Current [A] above which a moving axis is hard to move.
    """

    def __init__(self, alarm_a: float) -> None:
        self._alarm_a = alarm_a
        self._since_s: float | None = None
        self._last_s = 0.0
        self.text: str | None = None

    def update(self, telemetry: Telemetry, stands_since_s: float | None) -> None:
        """Take in the newest telemetry; `text` says what is wrong, until an hour without it or `forget`."""
        now_s = telemetry.time_monotonic_s
        text = self._judge(telemetry, stands_since_s)
        if text is None:
            self._since_s = None
            if self.text is not None and now_s - self._last_s > _OVER_AFTER_S:
                self.text = None
            return
        if self._since_s is None:
            self._since_s = now_s
        if now_s - self._since_s >= _LASTS_S:
            self.text, self._last_s = text, now_s

    @property
    def judges(self) -> bool:
        """Whether a current is high, and only has to last."""
        return self._since_s is not None

    def forget(self) -> None:
        """Forget what was told: a person has looked."""
        self.text = self._since_s = None

    def _judge(self, telemetry: Telemetry, stands_since_s: float | None) -> str | None:
        standing = stands_since_s is not None and telemetry.time_monotonic_s - stands_since_s > _RUN_OUT_S
        for name, current_a in (("A", telemetry.a_motor_current_a), ("B", telemetry.b_motor_current_a)):
            if current_a > self._alarm_a:
                return (
                    f"axis {name} draws more than {self._alarm_a:g} A: something is in its way, iced up or worn;"
                    " look at the mechanics"
                )
            if standing and current_a > _AT_REST_A:
                return f"axis {name} draws current although it stands: it is driven against something; look at it"
        return None


def show(
    alarms: Alarms, doubts: Doubts, identity: PositionerIdentity | None, telemetry: Telemetry, currents: Currents
) -> None:
    """Raise and end the alarms that follow from what is known of the positioner."""
    alarms.set("unexplained-motion", doubts.incident_of("motion"))
    alarms.set("deaf-to-stop", doubts.incident_of("deaf"))
    alarms.set("positioner-setup", "; ".join(identity.setup_conflicts) or None if identity else None)
    faults = (*(fault_text(name) for name in telemetry.faults), *doubts.vanished)
    alarms.set("positioner-fault", "; ".join(faults) or None)
    alarms.set("reference", doubts.reference)
    alarms.set("motor-current", currents.text)
