"""Fixtures: the whole service on the in-process rig under virtual time, with every simulated instrument in hand."""

import asyncio
from datetime import UTC, datetime
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest

from daemon.base.clock import LoopClock
from daemon.base.files import StateFolder
from daemon.base.process import Notifier
from daemon.base.records import Bus
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.settings import Settings
from daemon.motion.motion import OFTEN, Polling
from daemon.rigs.real import build_multiplexed_cube, build_pozsol, build_voltmeter
from daemon.rigs.simulated_positioner import build_unit
from daemon.service.recent import Recent
from daemon.service.rig import Rig, Role, TrackerInstruments
from daemon.service.service import Service
from daemon.service.snapshot import snapshot
from drivers.load.chroma63600 import Chroma63600
from drivers.load.connection import sweep_settings
from drivers.switches.ni_usb6008 import NiMultiplexer
from sim_drivers.load.core import LoadCore
from sim_drivers.multiplexer import MultiplexerCore
from sim_drivers.pozsol.core import PositionerCore
from sim_drivers.pv_source import PvSource
from sim_drivers.scene import Scene, SensorModel
from sim_drivers.transports import InMemoryLine, InMemoryPort, InMemoryStream
from sim_drivers.voltmeter.core import VoltmeterCore
from sim_drivers.weather import Conditions
from solar.ephemeris import Site
from solar.pv_module import Q_PEAK_G4_1_305

SITE = Site(48.717607, 2.209002, 156.0)
SENSORS = SensorModel(gain_error=0.0, noise_mv=0.02, cosine_error=0.0)
KEY = bytes(range(32))


class HandWeather:
    """Weather that a test sets by hand; the scene computes an hour ahead, so set it before the hour begins."""

    def __init__(self, dni=700.0, dhi=90.0):
        self.dni, self.dhi = dni, dhi

    def at(self, utc_s):
        one = np.ones_like(utc_s)
        return Conditions(one * np.nan, one * self.dni, one * self.dhi, one * np.nan, one * np.nan)

    def covers(self, utc_s):
        return np.ones(utc_s.shape, dtype=bool)


class SteppingClock(LoopClock):
    """A clock whose UTC a test can set."""

    step_s = 0.0

    def utc(self):
        return super().utc() + self.step_s


class ServiceRig:
    """One service, its instruments, and everything it has published."""

    polling = OFTEN
    kept_in = StateFolder

    def __init__(self, loop, settings, start, weather, role, setup=None, polling=OFTEN):
        self.polling = polling
        self.clock = SteppingClock(loop.time, start.timestamp())
        self.weather = weather
        self.wind_m_s = 3.0
        self.scene = Scene(SITE, weather, sky_model="isotropic", seed=1, sensors=SENSORS)
        self.switch = MultiplexerCore(inputs=self._sensor, latency_s=0.0)
        self.meter = VoltmeterCore(input_voltage=self.switch.output_voltage, random=np.random.default_rng(1))
        self.unit = PositionerCore(loop.time(), setup) if setup else build_unit(settings, self.clock)
        self.cables = SimpleNamespace()
        self.connect(settings)
        self.source = PvSource(self.scene, lambda _now: self.truth(), lambda _now: self.clock.utc(), Q_PEAK_G4_1_305)
        self.load_core = LoadCore(self.source, np.random.default_rng(2))
        self.cables.load = InMemoryLine("load", self.load_core, loop.time)
        self.load = Chroma63600(self.cables.load, self.load_core.channel, sweep_settings(settings.load))
        self.bus = Bus()
        self.records = []
        self.bus.subscribe(self.records.append)
        self.service = self.serve(settings, role)

    def connect(self, settings):
        """Lay the cables of cube and positioner, and put a driver at the end of each."""
        now, cables = self.clock.monotonic, self.cables
        cables.multiplexer = InMemoryPort(self.switch, now)
        cables.voltmeter = InMemoryLine("voltmeter", self.meter, now)
        self.multiplexer = NiMultiplexer(cables.multiplexer)
        self.voltmeter = build_voltmeter(settings, line=cables.voltmeter)
        self.cube = build_multiplexed_cube(settings, self.clock, self.multiplexer, self.voltmeter)
        self.positioner = self.drive(self.unit, settings)
        own = [named.settings for named in settings.trackers[1:]]
        cables.others = [InMemoryStream(build_unit(one, self.clock), now) for one in own]
        self.others = [build_pozsol(one, self.clock, line) for one, line in zip(own, cables.others, strict=True)]

    def drive(self, unit, settings):
        """Return the driver of a unit, or of what stands between."""
        self.cables.positioner = InMemoryStream(unit, self.clock.monotonic)
        return build_pozsol(settings, self.clock, self.cables.positioner)

    def serve(self, settings, role):
        """Return a service on these instruments, as a newly started process would be."""
        return Service(
            settings,
            role,
            Rig(
                self.cube,
                (
                    TrackerInstruments(self.positioner, None if settings.load.driver == "none" else self.load),
                    *(TrackerInstruments(positioner) for positioner in self.others),
                ),
                lambda: self.wind_m_s,
                simulated=True,
            ),
            self.clock,
            Random(1),
            self.bus,
            KEY,
            Notifier({}, 0),
            polling=self.polling,
            kept_in=self.kept_in,
        )

    def _sensor(self, channel, now_s):
        utc_s = self.clock.utc() + now_s - self.clock.monotonic()
        return self.scene.sensor_voltage(channel, utc_s) if channel < 4 else None

    @property
    def tracker(self):
        return self.service.trackers[0]

    @property
    def control(self):
        return self.tracker.control

    @property
    def motion(self):
        return self.tracker.motion

    @property
    def mode(self):
        return self.control.mode

    def see(self, recent=None, store=None):
        """Take a snapshot; `recent` knows what came over the bus, as far as a test wants to see of it."""
        return snapshot(self.service, Recent() if recent is None else recent, 1.0, store, {})

    def truth(self):
        return self.unit.truth(self.clock.monotonic())

    def of(self, kind):
        return [record for record in self.records if isinstance(record, kind)]

    async def until(self, condition, within_s, what, every_s=0.02):
        """Let time pass until the condition holds; it is looked at `every_s`."""
        deadline = self.clock.monotonic() + within_s
        while not condition():
            assert self.clock.monotonic() < deadline, f"{what} did not happen within {within_s} s; mode {self.mode}"
            await asyncio.sleep(every_s)

    async def until_mode(self, mode, within_s):
        await self.until(lambda: self.mode is mode, within_s, f"mode {mode}")


@pytest.fixture
def run_rig():
    """Run a scenario, an async function that is given the rig, beside the service.

    Where hours pass and nothing hangs on it, a positioner at rest may be looked at less often than the service does.
    """

    def run(
        scenario, *, start="2022-10-12T10:00", weather=None, role=Role.BOTH, setup=None, rest_look_s=None, **sections
    ):
        sections.setdefault("bridge", {}).update(listen="127.0.0.1:0", send_to=())
        settings = Settings.model_validate(sections)
        with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
            loop = runner.get_loop()
            rig = ServiceRig(
                loop,
                settings,
                datetime.fromisoformat(start).replace(tzinfo=UTC),
                HandWeather() if weather is None else weather,
                role,
                setup,
                OFTEN if rest_look_s is None else Polling(idle_s=rest_look_s),
            )

            async def beside():
                stop = asyncio.Event()
                serving = asyncio.create_task(rig.service.run(stop))
                acting = asyncio.create_task(scenario(rig))
                await asyncio.wait((serving, acting), return_when=asyncio.FIRST_COMPLETED)
                stop.set()
                outcomes = await asyncio.gather(serving, acting, return_exceptions=True)
                for outcome in reversed(outcomes):
                    if isinstance(outcome, BaseException):
                        raise outcome

            runner.run(beside())
        return rig

    return run
