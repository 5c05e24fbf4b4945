"""Two faults at once: what is declared for each alone has to hold for both together, and the stronger mode wins."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

from daemon.base.records import Mode
from daemon.rigs.campaign.faults import PROCESS_FAULTS
from daemon.studies.campaign.drills import (
    FALLBACK,
    FAULT,
    HOLD,
    STOW,
    WATCH_AFTER_RECOVERY_S,
    Drill,
    Phase,
    WorstSeen,
    describe_exceeded_bounds,
    drill_schedule,
    time_to_recovery_s,
    timed_commands,
)
from daemon.studies.campaign.many import run_all
from daemon.studies.campaign.person import WORKING_MODES
from daemon.studies.campaign.run import CampaignOutcome
from daemon.studies.campaign.schedule import Schedule, ScheduledEvent
from daemon.studies.spread.workers import Workers

# At rest the second comes while the first is dealt with; in mid-move before the first has ended the move.
_BEGINS_S: dict[Phase, float] = {"at rest": 300.0, "in mid-move": 45.0}
_SECOND_AFTER_S: dict[Phase, float] = {"at rest": 7.0, "in mid-move": 0.2}
# A person's hold or a stow may come before the move that would show a fault of one axis: then either mode is right.
_MODES_BY_STRENGTH = (
    ({*HOLD}, {*HOLD, *FAULT}),
    ({*STOW}, {*STOW, *FAULT}),
    ({*FAULT}, {*FAULT}),
    ({*FALLBACK}, {*FALLBACK}),
)
# Only a move shows these, and without readings there may be none.
_SHOWN_BY_A_MOVE = frozenset(("deaf", "undervoltage", "a_ignores_targets", "a_hall_loss", "b_hall_loss"))
_PROCESS_FAULTS = frozenset((*PROCESS_FAULTS, "suspended"))
_HIDING_FAULTS = _PROCESS_FAULTS | {"unplug_positioner", "positioner_silent"}
_HOMES_MOST = 3
_LEAVE_NO_MARK = ("a_slip", "b_slip", "a_switch_closed", "b_switch_closed")
_NO_PAIRS = (
    _PROCESS_FAULTS,
    {"a_switch_open", "a_switch_closed"},
    {"b_switch_open", "b_switch_closed"},
    {"clock_step", "suspended"},
    *({missed, process} for missed in _LEAVE_NO_MARK for process in _PROCESS_FAULTS),
)

LEFT_OUT = (
    "These pairs are left out: two faults of the one process; the same switch open and closed; a fault that leaves no\n"
    "mark in the unit (a count that slips, a switch closed for 10 s) while no process is there to see it; a process\n"
    "that stands still while the clock is set, because it then waits to hear the wind, and readings come meanwhile;\n"
    "and every fault that only a rotator has. A fault that only a move can show may stay unseen until there is a move."
)
"""Which pairs are not tried, as the page says it."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Two drills of the same phase, the second begun while the first lasts.

    Attributes
    ----------
    first, second
        What is declared for each alone.
    """

    first: Drill
    second: Drill

    @property
    def modes(self) -> frozenset[Mode]:
        """The modes of which the tracker has to be in one: working modes only where both faults let it work."""
        declared = {*self.first.mode, *self.second.mode}
        if declared == {*FAULT, *FALLBACK} and any(one.fault in _SHOWN_BY_A_MOVE for one in (self.first, self.second)):
            return frozenset(declared)
        return frozenset(next((allowed for asked, allowed in _MODES_BY_STRENGTH if asked & declared), WORKING_MODES))

    @property
    def within_s(self) -> float:
        """How soon after the second fault began [s]; longer if the service is away and sees nothing meanwhile."""
        bounds = self.first.within_s, self.second.within_s
        return sum(bounds) if self._fault_names & _PROCESS_FAULTS else max(bounds)

    @property
    def recovery_s(self) -> float:
        """How soon it works again after faults and commands [s]: one fault may be found after the other is gone."""
        return self.first.recovery_s + self.second.recovery_s

    @property
    def commands(self) -> tuple[str, ...]:
        """The commands that a person has to give: those that either fault asks for.

        A homing that finds a count wrong reports one axis only, so it is repeated while a count is in doubt.
        """
        asked = {*self.first.commands, *self.second.commands}
        hidden = (asked and self._fault_names & _HIDING_FAULTS) or {"auto", "home"} <= asked
        if hidden or "deaf" in self._fault_names:
            asked.add("clear")
        said: list[str] = [name for name in ("auto", "clear") if name in asked]
        if "home" in asked:
            said += ["home"] * (_HOMES_MOST if "clear" in asked else 1)
        return tuple(said)

    @property
    def _fault_names(self) -> set[str]:
        return {self.first.fault, self.second.fault}

    @property
    def _begins_s(self) -> tuple[float, float]:
        begin_s = _BEGINS_S[self.first.phase]
        return begin_s, begin_s + _SECOND_AFTER_S[self.first.phase]

    @property
    def _both_over_s(self) -> float:
        """When both are over and seen, and a storm has passed: a person comes then."""
        return max(
            begin_s + max(one.lasts_s, one.within_s) + (one.recovery_s if one.mode == STOW and self.commands else 0.0)
            for begin_s, one in zip(self._begins_s, (self.first, self.second), strict=True)
        )

    def schedule(self) -> Schedule:
        """Return the pair's run."""
        events = [
            ScheduledEvent(at_s=begin_s, what="fault", name=one.fault, value=one.value, lasts_s=one.lasts_s)
            for begin_s, one in zip(self._begins_s, (self.first, self.second), strict=True)
        ]
        said = [
            ScheduledEvent(at_s, "command", name) for at_s, name in timed_commands(self.commands, self._both_over_s)
        ]
        ends_s = (said[-1].at_s if said else self._both_over_s) + self.recovery_s + WATCH_AFTER_RECOVERY_S
        return drill_schedule([*events, *said], ends_s)

    def measure(self, schedule: Schedule, outcome: CampaignOutcome) -> WorstSeen:
        """Return what its run showed."""
        begun_s = self._begins_s[1]
        over_s = schedule.events[-1].at_s if self.commands else self._both_over_s
        reached_s = _time_to_modes_s(outcome, self.modes, begun_s)
        broken = tuple(sorted({violation.promise for violation in outcome.violations}))
        return WorstSeen(reached_s, time_to_recovery_s(outcome, over_s), broken, 1)

    def exceeded_bounds(self, seen: WorstSeen) -> Iterator[str]:
        """Yield a sentence for each thing that was worse than declared."""
        name = f"{self.first.fault} and {self.second.fault} {self.first.phase}"
        yield from describe_exceeded_bounds(name, self.name_modes(), self.within_s, self.recovery_s, seen)

    def name_modes(self) -> str:
        """Return the modes for people."""
        return "works on" if self.modes == frozenset(WORKING_MODES) else " or ".join(sorted(self.modes))


def declared_pairs(drills: Iterable[Drill]) -> list[Pair]:
    """Return every two drills of the same phase, except those in `_NO_PAIRS` and those of a rotator."""
    return [
        Pair(first, second)
        for first, second in combinations(drills, 2)
        if first.phase == second.phase
        and first.positioner == second.positioner == "pozsol"
        and first.fault != second.fault
        and not any({first.fault, second.fault} <= left_out for left_out in _NO_PAIRS)
    ]


def measure_pairs(pairs: Sequence[Pair], workers: Workers, progress: Callable[[float], None]) -> list[WorstSeen]:
    """Return what each pair's run showed."""
    schedules = [pair.schedule() for pair in pairs]
    outcomes = run_all(schedules, workers, progress)
    return [pair.measure(one, seen) for pair, one, seen in zip(pairs, schedules, outcomes, strict=True)]


def pair_rows(pairs: Sequence[Pair], seen: Sequence[WorstSeen]) -> Iterator[str]:
    """Yield a row of a table for each set of modes: how many pairs, the largest bounds, the worst that was seen."""
    for modes in dict.fromkeys(pair.name_modes() for pair in pairs):
        some = [(pair, found) for pair, found in zip(pairs, seen, strict=True) if pair.name_modes() == modes]
        within_s, reached_s = max(pair.within_s for pair, _ in some), max(found.reached_s for _, found in some)
        recovery_s, worst_back_s = max(pair.recovery_s for pair, _ in some), max(found.recovery_s for _, found in some)
        yield f"{modes} | {len(some)} | {within_s:g} s | {reached_s:.1f} s | {recovery_s:g} s | {worst_back_s:.1f} s"


def _time_to_modes_s(outcome: CampaignOutcome, modes: frozenset[Mode], begun_s: float) -> float:
    """Return how long after `begun_s` the tracker first was in one of the modes, infinite for never."""
    before = [mode for at_s, mode in outcome.entered_modes if at_s <= begun_s]
    if before and before[-1] in modes:
        return 0.0
    return next(
        (at_s - begun_s for at_s, mode in outcome.entered_modes if at_s > begun_s and mode in modes), float("inf")
    )
