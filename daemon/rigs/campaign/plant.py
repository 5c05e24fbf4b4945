"""The rig as it goes on while processes die on it: one unit, one cube, one sky, and one service after another."""

import asyncio
import math
import shutil
from contextlib import AbstractContextManager
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from daemon.base.records import Bus, Event, ModeChange, Move, Record, Scan
from daemon.base.state import StateFolder
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.rigs.campaign.disk import Disk
from daemon.rigs.campaign.rig import HandledRig, HandWeather
from daemon.service.rig import Role
from drivers.interfaces import AxisName, Positioner
from drivers.positioners.pozsol.positioner import PozsolPositioner
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import Setup
from solar.frames import Angles

HOMED = "homing finished"
PLUGGED = ("positioner", "multiplexer", "voltmeter")
UNIT_GOES_TO = Angles(35.0, 30.0)
"""Where the unit's own tracking and its stow modes drive, far from what the service ever asks for by itself."""
_OWN_TARGET_EVERY_S = 300
_WRITE_S = 0.004
"""As to a real port through its thread: what else happens while a packet is on its way can come in between."""


class Witness(Protocol):
    """Who is told of orders, services and plugs, and keeps what was broken."""

    def fails(self, promise: str, text: str) -> None:
        """Take note of a broken promise."""

    def packet(self, data: bytes, now_s: float) -> None:
        """Take note of a packet that reaches the unit."""

    def sending(self, target: tuple[float, float]) -> AbstractContextManager[None]:
        """Accompany a target [deg] while the driver sends and confirms it."""

    def homes(self, axis: AxisName) -> None:
        """Take note that a reference run is ordered."""

    def link_changes(self) -> None:
        """Take note that a plug was pulled or put back."""

    def service_begins(self) -> None:
        """Take note that a new process is there."""

    def scan(self, scan: Scan) -> None:
        """Take note of a scan that the service has accepted."""


class UnitTap:
    """The unit as one process reaches it: what is sent is noted, and a dead process sends nothing more.

    Parameters
    ----------
    unit
        The simulated unit.
    witness
        Notes every packet.
    """

    def __init__(self, unit: PositionerCore, witness: Witness) -> None:
        self._unit = unit
        self._witness = witness
        self.live_screens = unit.live_screens
        self.screens = unit.screens
        self.enumerate_usb = unit.enumerate_usb
        self.dead = False

    def feed(self, data: bytes, now: float) -> None:
        """Hand bytes to the unit."""
        if not self.dead:
            self._witness.packet(data, now)
            self._unit.feed(data, now)


class DriverTap:
    """The positioner's driver, with every order that goes through it noted.

    Parameters
    ----------
    driver, line
        The driver, and the unit as it reaches it.
    witness
        Notes targets and reference runs.
    """

    def __init__(self, driver: PozsolPositioner, line: UnitTap, witness: Witness) -> None:
        self._driver = driver
        self._witness = witness
        self._line = line
        self.open, self.close = driver.open, driver.close
        self.read_telemetry, self.disable_autonomy = driver.read_telemetry, driver.disable_autonomy
        self.stop, self.halt, self.clear_faults = driver.stop, driver.halt, driver.clear_faults
        self.repeated_s, self.standing, self.recall = driver.repeated_s, driver.standing, driver.recall

    async def move_to(self, a_deg: float, b_deg: float, *, first: AxisName = "a") -> None:
        """Move there; see the driver."""
        if self._line.dead:
            await self._driver.move_to(a_deg, b_deg, first=first)
            return
        with self._witness.sending((a_deg, b_deg)):
            await self._driver.move_to(a_deg, b_deg, first=first)

    async def home(self, axis: AxisName) -> None:
        """Begin a reference run; see the driver."""
        if not self._line.dead:
            self._witness.homes(axis)
        await self._driver.home(axis)


def nothing() -> None:
    """Do nothing."""


class Plant(HandledRig):
    """The instruments, and the service that runs on them at present.

    Parameters
    ----------
    loop, settings, start, weather, setup
        As for `HandledRig`.
    witness
        Is told of orders, services and plugs.

    Attributes
    ----------
    records
        Events, moves and changes of mode of all services so far; the rest would fill the memory in a day.
    plugged
        Which devices' cables are in.
    served
        Set while a service is there; one that is just ending is not.
    served_since_s
        When the present service began.
    disk
        What the service writes to.
    commands
        Tasks of persons whose command is under way; they die with the service.
    when_renewed
        Called with each new service before it runs: for what lasts outside of the process.
    """

    def __init__(
        self,
        loop: VirtualTimeLoop,
        settings: Settings,
        start: datetime,
        weather: HandWeather,
        setup: Setup,
        witness: Witness,
    ) -> None:
        self.witness = witness
        self.plugged = dict.fromkeys(PLUGGED, True)
        self.settings = settings
        self.served = asyncio.Event()
        self.served_since_s = math.inf
        self.commands: set[asyncio.Task[None]] = set()
        self.when_renewed = nothing
        self._serving: asyncio.Task[None] | None = None
        self._stop = asyncio.Event()
        self.disk = Disk()
        self._silent = False
        self._line: UnitTap
        super().__init__(loop, settings, start, weather, Role.BOTH, setup)

    @property
    def directory(self) -> Path:
        """Where the service keeps what it needs for its next start."""
        directory = self.settings.store.directory
        assert directory is not None  # noqa: S101 - narrowing; every plant has one
        return directory

    def connect(self, settings: Settings) -> None:
        """Lay the cables, and leave out those that are unplugged."""
        super().connect(settings)
        for device, up in self.plugged.items():
            getattr(self.cables, device).link_up = up
        self.cables.positioner.silent, self.cables.positioner.write_s = self._silent, _WRITE_S

    def drive(self, unit: PositionerCore, settings: Settings) -> Positioner:
        """Return the driver of the unit with a tap before and behind it."""
        self._line = UnitTap(unit, self.witness)
        driver = super().drive(self._line, settings)  # type: ignore[arg-type] # it passes for the unit
        assert isinstance(driver, PozsolPositioner)  # noqa: S101 - narrowing
        return DriverTap(driver, self._line, self.witness)

    def keep_in(self, directory: Path | None) -> StateFolder:
        """Return what writes the files that a service keeps, to a disk that can be full."""
        return StateFolder(directory, replace=self.disk.replace, reserve=self.disk.reserve)

    def note(self, record: Record) -> None:
        """Keep what somebody may ask for, and show scans to the witness."""
        if isinstance(record, Event | Move | ModeChange):
            self.records.append(record)
        elif isinstance(record, Scan):
            self.witness.scan(record)

    @property
    def is_served(self) -> bool:
        """Whether a service is there; one that is just ending is not."""
        return self.served.is_set()

    def wishes(self) -> bytes:
        """Return what persons have asked for, as it is kept."""
        kept = self.directory / "operator.json"
        return kept.read_bytes() if kept.is_file() else b""

    def kept_files(self) -> list[Path]:
        """Return what the service has kept for its next start."""
        return sorted(path for path in self.directory.rglob("*") if path.is_file())

    def has_homed(self, since_s: float) -> bool:
        """Tell whether a reference run of both axes has ended well since then."""
        return any(
            isinstance(record, Event) and record.text == HOMED and record.time_monotonic_s >= since_s
            for record in self.records
        )

    def plug(self, device: str, *, up: bool) -> None:
        """Pull a cable, or put it back."""
        self.plugged[device] = up
        getattr(self.cables, device).link_up = up
        if device == "positioner":
            self.witness.link_changes()

    @property
    def is_silent(self) -> bool:
        """Whether nothing comes from the unit although its cable is in."""
        return self._silent

    def silence(self, *, silent: bool) -> None:
        """Let nothing come from the unit any more, or let it be heard again."""
        self._silent = self.cables.positioner.silent = silent
        self.witness.link_changes()

    def start(self) -> None:
        """Start the service that has been built."""
        self._stop = asyncio.Event()
        self._serving = asyncio.create_task(self.service.run(self._stop), name="service")
        self._serving.add_done_callback(self._ended)
        self.served.set()
        self.served_since_s = self.clock.monotonic()
        self.witness.service_begins()

    def _ended(self, task: "asyncio.Task[None]") -> None:
        if task is self._serving and not task.cancelled():
            self.witness.fails("service-died", f"the service ended by itself: {task.exception()!r}")

    async def kill(self) -> None:
        """Let the process die at once: not a byte goes out any more, and no file changes."""
        serving, self._serving = self._serving, None
        self.served.clear()
        self._line.dead = True
        kept = {path: path.read_bytes() for path in self.kept_files()}
        await self._finish(serving, cancel=True)
        shutil.rmtree(self.directory, ignore_errors=True)
        for path, content in kept.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

    async def end(self) -> None:
        """Ask the service to end, as the service manager does."""
        serving, self._serving = self._serving, None
        self.served.clear()
        self._stop.set()
        await self._finish(serving, cancel=False)
        self._line.dead = True

    def renew(self) -> None:
        """Build and start a new process on the same instruments and files."""
        self.connect(self.settings)
        self.bus = Bus()
        self.bus.subscribe(self.note)
        self.service = self.serve(self.settings, Role.BOTH)
        self.when_renewed()
        self.start()

    async def _finish(self, serving: "asyncio.Task[None] | None", *, cancel: bool) -> None:
        commands, self.commands = self.commands, set()
        ending: list[asyncio.Task[Any]] = [*commands]
        for task in commands:
            task.cancel()
        if serving is not None:
            ending.append(serving)
            if cancel:
                serving.cancel()
        for outcome in await asyncio.gather(*ending, return_exceptions=True):
            if isinstance(outcome, Exception):
                self.witness.fails("service-died", f"the service did not end in order: {outcome!r}")


def build_plant(
    loop: VirtualTimeLoop,
    start: datetime,
    directory: Path,
    witness: Witness,
    *,
    law: str,
    rehome: str,
    synchronous: bool,
    sky_w_m2: tuple[float, float],
) -> Plant:
    """Return a plant, its service not yet started.

    Parameters
    ----------
    loop, start, witness
        As for `Plant`.
    directory
        Where the service keeps its files.
    law, rehome
        As in the settings.
    synchronous
        Whether the unit drives both axes at once.
    sky_w_m2
        DNI and DHI.
    """
    settings = Settings.model_validate(
        {
            "bridge": {"listen": "127.0.0.1:0", "send_to": ()},
            "law": {"driver": law},
            "motion": {"rehome": rehome},
            "safety": {"stow_at_least_s": 120.0},
            "store": {"directory": str(directory)},
        }
    )
    setup = Setup(synchronous=synchronous, own_target=_own_target, wind_stow=UNIT_GOES_TO, snow_stow=UNIT_GOES_TO)
    return Plant(loop, settings, start, HandWeather(*sky_w_m2), setup, witness)


def _own_target(now_s: float) -> Angles:
    """Return where the unit's own tracking points: it never stays for long."""
    return UNIT_GOES_TO if int(now_s // _OWN_TARGET_EVERY_S) % 2 else Angles(-20.0, 60.0)
