"""One run of the campaign: a schedule carried out on the plant under virtual time, watched all along."""

import asyncio
import gc
import logging
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daemon.base.records import Mode, ModeChange, Move
from daemon.base.timeloop import VirtualTimeLoop, virtual_time
from daemon.rigs.campaign.build import build_plant
from daemon.rigs.campaign.faults import FACE_FAULTS, FAULTS, PROCESS_FAULTS, PlantFault, Value
from daemon.service.operator_commands import COMMANDS_FOR_ALL
from daemon.studies.campaign.command_channel import CommandChannel, DirectCommandChannel, SharedCommandChannel
from daemon.studies.campaign.growth import WARM_AFTER_S, GrowthCheck, LogLine
from daemon.studies.campaign.matrix import refuse_unknown, settings_of
from daemon.studies.campaign.person import WORKING_MODES, Person, known_commands
from daemon.studies.campaign.schedule import Schedule, ScheduledEvent
from daemon.studies.campaign.watch.reporting import Violation
from daemon.studies.campaign.watch.truth import TruthWatch

GUST_S = 1.3
RECOVERS_WITHIN_S = 3000.0
_MEMORY = Path("/dev/shm")  # noqa: S108 - only a place for a directory of our own
_HANDLES = Path("/proc/self/fd")
_ASKED_AGAIN_AFTER = 10
_WARM_RETRY_S = 60.0


@dataclass(frozen=True, slots=True)
class CampaignOutcome:
    """What a run showed.

    Attributes
    ----------
    violations
        Broken promises.
    stop_latencies_s
        How soon the axes stood after each stop in motion.
    lines
        The service's log.
    moves
        How many there were.
    entered_modes
        The modes that were entered, each with its time [s].
    """

    violations: tuple[Violation, ...]
    stop_latencies_s: tuple[float, ...]
    lines: tuple[LogLine, ...]
    moves: int
    entered_modes: tuple[tuple[float, Mode], ...]

    @property
    def broken_promises(self) -> set[str]:
        """The names of the broken promises."""
        return {violation.promise for violation in self.violations}


class CampaignRun:
    """Carries out one schedule.

    Parameters
    ----------
    loop
        With virtual time.
    schedule
        What happens; `UserError` for what simulator or service cannot do.
    directory
        For what the service keeps.
    bounded
        Counts what must not grow.
    door
        Through which the commands go.
    """

    def __init__(
        self, loop: VirtualTimeLoop, schedule: Schedule, directory: Path, bounded: GrowthCheck, door: CommandChannel
    ) -> None:
        refuse_unknown(schedule, known_commands(door))
        self.watches = [TruthWatch() for _ in range(schedule.trackers)]
        self.plant = build_plant(
            loop,
            schedule.begin,
            settings_of(schedule, directory),
            self.watches,
            synchronous=schedule.synchronous,
            sky_w_m2=schedule.sky,
        )
        for mount, watch in zip(self.plant.mounts, self.watches, strict=True):
            watch.attach(mount)
        self._schedule = schedule
        self._door = door
        self._persons = [
            Person(mount, watch, door) for mount, watch in zip(self.plant.mounts, self.watches, strict=True)
        ]
        self._bounded = bounded
        self._fault_tasks: set[asyncio.Task[None]] = set()
        self._lasting_faults: Counter[tuple[str, int, Value]] = Counter()
        loop.set_exception_handler(self._unhandled)

    def _fails(self, promise: str, text: str) -> None:
        self.watches[0].add_violation(promise, text)

    def _unhandled(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        self._fails("defect", f"{context.get('message')}: {context.get('exception')!r}")

    async def carry_out(self, *, heal: bool) -> None:
        """Let everything of the schedule happen; with `heal`, then set everything right and see the tracker work."""
        plant, events = self.plant, list(self._schedule.events)
        while events and events[0].at_s < 0:
            # Before there is a service.
            self._start_event(events.pop(0))
            await asyncio.sleep(0)
        plant.start()
        watching = [asyncio.create_task(watch.run(), name="watch") for watch in self.watches]
        self._warm_timer = asyncio.get_running_loop().call_later(WARM_AFTER_S, self._count_warm_memory)
        try:
            for event in events:
                await asyncio.sleep(max(event.at_s - plant.clock.monotonic(), 0.0))
                self._start_event(event)
            await asyncio.sleep(max(self._schedule.hours * 3600 - plant.clock.monotonic(), 0.0))
            if heal:
                await self._end_all_faults()
                await asyncio.gather(*map(self._check_recovery, self._persons, self.watches))
            self._bounded.check(self._schedule, plant.records, self._fails)
        finally:
            self._warm_timer.cancel()
            await self._end_tasks(watching)

    def _count_warm_memory(self) -> None:
        if self.plant.is_served:
            self._bounded.note_memory_baseline(self.plant.records)
        else:
            # Without a service there would be less in memory than at the end.
            self._warm_timer = asyncio.get_running_loop().call_later(_WARM_RETRY_S, self._count_warm_memory)

    async def _end_tasks(self, watching: "list[asyncio.Task[None]]") -> None:
        plant = self.plant
        acting = {*self._fault_tasks, *plant.commands}
        for task in acting:
            task.cancel()
        await asyncio.gather(*acting, return_exceptions=True)
        if plant.is_served:
            await plant.end()
        for task in watching:
            task.cancel()
        for outcome in await asyncio.gather(*watching, return_exceptions=True):
            if isinstance(outcome, Exception):
                raise outcome
        # A cancelled task needs one more round of the loop to end.
        await asyncio.sleep(0)
        left = [task.get_name() for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        if left:
            self._fails("leak", f"tasks that outlive their service: {left}")

    def _start_event(self, event: ScheduledEvent) -> None:
        shared = event.what == "fault" and FAULTS[event.name].is_shared
        places = range(len(self.watches)) if event.tracker is None and not shared else (event.tracker or 0,)
        # One command for all trackers where the service has such a command, otherwise one for each tracker.
        together = SharedCommandChannel(self._door) if len(places) > 1 and event.name in COMMANDS_FOR_ALL else None
        for place in places:
            if event.what == "command":
                giving = self._persons[place].give(event.name, event.value, together)
                task = asyncio.create_task(giving, name=event.name)
                self.plant.commands.add(task)
            else:
                task = asyncio.create_task(self._fault(event, place), name=event.name)
                self._fault_tasks.add(task)
            task.add_done_callback(self._finish_event)

    def _finish_event(self, task: "asyncio.Task[None]") -> None:
        self.plant.commands.discard(task)
        self._fault_tasks.discard(task)
        if not task.cancelled() and task.exception() is not None:
            self._fails("defect", f"{task.get_name()} ended in {task.exception()!r}")
        for person in self._persons:
            person.check_wishes()

    async def _fault(self, event: ScheduledEvent, place: int) -> None:
        fault, plant = FAULTS[event.name], self.plant
        if event.name in PROCESS_FAULTS and not plant.is_served:
            return
        # Two faces can be faulty at once: each of them ends with its own event.
        face = event.value[:1] if event.name in FACE_FAULTS else ()
        key = event.name, 0 if fault.is_shared else place, face
        mount, watches = plant.mounts[place], self._watches_of_fault(*key[:2])
        for watch in watches:
            _note_fault_begin(watch, event.name, event.value, fault)
        self._lasting_faults[key] += 1
        await _await_if_needed(fault.begin(mount, event.value))
        for watch in watches:
            watch.active_faults += 1
        try:
            await asyncio.sleep(event.lasts_s)
        finally:
            for watch in watches:
                watch.active_faults -= 1
        # Another fault may have silenced the sensor meanwhile, or ended the service.
        served_s = plant.clock.monotonic() - plant.served_since_s
        awake_s = plant.clock.monotonic() - plant.resumed_s
        blew = event.name == "wind" and plant.wind_m_s == event.value[0]
        if blew and GUST_S <= event.lasts_s <= served_s and awake_s >= GUST_S:
            for watch in watches:
                if event.value[0] >= watch.mount.settings.safety.stow_wind_m_s:
                    watch.note_gust()
        self._lasting_faults[key] -= 1
        if fault.end is not None and not self._lasting_faults[key]:
            await _await_if_needed(fault.end(mount, event.value))
            for watch in watches:
                _note_fault_end(watch, event.name, fault)

    def _watches_of_fault(self, name: str, place: int) -> list[TruthWatch]:
        """Return the watches of the trackers to which a fault happens; all others must go on as without the fault."""
        return self.watches if FAULTS[name].is_shared else [self.watches[place]]

    async def _end_all_faults(self) -> None:
        """End whatever still lasts."""
        lasting = [task for task in self._fault_tasks if not task.done()]
        for task in lasting:
            task.cancel()
        await asyncio.gather(*lasting, return_exceptions=True)
        for (name, place, face), count in self._lasting_faults.items():
            fault = FAULTS[name]
            if count and fault.end is not None and name not in PROCESS_FAULTS:
                await _await_if_needed(fault.end(self.plant.mounts[place], face))
                for watch in self._watches_of_fault(name, place):
                    _note_fault_end(watch, name, fault)
        for device in self.plant.plugged:
            self.plant.plug(device, up=True)
        for mount in self.plant.mounts:
            mount.plug(up=True)
        if not self.plant.is_served:
            self.plant.start_new_process()

    async def _check_recovery(self, person: Person, watch: TruthWatch) -> None:
        """Set a tracker right as a person would, with `clear`, `auto` and `home`; then it has to work."""
        mount, begun_s = watch.mount, self.plant.clock.monotonic()
        settings = mount.settings
        within_s = RECOVERS_WITHIN_S + settings.safety.stow_at_least_s + settings.motion.retry_after_s
        for command in ("clear", "auto"):
            await person.give(command)
            await asyncio.sleep(30.0)
        turn = 0
        while mount.clock.monotonic() - begun_s < within_s:
            if turn and turn % _ASKED_AGAIN_AFTER == 0:
                await person.give("clear")
            homed = mount.has_homed(begun_s) or not mount.has_reference_run
            if not mount.motion.homing and not homed:
                # A stow refuses a reference run, so it is asked for until it has been made.
                await person.give("home")
            await asyncio.sleep(60.0)
            turn += 1
            at_rest = not mount.motion.doubt and not mount.motion.moving
            if mount.mode in WORKING_MODES and at_rest and (mount.has_homed(begun_s) or not mount.has_reference_run):
                break
        else:
            text = f"mode {mount.mode}: {mount.control.why} {within_s:g} s after everything was set right"
            watch.add_violation("does-not-recover", text)
            return
        if watch.is_wrong():
            text = f"after a reference run the truth is {mount.truth()}, and the service says {mount.motion.pose}"
            watch.add_violation("believes-a-wrong-count", text)


def _note_fault_begin(watch: TruthWatch, name: str, value: tuple[float, ...], fault: PlantFault) -> None:
    if fault.may_move:
        watch.note_self_motion()
    if name == "deaf":
        watch.note_deafness(is_deaf=True)
    elif name == "clock_step":
        watch.decision_check.steps.note(value[0], watch.now_s)
    if fault.may_lose_counts:
        watch.count_check.excused, watch.count_check.lost_s = True, watch.now_s
    if name.endswith("hall_loss"):
        watch.blind.add("a" if name[0] == "a" else "b")
    if fault.by_hand:
        watch.active_orders.note_button(is_held=True, now_s=watch.now_s)
    if name == "machine_sleeps":
        # A sleep alone justifies no alarm about the unit.
        watch.storms.note_disturbance(watch.now_s)
    else:
        watch.note_disturbance()


def _note_fault_end(watch: TruthWatch, name: str, fault: PlantFault) -> None:
    if fault.may_move:
        watch.note_self_motion()
    if fault.by_hand:
        watch.active_orders.note_button(is_held=False, now_s=watch.now_s)
    if name.endswith("hall_loss"):
        watch.note_hall_pulses_back("a" if name[0] == "a" else "b")
    if name == "deaf":
        watch.note_deafness(is_deaf=False)
    elif name == "clock_step":
        watch.decision_check.steps.note(0.0, watch.now_s)
    watch.note_disturbance()


async def _await_if_needed(result: Any) -> None:
    if result is not None:
        await result


def run_schedule(schedule: Schedule, door: CommandChannel | None = None, *, heal: bool = True) -> CampaignOutcome:
    """Carry out a schedule and return what it showed.

    Parameters
    ----------
    schedule
        What happens; events before 0 s happen before the service starts.
    door
        Through which the commands go; None for calls.
    heal
        Whether everything is set right at the end and the tracker has to work again.

    Raises
    ------
    UserError
        The schedule asks for something that simulator or service cannot do.
    """
    handles = _open_handles()
    # In memory where possible: a run writes too often for a disk.
    with (
        tempfile.TemporaryDirectory(dir=_MEMORY if _MEMORY.is_dir() else None) as folder,
        virtual_time() as runner,
    ):
        loop = runner.get_loop()
        assert isinstance(loop, VirtualTimeLoop)  # noqa: S101 - narrowing; it has just been made
        bounded = GrowthCheck(loop.time)
        with _capture_log(bounded):
            running = CampaignRun(loop, schedule, Path(folder), bounded, door or DirectCommandChannel())
            runner.run(running.carry_out(heal=heal))
    watches, plant = running.watches, running.plant
    left = _open_handles() - handles
    if left > 0:
        watches[0].violations.append(Violation("leak", schedule.hours * 3600, f"{left} files or sockets are left open"))
    return CampaignOutcome(
        violations=tuple(sorted((found for watch in watches for found in watch.violations), key=_at_s)),
        stop_latencies_s=tuple(latency_s for watch in watches for latency_s in watch.stop_latencies_s),
        lines=tuple(bounded.lines),
        moves=sum(isinstance(record, Move) for record in plant.records),
        entered_modes=tuple(
            (record.time_monotonic_s, record.after) for record in plant.records if isinstance(record, ModeChange)
        ),
    )


def _at_s(violation: Violation) -> float:
    return violation.at_s


@contextmanager
def _capture_log(handler: logging.Handler) -> Iterator[None]:
    """Let the service's log go to the handler and nowhere else."""
    logger = logging.getLogger("heliocube")
    level, propagate = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = propagate


def _open_handles() -> int:
    if sys.platform != "linux":
        return 0
    gc.collect()
    return sum(1 for _ in _HANDLES.iterdir())
