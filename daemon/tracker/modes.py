"""The state machine of the tracker: which mode follows from the situation, and why.

Maintenance comes first: people work on the tracker. Then a positioner that cannot move at all, because nothing can be
done; a request to stow stays latched meanwhile and is the first thing carried out after it. A person's stop comes next,
and a person at the unit's buttons, because somebody may be in reach of the axes. Stow pre-empts everything else, homing
and doubts included. The reason also names a stop, a lost positioner or a wanted stow that does not decide the mode.
"""

from dataclasses import dataclass
from enum import Enum, auto

from daemon.base.records import Mode


class DataState(Enum):
    """What the cube's data is good for."""

    FRESH = auto()
    WAITING = auto()
    BAD = auto()


@dataclass(frozen=True, slots=True)
class Situation:
    """Everything that the choice of mode depends on.

    Attributes
    ----------
    connected
        The positioner sends telemetry.
    blocked_why
        Why the positioner can move nothing, or None.
    doubt_why
        Why the positioner may move only to stow, or None.
    homing
        A reference run is on, or was asked for and comes next.
    maintenance_why
        Who works on the tracker, or None.
    stop_why
        Why an operator has stopped the axes, or None.
    buttons_why
        Why somebody counts as being at the unit's buttons, or None.
    stow_why
        The first reason to stow, or None.
    snow_why
        Why an operator wants the snow position, or None.
    hold_why
        Why an operator holds the tracker, or None.
    night_why
        Why it counts as night, or None.
    data, data_why
        Whether the cube's scans can be used, and why, in words.
    """

    connected: bool
    blocked_why: str | None
    doubt_why: str | None
    homing: bool
    maintenance_why: str | None
    stop_why: str | None
    buttons_why: str | None
    stow_why: str | None
    snow_why: str | None
    hold_why: str | None
    night_why: str | None
    data: DataState
    data_why: str


def next_mode(current: Mode, situation: Situation, *, at_stow: bool = False) -> tuple[Mode, str]:
    """Return the mode that the situation calls for, and the reason in words; `at_stow`: a stow would change nothing."""
    s = situation
    lost_why = s.blocked_why or (None if s.connected else "waiting for the positioner")
    done = "the tracker stands there" if at_stow else "not done"
    stow_wanted = None if s.stow_why is None else f"stow is wanted and {done} ({s.stow_why})"
    still_why = s.stop_why or s.buttons_why
    if s.maintenance_why is not None:
        return Mode.MAINTENANCE, _join_reasons(s.maintenance_why, s.stop_why, lost_why, stow_wanted)
    if lost_why is not None:
        return Mode.STARTING if s.blocked_why is None else Mode.FAULT, _join_reasons(lost_why, still_why, stow_wanted)
    if still_why is not None:
        return Mode.HOLD, _join_reasons(still_why, stow_wanted)
    if s.stow_why is not None:
        return Mode.STOW, s.stow_why
    if s.homing:
        return Mode.STARTING, "homing"
    if s.doubt_why is not None:
        return Mode.FAULT, s.doubt_why
    if s.snow_why is not None:
        return Mode.SNOW, s.snow_why
    if s.hold_why is not None:
        return Mode.HOLD, s.hold_why
    if s.night_why is not None:
        return Mode.NIGHT, s.night_why
    if s.data is DataState.FRESH:
        return Mode.TRACKING, s.data_why
    if s.data is DataState.BAD:
        return Mode.FALLBACK, s.data_why
    # Data may yet come. Tracking and fallback go on until then; any other mode waits for it in `starting`.
    return (current if current in (Mode.TRACKING, Mode.FALLBACK) else Mode.STARTING), s.data_why


def _join_reasons(*reasons: str | None) -> str:
    return "; ".join(reason for reason in reasons if reason is not None)
