"""The whole service on simulated instruments under a sky set by hand, with access to every instrument."""

from datetime import datetime
from pathlib import Path
from random import Random
from types import SimpleNamespace

import numpy as np

from daemon.base.clock import LoopClock
from daemon.base.process import SystemdNotifier
from daemon.base.records import Bus, Mode, Record
from daemon.base.state import StateFolder
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.motion.motion import Motion
from daemon.motion.polling import OFTEN, Polling
from daemon.rigs.real import build_multiplexed_cube, build_pozsol, build_voltmeter
from daemon.rigs.simulated_positioner import build_unit
from daemon.service.rig import Rig, Role, TrackerInstruments
from daemon.service.service import Service
from daemon.service.tracker import Tracker
from daemon.tracker.control import Control
from drivers.interfaces import Positioner
from drivers.load.chroma63600 import Chroma63600
from drivers.load.connection import sweep_settings
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.load.core import LoadCore
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pozsol.setup import Setup
from sim_drivers.pv_source import PvSource
from sim_drivers.scene import Scene, SensorModel
from sim_drivers.transports import InMemoryLine, InMemoryPort, InMemoryStream
from sim_drivers.voltmeter.core import VoltmeterCore
from sim_drivers.weather import Conditions
from solar.frames import Angles, Array
from solar.pv_module import Q_PEAK_G4_1_305

SENSORS = SensorModel(gain_error=0.0, noise_mv=0.02, cosine_error=0.0)
KEY = bytes(range(32))
CALM_M_S = 3.0
_FACES = 4


class ManualWeather:
    """Weather that is set by hand [W/m2]. The scene computes an hour ahead, so set it before the hour begins."""

    def __init__(self, dni: float = 700.0, dhi: float = 90.0) -> None:
        self.dni, self.dhi = dni, dhi

    def at(self, utc_s: Array) -> Conditions:
        """Return the same light at all instants, and no wind or temperature."""
        one = np.ones_like(utc_s)
        unknown = one * np.nan
        return Conditions(
            ghi_w_m2=unknown,
            dni_w_m2=one * self.dni,
            dhi_w_m2=one * self.dhi,
            wind_speed_m_s=unknown,
            temp_air_degc=unknown,
        )

    def covers(self, utc_s: Array) -> "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]":
        """Tell that there is weather at every instant."""
        return np.ones(utc_s.shape, dtype=bool)


class SteppingClock(LoopClock):
    """A clock whose UTC can be set, as on a PC, and whose monotonic time stands still while the machine sleeps.

    Attributes
    ----------
    step_s
        By how much UTC is off.
    slept_s
        How long the machine has slept so far: UTC and the world have gone on by this much more than monotonic time.
    """

    step_s = 0.0
    slept_s = 0.0

    def world_time_s(self, monotonic_s: float) -> float:
        """Return a monotonic time [s] plus all the time that the machine has slept."""
        return monotonic_s + self.slept_s

    def asleep_s(self) -> float:
        """Return `slept_s`, as a machine does that knows how long it slept."""
        return self.slept_s

    def utc(self) -> float:
        """UTC [s], off by `step_s`."""
        return self.true_utc() + self.step_s

    def true_utc(self) -> float:
        """UTC [s] as it truly is: the sun does not follow a clock that somebody has set."""
        return super().utc() + self.slept_s


class InMemoryRig:
    """One service, its instruments, and everything it has published.

    Parameters
    ----------
    loop
        The loop whose time the rig has.
    settings
        Settings of the service.
    start
        The instant at the loop's time 0.
    weather
        The sky.
    role
        Role of the service.
    setup
        How the positioners are built; None: as the settings say.
    polling
        How often the positioner is polled.

    Attributes
    ----------
    wind_m_s
        What the wind sensor says; None: it is silent.
    noise_v
        Standard deviation [V] of the noise on the sensors' cables.
    hold_why
        Why the service has to hold its trackers from the start, or None.
    synchronised
        What the kernel says of the PC's clock; None: nothing.
    has_fixed_start_pose
        Whether the place at which the positioner rested before tells nothing about where it is.
    """

    hold_why: str | None = None
    has_fixed_start_pose = False
    has_persistent_clock = False
    synchronised: bool | None = None

    def __init__(
        self,
        loop: VirtualTimeLoop,
        settings: Settings,
        start: datetime,
        weather: ManualWeather,
        role: Role,
        setup: Setup | None = None,
        polling: Polling = OFTEN,
    ) -> None:
        self.polling = polling
        self.clock = SteppingClock(loop.time, start.timestamp())
        self.weather = weather
        self.wind_m_s: float | None = CALM_M_S
        self.noise_v = 0.0
        self._noise = Random(1)  # noqa: S311 - a simulation
        self.scene = Scene(settings.site.place(), weather, sky_model="isotropic", seed=1, sensors=SENSORS)
        self.switch = MultiplexerCore(inputs=self._sensor, latency_s=0.0)
        self.meter = VoltmeterCore(input_voltage=self.switch.output_voltage, random=np.random.default_rng(1))
        self.units = [self.build_unit(named.settings, setup) for named in settings.trackers]
        self.unit = self.units[0]
        self.cables = SimpleNamespace()
        self.connect(settings)
        self.source = PvSource(
            self.scene, lambda _now: self.truth(), lambda _now: self.clock.true_utc(), Q_PEAK_G4_1_305
        )
        self.load_core = LoadCore(self.source, np.random.default_rng(2))
        self.cables.load = InMemoryLine("load", self.load_core, loop.time)
        self.load = Chroma63600(self.cables.load, self.load_core.channel, sweep_settings(settings.load))
        self.bus = Bus()
        self.records: list[Record] = []
        self.bus.subscribe(self.note)
        self.service = self.serve(settings, role)

    def build_unit(self, settings: Settings, setup: Setup | None) -> PositionerCore:
        """Return the simulated unit of a tracker."""
        return PositionerCore(self.clock.monotonic(), setup) if setup else build_unit(settings, self.clock)

    def note(self, record: Record) -> None:
        """Keep a record that was published."""
        self.records.append(record)

    def make_state_folder(self, directory: Path | None) -> StateFolder:
        """Return the folder of the files that a service keeps."""
        return StateFolder(directory)

    def connect(self, settings: Settings) -> None:
        """Lay the cables of cube and positioner, and put a driver at the end of each."""
        now, cables = self.clock.monotonic, self.cables
        cables.multiplexer = InMemoryPort(self.switch, now)
        cables.voltmeter = InMemoryLine("voltmeter", self.meter, now)
        self.multiplexer = NiMultiplexer(cables.multiplexer)
        self.voltmeter = build_voltmeter(settings, line=cables.voltmeter)
        self.cube = build_multiplexed_cube(settings, self.clock, self.multiplexer, self.voltmeter)
        cables.positioners = []
        self.positioner: Positioner
        self.positioner, *self.others = (
            self.build_driver(unit, named.settings) for unit, named in zip(self.units, settings.trackers, strict=True)
        )
        cables.positioner, *cables.others = cables.positioners

    def build_driver(self, unit: PositionerCore, settings: Settings) -> Positioner:
        """Lay the cable of a unit, or of a tap that stands for it, and return the driver."""
        line = InMemoryStream(unit, self.clock.monotonic)
        self.cables.positioners.append(line)
        return build_pozsol(settings, self.clock, line)

    def serve(self, settings: Settings, role: Role) -> Service:
        """Return a service on these instruments, as a newly started process would be."""
        return Service(
            settings,
            role,
            Rig(
                self.cube,
                (
                    TrackerInstruments(
                        self.positioner,
                        None if settings.load.driver == "none" else self.load,
                        has_fixed_start_pose=self.has_fixed_start_pose,
                    ),
                    *(TrackerInstruments(one, has_fixed_start_pose=self.has_fixed_start_pose) for one in self.others),
                ),
                lambda: self.wind_m_s,
                simulated=True,
                clock_synchronised=lambda: self.synchronised,
                has_persistent_clock=self.has_persistent_clock,
            ),
            self.clock,
            Random(1),  # noqa: S311 - jitter
            self.bus,
            KEY,
            SystemdNotifier({}, 0),
            polling=self.polling,
            kept_in=self.make_state_folder,
            hold_why=self.hold_why,
        )

    def _sensor(self, channel: int, now_s: float) -> float | None:
        utc_s = self.clock.true_utc() + now_s - self.clock.monotonic()
        if channel >= _FACES:
            return None
        noise_v = self._noise.gauss(0.0, self.noise_v) if self.noise_v else 0.0
        return self.scene.sensor_voltage(channel, utc_s) + noise_v

    @property
    def tracker(self) -> Tracker:
        """The first tracker."""
        return self.service.trackers[0]

    @property
    def control(self) -> Control:
        """What decides for it."""
        return self.tracker.control

    @property
    def motion(self) -> Motion:
        """What moves it."""
        return self.tracker.motion

    @property
    def mode(self) -> Mode:
        """What it does at present."""
        return self.control.mode

    def truth(self) -> Angles:
        """Return where the axes really stand."""
        return self.unit.truth(self.clock.monotonic())
