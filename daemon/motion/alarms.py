"""What motion shows of itself as alarms, and when motor currents are one."""

from daemon.base.alarms.alarms import Alarms
from daemon.motion.doubts import Doubts, fault_text
from drivers.interfaces import PositionerIdentity, Telemetry

_LASTS_S = 2.0
# With no motor driven the unit measures less than this; a motor that was driven needs a moment to run out.
_AT_REST_A = 0.3
_RUN_OUT_S = 3.0
# A motor that has just been switched on shows its current first and then its motion, which is judged elsewhere.
_STARTS_WITHIN_S = 1.0
# Pause between a stop that has not ended the current and the next stop; it doubles each time.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 2.0, 64.0
# After so long without a high current, the next one is reported anew.
_OVER_AFTER_S = 3600.0
# By then the service has switched off a mode that a person switched on at the unit.
_STAYS_ON_S = 15.0
AUTONOMOUS_MODE_TEXT = "a mode of the positioner's own is on: sun tracking, wind or snow"


class Currents:
    """Whether motor currents are what they should be.

    Parameters
    ----------
    alarm_a
        Current [A] above which a moving axis is hard to move.

    Attributes
    ----------
    warnings
        What is wrong with them: a sentence for each axis, and when it was last so [s].
    wants_stop
        A motor is on although its axis stands. Perhaps the last stop was not heard; or the axis moves, and stands only
        by a count that loses its impulses.
    """

    def __init__(self, alarm_a: float) -> None:
        self._alarm_a = alarm_a
        self._since_s: dict[str, float] = {}
        self._driven_since_s: float | None = None
        self._pause_s = _FIRST_PAUSE_S
        self._next_stop_s = float("-inf")
        self.warnings: dict[str, float] = {}
        self.wants_stop = False

    def update(self, telemetry: Telemetry, stands_since_s: float | None) -> None:
        """Take in the newest telemetry; `warnings` keeps what is wrong until an hour without it, or `forget`."""
        now_s = telemetry.time_monotonic_s
        standing = stands_since_s is not None and now_s - stands_since_s > _RUN_OUT_S
        driven = standing and any(current_a > _AT_REST_A for _, current_a in _currents_by_axis(telemetry))
        self._judge_stop(telemetry, driven=driven)
        wrong = [
            text
            for text in (self._current_fault(*each, standing=standing) for each in _currents_by_axis(telemetry))
            if text
        ]
        self._since_s = {text: self._since_s.get(text, now_s) for text in wrong}
        told = self.warnings | {text: now_s for text, since_s in self._since_s.items() if now_s - since_s >= _LASTS_S}
        self.warnings = {text: last_s for text, last_s in told.items() if now_s - last_s <= _OVER_AFTER_S}

    def note_stop(self, now_s: float) -> None:
        """Take note that both axes have been stopped at a monotonic time [s]."""
        if self.wants_stop:
            self.wants_stop = False
            self._next_stop_s = now_s + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, _LONGEST_PAUSE_S)

    @property
    def has_pending_fault(self) -> bool:
        """Whether a current is wrong at present, and will be told if it lasts."""
        return bool(self._since_s)

    @property
    def text(self) -> str | None:
        """All that is told, or None."""
        return "; ".join(self.warnings) or None

    def forget(self) -> None:
        """Forget what was told: a person has looked."""
        self.warnings, self._since_s = {}, {}

    def _judge_stop(self, telemetry: Telemetry, *, driven: bool) -> None:
        now_s = telemetry.time_monotonic_s
        if not driven or telemetry.button_pressed:
            self._driven_since_s, self._pause_s, self.wants_stop = None, _FIRST_PAUSE_S, False
            return
        if self._driven_since_s is None:
            self._driven_since_s = now_s
        self.wants_stop = now_s >= max(self._driven_since_s + _STARTS_WITHIN_S, self._next_stop_s)

    def _current_fault(self, name: str, current_a: float, *, standing: bool) -> str | None:
        if current_a > self._alarm_a:
            return (
                f"axis {name} draws more than {self._alarm_a:g} A: something is in its way, iced up or worn;"
                " look at the mechanics"
            )
        if standing and current_a > _AT_REST_A:
            return (
                f"axis {name} draws current although it stands, and is stopped again: it is driven against"
                " something, or moves without being counted; look at it"
            )
        return None


class AutonomousModeMonitor:
    """Whether a mode of the positioner's own stays on although the service switches it off.

    Attributes
    ----------
    text
        What to tell, or None.
    """

    def __init__(self) -> None:
        self._since_s: float | None = None
        self.text: str | None = None

    def update(self, telemetry: Telemetry) -> None:
        """Take in the newest telemetry."""
        if not telemetry.autonomous:
            self._since_s = self.text = None
        elif self._since_s is None:
            self._since_s = telemetry.time_monotonic_s
        elif telemetry.time_monotonic_s - self._since_s >= _STAYS_ON_S:
            self.text = (
                f"{AUTONOMOUS_MODE_TEXT}; it cannot be switched off from here, and nothing is moved: do it at the unit"
            )


def _currents_by_axis(telemetry: Telemetry) -> tuple[tuple[str, float], tuple[str, float]]:
    return ("A", telemetry.a_motor_current_a), ("B", telemetry.b_motor_current_a)


def update_alarms(
    alarms: Alarms,
    doubts: Doubts,
    identity: PositionerIdentity | None,
    telemetry: Telemetry,
    currents: Currents,
    autonomy: AutonomousModeMonitor,
) -> None:
    """Raise and end the alarms that follow from what is known of the positioner."""
    alarms.set("unexplained-motion", doubts.incident_of("motion"))
    alarms.set("deaf-to-stop", doubts.incident_of("deaf"))
    conflicts = identity.setup_conflicts if identity else ()
    alarms.set("positioner-setup", "; ".join(conflicts) or None, of=conflicts)
    # It is no news that a fault goes away which somebody has seen: both sentences contain its name.
    vanished_faults, own = doubts.vanished_faults, () if autonomy.text is None else (autonomy.text,)
    faults = [*(fault_text(name) for name in telemetry.faults), *vanished_faults.values(), *own]
    alarms.set("positioner-fault", "; ".join(faults) or None, of=(*telemetry.faults, *vanished_faults, *own))
    reference_alarm_text = doubts.reference_alarm_text
    alarms.set(
        "reference", reference_alarm_text, of=() if reference_alarm_text is None else reference_alarm_text.split("; ")
    )
    alarms.set("motor-current", currents.text, of=currents.warnings)
