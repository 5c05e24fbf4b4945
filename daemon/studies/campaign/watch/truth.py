"""The watch: it sees where the axes truly stand, knows what was ordered, and compares both with the promises.

The constants here and the methods that begin with ``_check`` say what each promise is and from when it binds. A promise
binds only while the service can keep it: the unit is plugged in and hears, and a service is there.
"""

import asyncio
import contextlib
import math
from collections.abc import Iterator

from daemon.base.records import Scan
from daemon.base.timeloop import call_until, wait_at_most
from daemon.rigs.campaign.plant import PlantTracker
from daemon.studies.campaign.watch import change_detector
from daemon.studies.campaign.watch.active_orders import AT_TARGET_DEG, RUN_OUT_S, ActiveOrders, AxisCount
from daemon.studies.campaign.watch.count_check import COUNT_CHECK_EVERY_S, CountCheck
from daemon.studies.campaign.watch.decision_check import DecisionCheck
from daemon.studies.campaign.watch.reach import Reach
from daemon.studies.campaign.watch.reporting import Reporting, Violation
from daemon.studies.campaign.watch.scan_check import check_scan
from daemon.studies.campaign.watch.storms import STORM_RESPONSE_S, Storms
from daemon.studies.campaign.watch.target_check import check_target
from drivers.interfaces import AxisName
from solar.frames import Angles

SAMPLE_S = 0.1
IDLE_SAMPLE_S = 2.0
MOVES_DEG = 0.003
"""An axis that turns this far within one sample counts as moving; a thirtieth of its full speed."""

STANDSTILL_S = 0.7
UNEXPLAINED_S = 2.0
SAMPLING_MARGIN_S = 0.15
UNIT_TRIPS_S = 1.5
"""Without Hall pulses nobody but the unit can see an axis move, and it takes 2 s to notice."""
LIMIT_MARGIN_DEG, SLEW_RUN_OUT_DEG = 0.02, 0.06  # A slew drive is sent to a limit in whole units, and runs out beyond.


class TruthWatch:
    """Compares what truly happens with what was promised; it is the `Witness` of one tracker.

    Attributes
    ----------
    mount
        The tracker that is watched.
    violations
        The broken promises.
    stop_latencies_s
        How long after each stop in mid-move the axes truly stood still.
    moving
        Which axes turn.
    blind
        Axes without Hall pulses.
    active_faults
        How many faults are on at present.
    """

    def __init__(self) -> None:
        self.violations: list[Violation] = []
        self.stop_latencies_s: list[float] = []
        self.active_orders = ActiveOrders()
        self.reporting = Reporting(self.add_violation)
        self.storms = Storms(self.add_violation)
        self.decision_check = DecisionCheck(self.add_violation)
        self.reach = Reach()
        self.count_check = CountCheck(self.add_violation)
        self._change_detector = change_detector.ChangeDetector()
        self.moving: dict[AxisName, bool] = {"a": False, "b": False}
        self.blind: set[AxisName] = set()
        self.active_faults = 0
        self._pose: Angles | None = None
        self._sampled_s = -math.inf
        self._wake = asyncio.Event()
        self._fast_until_s = 0.0
        self._last_target_s = -math.inf
        self._unexplained_s: dict[AxisName, float | None] = {"a": None, "b": None}
        self._self_moved_s = -math.inf
        self._stop_s: float | None = None
        self._stop_measured = True
        self._maintenance_s: float | None = None
        self._being_sent = 0
        self._sent_s = -math.inf
        self._noted_failures: set[tuple[str, int]] = set()

    def attach(self, mount: PlantTracker) -> None:
        """Watch a tracker. Its plant is built with this watch, so the watch exists before the tracker."""
        self.mount = mount

    @property
    def now_s(self) -> float:
        """The plant's time."""
        return self.mount.clock.monotonic()

    def add_violation(self, promise: str, text: str) -> None:
        """Take note of a broken promise, the first time in a minute."""
        key = (promise, int(self.now_s // 60))
        if key not in self._noted_failures:
            self._noted_failures.add(key)
            self.violations.append(Violation(promise, self.now_s, f"{self.mount.text_prefix}{text}"))

    # What the taps, the faults and the persons report.

    def note_packet(self, data: bytes, now_s: float) -> None:
        """Take note of a packet that reaches the unit."""
        self.active_orders.note_packet(data, now_s)
        self.wake()

    @contextlib.contextmanager
    def sending(self, target: tuple[float, float]) -> Iterator[None]:
        """Watch a target while it is sent; it counts once the driver says that the unit has taken it."""
        self._check_target(target)
        self._being_sent += 1
        try:
            yield
        finally:
            self._being_sent -= 1
            self._sent_s = self.now_s
        self.active_orders.confirm(*self._unit_counts())

    def note_homing(self, axis: AxisName) -> None:
        """Take note that a reference run is ordered."""
        if self._being_sent:
            self.add_violation("two-targets", f"a reference run of {axis} is ordered while a target is being sent")

    def note_service_start(self) -> None:
        """Take note that a new process is there."""
        self.reach.note_service_start(self.now_s)
        self.decision_check.note_service_start()

    def note_link_change(self) -> None:
        """Take note that a plug was pulled or put back, or that the unit hears or is heard again."""
        self.reach.note_link_change(self.now_s)
        self.wake()

    def note_wake_up(self, slept_s: float) -> None:
        """Take note that the machine has slept for `slept_s`: nobody could see where the axes went meanwhile."""
        self.decision_check.note_wake_up(self.mount, slept_s, self.now_s)
        self.note_link_change()
        self._pose = None

    def note_deafness(self, *, is_deaf: bool) -> None:
        """Take note that the unit takes no commands, or takes them again."""
        self.reach.note_deafness(self.now_s, is_deaf=is_deaf)
        self.wake()

    def note_hall_pulses_back(self, axis: AxisName) -> None:
        """Take note that an axis gives Hall pulses again: nobody could see what it did without them."""
        self.blind.discard(axis)
        self._unexplained_s[axis] = None

    def note_self_motion(self) -> None:
        """Take note that the unit may move by itself from now on."""
        self._self_moved_s = self.now_s
        self.wake()

    def note_stop_request(self) -> None:
        """Take note of a person's stop."""
        self._stop_s, self._stop_measured = self.now_s, not (self._live(self.now_s) and any(self.moving.values()))
        self.wake()

    def note_stop_release(self) -> None:
        """Take note that a person has released the stop."""
        self._stop_s, self._stop_measured = None, True

    def note_maintenance_start(self) -> None:
        """Take note of maintenance."""
        if self._maintenance_s is None:
            self._maintenance_s = self.now_s
        self._change_detector.forget()

    def note_maintenance_end(self) -> None:
        """Take note that maintenance is over, or was refused."""
        self._maintenance_s = None

    def note_gust(self) -> None:
        """Take note that the wind has been strong for more than a second."""
        if self.mount.is_served and self.now_s - self.reach.begun_s > STORM_RESPONSE_S:
            self.storms.gust_s = self.now_s
            self._change_detector.forget()

    def note_scan(self, scan: Scan) -> None:
        """Take note of a scan that the service has accepted."""
        check_scan(scan, self.add_violation)

    @property
    def is_stopped(self) -> bool:
        """Whether a person's stop is latched."""
        return self._stop_s is not None

    @property
    def is_in_maintenance(self) -> bool:
        """Whether the tracker is in maintenance."""
        return self._maintenance_s is not None

    @property
    def stop_asked_s(self) -> float:
        """When the latched stop was asked for; infinite without one."""
        return math.inf if self._stop_s is None else self._stop_s

    def was_disturbed(self, within_s: float) -> bool:
        """Tell whether a fault or a hand may have moved an axis lately."""
        now_s, since_s = self.now_s, max(self._self_moved_s, self.reach.since_s, self.count_check.lost_s)
        return now_s - since_s < within_s or self.active_orders.by_hand(now_s)

    def note_disturbance(self) -> None:
        """Take note that a fault begins or ends, or that a person gives a command."""
        self.reporting.note_cause(self.now_s)
        self.storms.note_disturbance(self.now_s)
        self.wake()

    def wake(self) -> None:
        """Sample often for a while: something may begin to move."""
        self._fast_until_s = max(self._fast_until_s, self.now_s + 1.0)
        self._change_detector.forget()
        self._wake.set()

    async def run(self) -> None:
        """Sample until cancelled."""
        while True:
            self.sample()
            if not self._rests():
                await call_until(SAMPLE_S, self._sample_and_rest)
            self._wake.clear()
            due_s = self.mount.unit.next_event(self.now_s)
            wait_s = IDLE_SAMPLE_S if due_s is None else min(max(due_s - self.now_s, SAMPLE_S), IDLE_SAMPLE_S)
            await wait_at_most(self._wake, wait_s)

    def _rests(self) -> bool:
        return not any(self.moving.values()) and self.now_s >= self._fast_until_s

    def _sample_and_rest(self) -> bool:
        self.sample()
        return self._rests()

    def sample(self) -> None:
        """Compare truth and promises once."""
        now_s, at = self.now_s, self.mount.axes()
        before, gone_s, self._pose = self._pose, now_s - self._sampled_s, at
        self._sampled_s = now_s
        if self.mount.motion.target is not None:
            self._last_target_s = now_s
        if before is None or gone_s <= 0:
            self._examine(at, at, 0.0, now_s)
            return
        least_deg = MOVES_DEG * min(gone_s / SAMPLE_S, 1.0)
        turns = change_detector.turning(before, at, least_deg)
        if not self._change_detector.is_unchanged(self.mount, turns, now_s):
            self._change_detector.forget()
            until_s = self._examine(before, at, least_deg, now_s)
            if until_s > now_s:
                self._change_detector.note(self.mount, now_s, turns, until_s)
        elif turns != change_detector.STANDS:
            self._note_motion(now_s)

    def _examine(self, before: Angles, at: Angles, least_deg: float, now_s: float) -> float:
        """Return until when [s] another look finds the same if nothing changes; -inf if time alone breaks a promise."""
        self.reach.sample(self.mount, now_s)
        live = self._live(now_s)
        until_s = min(
            self._check_axis("a", at.a_deg, at.a_deg - before.a_deg, least_deg, now_s, live=live),
            self._check_axis("b", at.b_deg, at.b_deg - before.b_deg, least_deg, now_s, live=live),
        )
        self._check_stop(now_s, live=live)
        self._check_reference(at, now_s)
        if not any(self.moving.values()):
            until_s = min(until_s, self.count_check.compared_s + COUNT_CHECK_EVERY_S)
        # The storm itself is one of the faults.
        self.storms.excused = self.active_faults > 1 or self.count_check.excused or self.count_check.wrong_s is not None
        self.storms.check(self.mount, self.mount.truth(), now_s, self.reach.since_s, live=live)
        if live:
            self.reporting.check(self.mount, now_s, by_hand=self.active_orders.by_hand(now_s))
        else:
            self.reporting.forget()
        waits = self.is_stopped or self.is_in_maintenance or self.storms.is_pending(now_s) or self.reporting.is_pending
        return until_s if live and not waits and not self.active_orders.by_hand(now_s) else -math.inf

    def _note_motion(self, now_s: float) -> None:
        self._fast_until_s = max(self._fast_until_s, now_s + 0.5)

    def _check_axis(
        self, axis: AxisName, at_deg: float, turned_deg: float, least_deg: float, now_s: float, *, live: bool
    ) -> float:
        """Return until when [s] the same reason explains the motion if nothing changes; -inf if none is sure to."""
        moving = self.moving[axis] = abs(turned_deg) > least_deg
        if not moving:
            self._unexplained_s[axis] = None
            return math.inf
        self._note_motion(now_s)
        counted = self._unit_count(axis)
        motion, left_deg = self.mount.motion, counted.left_deg
        # A move has arrived once it is within its tolerance; the axis may still turn through the rest.
        heads_until_s = self._last_target_s + RUN_OUT_S
        has_arrived = left_deg <= self.mount.settings.motion.tolerance_deg
        heading = motion.target is not None or (has_arrived and now_s < heads_until_s)
        counts_up = (turned_deg > 0.0) is not self.mount.is_lowered(axis)
        why = self.active_orders.why(axis, counted, now_s, counts_up=counts_up, homing=motion.homing, heading=heading)
        if why is None:
            # This justifies an alarm, whatever the count says, and however late a service starts and raises it.
            self.reporting.note_cause(now_s)
        if not live:
            self._unexplained_s[axis] = None
            return -math.inf
        if why is None:
            self._check_unexplained(axis, at_deg, now_s)
            # One axis may have taken a target that the other did not take: the move fails, and that is reported.
            if not self._being_sent and now_s - self._sent_s > UNEXPLAINED_S and self._counts(axis, at_deg):
                self.reporting.note_unexplained_motion(turned_deg, now_s, by_position=self.active_orders.by_position)
            return -math.inf
        self._unexplained_s[axis] = None
        self.reporting.note_standstill()
        if why == "order":
            limit_s = self._check_limits(axis, at_deg, turned_deg) / change_detector.FASTEST_DEG_PER_S
            until_s = now_s + min((left_deg - AT_TARGET_DEG) / change_detector.FASTEST_COUNTED_DEG_PER_S, limit_s)
            return until_s if motion.target is not None else min(until_s, heads_until_s)
        return math.inf if why == "home" else -math.inf

    def _live(self, now_s: float) -> bool:
        return self.reach.can_keep_promises(self.mount, now_s)

    def _unit_counts(self) -> tuple[AxisCount, AxisCount]:
        """Return what the unit itself says of the axes A and B."""
        return self._unit_count("a"), self._unit_count("b")

    def _unit_count(self, axis: AxisName) -> AxisCount:
        return AxisCount(*self.mount.unit.position_and_destination(axis, self.now_s), self.mount.units_per_deg(axis))

    # The promises.

    def _check_unexplained(self, axis: AxisName, at_deg: float, now_s: float) -> None:
        since_s = self._unexplained_s[axis]
        if since_s is None:
            self._unexplained_s[axis] = now_s - SAMPLE_S
        elif now_s - since_s > UNEXPLAINED_S + SAMPLING_MARGIN_S + (UNIT_TRIPS_S if axis in self.blind else 0.0):
            motion, control = self.mount.motion, self.mount.control
            self.add_violation(
                "unexplained-motion",
                f"axis {axis} has moved for {now_s - since_s:.1f} s without an order and stands at {at_deg:.2f} deg;"
                f" mode {control.mode}: {control.why}; target {motion.target}",
            )

    def _check_limits(self, axis: AxisName, at_deg: float, turned_deg: float) -> float:
        """Return how far it is to the limit that the axis turns to [deg]; below 0 beyond it."""
        low, high = self.mount.range_deg(axis)
        beyond_deg = low - at_deg if turned_deg < 0 else at_deg - high
        margin_deg = SLEW_RUN_OUT_DEG if self.mount.has_slew_drives else LIMIT_MARGIN_DEG
        if beyond_deg > margin_deg and self._counts(axis, at_deg):
            self.add_violation("limits", f"axis {axis} is driven to {at_deg:.3f} deg, beyond {low:g} to {high:g}")
        return -beyond_deg

    def _check_stop(self, now_s: float, *, live: bool) -> None:
        if self._stop_s is None and self._maintenance_s is None:
            return
        moving = any(self.moving.values())
        if not live:
            self._stop_measured = True
        if self._stop_s is not None and not self._stop_measured and not moving:
            self._stop_measured = True
            self.stop_latencies_s.append(now_s - self._stop_s)
        if not moving or not live or self.active_orders.by_hand(now_s):
            return
        since_s = self._stop_s if self._stop_s is not None else self._maintenance_s
        assert since_s is not None  # noqa: S101 - narrowing; one of the two is on
        itself_s = UNEXPLAINED_S + (UNIT_TRIPS_S if any(self.moving[axis] for axis in self.blind) else 0.0)
        free_s = max(since_s + STANDSTILL_S, self._self_moved_s + itself_s) + SAMPLING_MARGIN_S
        if now_s > free_s:
            kind = "stop" if self._stop_s is not None else "maintenance"
            axes = " and ".join(axis for axis, moves in self.moving.items() if moves)
            self.add_violation(
                f"moves-under-{kind}",
                f"axis {axes} moves {now_s - since_s:.1f} s after {kind} and stands at {self._pose};"
                f" mode {self.mount.control.mode}: {self.mount.control.why}",
            )

    def _counts(self, axis: AxisName, at_deg: float) -> bool:
        return self.count_check.is_count_true(self.mount, axis, at_deg, self.now_s)

    def is_wrong(self) -> bool:
        """Tell whether the unit's count is wrong."""
        return self.count_check.is_wrong(self.mount, self._pose or self.mount.axes(), self.now_s)

    def _check_reference(self, at: Angles, now_s: float) -> None:
        if not any(self.moving.values()) and self.mount.is_served:
            since_s = max(self.reach.since_s, self.reach.connected_s)
            self.count_check.check(self.mount, at, now_s, since_s, blind=bool(self.blind), live=self._live(now_s))

    def _check_target(self, target: tuple[float, float]) -> None:
        control, now_s = self.mount.control, self.now_s
        check_target(self.mount, target, self.add_violation)
        if self._being_sent:
            self.add_violation("two-targets", f"{target} is sent while another target is being sent")
        itself = now_s - self._self_moved_s < 10.0 or self.active_orders.by_hand(now_s)
        seen = self._pose is not None and self._counts("a", self._pose.a_deg) and self._counts("b", self._pose.b_deg)
        # Without Hall pulses an axis seems to stand, until the unit notices.
        moves = any(moves for axis, moves in self.moving.items() if axis not in self.blind)
        if moves and now_s - self._sampled_s <= SAMPLING_MARGIN_S and seen and not itself and self._live(now_s):
            self.add_violation("two-targets", f"{target} is sent while an axis moves ({self.moving})")
        if self._stop_s is not None and self.mount.is_served and now_s > self._stop_s:
            self.add_violation("moves-under-stop", f"{target} is sent under a stop; mode {control.mode}: {control.why}")
        self.decision_check.check(self.mount, target, now_s, self.reach.begun_s)
