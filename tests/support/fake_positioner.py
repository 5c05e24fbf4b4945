"""Motion alone, in virtual time, with a positioner whose place and telemetry a test sets by hand."""

import asyncio
import math
from random import Random

from daemon.base.alarms.alarms import Alarms
from daemon.base.clock import LoopClock
from daemon.base.records import Event, Move, Pose
from daemon.base.state import StateFolder
from daemon.base.timeloop import VirtualTimeLoop
from daemon.config.sections import MotionSettings
from daemon.motion.motion import Motion
from daemon.motion.polling import OFTEN
from drivers.errors import LinkLostError, StillMovingError
from drivers.interfaces import PositionerIdentity, Telemetry
from drivers.settings import PositionerSettings
from solar.frames import Limits

START_UTC_S = 1_665_568_800.0
LIMITS = Limits(-50.0, 50.0, 15.0, 90.0)
SPEED_DEG_PER_S = 2.0
DEAF_S = 2.0


class FakePositioner:
    """A driver without a unit behind it: both axes turn at once, and it counts in degrees."""

    def __init__(self, clock):
        self._clock = clock
        self._at, self._to, self._since_s = [0.0, 60.0], [0.0, 60.0], clock.monotonic()
        self.sent = []
        self.telemetry_overrides = {}
        self.identity = PositionerIdentity("board", "1", "7")
        self.is_lost = self.is_deaf = False
        self.refuses = {}
        self.looks = 0
        # How old the status is when it is read.
        self.status_age_s = 0.0
        self.homes_s = 20.0
        self._homed_s = -math.inf

    def place(self):
        now_s = self._clock.monotonic()
        way = SPEED_DEG_PER_S * (now_s - self._since_s)
        self._at = [
            at + math.copysign(min(abs(to - at), way), to - at) for at, to in zip(self._at, self._to, strict=True)
        ]
        self._since_s = now_s
        return tuple(self._at)

    def drive(self, a_deg, b_deg):
        """Move as if another program had ordered it."""
        self.place()
        self._to = [a_deg, b_deg]

    def put(self, a_deg, b_deg):
        """Stand elsewhere at once, as after a jump of the count."""
        self._at, self._to, self._since_s = [a_deg, b_deg], [a_deg, b_deg], self._clock.monotonic()

    async def open(self):
        self._answer("open")
        return self.identity

    async def close(self):
        self.sent.append("close")

    async def read_telemetry(self):
        if self.is_lost:
            raise LinkLostError("hand", "does not answer")
        self.looks += 1
        now_s, (a_deg, b_deg) = self._clock.monotonic(), self.place()
        says = {
            "homing": now_s < self._homed_s,
            "status_monotonic_s": now_s - self.status_age_s,
            "a_motor_current_a": 0.0,
            "b_motor_current_a": 0.0,
            **self.telemetry_overrides,
        }
        return Telemetry(now_s, a_deg, b_deg, a_deg, b_deg, *self._to, **says)

    async def disable_autonomy(self):
        self._answer("disable_autonomy")
        self.telemetry_overrides.pop("autonomous", None)

    async def move_to(self, a_deg, b_deg, *, first="a"):
        self._answer("move", a_deg, b_deg, first)
        self.drive(a_deg, b_deg)

    async def stop(self):
        self._answer("stop")
        self._stand()

    async def halt(self):
        self._answer("halt")
        self._stand()
        await asyncio.sleep(DEAF_S if self.is_deaf else 0.3)
        if self.is_deaf:
            raise StillMovingError("hand", "an axis still moves")

    async def home(self, axis):
        self._answer("home", axis)
        self._homed_s = self._clock.monotonic() + self.homes_s

    async def clear_faults(self, *, forgive=True):
        self._answer("clear", forgive)
        before = await self.read_telemetry()
        for name in ("faults", "was_reset", *(("reference_doubt",) if forgive else ())):
            self.telemetry_overrides.pop(name, None)
        return before

    def _answer(self, name, *what):
        self.sent.append((name, *what) if what else name)
        if self.is_lost:
            raise LinkLostError("hand", "does not answer")
        if name in self.refuses:
            raise self.refuses[name]

    def _stand(self):
        if not self.is_deaf:
            self.put(*self.place())
            self._homed_s = -math.inf


class RepeatingFakePositioner(FakePositioner):
    """The same, but `repeated_s` says that its telemetry has not changed, while `shows_the_same`."""

    shows_the_same = True

    def repeated_s(self, _telemetry):
        return self._clock.monotonic() - 0.1 if self.shows_the_same else None


class MotionRig:
    """Motion with everything that it needs, and what it has published."""

    def __init__(self, loop, settings, expected, folder, polling, make):
        self.clock = LoopClock(loop.time, START_UTC_S)
        self.unit = make(self.clock)
        self.records, self.changes = [], 0
        self.alarms = Alarms(self.clock, self.records.append)
        self.motion = Motion(
            self.unit,
            LIMITS,
            MotionSettings(**settings),
            expected,
            self.clock,
            Random(1),
            self.records.append,
            self._changed,
            self.alarms,
            StateFolder(folder),
            polling,
        )

    def _changed(self):
        self.changes += 1

    def records_of(self, kind):
        return [record for record in self.records if isinstance(record, kind)]

    @property
    def positioner_events(self):
        return [event.text for event in self.records_of(Event) if event.subject == "positioner"]

    @property
    def moves(self):
        return self.records_of(Move)

    @property
    def poses(self):
        return self.records_of(Pose)

    @property
    def active_alarms(self):
        return {alarm.name: alarm.text for alarm in self.alarms.active}

    async def until(self, condition, within_s=60.0):
        deadline_s = self.clock.monotonic() + within_s
        while not condition():
            assert self.clock.monotonic() < deadline_s, f"not within {within_s} s; told: {self.positioner_events}"
            await asyncio.sleep(0.05)

    async def wait_until_connected(self):
        await self.until(lambda: self.motion.connected and self.motion.stands_since_s is not None)
        await asyncio.sleep(1.0)


async def wait_out_standstill(rig):
    """Let time pass until every rule that asks for a standstill is satisfied."""
    await asyncio.sleep(30.0)


def run_motion(scenario, *, folder=None, expected=None, polling=OFTEN, connects=True, make=FakePositioner, **settings):
    """Run an async function that is given the rig, with motion running, and return the rig."""
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        rig = MotionRig(runner.get_loop(), settings, expected or PositionerSettings(), folder, polling, make)

        async def beside():
            running = asyncio.create_task(rig.motion.run())
            acting = asyncio.create_task(_act(scenario, rig, connects))
            await asyncio.wait((running, acting), return_when=asyncio.FIRST_COMPLETED)
            running.cancel()
            acting.cancel()
            for outcome in await asyncio.gather(running, acting, return_exceptions=True):
                # pytest's exceptions for a failed test derive from BaseException.
                if isinstance(outcome, BaseException) and not isinstance(outcome, asyncio.CancelledError):
                    raise outcome

        runner.run(beside())
    return rig


async def _act(scenario, rig, connects):
    if connects:
        await rig.wait_until_connected()
    await scenario(rig)
