"""The recorder: it sees where the axes truly stand, knows what was ordered, and holds both against the promises.

What the promises are, and from when on each of them binds, is in the constants here and in the methods that begin with
``_check``. A promise binds only while the service can keep it: the unit plugged in, hearing, and a service there.
"""

import asyncio
import contextlib
import math
from dataclasses import dataclass

from daemon.base.records import Mode
from drivers.positioners.pozsol.wire import Field, TokenStream
from tests.campaign.explain import Explained
from tests.campaign.storms import STORM_S, Storms
from tests.campaign.telling import Telling

SAMPLE_S = 0.1
IDLE_SAMPLE_S = 2.0
MOVES_DEG = 0.003
"""What an axis turns within one sample at least to count as moving; a thirtieth of its full speed."""

STANDSTILL_S = 0.7
UNEXPLAINED_S = 2.0
SAMPLING_S = 0.15
UNIT_TRIPS_S = 1.5
"""Without Hall pulses nobody but the unit can see an axis move, and it takes 2 s to notice."""
CONNECTED_S = 2.0
"""From the first telemetry on the service has this long before everything binds."""
CONNECTS_WITHIN_S = 15.0
HEARS_AGAIN_S = 6.0
"""After a unit was deaf: the service's pauses between stops may have grown by then."""
LIMIT_DEG = 0.02
COUNTED_DEG = 0.02
REFERENCE_DEG = 0.8
REFERENCE_EVERY_S = 5.0
DOUBTS_WITHIN_S = 30.0
STALE_S = 16.0
CLOCK_SETTLES_S = 890.0
CLOCK_STEP_S = 30.0


@dataclass(frozen=True, slots=True)
class Violation:
    """A broken promise: its name, when, and what was seen."""

    promise: str
    at_s: float
    text: str

    def __str__(self):
        return f"{self.promise} at {self.at_s:.2f} s: {self.text}"


class Watch:
    """Holds what truly happens against what was promised."""

    def __init__(self):
        self.plant = None
        self.violations = []
        self.stop_latencies_s = []
        self.explained = Explained()
        self.telling = Telling(self.fails)
        self.storms = Storms(self.fails)
        self.moving = {"a": False, "b": False}
        self._at = None
        self._sampled_s = -math.inf
        self._wake = asyncio.Event()
        self._fast_until_s = 0.0
        self._unexplained_s = {"a": None, "b": None}
        self._begun_s = 0.0
        self._connected_s = math.inf
        self._connected = False
        self._reachable_s = 0.0
        self._grace_s = 0.0
        self._deaf = False
        self._self_moved_s = -math.inf
        self._stop_s = None
        self._stop_measured = True
        self._maintenance_s = None
        self._wrong_s = None
        self._compared_s = -math.inf
        self.reference_excused = False
        self._stepped_s = -math.inf
        self._sendings = 0
        self._sent_s = -math.inf
        self.blind = set()
        self._told = set()
        self._screens, self._read = b"", {}

    @property
    def now_s(self):
        return self.plant.clock.monotonic()

    def fails(self, promise, text):
        """Take note of a broken promise, the first time in a minute."""
        key = (promise, int(self.now_s // 60))
        if key not in self._told:
            self._told.add(key)
            self.violations.append(Violation(promise, self.now_s, text))

    # What the taps, the faults and the persons tell.

    def heard(self, data, now):
        """A packet reaches the unit."""
        self.explained.packet(data, now)
        self.wake()

    @contextlib.contextmanager
    def sending(self, target):
        """A target is being sent; it counts once the driver says that the unit has taken it."""
        self._check_target(target)
        self._sendings += 1
        try:
            yield
        finally:
            self._sendings -= 1
            self._sent_s = self.now_s
        self.explained.confirmed(target, self._readings(), self.now_s)

    def homes(self, axis):
        if self._sendings:
            self.fails("two-targets", f"a reference run of {axis} is ordered while a target is being sent")

    def service_begins(self):
        self._begun_s = self.now_s
        self._connected, self._connected_s, self._reachable_s, self._grace_s = False, math.inf, self.now_s, 0.0

    def link_changes(self):
        """A plug was pulled or put back, or the unit hears again."""
        self._reachable_s, self._grace_s = self.now_s, 0.0
        self.wake()

    def deaf(self, *, is_deaf):
        self._deaf = is_deaf
        self._reachable_s = self.now_s
        self._grace_s = HEARS_AGAIN_S
        self.wake()

    def moves_itself(self):
        """The unit may move by itself from now on."""
        self._self_moved_s = self.now_s
        self.wake()

    def stop_is_asked(self):
        self._stop_s, self._stop_measured = self.now_s, not (self._live(self.now_s) and any(self.moving.values()))
        self.wake()

    def stop_is_released(self):
        self._stop_s = None
        self._stop_measured = True

    def maintenance_begins(self):
        if self._maintenance_s is None:
            self._maintenance_s = self.now_s

    def maintenance_ends(self):
        self._maintenance_s = None

    def gust(self):
        """The wind has been strong for more than a second."""
        if self.plant.is_served and self.now_s - self._begun_s > STORM_S:
            self.storms.gust_s = self.now_s

    def clock_steps(self):
        self._stepped_s = self.now_s

    @property
    def stopped(self):
        """Whether a person's stop is latched."""
        return self._stop_s is not None

    @property
    def maintained(self):
        """Whether the tracker is in maintenance."""
        return self._maintenance_s is not None

    @property
    def stop_asked_s(self):
        return self._stop_s

    def disturbed(self, within_s):
        """Whether a fault or a hand may have moved an axis lately."""
        now_s = self.now_s
        return now_s - max(self._self_moved_s, self._reachable_s) < within_s or self.explained.by_hand(now_s)

    def disturbs(self):
        """A fault begins or ends."""
        self.telling.cause(self.now_s)
        self.wake()

    def wake(self):
        """Look closely for a while: something may begin to move."""
        self._fast_until_s = max(self._fast_until_s, self.now_s + 1.0)
        self._wake.set()

    async def run(self):
        """Sample until cancelled."""
        while True:
            self.sample()
            if any(self.moving.values()) or self.now_s < self._fast_until_s:
                await asyncio.sleep(SAMPLE_S)
                continue
            self._wake.clear()
            due_s = self.plant.unit.next_event(self.now_s)
            wait_s = IDLE_SAMPLE_S if due_s is None else min(max(due_s - self.now_s, SAMPLE_S), IDLE_SAMPLE_S)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._wake.wait()

    def sample(self):
        """Look at the truth once."""
        now_s, at = self.now_s, self.plant.truth()
        before, gone_s, self._at = self._at, now_s - self._sampled_s, at
        self._sampled_s = now_s
        self._note_connection(now_s)
        if before is not None and gone_s > 0:
            least = MOVES_DEG * min(gone_s / SAMPLE_S, 1.0)
            for axis, was, is_now in (("a", before.a_deg, at.a_deg), ("b", before.b_deg, at.b_deg)):
                self._look_at_axis(axis, is_now, is_now - was, least, now_s)
        self._check_stop(now_s)
        self._check_reference(now_s)
        self.storms.look(self.plant, now_s, self._reachable_s, live=self._live(now_s))
        if self._live(now_s):
            self.telling.look(self.plant, now_s)
        else:
            self.telling.forget()

    def _look_at_axis(self, axis, at_deg, turned_deg, least_deg, now_s):
        moving = self.moving[axis] = abs(turned_deg) > least_deg
        if not moving:
            self._unexplained_s[axis] = None
            return
        self._fast_until_s = max(self._fast_until_s, now_s + 0.5)
        homing = self.plant.motion.homing
        heading = self.plant.motion.target is not None
        why = self.explained.why(axis, turned_deg, self._readings(), now_s, homing=homing, heading=heading)
        if not self._live(now_s):
            self._unexplained_s[axis] = None
            return
        if why is None:
            self._check_unexplained(axis, at_deg, now_s)
            # One axis may have taken a target that the other did not take: the move fails, and that is told.
            if not self._sendings and now_s - self._sent_s > UNEXPLAINED_S and self._counts(axis, at_deg):
                self.telling.unexplained(turned_deg, now_s)
        else:
            self._unexplained_s[axis] = None
            self.telling.stands()
            if why == "order":
                self._check_limits(axis, at_deg, turned_deg)

    def _note_connection(self, now_s):
        connected = self.plant.is_served and self.plant.motion.connected
        if connected and not self._connected:
            self._connected_s = now_s
        self._connected = connected

    @property
    def reachable(self):
        return self.plant.is_served and self.plant.plugged["positioner"] and not self._deaf

    def _live(self, now_s):
        """Whether the service can keep its promises: it has had time to connect and to be heard."""
        if not self.reachable:
            return False
        if now_s - self._reachable_s > CONNECTS_WITHIN_S:
            return True
        since_s = max(self._connected_s, self._reachable_s)
        return self._connected and now_s - since_s > max(CONNECTED_S, self._grace_s)

    def _readings(self):
        """What the unit itself says of its axes: position and destination of each, and the angles."""
        screens = self.plant.unit.live_screens(self.now_s)
        if screens != self._screens:
            found = dict(TokenStream().feed(screens + b"$"))
            self._screens, self._read = (
                screens,
                {
                    "a": (float(found[Field.A_POSITION]), float(found[Field.A_DESTINATION])),
                    "b": (float(found[Field.B_POSITION]), float(found[Field.B_DESTINATION])),
                    "angles": (float(found[Field.A_ANGLE]), float(found[Field.B_ANGLE])),
                },
            )
        return self._read

    # The promises.

    def _check_unexplained(self, axis, at_deg, now_s):
        since_s = self._unexplained_s[axis]
        if since_s is None:
            self._unexplained_s[axis] = now_s - SAMPLE_S
        elif now_s - since_s > UNEXPLAINED_S + SAMPLING_S + (UNIT_TRIPS_S if axis in self.blind else 0.0):
            motion, control = self.plant.motion, self.plant.control
            self.fails(
                "unexplained-motion",
                f"axis {axis} has moved for {now_s - since_s:.1f} s without an order and stands at {at_deg:.2f} deg;"
                f" mode {control.mode}: {control.why}; target {motion.target}",
            )

    def _check_limits(self, axis, at_deg, turned_deg):
        limits = self.plant.service.settings.limits
        low, high = (limits.a_min_deg, limits.a_max_deg) if axis == "a" else (limits.b_min_deg, limits.b_max_deg)
        beyond_deg = low - at_deg if turned_deg < 0 else at_deg - high
        if beyond_deg > LIMIT_DEG and self._counts(axis, at_deg):
            self.fails("limits", f"axis {axis} is driven to {at_deg:.3f} deg, beyond {low:g} to {high:g}")

    def _check_stop(self, now_s):
        if self._stop_s is None and self._maintenance_s is None:
            return
        moving = any(self.moving.values())
        if not self._live(now_s):
            self._stop_measured = True
        if self._stop_s is not None and not self._stop_measured and not moving:
            self._stop_measured = True
            self.stop_latencies_s.append(now_s - self._stop_s)
        if not moving or not self._live(now_s) or self.explained.by_hand(now_s):
            return
        since_s = self._stop_s if self._stop_s is not None else self._maintenance_s
        free_s = max(since_s + STANDSTILL_S, self._self_moved_s + UNEXPLAINED_S) + SAMPLING_S
        if now_s > free_s:
            kind = "stop" if self._stop_s is not None else "maintenance"
            axes = " and ".join(axis for axis, moves in self.moving.items() if moves)
            self.fails(
                f"moves-under-{kind}",
                f"axis {axes} moves {now_s - since_s:.1f} s after {kind} and stands at {self._at};"
                f" mode {self.plant.control.mode}: {self.plant.control.why}",
            )

    def _counts(self, axis, at_deg):
        """Whether the unit's count of an axis is the truth, to a hair."""
        setup = self.plant.unit.setup
        actuator = setup.a_actuator if axis == "a" else setup.b_actuator
        return abs(actuator.angle_deg(self._readings()[axis][0]) - at_deg) < COUNTED_DEG

    def is_wrong(self):
        """Whether the unit's count is not what is true."""
        says, at = self._readings()["angles"], self._at or self.plant.truth()
        return max(abs(says[0] - at.a_deg), abs(says[1] - at.b_deg)) > REFERENCE_DEG

    def _check_reference(self, now_s):
        if any(self.moving.values()) or not self.plant.is_served or now_s - self._compared_s < REFERENCE_EVERY_S:
            return
        self._compared_s = now_s
        if not self.is_wrong():
            self._wrong_s = None
            # What is a hair at one angle may be a degree at another.
            true = self._counts("a", self._at.a_deg) and self._counts("b", self._at.b_deg)
            self.reference_excused = self.reference_excused and bool(self.blind or not true)
            return
        if self._wrong_s is None:
            self._wrong_s = now_s
        motion, control = self.plant.motion, self.plant.control
        tracks = control.mode in (Mode.TRACKING, Mode.FALLBACK, Mode.NIGHT)
        since_s = max(self._wrong_s, self._reachable_s, self._connected_s if self._connected else math.inf)
        late = now_s - since_s > DOUBTS_WITHIN_S
        if tracks and late and not self.reference_excused and motion.doubt is None and self._live(now_s):
            self.fails(
                "believes-a-wrong-count",
                f"the unit says {self._readings()['angles']}, the truth is {self._at}; mode {control.mode}, no doubt",
            )

    def _check_target(self, target):
        control, now_s = self.plant.control, self.now_s
        if self._sendings:
            self.fails("two-targets", f"{target} is sent while another target is being sent")
        itself = now_s - self._self_moved_s < 10.0 or self.explained.by_hand(now_s)
        seen = self._at is not None and self._counts("a", self._at.a_deg) and self._counts("b", self._at.b_deg)
        near = now_s - self._sampled_s <= SAMPLING_S
        if any(self.moving.values()) and near and seen and not itself and self._live(now_s):
            self.fails("two-targets", f"{target} is sent while an axis moves ({self.moving})")
        if self._stop_s is not None and self.plant.is_served and now_s > self._stop_s:
            self.fails("moves-under-stop", f"{target} is sent under a stop; mode {control.mode}: {control.why}")
        # A second try of the same move is no new decision.
        begins = now_s - self.plant.motion.last_move_started_s < 1.0
        if begins and control.mode is Mode.TRACKING and control.state.scan_age_s > STALE_S:
            self.fails("stale", f"{target} is sent in tracking on readings {control.state.scan_age_s:.0f} s old")
        # A process that began after the step has never known another time.
        known = self._stepped_s > self._begun_s
        wrong_clock = (
            known and abs(self.plant.clock.step_s) > CLOCK_STEP_S and now_s - self._stepped_s < CLOCK_SETTLES_S
        )
        if wrong_clock and control.mode in (Mode.FALLBACK, Mode.NIGHT) and now_s - self._stepped_s > 1.0:
            step_s = self.plant.clock.step_s
            self.fails(
                "clock", f"{target} is sent in mode {control.mode} with the clock off by {step_s:g} s: {control.why}"
            )
