"""Starting the service for real: loop, clock, signals, log, display."""

import asyncio
import contextlib
import logging
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC
from functools import partial
from importlib.metadata import version
from pathlib import Path
from random import SystemRandom

from rich.console import Console

from daemon.api.app import Api
from daemon.api.configuration import OwnConfiguration
from daemon.api.server import ApiServer
from daemon.api.token import generate_token, load_token
from daemon.base import process
from daemon.base.clock import Clock, LoopClock, SystemClock, iso_utc
from daemon.base.errors import UserError
from daemon.base.installation import release
from daemon.base.process import SystemdNotifier, on_signals
from daemon.base.records import Bus, Event
from daemon.base.state import StateFolder
from daemon.base.timeloop import new_loop
from daemon.bridge.key_file import KeyFileWatch
from daemon.bridge.signing import generate_key, load_keys
from daemon.commands.status.live import LiveView
from daemon.commands.status.screen_log import ScreenLogStream
from daemon.config.settings import Settings
from daemon.config.simulation import DEFAULT_START
from daemon.cube.calibration import calibration_to_run
from daemon.mqtt.companion import Mqtt, links
from daemon.rigs.real import build_real_rig
from daemon.service.health import LoopWatch
from daemon.service.operator_commands import Operators
from daemon.service.recent import RecentRecords
from daemon.service.rig import Rig, Role
from daemon.service.service import Service
from daemon.service.snapshot import Snapshot, snapshot
from daemon.service.state import state_json
from daemon.store.records_folder import lock_folder
from daemon.store.release_kept import CUBE_FILE_NAME, FILE_NAME, ReleaseWatch
from daemon.store.settings_kept import CUBE_FILE_NAME as CUBE_SETTINGS_NAME
from daemon.store.settings_kept import FILE_NAME as SETTINGS_NAME
from daemon.store.settings_kept import publish_changes
from daemon.store.store import Origin, Store, new_run_id
from daemon.sunspec.server import SunSpecServer

log = logging.getLogger("heliocube")

# Pages, keys and files need a thread for a moment. Each tracker's MQTT link needs one more while the name of its broker
# is looked up, which takes seconds if no name server answers.
_THREADS = 8


def run_service(
    settings: Settings, role: Role, for_s: float | None, console: Console, config: Path | None = None
) -> None:
    """Run one role of the service until SIGINT, SIGTERM, SIGHUP or the end of `for_s` seconds of wall time.

    `config` is the file that the settings are from; by it commands know which service they reach.

    Raises
    ------
    UserError
        Something in the settings cannot work here: a weather file, a key, an address.
    """
    keys = bridge_keys(settings, role)
    calibration = None if role is Role.TRACKER else calibration_to_run(settings)
    journal = "JOURNAL_STREAM" in os.environ
    process.configure_logging(
        ScreenLogStream(console) if console.is_terminal and sys.stderr.isatty() else sys.stderr,
        journal=journal,
        level=logging.WARNING if console.is_terminal else logging.INFO,
    )
    # Real instruments run in real time, whatever the section simulation says.
    speed = 1.0 if settings.real else settings.simulation.speed
    roles = (Role.CUBE, Role.TRACKER) if role is Role.BOTH else (role,)
    with (
        lock_folder(settings.store.directory, tuple(each.value for each in roles)),
        asyncio.Runner(loop_factory=lambda: new_loop(speed)) as runner,
    ):
        loop = runner.get_loop()
        loop.set_default_executor(ThreadPoolExecutor(_THREADS + len(settings.trackers)))
        clock = _clock(settings, loop)
        rig = _rig(settings, role, clock, (for_s or 0.0) * speed)
        bus = Bus()
        recent = RecentRecords(several=len(settings.trackers) > 1)
        bus.subscribe(recent.note)
        mqtt = links(settings, role, clock, SystemRandom(), bus.publish, speed)
        name = CUBE_FILE_NAME if role is Role.CUBE else FILE_NAME
        releases = ReleaseWatch(StateFolder(settings.store.directory, behind=True), name, release(), clock, bus.publish)
        service = Service(
            settings,
            role,
            rig,
            clock,
            SystemRandom(),
            bus,
            keys[0] if keys else None,
            SystemdNotifier(os.environ, os.getpid()),
            speed,
            calibration,
            stow_sources={name: link.stow_sources() for name, link in mqtt.items()},
            send_beyond=_sender(settings, mqtt),
            kept_in=partial(StateFolder, behind=True),
            hold_why=releases.hold_why,
        )
        if not settings.real:
            fields = {"role": role, "speed": speed}
            log.warning("SIMULATED instruments: no hardware is moved", extra={"fields": fields})
        else:
            log.info("real instruments", extra={"fields": {"role": role}})
            if rig.simulated:
                log.warning("SIMULATED by a bench, as instruments.bench says: all records are marked so")
            if not isinstance(clock, SystemClock):
                log.warning("the clock is a bench's: it shows %s", iso_utc(clock.utc()))
        # Open ports before the store: a service that cannot have its address leaves no run there.
        runner.run(service.open())
        with _store(service, role, loop, console) as store:

            def see(tracker: str | None = None, *, glance: bool = False) -> Snapshot:
                kept = store.status if store else None
                names = mqtt if tracker is None else (tracker,)
                statuses = {name: mqtt[name].status for name in names}
                return snapshot(service, recent, speed, kept, statuses, tracker=tracker, glance=glance)

            for name, link in mqtt.items():
                link.attach(service, partial(see, name or None))
            key_file = _key_file(settings, keys, service, speed)
            own = OwnConfiguration(config, [each.name for each in service.trackers])
            api = _api(service, recent, speed, see, partial(see, glance=True), own, console, journal=journal)
            # In a journal the log is enough; status lines would only fill it.
            view = None if journal else LiveView(lambda: state_json(see()), console, speed)
            companions = (view, api, _sunspec(service, speed, see), key_file, service.loop_watch, *mqtt.values())
            process.freeze_startup_objects()
            runner.run(_run(service, for_s, speed, releases, companions))
    moving = [each.name for each in service.trackers if not each.is_stop_confirmed]
    stands = f"; motion is NOT known to be stopped: {', '.join(moving)}" if moving else "; motion is stopped"
    _print(console, f"ended at {iso_utc(clock.utc())[:19]}Z{stands if service.trackers else ''}")


def _print(console: Console, text: str) -> None:
    """Print a line; if the terminal, the disk or the reader is gone, go on without it."""
    # For a closed pipe rich raises SystemExit.
    with contextlib.suppress(OSError, SystemExit):
        console.print(text, highlight=False, soft_wrap=True)


def missing_requirements(settings: Settings, role: Role) -> list[str]:
    """Return why a role cannot run with these settings, as far as that is known without devices; empty if it can."""
    needed: list[Callable[[], object]] = [partial(bridge_keys, settings, role)]
    if settings.real:
        parts = (Role.CUBE, Role.TRACKER) if role is Role.BOTH else (role,)
        needed += [partial(build_real_rig, settings, part, SystemClock()) for part in parts]
    found = []
    for each in needed:
        try:
            each()
        except UserError as error:
            found.append(str(error))
    return found


def bridge_keys(settings: Settings, role: Role) -> tuple[bytes, ...]:
    """Return the keys of scans, first the one that signs; none for an insecure bridge.

    If no file is named, a new key is made for cube and tracker in one process.

    Raises
    ------
    UserError
        The file is missing, unsafe or no key, or two processes need a shared key and no file is named.
    """
    bridge = settings.bridge
    if bridge.key_file is not None:
        return load_keys(bridge.key_file)
    if bridge.insecure:
        return ()
    if role is Role.BOTH:
        return (generate_key(),)
    raise UserError(
        f"bridge.key_file: the role '{role}' needs the key that cube and tracker share; "
        "make one with 'heliocube config init DIR', or set bridge.insecure = true for a closed lab network"
    )


def _key_file(settings: Settings, keys: tuple[bytes, ...], service: Service, speed: float) -> KeyFileWatch | None:
    """Return the watch of the key file for new keys, or None if there is no file."""
    path = settings.bridge.key_file
    if path is None:
        return None
    service.take_keys(keys)
    return KeyFileWatch(path, keys, service.take_keys, speed)


def _rig(settings: Settings, role: Role, clock: Clock, duration_s: float) -> Rig:
    if settings.real:
        return build_real_rig(settings, role, clock)
    # Import late: a service on real instruments needs no simulator, and starts in half the time without it.
    from daemon.rigs.simulated import build_simulated_rig, build_weather

    weather, warning = build_weather(settings, clock.utc(), clock.utc() + duration_s, with_gaps=True)
    if warning:
        log.warning(warning)
    return build_simulated_rig(settings, role, clock, weather)


def _clock(settings: Settings, loop: asyncio.AbstractEventLoop) -> Clock:
    simulation = settings.simulation
    system = SystemClock()
    if settings.real and settings.bench_clock is None:
        return system
    if simulation.start_utc is None and simulation.speed == 1.0:
        return system
    speed = 1.0 if settings.real else simulation.speed
    start = simulation.start_utc or DEFAULT_START
    start_utc_s = start.replace(tzinfo=start.tzinfo or UTC).timestamp()
    if simulation.anchor_utc is not None:
        anchor = simulation.anchor_utc
        anchor_utc_s = anchor.replace(tzinfo=anchor.tzinfo or UTC).timestamp()
        start_utc_s += (system.utc() - anchor_utc_s) * speed
    return LoopClock(loop.time, start_utc_s)


@contextlib.contextmanager
def _store(service: Service, role: Role, loop: asyncio.AbstractEventLoop, console: Console) -> Iterator[Store | None]:
    """Keep every record of the service, if the settings say where; records that still wait are written at the end."""
    settings, site = service.settings.store, service.settings.site
    if settings.directory is None:
        _print(console, "nothing is kept: no store.directory is set")
        yield None
        return

    def publish(event: Event) -> None:
        # When the loop has ended, events of the store are only in the log.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(service.bus.publish, event)

    def alarm(name: str, text: str | None) -> None:
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(service.cube_alarms.set, name, text)

    origin = Origin(
        started_utc_s=service.clock.utc(),
        role=role.value,
        version=version("heliocube"),
        simulated=service.rig.simulated,
        site=site.name,
        latitude_deg=site.latitude_deg,
        longitude_deg=site.longitude_deg,
        altitude_m=site.altitude_m,
        # In a run of several trackers each record has the name of its own tracker.
        tracker="" if len(service.settings.trackers) > 1 else role.name_or_default(service.settings.mqtt.name),
        id=new_run_id(),
    )
    store = Store(settings.directory, settings.batch_s, settings.keep_days, origin, service.clock, publish, alarm)
    service.bus.subscribe(store.keep)
    name = CUBE_SETTINGS_NAME if role is Role.CUBE else SETTINGS_NAME
    said = service.settings.model_dump(mode="json")
    publish_changes(said, settings.directory, service.clock, service.bus.publish, name)
    try:
        yield store
    finally:
        store.close()


def _api(
    service: Service,
    recent: RecentRecords,
    speed: float,
    see: Callable[[], Snapshot],
    glance: Callable[[], Snapshot],
    own: OwnConfiguration,
    console: Console,
    *,
    journal: bool,
) -> ApiServer | None:
    """Return the local interface, which prints its address once it has its port; None if it is switched off."""
    settings = service.settings.api
    if not settings.enabled:
        return None
    token = generate_token() if settings.token_file is None else load_token(settings.token_file)
    where = f"the token of commands is in {settings.token_file}"
    if settings.token_file is None:
        # No token in a journal: more people read it than a terminal.
        where = "commands need api.token_file" if journal else f"commands need HELIOCUBE_TOKEN={token}"

    def print_address(url: str) -> None:
        _print(console, f"local interface at {url}; {where}")

    operators = Operators(service.trackers, speed, service.cube_alarms)
    api = Api(see, recent, operators, token, service.clock, speed, settings.hosts, glance, own)
    return ApiServer(settings, api, service.clock, service.cube_alarms.set, print_address, speed)


def _sunspec(service: Service, speed: float, see: Callable[[], Snapshot]) -> SunSpecServer | None:
    """Return the SunSpec device; None if it is switched off."""
    if not service.settings.sunspec.enabled:
        return None
    operators = Operators(service.trackers, speed)
    return SunSpecServer(service.settings, see, operators, service.clock, service.cube_alarms.set, speed)


def _sender(settings: Settings, mqtt: Mapping[str, Mqtt]) -> Callable[[bytes], None] | None:
    """Return the function that sends scans to a broker, or None if they go another way."""
    if settings.bridge.transport != "mqtt":
        return None
    return next((link.send_scan for link in mqtt.values()), None)


async def _run(
    service: Service,
    for_s: float | None,
    speed: float,
    releases: ReleaseWatch,
    companions: Iterable[LiveView | ApiServer | SunSpecServer | KeyFileWatch | LoopWatch | Mqtt | None],
) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    with on_signals(lambda: loop.call_soon_threadsafe(stop.set)) as end:
        if for_s is not None:
            loop.call_later(for_s * speed, end)
        running = (companion.run() for companion in companions if companion is not None)
        await service.run(stop, releases.run(lambda: service.is_everything_saved), *running)
