"""The rig as it goes on while processes die on it: one unit, one cube, one sky, and one service after another."""

import asyncio
import logging
import math
import shutil
from datetime import UTC, datetime

from daemon.base.records import Bus, Event
from daemon.config.settings import Settings
from daemon.service.rig import Role
from sim_drivers.pozsol.setup import Setup
from solar.frames import Angles
from tests.support.rig import HandWeather, ServiceRig

HOMED = "homing finished"
UNIT_GOES_TO = Angles(35.0, 30.0)
"""Where the unit's own tracking and its stow modes drive, far from what the service ever asks for by itself."""


class UnitTap:
    """The unit as one process reaches it: what is sent is heard, and a dead process sends nothing more."""

    def __init__(self, unit, hear):
        self._unit = unit
        self._hear = hear
        self.dead = False

    def feed(self, data, now):
        if not self.dead:
            self._hear(data, now)
            self._unit.feed(data, now)

    def __getattr__(self, name):
        return getattr(self._unit, name)


class DriverTap:
    """The positioner's driver, with every order that goes through it told to the watch."""

    def __init__(self, driver, line, watch):
        self._driver = driver
        self._watch = watch
        self.line = line

    def __getattr__(self, name):
        return getattr(self._driver, name)

    async def move_to(self, a_deg, b_deg, **how):
        if self.line.dead:
            return await self._driver.move_to(a_deg, b_deg, **how)
        with self._watch.sending((a_deg, b_deg)):
            await self._driver.move_to(a_deg, b_deg, **how)
        return None

    async def home(self, axis):
        if not self.line.dead:
            self._watch.homes(axis)
        return await self._driver.home(axis)


class Plant(ServiceRig):
    """The instruments, and the service that runs on them at present.

    Parameters
    ----------
    loop, settings, start, weather, setup
        As for `ServiceRig`.
    watch
        Is told of orders, services and commands; see `tests.campaign.watch`.
    """

    def __init__(self, loop, settings, start, weather, setup, watch):
        self.watch = watch
        self.watch.plant = self
        self.plugged = dict.fromkeys(("positioner", "multiplexer", "voltmeter"), True)
        self._lasting = settings
        self.serving = None
        self.served = asyncio.Event()
        self.served_since_s = math.inf
        self.commands = set()
        self._stop = None
        super().__init__(loop, settings, start, weather, Role.BOTH, setup)

    def connect(self, settings):
        super().connect(settings)
        for device, up in self.plugged.items():
            getattr(self.cables, device).link_up = up

    def drive(self, unit, settings):
        line = UnitTap(unit, self.watch.heard)
        return DriverTap(super().drive(line, settings), line, self.watch)

    @property
    def is_served(self):
        """Whether a service is there; one that is just ending is not."""
        return self.served.is_set()

    def wishes(self):
        """Return what persons have asked for, as it is kept."""
        kept = self._lasting.store.directory / "operator.json"
        return kept.read_bytes() if kept.is_file() else b""

    def kept_files(self):
        """Return what the service has kept for its next start."""
        return sorted(path for path in self._lasting.store.directory.rglob("*") if path.is_file())

    def has_homed(self, since_s):
        """Tell whether a reference run of both axes has ended well since then."""
        return any(record.text == HOMED and record.time_monotonic_s >= since_s for record in self.of(Event))

    def plug(self, device, *, up):
        self.plugged[device] = up
        getattr(self.cables, device).link_up = up
        if device == "positioner":
            self.watch.link_changes()

    def start(self):
        """Start the service that has been built."""
        self._stop = asyncio.Event()
        self.serving = asyncio.create_task(self.service.run(self._stop), name="service")
        self.serving.add_done_callback(self._ended)
        self.served.set()
        self.served_since_s = self.clock.monotonic()
        self.watch.service_begins()

    def _ended(self, task):
        if task is self.serving and not task.cancelled():
            self.watch.fails("service-died", f"the service ended by itself: {task.exception()!r}")

    async def kill(self):
        """Let the process die at once: not a byte goes out any more, and no file changes."""
        serving, self.serving = self.serving, None
        self.served.clear()
        self.positioner.line.dead = True
        kept = self._snapshot()
        await self._finish(serving, cancel=True)
        shutil.rmtree(self._lasting.store.directory, ignore_errors=True)
        for path, content in kept.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

    async def end(self):
        """Ask the service to end, as the service manager does."""
        serving, self.serving = self.serving, None
        self.served.clear()
        self._stop.set()
        await self._finish(serving, cancel=False)
        self.positioner.line.dead = True

    def renew(self):
        """Build and start a new process on the same instruments and files."""
        settings = self._lasting
        self.connect(settings)
        self.bus = Bus()
        self.bus.subscribe(self.records.append)
        self.service = self.serve(settings, Role.BOTH)
        self.start()

    async def _finish(self, serving, *, cancel):
        commands, self.commands = self.commands, set()
        for task in commands:
            task.cancel()
        if cancel:
            serving.cancel()
        outcomes = await asyncio.gather(serving, *commands, return_exceptions=True)
        for outcome in outcomes:
            if isinstance(outcome, Exception):
                self.watch.fails("service-died", f"the service did not end in order: {outcome!r}")

    def _snapshot(self):
        files = self._lasting.store.directory.rglob("*")
        return {path: path.read_bytes() for path in files if path.is_file()}


def build(loop, schedule, directory, watch):
    """Return the plant of a schedule, its service not yet started."""
    settings = Settings.model_validate(
        {
            "bridge": {"listen": "127.0.0.1:0", "send_to": ()},
            "law": {"name": schedule.law},
            "motion": {"rehome": schedule.rehome},
            "safety": {"stow_at_least_s": 120.0},
            "store": {"directory": str(directory)},
        }
    )
    setup = Setup(
        synchronous=schedule.synchronous,
        own_target=_own_target,
        wind_stow=UNIT_GOES_TO,
        snow_stow=UNIT_GOES_TO,
    )
    start = datetime.fromisoformat(schedule.start).replace(tzinfo=UTC)
    return Plant(loop, settings, start, HandWeather(*schedule.sky), setup, watch)


def _own_target(now_s):
    """Where the unit's own tracking points: it never stays for long."""
    return UNIT_GOES_TO if int(now_s // 300) % 2 else Angles(-20.0, 60.0)


class LogLines(logging.Handler):
    """Keeps the service's log lines with their time."""

    def __init__(self, now):
        super().__init__(logging.INFO)
        self._now = now
        self.lines = []

    def emit(self, record):
        self.lines.append((self._now(), record.levelname, record.name, record.getMessage()))
