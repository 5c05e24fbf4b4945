"""The running service: which parts a role consists of, how they start, and how they stop."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping, Sequence
from pathlib import Path
from random import Random
from types import MappingProxyType
from typing import Any

from daemon.base.alarms.alarms import Alarms
from daemon.base.alarms.kept import CUBE_FILE_NAME, AlarmFile
from daemon.base.clock import Clock
from daemon.base.clock_watch import ClockWatch
from daemon.base.errors import UserError
from daemon.base.process import SystemdNotifier
from daemon.base.records import Bus, Event, Scan
from daemon.base.sleeps import SleepWatch
from daemon.base.state import StateFolder
from daemon.bridge.receiver import BridgeReceiver
from daemon.bridge.sender import BridgeSender, pack
from daemon.config.settings import Settings
from daemon.cube.acquisition import Acquisition
from daemon.cube.calibration import CubeCalibration, ExpiryWatch, calibrated_cube
from daemon.cube.face_alarms import RemoteFaceAlarm, UnreadFaceAlarm
from daemon.cube.face_watch import FaceWatch
from daemon.motion.polling import OFTEN, Polling
from daemon.service.health import LoopWatch, Watchdog
from daemon.service.rig import Rig, Role
from daemon.service.state_migration import migrate_state_to_trackers, next_start_number, orphaned_state_text
from daemon.service.tracker import Tracker
from daemon.tracker.phase import Phase
from daemon.tracker.readings import SharedCache
from daemon.tracker.stow import StowSource
from drivers.errors import DriverHungError
from solar.ephemeris import SunElevation

log = logging.getLogger("heliocube.service")


class Service:
    """One process of heliocube in one role.

    Parameters
    ----------
    settings, role
        What to run.
    rig
        The instruments.
    clock, random
        Time and randomness for everything inside.
    bus
        Where records go.
    key
        The bridge's key; None for an insecure bridge.
    notifier
        Talks to the service manager.
    speed
        Speed of the clock relative to the machine's, for the watchdog.
    calibration
        The cube's calibration; None for the gains of the settings.
    polling
        How often to poll the positioner.
    stow_sources
        Reasons to stow besides the rig's wind sensor and the operator, by the name of the tracker.
    send_beyond
        Takes each signed scan of the cube to trackers that UDP does not reach, or None.
    kept_in
        Makes the folder of a tracker's kept state; in real time one whose disk is never waited for.
    hold_why
        Why the trackers are to be held from the start where nobody has asked for anything, or None.
    """

    def __init__(
        self,
        settings: Settings,
        role: Role,
        rig: Rig,
        clock: Clock,
        random: Random,
        bus: Bus,
        key: bytes | None,
        notifier: SystemdNotifier,
        speed: float = 1.0,
        calibration: CubeCalibration | None = None,
        polling: Polling = OFTEN,
        stow_sources: Mapping[str, Sequence[StowSource]] = MappingProxyType({}),
        send_beyond: Callable[[bytes], None] | None = None,
        kept_in: Callable[[Path | None], StateFolder] = StateFolder,
        hold_why: str | None = None,
    ) -> None:
        self.settings = settings
        self.role = role
        self.rig = rig
        self.clock = clock
        self.bus = bus
        self._folder = kept_in(settings.store.directory)
        self.cube_alarms = Alarms(clock, bus.publish, file=AlarmFile(self._folder, CUBE_FILE_NAME))
        self._remote_face_alarm = RemoteFaceAlarm(self.cube_alarms, clock)
        self._unread_faces = UnreadFaceAlarm(self.cube_alarms, clock)
        self._is_open = False
        self._random = random
        self._make_state_folder = kept_in
        self._hold_why = hold_why
        self._key = key
        self._notifier = notifier
        self.calibration = calibration
        self._expiry = ExpiryWatch(calibration, bus.publish)
        self._send_beyond = send_beyond
        self.sun_elevation_deg = SunElevation(settings.site.place())
        self.receiver: BridgeReceiver | None = None
        self.sender: BridgeSender | None = None
        self.acquisition: Acquisition | None = None
        self.trackers: tuple[Tracker, ...] = ()
        if role is not Role.CUBE:
            self.trackers = tuple(self._build_trackers(random, polling, stow_sources))
            alarm = self.cube_alarms.set
            self.receiver = BridgeReceiver(settings.bridge, key, clock, self._receive, notifier, alarm)
        if role is not Role.TRACKER:
            self._build_cube()
        self.sleeps = SleepWatch(clock)
        self.loop_watch = LoopWatch(clock, speed, self.sleeps.sleeps_until_now)
        self._watchdog = Watchdog(clock, notifier, self.trackers, self.acquisition, speed)

    def _build_cube(self) -> None:
        settings, rig = self.settings, self.rig
        if rig.cube is None:
            raise ValueError("the role cube needs a cube")
        cube = calibrated_cube(settings.cube, self.calibration) if self.calibration else settings.cube
        # In a process with trackers, these raise the alarm about the clock that they share with the cube.
        alarms = self.cube_alarms if self.role is Role.CUBE else None
        ran_utc_s = max((tracker.ran_utc_s for tracker in self.trackers), default=-math.inf)
        clock_watch = ClockWatch(self.clock, alarms, rig.clock_synchronised, ran_utc_s)
        self.acquisition = Acquisition(
            cube,
            rig.cube,
            self.clock,
            self._random,
            self._send,
            self.bus.publish,
            lambda utc_s: self.sun_elevation_deg(utc_s) if clock_watch.trusted else math.nan,
            rig.simulated,
            self.calibration.identifier if self.calibration else "",
            FaceWatch(settings.site, cube, self.clock, self.cube_alarms, clock_watch),
            self.cube_alarms,
        )

    def _build_trackers(
        self, random: Random, polling: Polling, stow_sources: Mapping[str, Sequence[StowSource]]
    ) -> Iterator[Tracker]:
        wanted, common, directory = self.settings.trackers, SharedCache(), self.settings.store.directory
        tables, folders = [table.name for table in self.settings.tracker], [own.store.directory for _, own in wanted]
        lefts = [orphaned_state_text(directory, tables, own) if directory and own else None for own in folders]
        number = next_start_number(directory)
        if tables and directory is not None:
            migrate_state_to_trackers(directory, tables)
        if len(wanted) != len(self.rig.trackers):
            raise ValueError(f"{len(wanted)} trackers are configured and {len(self.rig.trackers)} are on the rig")
        for place, ((name, settings), instruments) in enumerate(zip(wanted, self.rig.trackers, strict=True)):
            same_place = settings.site.place() == self.settings.site.place()
            tracker = Tracker(
                name=name,
                settings=settings,
                instruments=instruments,
                rig=self.rig,
                clock=self.clock,
                random=random,
                publish=self.bus.publish,
                sun_elevation_deg=self.sun_elevation_deg if same_place else SunElevation(settings.site.place()),
                polling=polling,
                stow_sources=stow_sources.get(name, ()),
                folder=self._make_state_folder(settings.store.directory),
                phase=Phase(place, len(wanted)),
                common=common,
                unheard=self._why_unheard,
                muted=self._mute_cube,
                hold_why=lefts[place] or self._hold_why,
                start_number=number,
            )
            self.bus.subscribe(tracker.note, name)
            yield tracker

    @property
    def is_everything_saved(self) -> bool:
        """Whether a restart now would forget nothing that was asked of any tracker."""
        return all(tracker.folder.unsaved is None for tracker in self.trackers)

    def take_keys(self, keys: tuple[bytes, ...]) -> None:
        """Sign scans with the first of these keys from now on, and accept what any of them has signed."""
        self._key = keys[0]
        if self.sender is not None:
            self.sender.take_key(keys[0])
        if self.receiver is not None:
            self.receiver.take_keys(keys)

    def _why_unheard(self) -> str:
        """Return why the bridge hears nothing, or what it has refused since the last scan, in words."""
        return "" if self.receiver is None else self.receiver.down_why or self.receiver.refused_since_accepted

    def _mute_cube(self) -> None:
        """Keep the cube's alarms silent while all trackers are muted: nobody is left who would want to hear them."""
        self.cube_alarms.mute(muted=all(tracker.alarms.muted for tracker in self.trackers))

    def _receive(self, scan: Scan) -> None:
        """Hand a scan of the bridge to every tracker, and to the bus."""
        # One instant for all trackers, so that what they know alike is worked out only once.
        utc_s = self.clock.utc()
        for tracker in self.trackers:
            tracker.receive(scan, utc_s)
        if self.role is Role.TRACKER:
            self._remote_face_alarm.note(scan)
        self._unread_faces.note(scan)
        self.bus.publish(scan)

    async def open(self) -> None:
        """Take the bridge's address, before anything begins that would collide with another service.

        Raises `UserError` if the address cannot be used; one that is not on this machine now is waited for. `run` calls
        this if nobody has.
        """
        if not self._is_open:
            await self._open_bridge()
            self._is_open = True

    async def run(self, stop: asyncio.Event, *companions: Coroutine[Any, Any, None]) -> None:
        """Run until `stop` is set; motion is stopped before anything else ends.

        Parameters
        ----------
        stop
            Ends the service.
        companions
            Displays and the like, which live and die with the service.

        Raises
        ------
        UserError
            The bridge's address cannot be used, and nothing has been started; the simulated weather has ended; or the
            software under a driver hangs for good.
        """
        try:
            await self.open()
            for tracker in self.trackers:
                tracker.check()
            if self._is_udp_listener and self.receiver is not None:
                # Not earlier: by now those who keep the records listen, too.
                await self.receiver.open()
            try:
                async with asyncio.TaskGroup() as group:
                    tasks = [
                        group.create_task(self._run_named(name, work), name=name)
                        for name, work in self._work(companions)
                    ]
                    self._notifier.ready()
                    await stop.wait()
                    self._notifier.stopping()
                    await asyncio.gather(*(tracker.stop_motion() for tracker in self.trackers))
                    for task in tasks:
                        task.cancel()
            except BaseExceptionGroup as group:
                users, defects = group.split(UserError)
                if users is not None and defects is None:
                    raise _first(users) from None
                raise
        finally:
            if self.sender is not None:
                await self.sender.close()
            if self.receiver is not None:
                await self.receiver.close()
            for companion in companions:
                companion.close()
            for tracker in self.trackers:
                tracker.folder.close()
            self._folder.close()

    @property
    def _is_udp_listener(self) -> bool:
        return self.role is Role.BOTH or (self.role is Role.TRACKER and self.settings.bridge.transport != "mqtt")

    async def _open_bridge(self) -> None:
        bridge = self.settings.bridge
        if self._is_udp_listener and self.receiver is not None:
            self.receiver.bind()
        if self.role is Role.TRACKER or (self.role is Role.CUBE and bridge.transport == "mqtt"):
            return
        if self.receiver is not None:
            # Both roles in one process still talk over the bridge, to wherever the receiver really listens.
            own = () if bridge.multicast_group else (self.receiver.address,)
            others = tuple(target for target in bridge.send_to if target not in (bridge.listen, self.receiver.address))
            bridge = bridge.model_copy(update={"send_to": own + others})
        self.sender = BridgeSender(bridge, self._key, self.clock)
        await self.sender.open()

    def _send(self, scan: Scan) -> None:
        self._expiry.check(scan.time_utc_s, scan.time_monotonic_s)
        if self.sender is not None:
            self.sender.send(scan)
        if self.receiver is not None and self.receiver.down_why is not None:
            # A scan that stays in this process needs no address of the network.
            self.receiver.take_own(pack(scan, self._key))
        if self._send_beyond is not None:
            self._send_beyond(pack(scan, self._key))
        if self.role is Role.CUBE:
            self.bus.publish(scan)

    def _work(self, companions: tuple[Coroutine[Any, Any, None], ...]) -> list[tuple[str, Awaitable[None]]]:
        work: list[tuple[str, Awaitable[None]]] = [("watchdog", self._watchdog.run())]
        for tracker in self.trackers:
            of = f" of {tracker.name}" if len(self.trackers) > 1 else ""
            work += [(f"{name}{of}", part) for name, part in tracker.named_coroutines()]
        if self.acquisition is not None:
            work.append(("acquisition", self.acquisition.run()))
        work += [(getattr(companion, "__name__", "companion"), companion) for companion in companions]
        return work

    async def _run_named(self, name: str, work: Awaitable[None]) -> None:
        """Tell which part died before the whole service stops for it."""
        try:
            await work
        except UserError:
            raise
        except DriverHungError as error:
            sentence = f"{error}: the service ends and must be restarted"
            self.bus.publish(Event(self.clock.utc(), self.clock.monotonic(), "service", sentence))
            raise UserError(sentence) from error
        except Exception:
            log.exception("the task '%s' died; the service stops", name)
            self.bus.publish(Event(self.clock.utc(), self.clock.monotonic(), "service", f"the task '{name}' died"))
            raise


def _first(group: BaseExceptionGroup[UserError]) -> UserError:
    first = group.exceptions[0]
    return _first(first) if isinstance(first, BaseExceptionGroup) else first
