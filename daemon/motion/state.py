"""What motion shows of itself: to control, to operators, and to whoever watches."""

from daemon.base.clock import Clock
from daemon.base.reconnect import Outage
from daemon.base.records import Move, Pose, Target
from daemon.motion.alarms import AUTONOMOUS_MODE_TEXT
from daemon.motion.doubts import fault_text
from daemon.motion.guard import Guard
from daemon.motion.retry import Retries
from daemon.motion.runs import Mover
from drivers.errors import RefusedError
from drivers.interfaces import PositionerIdentity, Telemetry


class MotionState:
    """The readable side of `daemon.motion.motion.Motion`.

    Parameters
    ----------
    guard, runs, retries, outage, clock
        What it is read from.
    """

    def __init__(self, guard: Guard, runs: Mover, retries: Retries, outage: Outage, clock: Clock) -> None:
        self._guard = guard
        self._runs = runs
        self._retries = retries
        self._clock = clock
        self.outage = outage

    @property
    def telemetry(self) -> Telemetry | None:
        """The newest look, None while the link is down."""
        return self._guard.telemetry

    @property
    def pose(self) -> Pose | None:
        """Where the tracker was seen last."""
        return self._guard.pose

    @property
    def identity(self) -> PositionerIdentity | None:
        """Identity of the unit that is or was connected last."""
        return self._guard.identity

    @property
    def target(self) -> Target | None:
        """Target of the move that is on."""
        return self._runs.target

    @property
    def heading(self) -> Target | None:
        """Target of the move that is on; None while that move is being ended."""
        return None if self._runs.is_interrupted() else self._runs.target

    @property
    def last_move(self) -> Move | None:
        """The move that ended last."""
        return self._runs.last_move

    @property
    def last_move_started_s(self) -> float:
        """Monotonic time at which the latest move began."""
        return self._runs.last_move_started_s

    @property
    def last_homed_started_s(self) -> float:
        """Monotonic time at which the latest reference run began that has ended well."""
        return self._runs.last_homed_started_s

    @property
    def homing(self) -> bool:
        """Whether a reference run of ours is on."""
        return self._guard.homing

    @property
    def unexplained_motion(self) -> str | None:
        """Why nothing moves, not even to stow, after motion without an order or against a stop, or None."""
        return self._guard.unexplained_motion

    @property
    def blocked(self) -> str | None:
        """Why nothing at all can be moved, or None; also None before the first contact."""
        telemetry = self._guard.telemetry_as_read
        if telemetry is None:
            return self.outage.reason if self.outage.is_down else None
        if self.unexplained_motion:
            return self.unexplained_motion
        if self.identity is not None and self.identity.setup_conflicts:
            return "; ".join(self.identity.setup_conflicts)
        if telemetry.faults:
            return f"the positioner reports {', '.join(telemetry.faults)}"
        if telemetry.autonomous:
            return AUTONOMOUS_MODE_TEXT
        return None

    @property
    def doubt(self) -> str | None:
        """Why only a stow may be ordered though the axes could move, or None."""
        if self._guard.doubts.reference:
            return self._guard.doubts.reference
        if self._retries.due_s(stow=False) > self._clock.monotonic():
            return self._retries.text
        return None

    @property
    def concerns(self) -> tuple[str, ...]:
        """Every fault and doubt that is shown at present; `clear_faults` forgives those that a person was shown."""
        telemetry = self._guard.telemetry_as_read
        faults = telemetry.faults if telemetry else ()
        failed = (self._retries.text,) if self._retries.text else ()
        conflicts = self.identity.setup_conflicts if self.identity else ()
        return (*(fault_text(name) for name in faults), *self._guard.doubts.texts, *failed, *conflicts)

    @property
    def connected(self) -> bool:
        """Whether telemetry is coming in."""
        return self._guard.telemetry_as_read is not None

    @property
    def moving(self) -> bool:
        """Whether a move or a homing run is on."""
        return self.target is not None or self.homing

    @property
    def was_at_rest(self) -> bool:
        """Whether the tracker stood, with nothing ordered, when it was seen last."""
        return self._guard.rest_pose is not None

    @property
    def is_button_pressed(self) -> bool:
        """Whether a button is pressed at the unit, by its latest status: somebody is there."""
        telemetry = self._guard.telemetry_as_read
        return telemetry is not None and telemetry.button_pressed

    @property
    def stands_since_s(self) -> float | None:
        """Monotonic time since which telemetry has shown both axes unmoved; None: moving, or not known."""
        return self._guard.stands_since_s

    def _readiness(self) -> tuple[bool, bool]:
        return self.connected and self.blocked is None and self.doubt is None, self.is_button_pressed

    def _refuse_frozen(self) -> None:
        if self._guard.frozen is not None:
            raise RefusedError("positioner", self._guard.frozen)
        if self.is_button_pressed:
            raise RefusedError("positioner", "a button is pressed at the unit: somebody is there")
