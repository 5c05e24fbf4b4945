"""One run of the campaign: a schedule carried out on the plant under virtual time, watched all along."""

import asyncio
import inspect
import logging
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

from daemon.base.timeloop import VirtualTimeLoop
from tests.campaign.doors import DOORS
from tests.campaign.faults import FAULTS, refuse_unknown
from tests.campaign.person import WORKS, Person, known
from tests.campaign.plant import LogLines, build
from tests.campaign.watch import Violation, Watch

GUST_S = 1.3
LINES_OF_AN_OUTAGE = 50
LINES_OF_A_COMMAND = 8
RECOVERS_WITHIN_S = 3000.0
MEMORY = Path("/dev/shm")
PROCESS = ("kill", "kill_torn", "end")
_ROUTINE = ("moving", "staying")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run showed: broken promises, how soon stops stood [s], and the service's log lines."""

    violations: tuple[Violation, ...]
    stop_latencies_s: tuple[float, ...]
    lines: tuple[tuple[float, str, str, str], ...]
    moves: int
    modes: Counter

    @property
    def promises(self):
        return {violation.promise for violation in self.violations}


class Run:
    """Carries out one schedule."""

    def __init__(self, loop, schedule, directory, lines, door):
        self.schedule = schedule
        self.watch = Watch()
        self.plant = build(loop, schedule, directory, self.watch)
        self.person = Person(self.plant, self.watch, door)
        self._lines = lines
        self._acting = set()
        self._lasting = Counter()
        loop.set_exception_handler(self._unhandled)
        refuse_unknown(schedule, known(door))

    def _unhandled(self, loop, context):
        self.watch.fails("defect", f"{context.get('message')}: {context.get('exception')!r}")

    async def carry_out(self, *, heal):
        """Let everything of the schedule happen; with `heal` set everything right and see the tracker work again."""
        plant, events = self.plant, list(self.schedule.events)
        while events and events[0].at_s < 0:
            # Before there is a service.
            self._act(events.pop(0))
            await asyncio.sleep(0)
        plant.start()
        watching = asyncio.create_task(self.watch.run(), name="watch")
        try:
            for event in events:
                await asyncio.sleep(max(event.at_s - plant.clock.monotonic(), 0.0))
                self._act(event)
            await asyncio.sleep(max(self.schedule.hours * 3600 - plant.clock.monotonic(), 0.0))
            if heal:
                await self._set_right()
                await self._see_it_work()
            self._count_lines()
        finally:
            acting = {*self._acting, *plant.commands}
            for task in acting:
                task.cancel()
            await asyncio.gather(*acting, return_exceptions=True)
            if plant.is_served:
                await plant.end()
            watching.cancel()
            outcomes = await asyncio.gather(watching, return_exceptions=True)
            if isinstance(outcomes[0], Exception):
                raise outcomes[0]

    def _act(self, event):
        if event.what == "command":
            task = asyncio.create_task(self.person.give(event.name, event.value), name=event.name)
            self.plant.commands.add(task)
        else:
            task = asyncio.create_task(self._fault(event), name=event.name)
            self._acting.add(task)
        task.add_done_callback(self._acted)

    def _acted(self, task):
        self.plant.commands.discard(task)
        self._acting.discard(task)
        if not task.cancelled() and task.exception() is not None:
            self.watch.fails("defect", f"{task.get_name()} ended in {task.exception()!r}")

    async def _fault(self, event):
        fault, plant = FAULTS[event.name], self.plant
        if event.name in PROCESS and not plant.is_served:
            return
        self._note(event.name, fault)
        self._lasting[event.name] += 1
        await _called(fault.begin, plant, event.value)
        await asyncio.sleep(event.lasts_s)
        # Another fault may have taken the sensor away meanwhile, or the service.
        heard_s = plant.clock.monotonic() - plant.served_since_s
        if event.name == "wind" and plant.wind_m_s == event.value[0] and GUST_S <= event.lasts_s <= heard_s:
            self.watch.gust()
        self._lasting[event.name] -= 1
        if fault.end is not None and not self._lasting[event.name]:
            await _called(fault.end, plant, event.value)
            self._note_end(event.name, fault)

    def _note(self, name, fault):
        if fault.moves:
            self.watch.moves_itself()
        if name == "deaf":
            self.watch.deaf(is_deaf=True)
        elif name == "clock_step":
            self.watch.clock_steps()
        if fault.uncounts:
            self.watch.reference_excused = True
        if name.endswith("hall_loss"):
            self.watch.blind.add(name[0])
        if fault.by_hand:
            self.watch.explained.held(is_held=True, now=self.plant.clock.monotonic())
        self.watch.disturbs()

    def _note_end(self, name, fault):
        if fault.moves:
            self.watch.moves_itself()
        if fault.by_hand:
            self.watch.explained.held(is_held=False, now=self.plant.clock.monotonic())
        if name.endswith("hall_loss"):
            self.watch.blind.discard(name[0])
        if name == "deaf":
            self.watch.deaf(is_deaf=False)
        self.watch.disturbs()

    async def _set_right(self):
        """End whatever still lasts."""
        lasting = [task for task in self._acting if not task.done()]
        for task in lasting:
            task.cancel()
        await asyncio.gather(*lasting, return_exceptions=True)
        for name, count in self._lasting.items():
            fault = FAULTS[name]
            if count and fault.end is not None and name not in PROCESS:
                await _called(fault.end, self.plant, next(e.value for e in self.schedule.events if e.name == name))
                self._note_end(name, fault)
        for device in self.plant.plugged:
            self.plant.plug(device, up=True)
        if not self.plant.is_served:
            self.plant.renew()

    async def _see_it_work(self):
        """A person sets the tracker right with the commands there are, and homes it; it has to work again then."""
        plant, begun_s = self.plant, self.plant.clock.monotonic()
        for command in ("clear", "auto"):
            await self.person.give(command)
            await asyncio.sleep(30.0)
        turn = 0
        while plant.clock.monotonic() - begun_s < RECOVERS_WITHIN_S:
            if turn and turn % 10 == 0:
                await self.person.give("clear")
            if not plant.motion.homing and not plant.has_homed(begun_s):
                # Under a stow it is refused, so it is asked for until it has been made.
                await self.person.give("home")
            await asyncio.sleep(60.0)
            turn += 1
            at_rest = not plant.motion.doubt and not plant.motion.moving
            if plant.mode in WORKS and at_rest and plant.has_homed(begun_s):
                break
        else:
            text = f"mode {plant.mode}: {plant.control.why} {RECOVERS_WITHIN_S:g} s after everything was set right"
            self.watch.fails("does-not-recover", text)
            return
        if self.watch.is_wrong():
            text = f"after a reference run the truth is {plant.truth()}, and the service says {plant.motion.pose}"
            self.watch.fails("believes-a-wrong-count", text)

    def _count_lines(self):
        """Hold the log of each hour against what happened in it."""
        told, happened = Counter(), Counter()
        for at_s, _, _, text in self._lines.lines:
            if text not in _ROUTINE:
                told[int(at_s // 3600)] += 1
        for event in self.schedule.events:
            if event.what == "command":
                happened[int(event.at_s // 3600)] += LINES_OF_A_COMMAND
                continue
            for hour in range(int(event.at_s // 3600), int((event.at_s + event.lasts_s) // 3600) + 1):
                happened[hour] += LINES_OF_AN_OUTAGE
        for hour, count in told.items():
            allowed = happened[hour] + LINES_OF_AN_OUTAGE
            if count > allowed and hour < self.schedule.hours:
                texts = Counter(text for at_s, _, _, text in self._lines.lines if int(at_s // 3600) == hour)
                text = f"{count} lines in hour {hour}, {allowed} allowed; most: {texts.most_common(3)}"
                self.watch.fails("log", text)


async def _called(call, *arguments):
    result = call(*arguments)
    if inspect.isawaitable(result):
        await result


def run(schedule, door=DOORS["direct"], *, heal=True):
    """Carry out a schedule and return what it showed.

    Parameters
    ----------
    schedule
        What happens; events before 0 s happen before the service starts.
    door
        Through which the commands go.
    heal
        Whether everything is set right at the end and the tracker has to work again.

    Raises
    ------
    CannotDoError
        The schedule asks for something that simulator or service cannot do.
    """
    logger = logging.getLogger("heliocube")
    # In memory where there is such a place: a run writes more often than a disk likes.
    with (
        tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder,
        asyncio.Runner(loop_factory=VirtualTimeLoop) as runner,
    ):
        loop = runner.get_loop()
        lines = LogLines(loop.time)
        level, propagate = logger.level, logger.propagate
        logger.addHandler(lines)
        logger.setLevel(logging.INFO)
        logger.propagate = False
        try:
            running = Run(loop, schedule, Path(folder), lines, door)
            runner.run(running.carry_out(heal=heal))
        finally:
            logger.removeHandler(lines)
            logger.setLevel(level)
            logger.propagate = propagate
    watch, plant = running.watch, running.plant
    kinds = Counter(type(record).__name__ for record in plant.records)
    modes = Counter(record.after for record in plant.records if type(record).__name__ == "ModeChange")
    return Outcome(tuple(watch.violations), tuple(watch.stop_latencies_s), tuple(lines.lines), kinds["Move"], modes)


def reduce(schedule, promises, again=run):
    """Return the schedule without all events that are not needed to break one of these promises."""
    events, at = list(schedule.events), 0
    while at < len(events):
        fewer = replace(schedule, events=tuple(events[:at] + events[at + 1 :]))
        if again(fewer).promises & promises:
            events = list(fewer.events)
        else:
            at += 1
    return replace(schedule, events=tuple(events))
