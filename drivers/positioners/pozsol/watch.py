"""What the positioner's telemetry says, put together over time: the newest look, reference runs, doubts."""

import math
from collections.abc import Callable
from functools import lru_cache

from drivers.errors import LinkLostError, ProtocolError
from drivers.interfaces import AxisName, Telemetry
from drivers.positioners.pozsol.end_switches import AxisBBitDetector, SwitchCheck
from drivers.positioners.pozsol.geometry import AxisSetup
from drivers.positioners.pozsol.homing import AxisObservation, HomingRun
from drivers.positioners.pozsol.link import LinkState
from drivers.positioners.pozsol.reference import LastKnownPositions, Reference
from drivers.positioners.pozsol.table import Value
from drivers.positioners.pozsol.wire import OWN_MOVES, Field, StatusWord, own_moves, parse_status

_DEVICE = "positioner"
AXES: tuple[AxisName, AxisName] = ("a", "b")
FAST_FIELDS = (
    Field.A_ANGLE,
    Field.A_POSITION,
    Field.A_DESTINATION,
    Field.B_ANGLE,
    Field.B_POSITION,
    Field.B_DESTINATION,
)
SLOW_FIELDS = (Field.SUPPLY, Field.STATUS, Field.MODE)
_EXTRA = (Field.A_CURRENT, Field.B_CURRENT, Field.A_REMAIN, Field.B_REMAIN)
_SLOW_STALE_S = 8.0
_JUMP_SHOWS_S = 1.0
# An axis that was out of sight may have run out, or slipped, by less than this.
_UNSEEN_DEG = 2.0
# On a reference run the unit aims so many of its position units inwards of where it is.
_HOMING_AIM_AHEAD, _HOMING_AIM_TOLERANCE = 10.0, 1.0


class PositionerWatch:
    """Makes one `Telemetry` after another of what a line has received.

    Parameters
    ----------
    now
        The service's monotonic time [s].
    setups
        The axes.
    stale_s
        Silence of the fast fields after which the unit counts as lost.
    b_out_bit
        Where the status word has axis B's motion bits; None where that is not known until B has moved.

    Attributes
    ----------
    reference
        What speaks against the count; outlives the link.
    run
        The reference run that is on, if any.
    """

    def __init__(
        self, now: Callable[[], float], setups: dict[AxisName, AxisSetup], stale_s: float, b_out_bit: int | None
    ) -> None:
        self._now = now
        self._setups = setups
        self._stale_s = stale_s
        self._layout = AxisBBitDetector(b_out_bit)
        self.reference = Reference()
        self._last_known = LastKnownPositions()
        self._set_anew = False
        self.run: HomingRun | None = None
        self._run_ended_s = -math.inf
        self._restarted_s: float | None = None
        self._jumped_s: float | None = None
        self._unseen_s: float | None = None
        self._checks: tuple[SwitchCheck, ...] = ()
        self._last: _LookAtRest | None = None
        self.start(None)

    def start(self, restarted_s: float | None) -> None:
        """Begin anew with a fresh connection; the unit restarted at `restarted_s` when it was opened, None if not."""
        self._restarted_s, self._jumped_s, self._unseen_s, self._last = restarted_s, None, None, None
        self._was_out_of_sight = True
        self._checks = tuple(SwitchCheck(axis, self._setups[axis]) for axis in AXES)
        if restarted_s is not None:
            self._set_anew = True
            self.reference.note(f"restart {restarted_s}", "the positioner has restarted")

    def read(self, state: LinkState) -> Telemetry:
        """Return what shows now.

        Raises
        ------
        LinkLostError
            The unit is silent or has restarted.
        ProtocolError
            It sends what cannot be read.
        """
        if state.restarted_s != self._restarted_s:
            self.reference.note(f"restart {state.restarted_s}", "the positioner has restarted")
            raise LinkLostError(_DEVICE, "has restarted: it prints its banner")
        if self._last is not None and self.run is None and self._last.repeats(state):
            return self._last.at(state.as_of_s)
        try:
            telemetry = self._telemetry(state)
        except (KeyError, ValueError) as error:
            raise ProtocolError(_DEVICE, f"sent telemetry that cannot be read: {error}") from error
        at_rest = not any(check.is_pending for check in self._checks)
        self._last = _LookAtRest(state, telemetry) if state.as_of_s > -math.inf and at_rest else None
        return telemetry

    def repeated_s(self, telemetry: Telemetry, state: LinkState) -> float | None:
        """Return the time at which a look would show what this last one did; None where a new look has to be made."""
        last = self._last
        if last is None or last.shown is not telemetry or self.run is not None:
            return None
        return state.as_of_s if last.repeats(state) and state.restarted_s == self._restarted_s else None

    def note_target(self, axis: AxisName, destination: float) -> None:
        """Take note of a target that is about to be sent: should the link be lost, the axis may have gone there."""
        self._last_known.note_target(axis, destination)

    def note_standstill(self) -> None:
        """Take note that both axes stand after a stop, and forget what they were told."""
        self._last_known.forget_targets()

    def begin_reference_run(self, axis: AxisName, before: Telemetry, sent_s: float) -> HomingRun:
        """Watch a reference run from now on; until it has ended well the count is in doubt."""
        start = position_of(axis, before)
        stood, trusted = self._last_known.of(axis, start), not self.reference.doubts(axis)
        if stood is None and f"{axis} before" in self.reference.kinds:
            # A process that died on a reference run has left no place, but the unit may have kept its count.
            stood = start
        self._last_known.note_target(axis, 0.0)
        self.run = HomingRun(axis, self._setups[axis], start, sent_s, trusted=trusted, last_trusted_position=stood)
        return self.run

    def abort_reference_run(self) -> None:
        """Note that the reference run, if one is on, was ended before its end."""
        run, self.run = self.run, None
        if run is not None and run.begun:
            self._last = None
            name = run.axis.upper()
            self.reference.note(f"{run.axis} unfinished", f"the reference run of {name} did not end", run.axis)

    def standing(self) -> tuple[float | None, float | None]:
        """Return where A and B stand by all that is known, in the unit's position units; None where unknown."""
        return self._last_known.worst_case_position("a"), self._last_known.worst_case_position("b")

    def recall(self, places: dict[AxisName, float | None], doubt: str) -> None:
        """Take over where the axes stood before this process began; the count may have been set anew since."""
        self._set_anew = True
        for axis, place in places.items():
            if place is not None:
                self._last_known.recall(axis, place)
            if doubt:
                self.reference.note(f"{axis} before", doubt, axis, stands=place)

    def forgive(self, kinds: tuple[str, ...]) -> None:
        """Forget doubts that a person has seen."""
        self.reference.forgive(kinds)
        self._last = None

    def _telemetry(self, state: LinkState) -> Telemetry:
        known = state.values
        fast = [known[field] for field in FAST_FIELDS]
        time_s = max(min([value.time_s for value in fast]), state.as_of_s)
        status_s = max(known[Field.STATUS].time_s, state.as_of_s)
        self._require_fresh(time_s, max(min([known[field].time_s for field in SLOW_FIELDS]), state.as_of_s))
        text = known[Field.STATUS].text.decode("latin-1")
        position_b = known[Field.B_POSITION].number
        self._layout.update(position_b, time_s, parse_status(text).word, status_s)
        status = parse_status(text, self._layout.bit)
        a, a_at, a_to, b, b_at, b_to = (value.number for value in fast)
        a_amps, b_amps, a_left, b_left = (known[field].number if field in known else math.nan for field in _EXTRA)
        seen: dict[AxisName, AxisObservation] = {
            "a": AxisObservation(
                position=a_at, destination=a_to, remain=a_left, time_s=time_s, status=status, status_s=status_s
            ),
            "b": AxisObservation(
                position=b_at, destination=b_to, remain=b_left, time_s=time_s, status=status, status_s=status_s
            ),
        }
        homing = self._follow_run(seen) or status.homing
        self._note_doubts(state, seen, homing)
        return Telemetry(
            time_monotonic_s=time_s,
            a_deg=a,
            b_deg=b,
            position_a=a_at,
            position_b=b_at,
            destination_a=a_to,
            destination_b=b_to,
            faults=status.faults,
            was_reset=status.was_reset,
            button_pressed=status.button_pressed,
            homing=homing,
            aims_home=any(abs(way - _HOMING_AIM_AHEAD) <= _HOMING_AIM_TOLERANCE for way in (a_at - a_to, b_at - b_to)),
            autonomous=status.autonomous,
            own_moves=_own_moves(tuple(known[code].text if code in known else None for code in OWN_MOVES)),
            reference_doubt=self.reference.text,
            status_monotonic_s=status_s,
            supply_v=known[Field.SUPPLY].number,
            a_motor_current_a=a_amps,
            b_motor_current_a=b_amps,
            details=_details(known[Field.MODE], status, a_left, b_left),
        )

    def _require_fresh(self, fast_s: float, slow_s: float) -> None:
        now_s = self._now()
        for heard_s, most_s in ((fast_s, self._stale_s), (slow_s, max(_SLOW_STALE_S, self._stale_s))):
            if now_s - heard_s > most_s:
                raise LinkLostError(_DEVICE, f"has been silent for {now_s - heard_s:.1f} s")

    def _follow_run(self, seen: dict[AxisName, AxisObservation]) -> bool:
        """Let the reference run see the newest look; return whether one is on."""
        run = self.run
        if run is None:
            return False
        run.update(seen[run.axis])
        if not run.over:
            return run.begun
        self.run, self._run_ended_s = None, self._now()
        if run.failure:
            self.reference.note(f"{run.axis} failed {run.sent_s}", run.failure, run.axis)
            return False
        self.reference.proven(run.axis, travelled=run.travelled)
        stuck = bool(run.mismatch) and not run.travelled
        if stuck and run.last_trusted_position is not None:
            self._last_known.note_stuck_switch(run.axis, run.last_trusted_position, seen[run.axis].position)
        else:
            self._last_known.note_referenced(run.axis)
            if run.position_if_switch_wrong is not None:
                self._last_known.note_contradiction(run.axis, run.position_if_switch_wrong, seen[run.axis].position)
        if run.mismatch:
            # Without travel neither the count nor the switch can be shown to be right.
            needs_travel = stuck or run.position_if_switch_wrong is not None
            kind = f"{run.axis} mismatch {run.sent_s}"
            self.reference.note(
                kind, run.mismatch, run.axis, needs_travel=needs_travel, stands=run.position_if_switch_wrong
            )
        return False

    def _note_doubts(self, state: LinkState, seen: dict[AxisName, AxisObservation], homing: bool) -> None:
        status = seen["a"].status
        if status.was_reset:
            self._set_anew = self._set_anew or "reset" not in self.reference.kinds
            self.reference.note("reset", "the positioner has restarted")
        if state.jumped_s is not None and state.jumped_s != self._jumped_s:
            self._jumped_s = state.jumped_s
            # At the end of a reference run the count is meant to jump.
            if not homing and state.jumped_s > self._run_ended_s + _JUMP_SHOWS_S:
                self._set_anew = True
                self.reference.note(f"jump {state.jumped_s}", "the positioner's count has jumped")
        if state.moved_unseen_s != self._unseen_s:
            self._unseen_s = state.moved_unseen_s
            # A person who holds a button drives an axis to where it was not told to go.
            self._was_out_of_sight = self._was_out_of_sight or not status.button_pressed
        for check in self._checks:
            look = seen[check.axis]
            misfit = check.update(look.position, look.status, look.status_s)
            if misfit and not homing:
                self.reference.note(f"{check.axis} switch", misfit, check.axis, needs_travel=True)
        for axis in AXES:
            position, destination, set_anew = seen[axis].position, seen[axis].destination, self._set_anew
            trusted = not self.reference.doubts(axis)
            if self._was_out_of_sight and not status.autonomous:
                # A restart may have gone unseen: the unit takes its mark back by itself after 15 minutes.
                strayed = self._last_known.stray_text(axis, position, self._setups[axis].units(_UNSEEN_DEG))
                if strayed:
                    self._note_strayed(seen[axis], axis, strayed)
                    trusted, set_anew = False, True
            self._last_known.note(axis, position, destination, trusted=trusted, set_anew=set_anew)
        self._set_anew = self._was_out_of_sight = False

    def _note_strayed(self, look: AxisObservation, axis: AxisName, text: str) -> None:
        if f"{axis} before" in self.reference.kinds:
            # That doubt stands already, with the place of the axis if its end switch has lied.
            return
        # On a closed switch a reference run does not travel, and cannot tell whether count or switch is right.
        stands = self._last_known.worst_case_position(axis) if f"{axis}_low" in look.status.end_switches else None
        self.reference.note(f"{axis} strayed {look.time_s}", text, axis, stands=stands)


def position_of(axis: AxisName, seen: Telemetry) -> float:
    """Return where one axis was seen, in the unit's position units."""
    return seen.position_a if axis == "a" else seen.position_b


@lru_cache(maxsize=64)
def _own_moves(texts: tuple[bytes | None, ...]) -> tuple[str, ...]:
    """Name the settings that are on, from the texts of the fields `OWN_MOVES`, which are the same at every look."""
    shown = zip(OWN_MOVES, texts, strict=True)
    return own_moves({code: text.decode("latin-1").strip() for code, text in shown if text is not None})


def _details(mode: Value, status: StatusWord, a_left: float, b_left: float) -> dict[str, str | float]:
    """Return what people are shown: the mode, closed end switches, the counts at which they were met, a bad memory."""
    found: dict[str, str | float] = {"mode": mode.text.decode("latin-1").strip()}
    if status.end_switches:
        found["end_switches"] = ", ".join(status.end_switches)
    if status.memory_fault:
        found["memory"] = "cannot be read or written"
    for axis, left in (("a", a_left), ("b", b_left)):
        if not math.isnan(left):
            found[f"{axis}_count_at_switch"] = left
    return found


class _LookAtRest:
    """The last look at a unit at rest, which says the same every time."""

    def __init__(self, state: LinkState, telemetry: Telemetry) -> None:
        self._state = state
        self.shown = telemetry

    def repeats(self, state: LinkState) -> bool:
        before = self._state
        return state.values is before.values and state.jumped_s == before.jumped_s

    def at(self, time_s: float) -> Telemetry:
        self.shown = self.shown.with_time(time_s)
        return self.shown
