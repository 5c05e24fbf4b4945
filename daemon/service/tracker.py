"""One tracker: all that belongs to it alone, from its settings to its positioner, its wishes and its alarms."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from random import Random

from daemon.base.alarms.alarms import Alarms
from daemon.base.alarms.kept import AlarmFile
from daemon.base.alarms.kinds import with_tracker_option
from daemon.base.clock import Clock
from daemon.base.clock_watch import ClockWatch
from daemon.base.process import CURRENT_TRACKER
from daemon.base.records import Event, ModeChange, Move, Pose, Record, Scan, tag_with_tracker
from daemon.base.recurrence import LogBudget
from daemon.base.state import StateFolder
from daemon.config.settings import Settings
from daemon.motion.motion import Motion
from daemon.motion.polling import Polling
from daemon.motion.shutdown import stop_and_confirm
from daemon.received.shadow import ActiveTracker, Shadow
from daemon.received.today import FILE_NAME, ReceivedToday
from daemon.service.mode_times import ModeTimes
from daemon.service.rig import Rig, TrackerInstruments
from daemon.service.state_migration import LastStart, last_start_file, last_start_utc_s
from daemon.tracker.control import Control
from daemon.tracker.curves import IvAcquisition
from daemon.tracker.orders import Orders
from daemon.tracker.phase import Phase
from daemon.tracker.pointing import build_pointing, build_shadow
from daemon.tracker.readings import Readings, SharedCache
from daemon.tracker.stow import StowSource, WindStow
from daemon.tracker.stow_watch import SafetyFile, StowWatch
from daemon.tracker.wishes import WishFile
from drivers.errors import DriverHungError
from solar.ephemeris import SunElevation

log = logging.getLogger("heliocube.service")
_commands_log = logging.getLogger("heliocube.operator")

# Of the ground, where the law learns no albedo; the same as the default of laws that are told one.
_ALBEDO = 0.2
_NO_WIND_SOURCE = "no wind source: nothing stows the tracker in a storm"
_NOTHING_KEPT = (
    "store.directory is not set: a restart forgets what persons asked for, a storm and what is in doubt, and no records"
    " are kept"
)
# All positioners connect within this time, and are then looked at, one after the other.
_CONNECT_WITHIN_S = 0.5
# Drivers answer or fail within seconds; without this limit nobody would notice one that does neither.
_HUNG_AFTER_S = 120.0
_LOOKS_MISSED = 3.0
# The unit needs a second or two; systemd waits 15 s for the whole service to end.
_STAND_WITHIN_S = 8.0
# Persons do not give more commands within half a day; of a program's further ones only the number is logged.
_COMMANDS_LOGGED = 50
_SETTLE_EVERY_S = 60.0


class Tracker:
    """A tracker and everything that decides for it; several of them share a process, a clock and a bus, and no more.

    Parameters
    ----------
    name
        What its records, topics and kept state are known by.
    settings
        Its own.
    instruments
        Its own, owned from here on.
    rig
        Whose wind sensor and clock it shares with others.
    clock, random
        Time and randomness for everything inside.
    publish
        Takes its records, which bear its name.
    sun_elevation_deg
        Returns the sun's elevation at a UTC [s], where the tracker stands.
    polling
        How often to poll the positioner.
    stow_sources
        Reasons to stow besides the rig's wind sensor and the operator.
    folder
        Where its state is kept over a restart.
    phase
        When its turn is among the trackers of the process. For the only tracker, a driver that hangs for good ends the
        process.
    common
        What all trackers of the same cube know alike.
    unheard
        Returns why the bridge hears nothing, or what it has refused since the last scan, in words; empty for nothing.
    muted
        Called when its alarms are silenced or heard again.
    hold_why
        Why it is to be held from the start where nobody has asked for anything, or None.
    start_number
        Number of this start among all starts of the service.
    """

    def __init__(
        self,
        name: str,
        settings: Settings,
        instruments: TrackerInstruments,
        rig: Rig,
        clock: Clock,
        random: Random,
        publish: Callable[[Record], None],
        sun_elevation_deg: SunElevation,
        polling: Polling,
        stow_sources: Sequence[StowSource],
        folder: StateFolder,
        *,
        phase: Phase,
        common: SharedCache,
        unheard: Callable[[], str],
        muted: Callable[[], None],
        hold_why: str | None = None,
        start_number: int,
    ) -> None:
        self.name = name
        self.settings = settings
        self.clock = clock
        self.is_only_tracker = phase.trackers == 1
        self.publish = tag_with_tracker(lambda record: publish(self._as_typed(record)), name)
        self.alarms = Alarms(clock, self.publish, muted, AlarmFile(folder))
        self._rig = rig
        self.folder = folder
        self._phase = phase
        sources: list[StowSource] = [*stow_sources]
        if rig.wind_speed_m_s is not None:
            sources.append(WindStow(settings.safety, rig.wind_speed_m_s))
        self.stow_watch = StowWatch(sources, SafetyFile(folder), clock, self.alarms, self._decide_again)
        self.motion = Motion(
            instruments.positioner,
            settings.limits.limits(),
            settings.motion,
            settings.instruments.positioner,
            clock,
            random,
            self._publish_of_motion,
            self._decide_again,
            self.alarms,
            folder,
            polling,
            has_fixed_start_pose=instruments.has_fixed_start_pose,
        )
        self.ran_utc_s = last_start_utc_s(folder) if rig.has_persistent_clock else -math.inf
        self._clock_watch = ClockWatch(clock, self.alarms, rig.clock_synchronised, self.ran_utc_s)
        pointing = build_pointing(settings, clock.utc(), folder, common)
        self.control = Control(
            settings,
            clock,
            self.motion,
            pointing,
            Readings(settings, clock, sun_elevation_deg, pointing.law, unheard, common),
            self.stow_watch,
            Orders(clock, WishFile(folder), hold_why),
            self.publish,
            self.alarms,
            folder,
            self._clock_watch,
            phase,
        )
        self.received = self._build_received_today(FILE_NAME)
        self.shadow = self._build_shadow(common) if settings.law.shadow else None
        self.mode_times = ModeTimes(clock, settings.site.longitude_deg)
        self.is_stop_confirmed = False
        self._start_number = start_number
        self._commands = LogBudget("commands", _COMMANDS_LOGGED)
        self._motion_task: asyncio.Future[None] | None = None
        self._hung_why: str | None = None
        self._seems_hung = False
        self.curves: IvAcquisition | None = None
        if instruments.load is not None:
            self.curves = IvAcquisition(
                settings.load,
                instruments.load,
                clock,
                random,
                self.publish,
                sun_elevation_deg,
                settings.safety.scan_stale_s,
                lambda: self._clock_watch.trusted_now,
            )

    @property
    def log_name(self) -> str:
        """Its name in lines of the log; empty where there is no other tracker."""
        return "" if self.is_only_tracker else self.name

    def _as_typed(self, record: Record) -> Record:
        """Return a record whose words name commands as they are typed for this tracker."""
        if self.is_only_tracker:
            return record
        if isinstance(record, Event):
            return replace(record, text=with_tracker_option(record.text, self.name))
        if isinstance(record, ModeChange | Move):
            return replace(record, why=with_tracker_option(record.why, self.name))
        return record

    def receive(self, scan: Scan, utc_s: float) -> None:
        """Take in a fresh, authentic scan that has come at this UTC [s]; its monotonic times are on our clock."""
        self.control.receive(scan, utc_s)
        if self._clock_watch.trusted:
            pose = self.motion.pose if self.motion.connected else None
            if self.shadow is not None:
                self.shadow.add(scan, self._active_state(pose), utc_s)
            self.received.add(scan, pose, utc_s)

    def _active_state(self, pose: Pose | None) -> ActiveTracker:
        control = self.control
        return ActiveTracker(
            mode=control.mode,
            pose=pose,
            used=control.budget.used,
            received=self.received,
            mean=lambda: control.state.irradiances,
        )

    def _publish_of_motion(self, record: Record) -> None:
        if isinstance(record, Pose):
            record = replace(record, wind_m_s=self.stow_watch.take_gust(), tracker=self.name)
        self.publish(record)

    def _build_received_today(self, file_name: str) -> ReceivedToday:
        settings = self.settings
        place, limits, utc_s = settings.site.place(), settings.limits.limits(), self.clock.utc()
        return ReceivedToday(place, limits, self._albedo, self.folder, utc_s, self._phase, file_name)

    def _build_shadow(self, common: SharedCache) -> Shadow:
        settings, utc_s = self.settings, self.clock.utc()
        law = build_shadow(settings, utc_s, self.folder, common)
        received = self._build_received_today(f"shadow-{law.named.name}-{FILE_NAME}")
        return Shadow(law, settings, received, self.folder, self.publish, utc_s, self._phase)

    def _albedo(self) -> float:
        """Return what is known of the ground; one number for every plane that is compared."""
        learned = getattr(self.control.pointing.law.learned, "albedo", None)
        if learned is None and self.shadow is not None:
            learned = self.shadow.albedo
        return _ALBEDO if learned is None else float(learned)

    def note(self, record: Record) -> None:
        """Take in a record of the bus that concerns it: its own poses and modes, and every scan."""
        if isinstance(record, Pose):
            self.control.note(record)
        elif isinstance(record, ModeChange):
            self.mode_times.note(record)
        elif self.curves is not None:
            self.curves.note(record)

    @property
    def unsaved_state_text(self) -> str | None:
        """What a restart forgets of a real tracker because no folder is set for it, in a sentence, or None."""
        return _NOTHING_KEPT if self.folder.directory is None and not self._is_simulated_here else None

    @property
    def _is_simulated_here(self) -> bool:
        """Whether this process itself simulates the instruments; not a bench, for that key may be set by mistake."""
        return self._rig.simulated and not self.settings.instruments.bench

    def check(self) -> None:
        """Raise the alarms that follow from the settings alone: no source of stow, nowhere to keep anything."""
        before = CURRENT_TRACKER.set(self.log_name)
        try:
            self._check_wind_source()
            self._check_folder()
        finally:
            CURRENT_TRACKER.reset(before)

    def _check_folder(self) -> None:
        """Raise an alarm where a restart would forget all that a real tracker has to keep, and note the start.

        The note shows before the first stop whether the disk works: the folder reports what it could not write.
        """
        self.alarms.set("nothing-kept", self.unsaved_state_text)
        this = LastStart(started_utc_s=self.clock.utc(), version=version("heliocube"), number=self._start_number)
        last_start_file(self.folder).save(this)

    def _check_wind_source(self) -> None:
        """Raise an alarm where nothing would stow a real tracker in a storm."""
        accepted = self.settings.safety.without_wind_source == "accepted"
        if not (self.stow_watch.has_sources or self._is_simulated_here or accepted):
            self.alarms.set("no-wind-source", _NO_WIND_SOURCE)

    def named_coroutines(self) -> Iterator[tuple[str, Awaitable[None]]]:
        """Yield what has to run, each with its name."""
        yield "motion", self._run_with_log_name(self._move())
        yield "control", self._run_with_log_name(self.control.run())
        yield "log of commands", self._run_with_log_name(self._settle_commands())
        if self.stow_watch.has_sources:
            yield "stow", self._run_with_log_name(self.stow_watch.run())
        if self.curves is not None:
            yield "load", self._run_with_log_name(self.curves.run())

    def log_command(self, text: str) -> None:
        """Log a command, whichever way it came; if there are very many, only their number."""
        self._log_commands(self._commands.spend(self.clock.monotonic(), text))

    async def _settle_commands(self) -> None:
        while True:
            await asyncio.sleep(_SETTLE_EVERY_S)
            self._log_commands(self._commands.poll_flood_summary(self.clock.monotonic()))

    def _log_commands(self, line: str) -> None:
        if line:
            _commands_log.info("%s", line)

    async def stop_motion(self) -> None:
        """Stop the axes for good, and say whether telemetry shows them standing."""
        await self._run_with_log_name(self._stop_motion())

    async def _run_with_log_name(self, work: Awaitable[None]) -> None:
        """Do work, in a task of its own, whose lines in the log bear the tracker's name where there are several."""
        if self.log_name:
            CURRENT_TRACKER.set(self.log_name)
        await work

    async def _stop_motion(self) -> None:
        left = await stop_and_confirm(self.motion, self.clock, _STAND_WITHIN_S)
        self.is_stop_confirmed = left is None
        if left is None:
            log.info("motion stopped: telemetry shows both axes standing")
        else:
            log.warning("motion is not known to be stopped: %s", left)

    async def _move(self) -> None:
        try:
            if not self.is_only_tracker:
                await asyncio.sleep(self._phase.delay_s(_CONNECT_WITHIN_S))
            self._motion_task = asyncio.ensure_future(self.motion.run())
            await self._wait_for_motion_end(self._motion_task)
        except Exception as error:
            if self.is_only_tracker:
                raise
            if not isinstance(error, DriverHungError):
                log.exception("the driver of the positioner has failed")
            self._give_up(error)
            await asyncio.Event().wait()

    async def _wait_for_motion_end(self, moving: asyncio.Future[None]) -> None:
        try:
            await moving
        except asyncio.CancelledError:
            if self._hung_why is None:
                raise
            raise DriverHungError("positioner", self._hung_why) from None

    def watch_driver(self) -> None:
        """Give the positioner up if a call of its driver does not return; called every few seconds."""
        telemetry = self.motion.telemetry
        if self._motion_task is None or self._motion_task.done() or telemetry is None:
            self._seems_hung = False
            return
        silent_s = self.clock.monotonic() - telemetry.time_monotonic_s
        longest_s = max(_HUNG_AFTER_S, _LOOKS_MISSED * self.motion.poll_interval_s)
        before, self._seems_hung = self._seems_hung, silent_s > longest_s
        # Right after the whole process stood still, this may come before the first look: the next call decides.
        if before and self._seems_hung:
            self._hung_why = f"a call of its driver has not returned for {silent_s:.0f} s"
            self._motion_task.cancel()

    def _give_up(self, error: Exception) -> None:
        """Leave a positioner that only a new process can connect, so that the other trackers go on."""
        what = str(error) if isinstance(error, DriverHungError) else f"positioner: {type(error).__name__}: {error}"
        sentence = f"{what}: the tracker {self.name} is neither moved nor stowed until the service is restarted"
        log.error("%s", sentence)
        self.motion.give_up(what)
        self.publish(Event(self.clock.utc(), self.clock.monotonic(), "service", sentence))
        self.alarms.set("driver-hung", sentence)

    def _decide_again(self) -> None:
        self.control.decide_again()
