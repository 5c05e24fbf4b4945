"""Simulated instruments, alone or with a cube and two trackers under one sky, and the bench that serves them."""

import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from daemon.base import plugins
from daemon.base.clock import Clock
from daemon.base.errors import UserError
from daemon.base.records import FACES
from daemon.config.plugin_sections import LOAD
from daemon.config.settings import Settings
from daemon.config.simulation import WeatherName
from daemon.rigs.measured import CubeInGaps, missing_by_day, weather_notes
from daemon.rigs.real import build_pozsol, positioner_surroundings
from daemon.rigs.simulated_cube import build_bench_sensors, build_cube_cores, build_simulated_cube
from daemon.rigs.simulated_positioner import build_unit
from daemon.rigs.simulated_rotator import build_rotator, build_simulated_rotator, rotator_truth
from daemon.service.rig import Rig, Role, TrackerInstruments
from drivers.interfaces import Cube, ElectronicLoad, Positioner
from drivers.load.chroma63600 import Chroma63600
from drivers.load.connection import sweep_settings
from drivers.positioners.pozsol.driver import PozsolSettings
from drivers.positioners.rotctld.driver import RotctldSettings
from sim_drivers.load.core import LoadCore
from sim_drivers.pv_source import PvSource, SourceLight
from sim_drivers.scene import FaceGeometry, Scene, SensorModel, default_faces
from sim_drivers.transports import InMemoryLine, InMemoryStream
from sim_drivers.weather import GeneratedWeather, Weather, WeatherError, WeatherInParts
from sim_drivers.weather_files import MeasuredWeather, load_weather
from solar.ephemeris import DAY_S, extraterrestrial_dni, sun_direction
from solar.frames import Angles, Array
from solar.pv_module import Q_PEAK_G4_1_305, PvModule
from solar.skies.sky import Sky, sky

if TYPE_CHECKING:
    from sim_drivers.pozsol.core import PositionerCore

_FLAT = Angles(0.0, 90.0)
_COVER_EVERY_S = 60.0
_NO_LIGHT = SourceLight(0.0, 15.0)
_WIND_EVERY_S = 1800.0


def build_weather(
    settings: Settings, from_utc_s: float, to_utc_s: float, *, with_gaps: bool = False
) -> tuple[Weather, str | None]:
    """Return the simulated weather for a span of time, and a warning about a file or None.

    Parameters
    ----------
    settings
        The weather's name or file, the site and the seed.
    from_utc_s, to_utc_s
        The span [s UTC].
    with_gaps
        Whether gaps of the file by day count as missing data and not as an error; the span must have some weather.

    Raises
    ------
    UserError
        The file cannot be read, or does not cover the span.
    """
    choice, site = settings.simulation.weather, settings.site.place()
    if not isinstance(choice, Path):
        return GeneratedWeather(choice, site, settings.simulation.seed), None
    try:
        weather = load_weather(choice)
        reaches = weather.start_utc_s <= from_utc_s <= weather.end_utc_s
        if not reaches:
            # A night needs no weather, but the day after it does.
            to_utc_s = max(from_utc_s + DAY_S, to_utc_s)
        # A service may be told to run for ages: weather that is missing then is missing on the day after the file ends.
        to_utc_s = min(max(from_utc_s, weather.end_utc_s) + DAY_S, to_utc_s)
        instants = np.append(np.arange(from_utc_s, to_utc_s, _COVER_EVERY_S), to_utc_s)
        missing = missing_by_day(weather, site, instants)
        inside = (missing >= weather.start_utc_s) & (missing <= weather.end_utc_s)
        if with_gaps and weather.covers(instants).any():
            missing = missing[~inside]
        try:
            weather.at(missing)
        except WeatherError as error:
            if reaches:
                raise
            # Round up to a whole second, so that the file has begun by then.
            first = datetime.fromtimestamp(math.ceil(weather.start_utc_s), UTC)
            raise UserError(f"{error}; add --start {first:%Y-%m-%dT%H:%M:%SZ}, or another of its instants") from error
        return weather, "; ".join(weather_notes(weather, site, from_utc_s, to_utc_s)) or None
    except WeatherError as error:
        raise UserError(str(error)) from error


def build_simulated_rig(settings: Settings, role: Role, clock: Clock, weather: Weather) -> Rig:
    """Build the simulated instruments that a role needs, under one sky; `UserError` for a real load among them."""
    scene = _build_scene(settings, weather)
    rig = _bare_rig(scene, clock, weather)
    if role is not Role.TRACKER:
        cube = build_simulated_cube(settings, clock, scene)
        rig = replace(rig, cube=_silent_in_gaps(cube, settings, clock, weather))
    if role is not Role.CUBE:
        built = [
            _build_tracker(own, clock, scene, Q_PEAK_G4_1_305, _noise_of_load(settings, number))
            for number, (_, own) in enumerate(settings.trackers)
        ]
        rig = replace(rig, trackers=tuple(instruments for _, instruments in built))
    return rig


@dataclass(frozen=True, slots=True)
class SimulatedPair:
    """The instruments of a cube and two trackers under one sky.

    Attributes
    ----------
    rigs
        Cube and first tracker; second tracker.
    truths
        Where each tracker's axes truly stand at a monotonic time.
    overhead
        The sky over them, the temperature of the air [degC] and the wind [m/s] at instants (n,) [s UTC]; NaN where the
        weather does not have them, also for the light in its gaps.
    """

    rigs: tuple[Rig, Rig]
    truths: tuple[Callable[[float], Angles], Callable[[float], Angles]]
    overhead: Callable[[Array], tuple[Sky, Array, Array]]


def build_simulated_pair(
    settings: Settings, clock: Clock, weather: Weather, modules: tuple[PvModule, PvModule]
) -> SimulatedPair:
    """Build the simulated instruments of a cube and two trackers; `UserError` for a real load."""
    scene = _build_scene(settings, weather)
    cube = _silent_in_gaps(build_simulated_cube(settings, clock, scene), settings, clock, weather)
    (one, first), (other, second) = (
        _build_tracker(settings, clock, scene, module, np.random.default_rng([settings.simulation.seed, 2, number]))
        for number, module in enumerate(modules)
    )

    def overhead(utc_s: Array) -> tuple[Sky, Array, Array]:
        covered = weather.covers(utc_s)
        told = weather.at(utc_s[covered])
        columns = (told.dni_w_m2, told.dhi_w_m2, told.temp_air_degc, told.wind_speed_m_s)
        dni, dhi, air, wind = (np.full(utc_s.shape, np.nan) for _ in columns)
        for whole, part in zip((dni, dhi, air, wind), columns, strict=True):
            whole[covered] = part
        sun, extra = sun_direction(utc_s, *settings.site.place()), extraterrestrial_dni(utc_s)
        return sky(settings.simulation.sky, sun, dni, dhi, extra), air, wind

    around = _bare_rig(scene, clock, weather)
    rigs = (
        replace(around, cube=cube, trackers=(first,)),
        replace(around, trackers=(second,)),
    )
    return SimulatedPair(rigs, (one, other), overhead)


def _silent_in_gaps(cube: Cube, settings: Settings, clock: Clock, weather: Weather) -> Cube:
    """Return a cube that does not answer in the gaps of measured weather."""
    return CubeInGaps(cube, weather, settings.site.place(), clock) if isinstance(weather, MeasuredWeather) else cube


def build_weather_in_parts(settings: Settings, parts: Sequence[tuple[float, WeatherName]]) -> Weather:
    """Return built-in weather of several kinds, each from its instant [s UTC] on; the first one also before."""
    site, seed = settings.site.place(), settings.simulation.seed
    return WeatherInParts([(begin_utc_s, GeneratedWeather(kind, site, seed)) for begin_utc_s, kind in parts])


def _bare_rig(scene: Scene, clock: Clock, weather: Weather) -> Rig:
    """Return a rig of no instruments under a sky."""

    def wind() -> float | None:
        # Called every second of a simulated day: a context manager would cost more time.
        try:
            return scene.wind_speed(clock.utc())
        except WeatherError as error:
            raise UserError(str(error)) from error

    sensor = wind if _has_wind(weather) else None
    return Rig(None, (), sensor, simulated=True, sky_text=partial(_sky_text, scene, clock))


def _has_wind(weather: Weather) -> bool:
    """Tell whether weather has wind at all: without it the rig has no wind sensor, rather than a silent one."""
    if not isinstance(weather, MeasuredWeather):
        return True
    instants = np.arange(weather.start_utc_s, weather.end_utc_s, _WIND_EVERY_S)
    instants = instants[weather.covers(instants)]
    return instants.size == 0 or bool(np.isfinite(weather.at(instants).wind_speed_m_s).any())


def _build_tracker(
    settings: Settings, clock: Clock, scene: Scene, module: PvModule, noise: np.random.Generator
) -> tuple[Callable[[float], Angles], TrackerInstruments]:
    """Return where a tracker's axes truly stand, and its instruments."""
    truth, positioner = build_simulated_positioner(settings, clock)
    load = _build_load(settings, clock, _build_source(clock, scene, truth, module), noise)
    return truth, TrackerInstruments(positioner, load, has_fixed_start_pose=True)


class _Module(PvSource):
    def light_now(self, now: float) -> SourceLight:
        try:
            return super().light_now(now)
        except WeatherError:
            # Without weather there is no light. The cube reports that a file has ended.
            return _NO_LIGHT


def _build_source(clock: Clock, scene: Scene, pose: Callable[[float], Angles], module: PvModule) -> PvSource:
    def utc_s(now_s: float) -> float:
        return clock.utc() + now_s - clock.monotonic()

    def present(_now_s: float) -> Angles:
        # A load answers some milliseconds in the future; that must not move the axes ahead of all others' time.
        return pose(clock.monotonic())

    return _Module(scene, present, utc_s, module)


def _build_load(
    settings: Settings, clock: Clock, source: PvSource, noise: np.random.Generator
) -> ElectronicLoad | None:
    load = settings.load
    if load.driver == "none":
        return None
    if load.driver != "simulated":
        raise UserError(
            f'load.driver = "{load.driver}" is a real load and instruments.kind is "simulated":'
            ' set load.driver to "simulated"'
        )
    core = LoadCore(source, noise, now=clock.monotonic())
    return Chroma63600(InMemoryLine("load", core, clock.monotonic), core.channel, sweep_settings(load))


def _noise_of_load(settings: Settings, number: int = 0) -> np.random.Generator:
    """Return the random generator for the noise of a tracker's load; trackers are numbered from 0."""
    return np.random.default_rng([settings.simulation.seed, 2, *([number] if number else [])])


def _build_scene(settings: Settings, weather: Weather) -> Scene:
    simulation = settings.simulation
    return Scene(
        settings.site.place(),
        weather,
        sky_model=simulation.sky,
        albedo=simulation.albedo,
        seed=simulation.seed,
        sensors=SensorModel(gain_error=simulation.sensor_gain_error, noise_mv=simulation.sensor_noise_mv),
        faces=_faces(settings),
    )


def build_simulated_positioner(settings: Settings, clock: Clock) -> tuple[Callable[[float], Angles], Positioner]:
    """Build the simulated positioner; return where its axes truly stand at a time, and the instrument on its link.

    A driver with a function `simulate` simulates its own unit; `UserError` for one that cannot be simulated.
    """
    own = settings.instruments.positioner
    if isinstance(own, RotctldSettings):
        return build_simulated_rotator(settings, own, clock)
    simulate = getattr(plugins.load(plugins.POSITIONERS, own.driver), "simulate", None)
    if simulate is not None:
        truth, positioner = simulate(own, positioner_surroundings(settings, clock))
        return truth, positioner
    if not isinstance(own, PozsolSettings):
        raise UserError(
            f'instruments.positioner.driver = "{own.driver}" cannot be simulated and instruments.kind is "simulated":'
            ' set instruments.positioner.driver to "pozsol"'
        )
    core = build_unit(settings, clock)
    return core.truth, build_pozsol(settings, clock, InMemoryStream(core, clock.monotonic))


def _faces(settings: Settings) -> list[FaceGeometry]:
    """Return the cube's geometry; an azimuth that is not configured follows from the face's name at this site."""
    named = default_faces(settings.site.latitude_deg)
    faces = [getattr(settings.cube, name) for name in FACES]
    return [
        FaceGeometry(default.azimuth_deg if face.azimuth_deg is None else face.azimuth_deg, face.tilt_deg)
        for face, default in zip(faces, named, strict=True)
    ]


def _sky_text(scene: Scene, clock: Clock) -> str:
    try:
        sky = scene.sky_state(clock.utc())
        wind = scene.wind_speed(clock.utc())
    except WeatherError:
        return "a gap in the weather file"
    text = f"GHI {sky.ghi_w_m2:.0f}, DNI {sky.dni_w_m2:.0f}, DHI {sky.dhi_w_m2:.0f} W/m2"
    return text if wind is None else f"{text}, wind {wind:.1f} m/s"


class BenchPorts(NamedTuple):
    """Loopback ports of the bench: of NI's gRPC server, Modbus TCP and rotctld; 0 for one that is not there."""

    ni_server: int
    modbus: int
    rotctld: int


async def run_bench(
    settings: Settings,
    directory: Path,
    clock: Clock,
    weather: Weather,
    stop: asyncio.Event,
    ready: Callable[[BenchPorts], None],
) -> None:
    """Serve the simulated instruments on real transports until `stop` is set.

    A rotctld that the settings name is not served: somebody else runs it. `ready` is called with the ports as soon as
    all instruments are there. Raises `UserError` when the directory cannot be used.
    """
    try:
        from sim_drivers.bench.bench import Bench, BenchClock  # noqa: PLC0415 - needs pseudo-terminals, as nothing else does
        from sim_drivers.bench.client import BenchError  # noqa: PLC0415
        from sim_drivers.bench.control import BenchControl  # noqa: PLC0415
        from sim_drivers.bench.rotator_host import RotatorHost  # noqa: PLC0415
    except ImportError as error:
        raise UserError(f"the bench needs the pseudo-terminals of Linux, which are not here ({error})") from error

    scene = _build_scene(settings, weather)
    gaps = weather if isinstance(weather, MeasuredWeather) else None
    switch, meter = build_cube_cores(settings, clock, scene, gaps)
    own = settings.instruments.positioner
    unit: PositionerCore | RotatorHost | None = None
    if not isinstance(own, RotctldSettings):
        unit = build_unit(settings, clock)
    elif own.server is None:
        core = build_rotator(settings, own, clock)
        unit = RotatorHost(core, rotator_truth(core, settings), clock.monotonic)
    source = _build_source(clock, scene, (lambda _now_s: _FLAT) if unit is None else unit.truth, Q_PEAK_G4_1_305)
    noise, now_s = _noise_of_load(settings), clock.monotonic()
    if settings.load.driver == "agilent6063b":
        load = LoadCore(source, noise, make="agilent6063b", now=now_s)
    else:
        load = LoadCore(source, noise, channel=LOAD.with_driver(settings.load, "chroma63600").channel, now=now_s)
    bench = Bench(
        directory,
        scene,
        switch,
        meter,
        unit,
        load,
        source,
        BenchClock(clock.monotonic, clock.utc),
        settings.instruments.voltmeter.baud_rate,
        build_bench_sensors(settings, clock, scene),
    )

    def served() -> None:
        rotctld = bench.positioner.tcp_port if isinstance(bench.positioner, RotatorHost) else 0
        ready(BenchPorts(bench.multiplexer.port, getattr(bench.cube, "tcp_port", 0), rotctld))

    try:
        async with BenchControl(bench):
            await bench.run(stop, served)
    except BenchError as error:
        raise UserError(str(error)) from error
