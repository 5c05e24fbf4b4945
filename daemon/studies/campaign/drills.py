"""One fault at a time: how soon the tracker is in the mode that is declared for it, and how soon it works again."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from daemon.base.records import Mode
from daemon.studies.campaign.person import WORKING_MODES
from daemon.studies.campaign.run import CampaignOutcome
from daemon.studies.campaign.schedule import Schedule, ScheduledEvent

Phase = Literal["at rest", "in mid-move"]

FAULT, HOLD, STOW, FALLBACK, STARTING = (
    (Mode.FAULT,),
    (Mode.HOLD,),
    (Mode.STOW,),
    (Mode.FALLBACK,),
    (Mode.STARTING,),
)
_BEGINS_S: dict[Phase, tuple[float, ...]] = {
    # The slow screens take 3.24 s to come round, and control decides every 5 s.
    "at rest": (300.0, 301.7, 303.1),
    # Within the first move after the start, which takes a minute and a half.
    "in mid-move": (45.0, 51.6, 58.2),
}
_PERSON_COMES_AFTER_S = 20.0
_NEXT_COMMAND_S, _HOMES_WITHIN_S = 10.0, 250.0
WATCH_AFTER_RECOVERY_S = 120.0
"""How long a run goes on after the tracker should work again."""


@dataclass(frozen=True, slots=True)
class Drill:
    """A fault alone, and what is declared for it.

    Attributes
    ----------
    fault, value, lasts_s
        As in a schedule.
    mode
        The tracker has to be in one of these; empty: it keeps its mode.
    within_s
        How soon after the fault began.
    commands
        What a person has to say before the tracker works again, from 20 s after the fault is over; empty: nothing.
    recovery_s
        How soon the tracker works again, after the fault is over or after the last of these commands.
    phase
        Whether the axes stand when the fault begins.
    positioner
        Driver of the positioner that has the fault.
    """

    fault: str
    value: tuple[float, ...]
    lasts_s: float
    mode: tuple[Mode, ...]
    within_s: float
    commands: tuple[str, ...]
    recovery_s: float
    phase: Phase
    positioner: Literal["pozsol", "rotctld"] = "pozsol"

    def schedules(self) -> Iterator[Schedule]:
        """Yield the drill's runs."""
        for seed, begin_s in enumerate(_BEGINS_S[self.phase]):
            events = [
                ScheduledEvent(at_s=begin_s, what="fault", name=self.fault, value=self.value, lasts_s=self.lasts_s),
                *(
                    ScheduledEvent(at_s, "command", name)
                    for at_s, name in timed_commands(self.commands, begin_s + self.lasts_s)
                ),
            ]
            ends_s = events[-1].at_s + self.lasts_s + self.recovery_s + WATCH_AFTER_RECOVERY_S
            yield replace(drill_schedule(events, ends_s, seed), positioner=self.positioner)

    def measure(self, schedules: Sequence[Schedule], outcomes: Sequence[CampaignOutcome]) -> "WorstSeen":
        """Return the worst of its runs."""
        reached, back, broken = [], [], []
        for schedule, outcome in zip(schedules, outcomes, strict=True):
            begin_s = schedule.events[0].at_s
            over_s = schedule.events[-1].at_s if self.commands else begin_s + self.lasts_s
            reached.append(_time_to_mode_s(outcome, self.mode, begin_s) if self.mode else 0.0)
            back.append(time_to_recovery_s(outcome, over_s))
            broken += [violation.promise for violation in outcome.violations]
        return WorstSeen(max(reached), max(back), tuple(sorted(set(broken))), len(outcomes))


@dataclass(frozen=True, slots=True)
class WorstSeen:
    """The worst of the runs of a drill or of a pair [s]; infinite where it did not happen.

    Attributes
    ----------
    reached_s, recovery_s
        From the fault (of a pair: the second one) to the declared mode; from its end, or from the last command, until
        the tracker works again.
    broken
        Promises that were broken.
    runs
        How many there were.
    """

    reached_s: float
    recovery_s: float
    broken: tuple[str, ...]
    runs: int


def describe_exceeded_bounds(
    name: str, modes: str, within_s: float, recovery_s: float, seen: WorstSeen
) -> Iterator[str]:
    """Yield a sentence for each thing that was worse than declared."""
    if not seen.reached_s <= within_s:
        yield f"{name}: {modes} after {seen.reached_s:.1f} s, {within_s:g} s are declared"
    if not seen.recovery_s <= recovery_s:
        yield f"{name}: back after {seen.recovery_s:.1f} s, {recovery_s:g} s are declared"
    for promise in seen.broken:
        yield f"{name}: breaks {promise}"


def drill_schedule(events: Sequence[ScheduledEvent], ends_s: float, seed: int = 0) -> Schedule:
    """Return a clear morning with these events, over at `ends_s`."""
    return Schedule(
        seed=seed,
        hours=ends_s / 3600,
        start="2022-10-12T10:00",
        law="mu-prime",
        rehome="operator",
        synchronous=False,
        sky=(700.0, 90.0),
        events=tuple(events),
    )


def timed_commands(commands: Sequence[str], over_s: float) -> Iterator[tuple[float, str]]:
    """Yield time [s] and name of each command of a person, who comes after all faults are over at `over_s`."""
    at_s = over_s + _PERSON_COMES_AFTER_S
    for name in commands:
        yield at_s, name
        at_s += _HOMES_WITHIN_S if name == "home" else _NEXT_COMMAND_S


def _time_to_mode_s(outcome: CampaignOutcome, modes: tuple[Mode, ...], begin_s: float) -> float:
    """Return how long after `begin_s` one of the modes was entered, infinite for never."""
    return next(
        (at_s - begin_s for at_s, mode in outcome.entered_modes if at_s >= begin_s and mode in modes), float("inf")
    )


def time_to_recovery_s(outcome: CampaignOutcome, over_s: float) -> float:
    """Return how long after `over_s` the tracker began to work for good, infinite for never."""
    works_s = float("inf")
    for at_s, mode in outcome.entered_modes:
        if mode not in WORKING_MODES:
            works_s = float("inf")
        elif works_s == float("inf"):
            works_s = max(at_s - over_s, 0.0)
    return works_s
