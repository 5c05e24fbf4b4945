"""The running service: which parts a role consists of, how they start, and how they stop."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass
from enum import StrEnum
from random import Random
from typing import Any

from daemon.base.alarms import Alarms
from daemon.base.clock import Clock
from daemon.base.clock_watch import ClockWatch
from daemon.base.errors import UserError
from daemon.base.process import Notifier
from daemon.base.records import Bus, Event, Scan
from daemon.bridge.receiver import BridgeReceiver
from daemon.bridge.sender import BridgeSender, pack
from daemon.config.settings import Settings
from daemon.cube.acquisition import Acquisition
from daemon.cube.calibration import CubeCalibration, ExpiryWatch, calibrated_cube
from daemon.cube.face_watch import FaceWatch
from daemon.motion.end import finish
from daemon.motion.motion import OFTEN, Motion, Polling
from daemon.service.health import Watchdog
from daemon.tracker.control import Control
from daemon.tracker.curves import IvAcquisition
from daemon.tracker.orders import Orders
from daemon.tracker.pointing import build_pointing
from daemon.tracker.stow import StowSource, WindStow
from daemon.tracker.stow_watch import SafetyFile, StowWatch
from daemon.tracker.wishes import WishFile
from drivers.errors import DriverHungError
from drivers.interfaces import ElectronicLoad, Multiplexer, Positioner, Voltmeter
from solar.ephemeris import SunElevation

log = logging.getLogger("heliocube.service")

_NO_WIND_SOURCE = (
    "no wind source: nothing stows the tracker in a storm; set mqtt.wind.topic or mqtt.safe.topic,"
    ' or safety.without_wind_source = "accepted"'
)
# The unit needs a second or two; systemd waits 15 s for the whole of it.
_STAND_WITHIN_S = 8.0


class Role(StrEnum):
    """What one process does."""

    CUBE = "cube"
    TRACKER = "tracker"
    BOTH = "both"


@dataclass(frozen=True, slots=True)
class Rig:
    """The instruments of one process, real or simulated.

    Attributes
    ----------
    multiplexer, voltmeter, positioner
        None where the role has no use for them.
    wind_speed_m_s
        Latest wind speed [m/s]; None where there is no wind sensor at all.
    simulated
        True if any of it is a simulation.
    sky_text
        One line about the simulated sky for displays, or None.
    load
        None where there is none on the tracker's module.
    clock_synchronised
        Whether anything has synchronised the machine's clock; None where that is not known or there is no such clock.
    """

    multiplexer: Multiplexer | None
    voltmeter: Voltmeter | None
    positioner: Positioner | None
    wind_speed_m_s: Callable[[], float | None] | None
    simulated: bool
    sky_text: Callable[[], str] | None = None
    load: ElectronicLoad | None = None
    clock_synchronised: Callable[[], bool | None] = lambda: None


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
        Of the bridge; None for an insecure one.
    notifier
        To the service manager.
    speed
        How many times as fast as the machine's the clock runs, for the watchdog.
    calibration
        Of the cube; None for the gains of the settings.
    polling
        How often to look at the positioner.
    stow_sources
        Reasons to stow besides the rig's wind sensor and the operator.
    send_beyond
        Takes each signed scan of the cube to trackers that UDP does not reach, or None.
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
        notifier: Notifier,
        speed: float = 1.0,
        calibration: CubeCalibration | None = None,
        polling: Polling = OFTEN,
        stow_sources: Sequence[StowSource] = (),
        send_beyond: Callable[[bytes], None] | None = None,
    ) -> None:
        self.settings = settings
        self.role = role
        self.rig = rig
        self.clock = clock
        self.bus = bus
        self.alarms = Alarms(clock, bus.publish)
        self._random = random
        self._key = key
        self._notifier = notifier
        self.calibration = calibration
        self._expiry = ExpiryWatch(calibration, bus.publish)
        self._polling = polling
        self._stow_sources = stow_sources
        self._send_beyond = send_beyond
        self.sun_elevation_deg = SunElevation(settings.site.place())
        self.receiver: BridgeReceiver | None = None
        self.sender: BridgeSender | None = None
        self.acquisition: Acquisition | None = None
        self.motion: Motion | None = None
        self.control: Control | None = None
        self.curves: IvAcquisition | None = None
        self.stow_watch: StowWatch | None = None
        if role is not Role.CUBE:
            self._build_tracker()
        if role is not Role.TRACKER:
            self._build_cube()
        self._watchdog = Watchdog(clock, notifier, self.control, self.acquisition, speed)

    def _build_cube(self) -> None:
        settings, rig = self.settings, self.rig
        if rig.multiplexer is None or rig.voltmeter is None:
            raise ValueError("the cube's role needs a multiplexer and a voltmeter")
        cube = calibrated_cube(settings.cube, self.calibration) if self.calibration else settings.cube
        self.acquisition = Acquisition(
            cube,
            settings.instruments.multiplexer.settle_s,
            rig.multiplexer,
            rig.voltmeter,
            self.clock,
            self._random,
            self._send,
            self.bus.publish,
            self.sun_elevation_deg,
            rig.simulated,
            self.calibration.identifier if self.calibration else "",
            FaceWatch(settings.site, cube, self.clock, self.alarms),
        )

    def _build_tracker(self) -> None:
        settings, rig = self.settings, self.rig
        if rig.positioner is None:
            raise ValueError("the tracker's role needs a positioner")
        limits = settings.limits.limits()
        sources: list[StowSource] = [*self._stow_sources]
        if rig.wind_speed_m_s is not None:
            sources.append(WindStow(settings.safety, rig.wind_speed_m_s))
        self.stow_watch = StowWatch(sources, SafetyFile(settings.store.directory), self.clock, self._look_again)
        self.motion = Motion(
            rig.positioner,
            limits,
            settings.motion,
            settings.instruments.positioner,
            self.clock,
            self._random,
            self.bus.publish,
            self._look_again,
            self.alarms,
            self._polling,
            settings.store.directory,
        )
        self.control = Control(
            settings,
            self.clock,
            self.motion,
            build_pointing(settings, self.clock.utc()),
            self.sun_elevation_deg,
            self.stow_watch,
            Orders(self.clock, WishFile(settings.store.directory)),
            self.bus.publish,
            self.alarms,
            ClockWatch(self.clock, self.alarms, rig.clock_synchronised),
        )
        self.bus.subscribe(self.control.note)
        self.receiver = BridgeReceiver(settings.bridge, self._key, self.clock, self.control.receive)
        if rig.load is not None:
            stale_s = settings.safety.scan_stale_s
            self.curves = IvAcquisition(
                settings.load, rig.load, self.clock, self._random, self.bus.publish, self.sun_elevation_deg, stale_s
            )
            self.bus.subscribe(self.curves.note)

    def _look_again(self) -> None:
        if self.control is not None:
            self.control.look_again()

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
            await self._open_bridge()
            self._tell_of_wind()
            try:
                async with asyncio.TaskGroup() as group:
                    tasks = [
                        group.create_task(self._named(name, work), name=name) for name, work in self._work(companions)
                    ]
                    self._notifier.ready()
                    await stop.wait()
                    self._notifier.stopping()
                    await self._stop_motion()
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

    def _tell_of_wind(self) -> None:
        watch, accepted = self.stow_watch, self.settings.safety.without_wind_source == "accepted"
        if watch is not None and not (watch.watched or self.rig.simulated or accepted):
            self.alarms.set("no-wind-source", _NO_WIND_SOURCE)

    async def _open_bridge(self) -> None:
        bridge = self.settings.bridge
        if self.receiver is not None and not (self.role is Role.TRACKER and bridge.transport == "mqtt"):
            await self.receiver.open()
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
        self._expiry.look(scan.time_utc_s, scan.time_monotonic_s)
        if self.sender is not None:
            self.sender.send(scan)
        if self._send_beyond is not None:
            self._send_beyond(pack(scan, self._key))
        if self.role is Role.CUBE:
            self.bus.publish(scan)

    def _work(self, companions: tuple[Coroutine[Any, Any, None], ...]) -> list[tuple[str, Awaitable[None]]]:
        work: list[tuple[str, Awaitable[None]]] = [("watchdog", self._watchdog.run())]
        if self.motion is not None and self.control is not None:
            work += [("motion", self.motion.run()), ("control", self.control.run())]
        if self.stow_watch is not None and self.rig.wind_speed_m_s is not None:
            work.append(("stow", self.stow_watch.run()))
        if self.acquisition is not None:
            work.append(("acquisition", self.acquisition.run()))
        if self.curves is not None:
            work.append(("load", self.curves.run()))
        work += [(getattr(companion, "__name__", "companion"), companion) for companion in companions]
        return work

    async def _named(self, name: str, work: Awaitable[None]) -> None:
        """Tell which part died before the whole service stops for it."""
        try:
            await work
        except UserError:
            raise
        except DriverHungError as error:
            sentence = f"{error}: the service ends, and has to be started anew"
            self.bus.publish(Event(self.clock.utc(), self.clock.monotonic(), "service", sentence))
            raise UserError(sentence) from error
        except Exception:
            log.exception("the task '%s' died; the service stops", name)
            self.bus.publish(Event(self.clock.utc(), self.clock.monotonic(), "service", f"the task '{name}' died"))
            raise

    async def _stop_motion(self) -> None:
        if self.motion is None:
            return
        left = await finish(self.motion, self.clock, _STAND_WITHIN_S)
        if left is None:
            log.info("motion stopped: telemetry shows both axes standing")
        else:
            log.warning("motion is not known to be stopped: %s", left)


def _first(group: BaseExceptionGroup[UserError]) -> UserError:
    first = group.exceptions[0]
    return _first(first) if isinstance(first, BaseExceptionGroup) else first
