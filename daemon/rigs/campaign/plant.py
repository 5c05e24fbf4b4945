"""The rig of a campaign: units, one cube and one sky, which go on while one service after another runs on them."""

import asyncio
import math
import shutil
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from daemon.base.records import Bus, Event, Mode, ModeChange, Move, Record, Scan, is_relevant_to
from daemon.base.state import StateFolder
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.motion.motion import Motion
from daemon.rigs.campaign.disk import Disk
from daemon.rigs.campaign.rig import InMemoryRig, ManualWeather, SteppingClock
from daemon.rigs.campaign.rotator import GONE, RotatorTap, SleeplessRotator, build_rotator_driver
from daemon.rigs.campaign.taps import DriverTap, PozsolTap, SleeplessUnit, UnitTap, Witness
from daemon.rigs.simulated_positioner import configured_setup
from daemon.service.rig import Role
from daemon.service.service import Service
from daemon.tracker.control import Control
from drivers.interfaces import AxisName, Positioner
from drivers.positioners.pozsol.positioner import PozsolPositioner
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import Setup
from sim_drivers.transports import InMemoryStream
from solar.frames import Angles

HOMED = "homing finished"
PLUGGABLE_DEVICES = ("multiplexer", "voltmeter")
ROTCTLD = "rotctld"
UNIT_OWN_TARGET = Angles(35.0, 30.0)
"""Where the unit's own tracking and its stow modes drive, far from what the service ever asks for by itself."""
_WRITE_S = 0.004
"""As long as a write to a real port through its thread takes: other events can happen while a packet is on its way."""
_MOST_MM_PER_DEG = 5.0
"""Most millimetres that an actuator extends for a degree; for a unit that counts degrees it is more than enough."""


def no_op() -> None:
    """Do nothing."""


class PlantTracker:
    """One tracker of the plant: its unit and cable, and what the service at present does with it.

    Parameters
    ----------
    plant
        The plant that it belongs to.
    place
        Its place among the trackers, from 0.
    witness
        Is told of its orders and its plug.

    Attributes
    ----------
    unit
        The simulated unit; built before the first service.
    plugged, is_silent, is_gone
        Whether its cable is in; whether the unit sends nothing although it is in; whether rotctld has lost the rotator.
    records
        Those of the plant's records that concern this tracker or no tracker.
    text_prefix
        Stands before each sentence on this tracker if there are several; empty for a single one.
    """

    def __init__(self, plant: "Plant", place: int, witness: Witness) -> None:
        self.plant = plant
        self.place = place
        self.witness = witness
        self.plugged = True
        self.is_silent = self.is_gone = False
        self.records: list[Record] = []
        self.unit: SleeplessUnit | SleeplessRotator
        self.line: UnitTap | RotatorTap
        self.name, self.settings = plant.settings.trackers[place]
        self.text_prefix = f"{self.name}: " if plant.settings.tracker else ""

    def build_driver(
        self, unit: PositionerCore, settings: Settings, build: Callable[[PositionerCore, Settings], Positioner]
    ) -> Positioner:
        """Return the unit's driver, with a tap on either side of it."""
        rotator: object = unit
        if isinstance(rotator, SleeplessRotator):
            self.unit, self.line = rotator, (tap := RotatorTap(rotator, self.clock, self.witness))
            self.plant.cables.positioners.append(tap)
            return DriverTap(build_rotator_driver(rotator, tap, settings, self.clock), tap, self.witness)
        self.unit = SleeplessUnit(unit, self.clock.world_time_s)
        self.line = UnitTap(self.unit, self.witness)
        driver = build(self.line, settings)  # type: ignore[arg-type] # it passes for the unit
        assert isinstance(driver, PozsolPositioner)  # noqa: S101 - narrowing
        return PozsolTap(driver, self.line, self.witness)

    @property
    def clock(self) -> SteppingClock:
        """The plant's clock."""
        return self.plant.clock

    @property
    def service(self) -> Service:
        """The service that runs at present."""
        return self.plant.service

    @property
    def is_served(self) -> bool:
        """Whether a service is there; one that is just ending is not."""
        return self.plant.is_served

    @property
    def wind_m_s(self) -> float | None:
        """What the wind sensor says; None: it is silent."""
        return self.plant.wind_m_s

    @property
    def wind_silent_since_s(self) -> float:
        """Since when the wind sensor says nothing; infinite while it does."""
        return self.plant.wind_silent_since_s if self.plant.wind_m_s is None else math.inf

    @property
    def motion(self) -> Motion:
        """What moves it."""
        return self.plant.service.trackers[self.place].motion

    @property
    def control(self) -> Control:
        """What decides for it."""
        return self.plant.service.trackers[self.place].control

    @property
    def mode(self) -> Mode:
        """What it does at present."""
        return self.control.mode

    def truth(self) -> Angles:
        """Return where it really stands, as A and B."""
        return self.unit.truth(self.clock.monotonic())

    def axes(self) -> Angles:
        """Return where its axes really stand: A and B, or a rotator's azimuth and elevation."""
        return self.unit.axes(self.clock.monotonic())

    def range_deg(self, axis: AxisName) -> tuple[float, float]:
        """Return the range that no order may drive an axis out of: the limits, or for a rotator its own range."""
        if isinstance(self.unit, SleeplessRotator):
            return self.unit.limits[axis]
        limits = self.settings.limits
        return (limits.a_min_deg, limits.a_max_deg) if axis == "a" else (limits.b_min_deg, limits.b_max_deg)

    @property
    def has_slew_drives(self) -> bool:
        """Whether its unit counts degrees, or impulses of a gear on the axis."""
        return (
            not isinstance(self.unit, SleeplessRotator) and self.settings.instruments.positioner.position_unit != "mm"
        )

    def units_per_deg(self, axis: AxisName) -> float:
        """Return the largest count that a degree can have in its unit."""
        positioner = self.settings.instruments.positioner
        by_impulses = positioner.position_unit == "impulse"
        return float(getattr(positioner, f"{axis}_axis").impulses_per_deg) if by_impulses else _MOST_MM_PER_DEG

    def is_lowered(self, axis: AxisName) -> bool:
        """Tell whether an axis counts upwards while its angle goes down."""
        positioner = self.settings.instruments.positioner
        return positioner.position_unit == "mm" and getattr(positioner, f"{axis}_axis").sense == "lowers"

    @property
    def has_reference_run(self) -> bool:
        """Whether it can be homed."""
        return self.settings.instruments.positioner.has_reference_run

    def wishes(self) -> bytes:
        """Return the wishes of persons for it, as the service keeps them."""
        directory = self.settings.store.directory
        assert directory is not None  # noqa: S101 - narrowing; every plant has one
        kept = directory / "operator.json"
        return kept.read_bytes() if kept.is_file() else b""

    def has_homed(self, since_s: float) -> bool:
        """Tell whether a reference run of both axes has ended well since then."""
        return any(
            isinstance(record, Event) and record.text == HOMED and record.time_monotonic_s >= since_s
            for record in self.records
        )

    def restore_cable(self) -> None:
        """Put a new cable in the state of the one before."""
        self._cable.link_up, self._cable.silent, self._cable.write_s = self.plugged, self.is_silent, _WRITE_S

    def plug(self, *, up: bool) -> None:
        """Pull its cable, or put it back."""
        self.plugged = self._cable.link_up = up
        self.witness.note_link_change()

    def silence(self, *, silent: bool) -> None:
        """Let the unit send nothing any more, or let it be heard again."""
        self.is_silent = self._cable.silent = silent
        self.witness.note_link_change()

    def set_rotator_gone(self, *, is_gone: bool) -> None:
        """Let rotctld lose its rotator, or reach it again."""
        self.is_gone = is_gone
        (self.unit.inject if is_gone else self.unit.repair)(GONE, self.clock.monotonic())
        self.witness.note_link_change()

    @property
    def _cable(self) -> InMemoryStream | RotatorTap:
        cable: InMemoryStream | RotatorTap = self.plant.cables.positioners[self.place]
        return cable


class Plant(InMemoryRig):
    """The instruments, and the service that runs on them at present.

    Parameters
    ----------
    loop, settings, start, weather, setup
        As for `InMemoryRig`.
    witnesses
        One for each tracker, which is told of its orders and its plug, and of services.

    Attributes
    ----------
    mounts
        The trackers.
    records
        Events, moves and changes of mode of all services so far; the rest would fill the memory in a day.
    plugged
        Which cables of the cube are in.
    served
        Set while a service is there; one that is just ending is not.
    served_since_s
        When the present service began.
    resumed_s
        When a service that stood still last went on.
    wind_silent_since_s
        When the wind sensor fell silent last.
    disk
        The disk that the service writes to.
    commands
        Tasks of persons' commands that are under way; they die with the service.
    on_new_process
        Called for each new service before it runs, to apply a fault that lasts outside of the process.
    """

    def __init__(
        self,
        loop: VirtualTimeLoop,
        settings: Settings,
        start: datetime,
        weather: ManualWeather,
        setup: Setup,
        witnesses: Sequence[Witness],
    ) -> None:
        self.plugged = dict.fromkeys(PLUGGABLE_DEVICES, True)
        self.settings = settings
        self.mounts = [PlantTracker(self, place, witness) for place, witness in enumerate(witnesses)]
        self.served = asyncio.Event()
        self.served_since_s = math.inf
        self.resumed_s = -math.inf
        self.wind_silent_since_s = -math.inf
        self.commands: set[asyncio.Task[None]] = set()
        self.on_new_process = no_op
        self._serving: asyncio.Task[None] | None = None
        self._stop = asyncio.Event()
        self.disk = Disk()
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
        for mount in self.mounts:
            mount.restore_cable()

    def build_unit(self, settings: Settings, setup: Setup | None) -> PositionerCore:
        """Return the simulated unit of a tracker, or its rotator."""
        if settings.instruments.positioner.driver == ROTCTLD:
            return SleeplessRotator(settings, self.clock, UNIT_OWN_TARGET)  # type: ignore[return-value] # it passes for one
        return super().build_unit(settings, setup and configured_setup(settings, setup))

    def build_driver(self, unit: PositionerCore, settings: Settings) -> Positioner:
        """Return the driver of the next unit, with a tap on either side of it."""
        return self.mounts[len(self.cables.positioners)].build_driver(unit, settings, super().build_driver)

    def make_state_folder(self, directory: Path | None) -> StateFolder:
        """Return the folder of the files that a service keeps, on a disk that can be full."""
        return StateFolder(directory, replace=self.disk.replace, reserve=self.disk.reserve)

    def note(self, record: Record) -> None:
        """Keep the records that a watch may ask for, and show scans to the witness."""
        if isinstance(record, Event | Move | ModeChange):
            self.records.append(record)
            for mount in self.mounts:
                if is_relevant_to(record, mount.name):
                    mount.records.append(record)
        elif isinstance(record, Scan):
            self.mounts[0].witness.note_scan(record)

    @property
    def is_served(self) -> bool:
        """Whether a service is there; one that is just ending is not."""
        return self.served.is_set()

    def sleep(self, lasts_s: float) -> None:
        """Let the machine sleep for `lasts_s`, with its services, while the world goes on."""
        self.clock.slept_s += lasts_s
        for mount in self.mounts:
            mount.witness.note_wake_up(lasts_s)

    def kept_files(self) -> list[Path]:
        """Return the files that the service has kept for its next start."""
        return sorted(path for path in self.directory.rglob("*") if path.is_file())

    def plug(self, device: str, *, up: bool) -> None:
        """Pull a cable of the cube, or put it back."""
        self.plugged[device] = up
        getattr(self.cables, device).link_up = up

    def start(self) -> None:
        """Start the service that has been built."""
        self._stop = asyncio.Event()
        self._serving = asyncio.create_task(self.service.run(self._stop), name="service")
        self._serving.add_done_callback(self._report_unexpected_end)
        self.served.set()
        self.served_since_s = self.clock.monotonic()
        for mount in self.mounts:
            mount.witness.note_service_start()

    def _report_unexpected_end(self, task: "asyncio.Task[None]") -> None:
        if task is self._serving and not task.cancelled():
            self.mounts[0].witness.add_violation("service-died", f"the service ended by itself: {task.exception()!r}")

    async def kill(self) -> None:
        """Let the process die at once: it sends no more bytes and changes no file."""
        serving, self._serving = self._serving, None
        self.served.clear()
        self._cut_all_lines()
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
        self._cut_all_lines()

    def _cut_all_lines(self) -> None:
        """Let the process send no more bytes."""
        for mount in self.mounts:
            mount.line.dead = True

    def start_new_process(self) -> None:
        """Build and start a new process on the same instruments and files."""
        self.connect(self.settings)
        self.bus = Bus()
        self.bus.subscribe(self.note)
        self.service = self.serve(self.settings, Role.BOTH)
        self.on_new_process()
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
                self.mounts[0].witness.add_violation("service-died", f"the service did not end in order: {outcome!r}")
